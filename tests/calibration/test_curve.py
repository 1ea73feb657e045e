"""Softening curves: reading them, fitting laws to them, what the data leave open."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import curve_fit

from calibration import curve_report, descent
from calibration.curve import fit_curve, sampled, traction
from calibration.data.published import PUBLISHED, text
from calibration.parameters import Free, Parameters
from calibration.tables import DATA, Curve, read_curve
from jaxmpm.errors import RunError, SceneError

SET = {"ft": 3.0, "Ep": 8.184, "n": 0.128, "E": 32000.0, "h": 0.05}


def points(law, values, w, noise=0.0):
    """A curve of a law, with noise."""
    sigma = np.asarray(traction(law, values, w))
    sigma = sigma + noise * np.random.default_rng(0).normal(size=len(w))
    return Curve(w, sigma, np.ones(len(w)), law)


# ------------------------------------------------------------------ the damage law


def test_openings_of_the_uniaxial_curve():
    w = np.array([0.0, 0.004472, 0.013134, 0.030863, 0.054394, 0.076694, 0.119953])
    stress = traction("damage", SET, w)
    np.testing.assert_allclose(stress / 3, [1, 0.9, 0.75, 0.5, 0.25, 0.1, 0.01], rtol=1e-4)


def test_stress_at_an_opening_has_the_derivatives_of_differences():
    w = np.array([0.0, 0.01, 0.1, 3.0])
    at = jnp.log(jnp.array([3.0, 8.184, 0.128]))
    stress = jax.jit(
        lambda x: traction("damage", SET | dict(zip(("ft", "Ep", "n"), jnp.exp(x), strict=True)), w)
    )
    exact = jax.jit(jax.jacfwd(stress))(at)
    for k, unit in enumerate(np.eye(3) * 1e-5):
        quotient = (stress(at + unit) - stress(at - unit)) / 2e-5
        np.testing.assert_allclose(exact[:, k], quotient, rtol=1e-6, atol=1e-8)


def test_known_parameters_are_recovered():
    lines = []
    fit = fit_curve(
        points("damage", SET, np.linspace(0, 0.1, 30)), E=32000, h=0.05, show=lines.append
    )
    for name in ("ft", "Ep", "n"):
        assert fit.values[name] == pytest.approx(SET[name], rel=1e-6)
    assert (
        fit.converged and fit.rms < 1e-8 and fit.values["GF"] == pytest.approx(0.110036, rel=1e-5)
    )
    assert any("Adam" in line for line in lines) and any("Gauss-Newton" in line for line in lines)
    assert all("loss" in line and "|gradient|" in line and "Ep = " in line for line in lines)


def test_with_the_fracture_energy_fixed_n_follows(tmp_path, figures):
    fix = {"ft": 3.0, "GF": 0.110036}
    fit = fit_curve(points("damage", SET, np.linspace(0, 0.1, 30)), E=32000, h=0.05, fix=fix)
    assert fit.values["Ep"] == pytest.approx(8.184, rel=1e-4) and fit.values["n"] == pytest.approx(
        0.128, rel=1e-4
    )
    p = np.linspace(0, 1, 100001) ** 2 * 400
    s, q = np.exp(-p), 8.184 / 32000 * np.exp(-0.128 * p)
    stress = 3 * s * (1 + q) / (s + q)
    w = 0.05 * (stress / s - stress) / 32000
    beyond = np.trapezoid(stress[w > 0.1], w[w > 0.1]) / 0.110036
    assert fit.beyond == pytest.approx(beyond, abs=1e-4)
    assert "GF = 0.110036 N/mm fixed" in curve_report.words(fit)
    curve_report.write(fit, tmp_path)
    assert (tmp_path / "fit.png").stat().st_size > 5000 and "Ep" in (
        tmp_path / "fit.json"
    ).read_text()
    above, below = figures[0].axes
    assert "residual" in below.get_ylabel() and len(above.lines) == 2


# ------------------------------------------------------------------ cohesive laws, uncertainty


def test_covariance_is_that_of_scipy():
    w = np.linspace(0, 0.2, 50)
    data = points("exponential", {"ft": 3.0, "GF": 0.11}, w, noise=0.05)
    fit = fit_curve(data, "exponential")
    model = lambda w, ft, GF: ft * np.exp(-w * ft / GF)  # noqa: E731
    values, covariance = curve_fit(model, w, data.sigma, p0=[2.0, 0.2])
    np.testing.assert_allclose([fit.values["ft"], fit.values["GF"]], values, rtol=1e-5)
    np.testing.assert_allclose(fit.uncertainty.covariance, covariance, rtol=1e-3)
    assert not fit.uncertainty.warnings and abs(fit.uncertainty.correlation[0, 1]) < 1


def test_a_piece_of_a_curve_leaves_strength_and_energy_open():
    piece = points("exponential", {"ft": 3.0, "GF": 0.11}, np.linspace(0.05, 0.051, 20))
    (warning,) = fit_curve(piece, "exponential").uncertainty.warnings
    assert "not determined" in warning and "ft^" in warning and "GF^" in warning
    start = points("exponential", {"ft": 3.0, "GF": 0.11}, np.linspace(0.0, 1e-3, 20))
    (warning,) = fit_curve(start, "exponential").uncertainty.warnings
    assert "GF^1.00" in warning and "ft" not in warning  # the strength is seen, the energy is not


def test_a_failed_evaluation_is_a_step_rejected():
    def residual(theta):  # NaN on a good part of the way
        x, y = theta
        return jnp.stack([10 * (y - x**2), 1 - x, jnp.where(y > 1.5, jnp.nan, 0.0)])

    evaluate, failures = jax.jit(descent.linearised(residual)), []

    def failing(theta):
        if theta[0] < -1.3:
            failures.append(theta)
            raise RunError("diverged")
        return evaluate(theta)

    end = descent.gauss_newton(failing, np.array([-1.2, 1.0]), steps=200)
    np.testing.assert_allclose(end.theta, 1, atol=1e-6)
    assert end.converged and end.rejected > 0
    slope = jax.jit(jax.vmap(descent.with_slope(residual)))
    best, least = descent.adam(slope, jnp.array([[-1.2, 1.0], [0.0, 1.4], [0.0, 2.0]]), steps=200)
    assert np.isfinite(least[:2]).all() and np.isinf(least[2]) and least.min() < 0.1


def test_parameters_stay_admissible():
    p = Parameters({"n": Free(0.1, 0.0, 0.5), "Ep": Free(8.0)}, {"h": 0.05})
    values = p.values(p.start())
    assert float(values["n"]) == pytest.approx(0.1) and float(values["Ep"]) == pytest.approx(8.0)
    assert 0 < float(p.values(p.start() - 30)["n"]) and float(p.values(p.start() + 20)["n"]) < 0.5
    change = jax.jacfwd(lambda t: jnp.log(p.values(t)["n"]))(p.start())[0]
    assert float(p.relative(p.start())[0]) == pytest.approx(float(change))


# ------------------------------------------------------------------ files


@pytest.mark.parametrize("name", PUBLISHED)
def test_bundled_curves_are_their_formulae(name):
    assert (DATA / f"{name}.csv").read_text() == text(name)
    data = read_curve(name)
    assert np.trapezoid(data.sigma, data.w) == pytest.approx(0.11, rel=2e-3)
    law = {"hordijk_1991": "hordijk", "petersson_1981": "bilinear"}.get(name)
    if law:
        np.testing.assert_allclose(
            data.sigma, traction(law, {"ft": 3.0, "GF": 0.11}, data.w), atol=2e-4
        )


def test_a_law_is_sampled_down_to_one_per_cent():
    data = sampled("linear", 3.0, 0.11)
    assert data.sigma[0] == 3 and 0 <= data.sigma[-1] <= 0.031 and (np.diff(data.w) > 0).all()


@pytest.mark.parametrize(
    "content, parts",
    [
        ("", ["empty"]),
        ("a,b\n1,2\n", ["header", "w [mm]", "sigma [MPa]"]),
        ("w [mm],load [N]\n1,2\n", ["sigma [MPa]"]),
        ("w [um],sigma [MPa]\n1,2\n", ["w [um]", "w [mm]"]),
        ("w [mm],sigma [MPa]\n0,3\n0.1,abc\n", ["line 3", "sigma = 'abc'", "finite"]),
        ("w [mm],sigma [MPa]\n0,3\n0.1,nan\n", ["line 3", "sigma = 'nan'"]),
        ("# note\nw [mm],sigma [MPa]\n-1,3\n", ["line 3", "w = '-1'", "0 or more"]),
        ("w [mm],sigma [MPa]\n0,3\n0.1\n", ["line 3", "sigma = ''"]),
        ("w [mm],sigma [MPa]\n0,3\n", ["1 rows", "at least 2"]),
        ("w [mm],sigma [MPa]\n0,-3\n1,0\n", ["sigma", "above 0"]),
        ("w [mm],sigma [MPa],weight\n0,3,0\n1,0,0\n", ["weight", "above 0"]),
    ],
)
def test_a_bad_file_is_refused_in_one_line(tmp_path, content, parts):
    (tmp_path / "c.csv").write_text(content)
    with pytest.raises(SceneError) as refused:
        read_curve(tmp_path / "c.csv")
    assert len(refused.value.lines) == 1 and all(part in str(refused.value) for part in parts)


def test_too_little_to_find_anything_is_refused():
    data = Curve(np.array([0.0, 0.01]), np.array([3.0, 2.0]), np.ones(2), "two")
    for change, part in (
        ({}, "3 parameters"),
        ({"fix": {"n": 0.7}}, "between 0 and 0.5"),
        ({"h": None}, "h (mm)"),
    ):
        with pytest.raises(SceneError, match=part.replace("(", r"\(").replace(")", r"\)")):
            fit_curve(data, **({"E": 32000, "h": 0.05} | change))
