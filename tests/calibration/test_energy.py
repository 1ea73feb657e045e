"""E_p and n from the fracture energy: closed form, descent, derivatives, refusals."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibration import damage_curve, energy
from calibration.energy import Centroid, InitialSlope, Modulus, Point, fit_energy
from calibration.energy_report import calibrate_energy, words
from calibration.width import fit_width
from jaxmpm.errors import SceneError

CONCRETE = (32000.0, 3.0, 0.11, 0.05)  # E, f_t, G_F, h


def plain_curve(E, ft, Ep, n, h):
    """w, mm, and σ, MPa, by NumPy, down to nothing."""
    p = np.linspace(0, 1, 400001) ** 2 * 400
    s, q = np.exp(-p), Ep / E * np.exp(-n * p)
    stress = ft * s * (1 + q) / (s + q)
    return h * (stress / (s * E) - stress / E), stress


@pytest.fixture(scope="module")
def concrete():
    return calibrate_energy(*CONCRETE)


def test_the_published_pair_and_what_follows_from_it(concrete):
    assert f"{concrete.Ep:.4f} {concrete.n:.5f}" == "8.1839 0.12797"
    assert concrete.h_gF == pytest.approx(0.11, rel=1e-12)
    assert concrete.k == pytest.approx(2 * 0.05 * 9 / 0.11, rel=1e-12)
    assert concrete.H_max == pytest.approx(32000 * 0.11 / (2 * 9), rel=1e-12)
    assert 'band = { law = "damage", ft = 3, Ep = 8.1839107, n = 0.12797352, h = 0.05 }' in words(
        concrete
    )


def test_descent_finds_the_same(concrete):
    assert f"{concrete.descent_Ep:.4f} {concrete.descent_n:.5f}" == "8.1839 0.12797"
    assert concrete.disagreement < 1e-9


def test_the_curve_has_the_area_and_slope_that_were_asked_for(concrete):
    w, stress = plain_curve(32000, 3, concrete.Ep, concrete.n, 0.05)
    assert np.trapezoid(stress, w) == pytest.approx(0.11, rel=1e-6)
    assert (stress[20] - stress[0]) / w[20] == pytest.approx(-2 * 9 / 0.11, rel=1e-3)


def test_second_example_obeys_another_slope_but_is_found_back():
    """Table 1 of the paper: E_p given, n from the implied G_F; or from the factor of its slope."""
    E, ft, Ep = (
        np.array([45e3, 30e3, 30e3]),
        np.array([3.0, 2.0, 1.5]),
        np.array([10.0, 10.0, 20.0]),
    )
    GF, h = np.array([0.0185721, 0.00755607, 0.00182723]), np.full(3, 0.005)
    fit = jax.jit(jax.vmap(fit_energy))
    found = fit(E, ft, GF, h, Modulus(Ep))
    assert (np.asarray(found.status) == energy.FOUND).all()
    np.testing.assert_allclose(found.n, 0.179, atol=2e-6)
    factor = Ep / (1 + Ep / E) * GF / (h * ft**2)
    np.testing.assert_allclose(factor, [4.126, 3.777, 3.246], atol=1e-3)  # not the 2 of the plate
    again = fit(E, ft, GF, h, InitialSlope(factor))
    np.testing.assert_allclose(again.Ep, Ep, rtol=1e-12)
    np.testing.assert_allclose(again.n, found.n, rtol=1e-9)


def test_a_thousand_random_sets_are_solved_or_refused_for_the_right_reason():
    rng, count = np.random.default_rng(0), 1000
    E, ft = 10 ** rng.uniform(3.5, 5, count), 10 ** rng.uniform(-0.5, 1.2, count)
    GF, h = 10 ** rng.uniform(-3, 0, count), 10 ** rng.uniform(-4, 1, count)
    fit = jax.jit(jax.vmap(fit_energy, (0, 0, 0, 0, None)))(E, ft, GF, h, InitialSlope())
    status, k = np.asarray(fit.status), 2 * h * ft**2 / GF
    expected = np.where(k / E < 1, energy.FOUND, energy.TOO_STEEP)
    expected = np.where(h * ft**2 / (2 * E * GF) >= 1, energy.ELASTIC, expected)
    assert (status == expected).all() and (status == energy.FOUND).sum() > 900
    good = status == energy.FOUND
    np.testing.assert_allclose(
        energy.fracture_energy(E, ft, fit.Ep, fit.n, h)[good], GF[good], rtol=1e-9
    )
    assert np.isnan(fit.Ep[~good]).all() and ((fit.n[good] > 0) & (fit.n[good] < 0.5)).all()


def test_derivatives_are_those_of_central_differences():
    at = jnp.log(jnp.array(CONCRETE))
    found = lambda x: jnp.stack(fit_energy(*jnp.exp(x))[:2])  # noqa: E731
    ahead = jax.jit(jax.jacfwd(found))(at)
    np.testing.assert_allclose(jax.jit(jax.jacrev(found))(at), ahead, rtol=1e-10, atol=1e-12)
    step, value = 1e-5, jax.jit(found)
    for k, unit in enumerate(np.eye(4)):
        quotient = (value(at + step * unit) - value(at - step * unit)) / (2 * step)
        np.testing.assert_allclose(ahead[:, k], quotient, rtol=1e-7, atol=1e-8)
    # what a fit of a specimen needs: dE_p/dG_F and dn/dG_F
    np.testing.assert_allclose(ahead[:, 2] / 0.11, [-74.418, -0.105465], rtol=1e-4)


def test_a_centre_of_gravity_is_met_with_the_derivative_in_GF():
    E, ft, GF, h = CONCRETE
    fit = jax.jit(
        lambda GF: jax.jvp(lambda G: fit_energy(E, ft, G, h, Centroid(0.035)), (GF,), (1.0,))
    )
    found, change = fit(GF)
    w, stress = plain_curve(E, ft, float(found.Ep), float(found.n), h)
    assert found.status == energy.FOUND and np.trapezoid(stress, w) == pytest.approx(GF, rel=1e-6)
    assert np.trapezoid(w**2 / 2, -stress) / GF == pytest.approx(0.035, rel=1e-6)
    quotient = (fit(GF * 1.00001)[0].n - fit(GF * 0.99999)[0].n) / (2e-5 * GF)
    assert float(change.n) == pytest.approx(float(quotient), rel=1e-5)


def test_a_point_on_the_tail_is_met_and_a_second_curve_mentioned():
    found = calibrate_energy(*CONCRETE, Point(0.075, 0.1))
    w, stress = plain_curve(32000, 3, found.Ep, found.n, 0.05)
    assert np.interp(-0.3, -stress, w) == pytest.approx(0.075, rel=1e-6)
    assert np.trapezoid(stress, w) == pytest.approx(0.11, rel=1e-6) and found.disagreement < 1e-9
    assert "second curve" in words(found)


def test_the_width_is_found_from_a_slope_and_a_point(concrete):
    e, n = jnp.asarray(concrete.Ep / 32000), jnp.asarray(concrete.n)
    w = float(damage_curve.opening_at(0.5, e, n)) * 0.05 * 3 / 32000
    found = jax.jit(fit_width)(32000.0, 3.0, 0.11, Point(w))
    assert found.h == pytest.approx(0.05, rel=1e-8) and found.n == pytest.approx(
        concrete.n, rel=1e-8
    )


def test_single_precision_is_kept_and_good_to_its_digits():
    found = jax.jit(fit_energy)(*map(jnp.float32, CONCRETE))
    assert found.Ep.dtype == jnp.float32 and found.status == energy.FOUND
    assert found.Ep == pytest.approx(8.18391, rel=1e-5) and found.n == pytest.approx(
        0.1279735, rel=1e-4
    )


@pytest.mark.parametrize(
    "change, condition, parts",
    [
        ({"h": 200.0}, InitialSlope(), ["h = 200", "below", "195.6 mm", "steeper"]),
        ({"GF": 1e-6}, InitialSlope(), ["GF = 1e-06", "above", "7.031e-06", "elastic"]),
        (
            {"GF": np.nan, "h": -1.0},
            InitialSlope(),
            ["GF = nan", "h = -1", "finite number above 0"],
        ),
        (
            {},
            InitialSlope(0.4),
            ["slope-factor = 0.4", "above 0.5", "GF = 0.11", "(0.1375, infinity)"],
        ),
        ({}, Modulus(1.0), ["GF = 0.11", "Ep = 1 MPa", "(0.225007, infinity)"]),
        ({}, Point(0.05), ["w = 0.05", "0.03667 mm", "ratio = 0.5", "GF = 0.11"]),
    ],
)
def test_a_refusal_names_the_value_and_what_was_expected(change, condition, parts):
    given = dict(zip(("E", "ft", "GF", "h"), CONCRETE, strict=True)) | change
    with pytest.raises(SceneError) as refused:
        calibrate_energy(**given, condition=condition)
    assert len(refused.value.lines) == 1
    assert all(part in str(refused.value) for part in parts), str(refused.value)
