"""The damage law: onset, criterion, the uniaxial curve and what it dissipates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_tensor import full

from jaxmpm import tensor
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.law import Inside
from jaxmpm.laws.smeared import softening_at

SIZES = pytest.mark.parametrize("size", [1, 3, 4, 6])
BULK = Elastic(32000.0, 0.2)
LAW = Damage(3.0, 8.184, 0.128, 0.05)

# E, f_t, E_p, n, h of Nguyen's examples and the dissipation of a crack that they imply, N/mm
SETS = [
    (32000.0, 3.0, 8.184, 0.128, 0.05, 0.110036),
    (45000.0, 3.0, 10.0, 0.179, 0.005, 0.0185721),
    (30000.0, 2.0, 10.0, 0.179, 0.005, 0.00755607),
    (30000.0, 1.5, 20.0, 0.179, 0.005, 0.00182723),
]
EVERY_SET = pytest.mark.parametrize("E, ft, Ep, n, h, expected", SETS)


def ratio_of_tensors(stress, E, nu, ft):
    """sqrt(E s+ : C : s+) / f_t with the full tensors and the elastic compliance C."""
    values, vectors = np.linalg.eigh(full(stress))
    positive = np.einsum("kip,kp,kjp->kij", vectors, np.maximum(values, 0), vectors)
    trace = np.trace(positive, axis1=1, axis2=2)[:, None, None]
    strain = ((1 + nu) * positive - nu * trace * np.eye(3)) / E
    return np.sqrt(E * np.einsum("kij,kij->k", positive, strain)) / ft


@SIZES
def test_onset_is_that_of_full_tensors(size):
    rng = np.random.default_rng(size)
    stress = rng.normal(size=(2000, size)) * 3
    stress[:10] = 0
    if size > 1:
        stress[10:50, tensor.NORMALS[size] :] = 0
        stress[10:50, 1] = stress[10:50, 0]  # equal principal values
    ratio = np.asarray(jax.jit(jax.vmap(lambda s: LAW.onset(s, BULK)))(stress))
    np.testing.assert_allclose(ratio, ratio_of_tensors(stress, 32000, 0.2, 3), atol=1e-12)
    pressed = jnp.zeros(size).at[: tensor.NORMALS[size]].set(-3.0)
    assert LAW.onset(pressed, BULK) == 0
    np.testing.assert_allclose(LAW.onset(jnp.zeros(size).at[0].set(3.0), BULK), 1, rtol=1e-14)


@SIZES
def test_onset_has_a_finite_and_right_derivative(size):
    """By central differences; where principal values coincide, and without stress, finite."""
    rng = np.random.default_rng(0)
    stress = jnp.asarray(rng.normal(size=(500, size)) * 3)
    onset = jax.jit(jax.vmap(lambda s: LAW.onset(s, BULK)))
    gradient = jax.jit(jax.vmap(jax.grad(lambda s: LAW.onset(s, BULK))))
    step = 1e-5
    quotient = np.stack(
        [(onset(stress + step * u) - onset(stress - step * u)) / (2 * step) for u in np.eye(size)],
        1,
    )
    exact, ratio = np.asarray(gradient(stress)), np.asarray(onset(stress))
    smooth = ratio > 0.05
    # a principal value that changes sign within the step spoils the quotient of a few
    error = np.abs(exact - quotient).max(1)[smooth]
    assert smooth.sum() > 200 and np.quantile(error, 0.98) < 1e-8
    equal = jnp.zeros(size).at[: tensor.NORMALS[size]].set(2.0)
    special = jnp.stack([jnp.zeros(size), equal, -equal])
    assert np.isfinite(gradient(special)).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_curve_fulfils_the_criterion(dtype):
    """r̂ (s + e sⁿ) = 1 + e sⁿ, and nothing is lost where 1 − D is below round-off."""
    softening = np.r_[0, np.geomspace(1e-6, 80, 400)].astype(dtype)
    for E, ft, Ep, n, h, _ in SETS:
        law, bulk = (
            jax.tree.map(dtype, tree) for tree in (Damage(ft, Ep, n, h), Elastic(E, 0.2))
        )
        ratio, s = (np.asarray(a) for a in law.soften(jnp.asarray(softening), bulk))
        assert ratio.dtype == s.dtype == dtype and ratio[0] == s[0] == 1
        r, e, sn = ratio.astype(float), Ep / E, np.exp(-n * softening.astype(float))
        left = r * (np.exp(-softening.astype(float)) + e * sn) / (1 + e * sn)
        # an error of eps in p is one of eps p in its exponential
        assert (np.abs(left - 1) / (1 + softening)).max() < 8 * np.finfo(dtype).eps
        assert (np.diff(ratio[1:]) >= 0).all() and (s > 0).all()


def test_softening_is_found_back_from_the_ratio_and_has_its_derivatives():
    rng = np.random.default_rng(2)
    softening = 10 ** rng.uniform(-3, 1.8, 400)
    e, n = 10 ** rng.uniform(-4, -2, 400), rng.uniform(0.05, 0.45, 400)
    curve = lambda p, e, n: Damage(1.0, e, n, 1.0).soften(p, Elastic(1.0, 0.0))[0]  # noqa: E731
    ratio = curve(softening, e, n)
    np.testing.assert_allclose(softening_at(ratio, e, n), softening, rtol=1e-9, atol=1e-12)
    # p(r̂(p, e, n), e, n) = p in each of its variables
    one, zero = np.ones(400), np.zeros(400)
    back = lambda p, e, n: softening_at(curve(p, e, n), e, n)  # noqa: E731
    for tangents, expected in (((one, zero, zero), 1), ((zero, one, zero), 0), ((zero, zero, one), 0)):
        _, change = jax.jvp(back, (softening, e, n), tangents)
        scale = 1 + softening / np.minimum(e, 1) * tangents[1] + softening**2 * tangents[2]
        np.testing.assert_allclose(change / scale, expected / scale, atol=1e-7)


@SIZES
def test_effective_traction_is_that_of_the_elastic_band(size):
    """Eq. 3 and Hooke's law with full tensors in NumPy."""
    rng = np.random.default_rng(size)
    count = tensor.DIMENSION[size]
    normal = rng.normal(size=count)
    normal /= np.linalg.norm(normal)
    jump, onset = rng.normal(size=count) * 1e-4, rng.normal(size=size) * 1e-4
    inside = Inside(*map(jnp.asarray, (jump, onset, normal)))
    traction, ratio = LAW.effective(inside, BULK)
    n3, w3 = (np.pad(v, (0, 3 - count)) for v in (normal, jump))
    strain = full(onset[None], 0.5)[0] + (np.outer(n3, w3) + np.outer(w3, n3)) / 2 / 0.05
    E, nu = 32000.0, 0.2
    if size == 1:
        stress = E * np.diag([strain[0, 0], 0, 0])
    else:
        if size == 3:
            strain[2, 2] = -nu / (1 - nu) * (strain[0, 0] + strain[1, 1])
        lame = E * nu / ((1 + nu) * (1 - 2 * nu))
        stress = lame * np.trace(strain) * np.eye(3) + E / (1 + nu) * strain
    np.testing.assert_allclose(traction, (stress @ n3)[:count], rtol=1e-12, atol=1e-10)
    values = np.maximum(np.linalg.eigvalsh(stress), 0)
    square = (1 + nu) * (values**2).sum() - nu * values.sum() ** 2
    np.testing.assert_allclose(ratio, np.sqrt(square) / 3.0, rtol=1e-12)


