"""The damage law: onset, criterion, the uniaxial curve and what it dissipates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm.laws.damage import Damage, log_integrity
from jaxmpm.laws.elastic import Elastic

SIZES = pytest.mark.parametrize("size", [3, 4])
BULK = Elastic(32000.0, 0.2)
LAW = Damage(3.0, 8.184, 0.128, 0.05)
respond = jax.jit(jax.vmap(lambda law, strain, history, bulk: law.respond(strain, history, bulk)))
respond_one = jax.jit(lambda law, strain, history, bulk: law.respond(strain, history, bulk))

# E, f_t, E_p, n, h and the dissipation of a crack, N/mm
SETS = [
    (32000.0, 3.0, 8.184, 0.128, 0.05, 0.110036),
    (45000.0, 3.0, 10.0, 0.179, 0.005, 0.0185721),
    (30000.0, 2.0, 10.0, 0.179, 0.005, 0.00755607),
    (30000.0, 1.5, 20.0, 0.179, 0.005, 0.00182723),
]
EVERY_SET = pytest.mark.parametrize("E, ft, Ep, n, h, expected", SETS)

STEPS = 2001


@jax.jit
def along(law, bulk, path):
    """Histories and stresses along a path of strains (steps, size)."""

    def step(history, strain):
        stress, history = law.respond(strain, history, bulk)
        return history, (history, stress)

    return jax.lax.scan(step, law.initial(), path)[1]


def ratio_of_tensors(stress, E, nu, ft):
    """sqrt(E s+ : C : s+) / f_t with the full tensors and the elastic compliance C."""
    matrix = np.zeros((len(stress), 3, 3))
    matrix[:, 0, 0], matrix[:, 1, 1] = stress[:, 0], stress[:, 1]
    matrix[:, 0, 1] = matrix[:, 1, 0] = stress[:, -1]
    if stress.shape[1] == 4:
        matrix[:, 2, 2] = stress[:, 2]
    values, vectors = np.linalg.eigh(matrix)
    positive = np.einsum("kip,kp,kjp->kij", vectors, np.maximum(values, 0), vectors)
    trace = np.trace(positive, axis1=1, axis2=2)[:, None, None]
    strain = ((1 + nu) * positive - nu * trace * np.eye(3)) / E
    return np.sqrt(E * np.einsum("kij,kij->k", positive, strain)) / ft


@SIZES
def test_onset_is_that_of_full_tensors(size):
    rng = np.random.default_rng(size)
    stress = rng.normal(size=(2000, size)) * 3
    stress[:50, -1], stress[:50, 1] = 0, stress[:50, 0]  # equal in the plane
    stress[50:60] = 0
    stress[60:160, :] = -np.abs(stress[60:160, :])
    stress[60:160, -1] = np.sqrt(stress[60:160, 0] * stress[60:160, 1]) * 0.99  # compression
    ratio = np.asarray(jax.jit(jax.vmap(lambda s: LAW.onset(s, BULK)))(stress))
    np.testing.assert_allclose(ratio, ratio_of_tensors(stress, 32000, 0.2, 3), atol=1e-12)
    np.testing.assert_array_equal(ratio[50:160], 0)
    one = jnp.zeros(size).at[0].set(3.0)
    np.testing.assert_allclose(LAW.onset(one, BULK), 1, rtol=1e-15)


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
    assert smooth.sum() > 300 and np.quantile(error, 0.98) < 1e-8
    special = jnp.stack([jnp.zeros(size), jnp.full(size, 2.0).at[-1].set(0.0), -jnp.ones(size)])
    assert np.isfinite(gradient(special)).all()


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_criterion_holds_to_round_off(dtype):
    ratio = np.r_[1.0, 1 + np.geomspace(1e-6, 1, 200), np.geomspace(2, 1e8, 600)]
    root = jax.jit(jax.vmap(log_integrity, (0, None, None, None)))
    for E, _, Ep, n, *_ in SETS:
        args = [np.asarray(a, dtype) for a in (ratio, Ep / E, n, 0.0)]
        z = np.asarray(root(*args))
        assert z.dtype == dtype and np.all(z <= 0)
        r, e, n, _ = (a.astype(float) for a in args)
        z = z.astype(float)
        left = r * np.exp(z) + e * (r - 1) * np.exp(n * z) - 1
        # an error of eps in z is one of eps |z| in the terms, which are of order one
        assert (np.abs(left) / (1 + np.abs(z))).max() < 16 * np.finfo(dtype).eps
        assert z[0] == 0


def test_root_does_not_depend_on_where_the_search_starts():
    ratio = jnp.geomspace(1.001, 1e8, 300)
    root = jax.jit(jax.vmap(log_integrity, (0, None, None, 0)))
    e, n = 8.184 / 32000, 0.128
    cold = root(ratio, e, n, jnp.zeros(300))
    # from the right of the root, as the last root always is but for round-off
    for start in (-1e-3 * jnp.ones(300), 0.5 * cold, 0.99 * cold, cold, cold * (1 + 1e-12)):
        np.testing.assert_allclose(root(ratio, e, n, start), cold, rtol=1e-13, atol=1e-15)


def test_root_has_the_derivatives_of_differences():
    rng = np.random.default_rng(2)
    ratio = 1 + 10 ** rng.uniform(-2, 7, 400)
    e, n = 10 ** rng.uniform(-4, -2, 400), rng.uniform(0.05, 0.45, 400)
    args = [jnp.asarray(a) for a in (ratio, e, n, 0 * ratio)]
    root = jax.jit(jax.vmap(log_integrity))
    for number in range(3):
        exact = jax.jit(jax.vmap(jax.grad(log_integrity, number)))(*args)
        size, moved = args[number] - (1 if number == 0 else 0), []
        for k in (-2, -1, 1, 2):
            changed = list(args)
            changed[number] = args[number] + 1e-3 * k * size
            moved.append(root(*changed))
        quotient = (moved[0] - 8 * moved[1] + 8 * moved[2] - moved[3]) / (12e-3 * size)
        noise = 1e-14 * (1 + np.abs(moved[0])) / (1e-3 * size)
        assert np.max(np.abs(exact - quotient) / (1e-7 * np.abs(exact) + noise)) < 1
        assert np.median(noise / np.abs(exact)) < 1e-6


@SIZES
def test_history_only_ever_grows(size):
    """Under any strain path: the ratio and the dissipation never fall, z never rises."""
    rng = np.random.default_rng(5)
    path = rng.normal(size=(60, 256, size)) * 10 ** rng.uniform(-5, -3, (60, 256, 1))
    fill = lambda tree: jax.tree.map(lambda leaf: jnp.full(256, leaf), tree)  # noqa: E731
    law, bulk = fill(LAW), fill(BULK)
    history, grown = jax.vmap(lambda law: law.initial())(law), 0
    for strain in path:
        stress, new = respond(law, jnp.asarray(strain), history, bulk)
        change = jax.tree.map(lambda a, b: np.asarray(a - b), new, history)
        round_off = 1e-14 * (1 + np.abs(new.log_integrity))
        assert np.all(change.ratio >= 0) and np.all(change.log_integrity <= round_off)
        assert np.all(change.dissipated >= -1e-13 * np.asarray(new.dissipated))
        still = change.ratio == 0
        assert np.all(np.abs(change.log_integrity[still]) <= round_off[still])
        assert np.all(change.log_integrity[change.ratio > 1e-9] < 0)
        effective = jax.vmap(lambda b, e: b.stress(e))(bulk, jnp.asarray(strain))
        integrity = jnp.exp(new.log_integrity)[:, None]
        np.testing.assert_allclose(stress, integrity * effective, rtol=1e-12)
        grown += np.asarray(new.ratio > history.ratio).sum()
        history = new
    assert grown > 500


@SIZES
def test_frozen_and_cohesion_and_loads_agree_with_respond(size):
    rng = np.random.default_rng(6)
    strain = jnp.asarray(rng.normal(size=(300, size)) * 3e-4)
    fill = lambda tree: jax.tree.map(lambda leaf: jnp.full(300, leaf), tree)  # noqa: E731
    law, bulk = fill(LAW), fill(BULK)
    stress, history = respond(law, strain, jax.vmap(lambda law: law.initial())(law), bulk)
    held = jax.vmap(lambda a, e, q, b: a.frozen(e, q, b))(law, strain, history, bulk)
    np.testing.assert_allclose(held, stress, rtol=1e-14)
    # the strength ratio of the true stress, where it loads, is the cohesion
    ratio = jax.vmap(lambda a, s, b: a.onset(s, b))(law, stress, bulk)
    loaded = np.asarray(history.ratio > 1)
    assert 50 < loaded.sum() < 300
    cohesion = jax.vmap(lambda a, q: a.cohesion(q))(law, history)
    np.testing.assert_allclose(ratio[loaded], cohesion[loaded], rtol=1e-12)
    np.testing.assert_array_equal(cohesion[~loaded], 1)


# ------------------------------------------------------------------ uniaxial tension


@SIZES
@EVERY_SET
def test_slope_at_onset_is_minus_ep(E, ft, Ep, n, h, expected, size):
    law, bulk = Damage(ft, Ep, n, h), Elastic(E, 0.0)
    strain = jnp.zeros(size).at[0].set(ft / E)
    slope = jax.jacfwd(lambda e: respond_one(law, e, law.initial(), bulk)[0])(strain * (1 + 1e-9))
    assert float(slope[0, 0]) == pytest.approx(-Ep, rel=1e-6)


def test_uniaxial_curve_is_the_closed_form():
    """Also with nu = 0.2, where the band is under uniaxial stress if it may contract."""
    s = np.exp(np.linspace(0, -18, 200))[1:]
    e = 8.184 / 32000
    exact = 3.0 * s * (1 + e * s**0.128) / (s + e * s**0.128)
    direct = exact / (s * 32000)
    strain = np.stack([direct, -0.2 * direct, 0 * direct], 1)
    start = LAW.initial()
    stress, history = jax.vmap(lambda e: LAW.respond(e, start, BULK))(jnp.asarray(strain))
    np.testing.assert_allclose(stress[:, 0], exact, rtol=1e-12)
    np.testing.assert_allclose(stress[:, 1:], 0, atol=1e-12)
    np.testing.assert_allclose(history.log_integrity, np.log(s), rtol=1e-12)


def exact_dissipation(E, ft, Ep, n, s_end=0.0):
    """Integral of F dD from D = 0 to 1 - s_end, N/mm², by Gauss-Legendre in s = x^(1/(1-2n))."""
    x, weight = np.polynomial.legendre.leggauss(400)
    power = 1 / (1 - 2 * n)  # takes the singularity s^(-2n) away
    low = s_end ** (1 / power)
    pieces = np.r_[low, np.geomspace(max(low, 1e-12), 1, 40)[1:]]
    total = 0.0
    for a, b in zip(pieces[:-1], pieces[1:], strict=True):
        t = (a + b) / 2 + (b - a) / 2 * x
        s = t**power
        r = (1 + Ep / E * s**n) / (s + Ep / E * s**n)
        total += (b - a) / 2 * (weight * r**2 * power * t ** (power - 1)).sum()
    return ft**2 / (2 * E) * total


@EVERY_SET
def test_dissipation_is_that_of_the_parameters(E, ft, Ep, n, h, expected):
    assert h * exact_dissipation(E, ft, Ep, n) == pytest.approx(expected, rel=5e-6)


@pytest.mark.parametrize("decades_per_step, tolerance", [(1 / 200, 5e-5), (1 / 4, 0.06)])
@EVERY_SET
def test_law_counts_what_it_dissipates(E, ft, Ep, n, h, expected, decades_per_step, tolerance):
    """Pulled apart to a strength ratio of 1e9 in steps of equal factors."""
    ratio = 10 ** np.arange(0, 9.0001, decades_per_step)
    law, bulk = Damage(ft, Ep, n, h), Elastic(E, 0.0)
    ratio = np.r_[ratio, np.full(STEPS - len(ratio), ratio[-1])]  # one length, one compilation
    path = jnp.zeros((STEPS, 3)).at[:, 0].set(ratio * ft / E)
    history = jax.tree.map(lambda leaf: leaf[-1], along(law, bulk, path)[0])
    rest = exact_dissipation(E, ft, Ep, n) - exact_dissipation(
        E, ft, Ep, n, float(np.exp(history.log_integrity))
    )
    found = h * (float(law.dissipated(history)) + rest)
    assert 0 <= h * rest < 1e-3 * expected
    assert found == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize("turns", [False, True])
def test_stored_and_dissipated_energy_account_for_the_work(turns):
    """Also where something is compressed: damage lets go of that energy too."""
    ratio = np.geomspace(1, 3e3, STEPS)
    path, turn = np.zeros((STEPS, 3)), np.log(ratio) * turns
    path[:, 0] = ratio
    path[:, 1], path[:, 2] = 0.3 * ratio * np.cos(3 * turn), 0.4 * ratio * np.cos(turn)
    path = jnp.asarray(path)
    path /= LAW.onset(BULK.stress(path[0]), BULK)
    history, stress = along(LAW, BULK, path)
    stored = jax.vmap(lambda e, q: LAW.stored(e, q, BULK))(path, history)
    work = float(((stress[1:] + stress[:-1]) / 2 * jnp.diff(path, axis=0)).sum())
    dissipated = LAW.dissipated(jax.tree.map(lambda leaf: leaf[-1], history))
    gap = work - float(stored[-1] - stored[0]) - float(dissipated)
    assert float(dissipated) > 0.3 * work
    assert abs(gap) < (1e-4 if turns else 1e-13) * work


def test_largest_size_is_where_the_point_snaps_back():
    """The slope of bulk and band in series turns vertical: (1 - f) / E = f / Ep at f = h / H."""
    f = 0.05 / float(LAW.largest_size(BULK))
    assert (1 - f) / 32000 == pytest.approx(f / 8.184, rel=1e-12)
    assert float(LAW.largest_size(BULK)) == pytest.approx(195.6, abs=0.06)
    mortar = Damage(2.0, 10.0, 0.179, 0.005)
    assert float(mortar.largest_size(Elastic(30000.0, 0.2))) == pytest.approx(15.0, abs=0.01)