# ------------------------------------------------------------------ dissipation


def quadrature(E, ft, Ep, n, h, last):
    """h ∫ F(D) dD up to a softening, by trapezoids in ln s."""
    p = np.linspace(0, 1, 400001) ** 2 * last
    s, e = np.exp(-p), Ep / E
    ratio = (1 + e * s**n) / (s + e * s**n)
    return h * ft**2 / (2 * E) * np.trapezoid(ratio**2 * s, p)


@EVERY_SET
def test_dissipation_in_closed_form_is_that_of_quadrature(E, ft, Ep, n, h, expected):
    law, bulk = Damage(ft, Ep, n, h), Elastic(E, 0.2)
    for last in (1e-3, 0.3, 4.0, 9.0, 15.0, 60.0):
        found = float(law.given_up(jnp.asarray(last), bulk))
        assert found == pytest.approx(quadrature(E, ft, Ep, n, h, last), rel=1e-7)
    assert float(law.given_up(jnp.asarray(300.0), bulk)) == pytest.approx(expected, rel=5e-6)


@pytest.mark.parametrize("n", [1e-4, 0.128, 0.3, 0.45, 0.499])
@pytest.mark.parametrize("dtype, limit", [(np.float64, 1e-8), (np.float32, 3e-5)])
def test_fracture_energy_is_that_of_quadrature_up_to_n_of_a_half(n, dtype, limit):
    last = 40 / (1 - 2 * n) + 40  # what is left falls as exp(-(1 - 2n) p)
    p = np.linspace(0, 1, 400001) ** 3 * last
    e = 8.184 / 32000
    ratio = np.log1p(e * np.exp(-n * p)) - np.logaddexp(-p, np.log(e) - n * p)  # ln r̂
    exact = 0.05 * 9 / 64000 * np.trapezoid(np.exp(2 * ratio - p), p)
    law, bulk = (
        jax.tree.map(dtype, tree) for tree in (Damage(3.0, 8.184, n, 0.05), Elastic(32e3, 0.2))
    )
    found = jax.jit(lambda law, bulk: law.fracture_energy(bulk))(law, bulk)
    assert found.dtype == dtype and float(found) == pytest.approx(exact, rel=limit)


def test_dissipation_has_the_derivatives_of_differences():
    def given(variables):
        ft, Ep, n, h, E, p = jnp.exp(variables)
        return Damage(ft, Ep, n, h).given_up(p, Elastic(E, 0.2))

    for p in (0.5, 8.0, 30.0):
        at = jnp.log(jnp.array([3.0, 8.184, 0.128, 0.05, 32000.0, p]))
        exact = jax.jacfwd(given)(at)
        np.testing.assert_allclose(jax.jacrev(given)(at), exact, rtol=1e-9, atol=1e-14)
        step = 1e-5
        for k, unit in enumerate(np.eye(6)):
            quotient = (given(at + step * unit) - given(at - step * unit)) / (2 * step)
            assert float(exact[k]) == pytest.approx(float(quotient), rel=1e-5, abs=1e-11)


def test_largest_size_is_where_the_point_snaps_back():
    """The slope of bulk and band in series turns vertical: (1 - f) / E = f / Ep at f = h / H."""
    f = 0.05 / float(LAW.largest_size(BULK))
    assert (1 - f) / 32000 == pytest.approx(f / 8.184, rel=1e-12)
    assert float(LAW.largest_size(BULK)) == pytest.approx(195.6, abs=0.06)
    mortar = Damage(2.0, 10.0, 0.179, 0.005)
    assert float(mortar.largest_size(Elastic(30000.0, 0.2))) == pytest.approx(15.0, abs=0.01)
