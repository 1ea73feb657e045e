"""Materials of whole simulations from their curves: derivatives, recovery, failures, the command."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibration import curve, leaves, specimen, specimen_cli, specimen_report
from calibration.specimen import Source, Specimen
from calibration.specimen_fit import Problem, check_reach, fit_specimens, twin_of
from jaxmpm import cli
from jaxmpm.differentiable import History, Run
from jaxmpm.errors import RunError, SceneError

HEAVY = ["parameters.cell=10", *(f"materials.{m}.density=2.4e-6" for m in ("weak", "concrete"))]
NAMES = ["weak.ft", "weak.GF"]
TRUTH = {"weak.ft": 2.85, "weak.GF": 0.0993071}


class Slow(Run):
    """The bar pulled infinitely slowly, in closed form: its compliance and the softening curve."""

    def __call__(self, model=None, reverse=False):
        law, bulk, row = model.embedding.law, model.embedding.bulk, self.materials.index("weak")
        values = {leaf: getattr(law, leaf)[row] for leaf in ("ft", "Ep", "n", "h")} | {"E": bulk.E[row]}
        w = jnp.concatenate([jnp.zeros(20), jnp.linspace(0.0, 0.15, 180)])
        stress = jnp.concatenate([jnp.linspace(0.05, 1.0, 20) * values["ft"], curve.traction("damage", values, w[20:])])
        gauges = {"delta": w + stress * 100 / values["E"], "load": 100 * stress}
        well = jnp.where(jnp.isfinite(stress), 0, 1)
        rest = dict.fromkeys(History._fields, w)
        return History(**rest | {"gauges": gauges, "status": well})


@pytest.fixture(scope="module")
def slow():
    one = Specimen.of(Source("bar", tuple(HEAVY)), twin=True)
    return replace(one, run=Slow(**vars(one.run)))


def problem_of(*specimens, free=NAMES, start=None, **options):
    runs = [one.run for one in specimens]
    return Problem(list(specimens), leaves.parameters(runs, free, start or {}, {}, {}), **options)


@pytest.fixture(scope="module")
def twin(slow):
    return twin_of(problem_of(slow), 0.02, 60)


def test_derived_leaves_are_the_scene_at_its_own_energy(slow):
    """0.0993 N/mm and the initial slope of the paper give E_p and n back; where there are none, NaN."""
    found = leaves.leaves(slow.run, slow.scene, TRUTH)
    assert slow.scene["weak.GF"] == pytest.approx(0.0993071, rel=1e-5)
    assert float(found["weak.Ep"]) == pytest.approx(8.184, rel=2e-3)
    assert float(found["weak.n"]) == pytest.approx(0.128, rel=2e-3)
    assert np.isnan(float(leaves.leaves(slow.run, slow.scene, {"weak.GF": 1e-6})["weak.Ep"]))


def test_tangents_are_central_differences(slow, twin):
    """Through the load at the measured displacements, the work, E_p and n, in all that can be free."""
    free = ["weak.ft", "weak.GF", "weak.slope_factor", "weak.E"]
    problem = replace(problem_of(*twin.specimens, free=free), jacobian="tangent", work=0.5)
    theta = problem.parameters.theta({"weak.ft": 2.5, "weak.GF": 0.12, "weak.slope_factor": 1.7, "weak.E": 31e3})
    value, jacobian = problem.evaluate(theta)
    assert value.shape == (61,) and jacobian.shape == (*value.shape, 4)
    step = 1e-6 * np.eye(4)
    by_differences = np.stack([(problem.value(theta + s) - problem.value(theta - s)) / 2e-6 for s in step], 1)
    scale = np.abs(jacobian).max(0)
    smooth = np.abs(by_differences - jacobian).max(1) < 1e-5 * scale.max()
    assert smooth.mean() > 0.9  # where the peak is passed between two measured points a load bends
    secant = problem.evaluate(theta, width=1e-4)[1]
    np.testing.assert_allclose(secant[smooth] / scale, jacobian[smooth] / scale, atol=1e-3)


@pytest.mark.parametrize("options", [{}, {"jacobian": "tangent"}, {"method": "adam"}])
def test_two_parameters_come_back_from_a_noisy_curve(twin, options):
    """2 % of noise; from 50 % off in both directions within 2 %, and within the standard deviations."""
    problem = replace(twin, jacobian=options.get("jacobian", "secant"))
    off = [{"weak.ft": 1.5, "weak.GF": 0.15}, {"weak.ft": 4.2, "weak.GF": 0.05}]
    starts = jnp.stack([problem.parameters.theta(values) for values in off])
    fit = fit_specimens(problem, starts, options.get("method", "gauss_newton"))
    about = specimen_report.known(fit)
    for _, end in fit.all:
        values = problem.parameters.values(end.theta)
        assert end.converged and all(float(values[name]) == pytest.approx(TRUTH[name], rel=0.02) for name in NAMES)
    for name, deviation in zip(NAMES, about.deviation, strict=True):
        assert 0 < deviation < 0.02 * TRUTH[name] and abs(fit.values[name] - TRUTH[name]) < 4 * deviation
    assert not about.warnings


def test_a_run_that_fails_is_a_step_rejected(twin):
    """NaN at the first trial and a law that does not exist; without a start that runs, one error."""
    problem = replace(twin, _programs={}, _last=(None, None))
    value, calls = problem.value, []

    def failing(theta):
        calls.append(theta)
        return value(theta) * (jnp.nan if len(calls) == 2 else 1.0)

    problem.value = failing
    fit = fit_specimens(problem, problem.parameters.theta({"weak.ft": 2.5, "weak.GF": 0.12})[None])
    assert fit.end.rejected >= 1 and fit.values["weak.ft"] == pytest.approx(2.85, rel=0.02)
    with pytest.raises(RunError, match="none of 1 starts"):
        fit_specimens(twin, twin.parameters.theta({"weak.ft": 2.5, "weak.GF": 1e-6})[None])


def test_a_start_must_run_and_reach_the_end_of_the_curve(slow, twin):
    with pytest.raises(SceneError, match="start weak.ft = 2.85  weak.GF = 1e-06: expected"):
        check_reach(problem_of(slow, start={"weak.GF": 1e-6}))
    far = replace(twin.specimens[0], at=2 * twin.specimens[0].at)
    with pytest.raises(SceneError, match="data of bar = .* mm: expected delta within"):
        check_reach(problem_of(far))
    assert np.isnan(problem_of(far).value(twin.parameters.start())).all()


def test_specimens_share_their_parameters(twin):
    """Twice the same curve: the same parameters, each deviation smaller by the square root of 2."""
    start = twin.parameters.theta({"weak.ft": 2.6, "weak.GF": 0.11})[None]
    one = fit_specimens(twin, start)
    two = fit_specimens(replace(twin, specimens=2 * twin.specimens, _programs={}, _last=(None, None)), start)
    assert two.values == pytest.approx(one.values, rel=1e-3) and two.end.residual.size == 120
    ratio = specimen_report.known(two).deviation / specimen_report.known(one).deviation
    np.testing.assert_allclose(ratio, 0.5**0.5, rtol=0.02)


def test_a_band_is_fitted_at_its_middle_in_half_widths(tmp_path, slow):
    file = tmp_path / "tests.csv"
    file.write_text("delta_mm,low_N,high_N\n0.0,0,0\n0.01,90,110\n0.02,100,200\n0.03,40,60\n")
    one = Specimen.of(Source("bar", tuple(HEAVY), str(file), (0.0, 0.025)))
    np.testing.assert_array_equal(one.load, [0.0, 100.0, 150.0])
    np.testing.assert_array_equal(one.scale, [1.5, 10.0, 50.0])
    line = jnp.linspace(0.0, 0.2, 201)
    found = one.residual((line.at[1].set(0.003).at[2].set(0.0025), 1e4 * line))
    np.testing.assert_allclose(found, [0.0, 0.0, 1.0], atol=1e-9)


def test_averages_take_vibrations_out_and_leave_straight_lines(slow):
    """Over 6 samples a load that swings every 3 samples is as if it did not."""
    one = replace(slow, average=6, run=replace(slow.run))
    values = {"weak.ft": 2.0, "weak.GF": 0.1}
    swing = lambda run, model: (h := Slow.__call__(run, model))._replace(
        gauges={"delta": h.gauges["delta"], "load": h.gauges["load"] + 50 * jnp.cos(2 * jnp.pi * jnp.arange(200) / 3)}
    )
    shaken = replace(one, run=type("Shaken", (Slow,), {"__call__": swing})(**vars(slow.run)))
    for found, wanted in zip(shaken.curve(values), one.curve(values), strict=True):
        assert found.shape == (196,)
        np.testing.assert_allclose(found, wanted, atol=1e-9)
    with pytest.raises(SceneError, match="smooth = 1: expected a time up to"):
        Specimen.of(Source("bar", tuple(HEAVY), smooth=1.0), twin=True)


def test_starts_are_log_uniform_half_to_one_and_a_half(twin):
    many = jax.vmap(lambda t: jnp.stack(list(twin.parameters.values(t).values())))(leaves.about(twin.parameters, 200))
    share = many / many[0]
    assert share[1:].min() > 0.5 and share.max() < 1.5 and share[1:].min() < 0.52 and share.max() > 1.45


def test_the_command(tmp_path, capsys, figures, monkeypatch):
    """A twin of the bar: words, JSON and a picture."""
    of = Run.of
    monkeypatch.setattr(specimen, "Run", type("", (), {"of": lambda *args: Slow(**vars(of(*args)))}))
    sets = [word for change in HEAVY for word in ("--set", change)]
    words = ["specimen", "bar", *sets, "--free", "weak.GF", "--twin", "0.02", "--starts", "2"]
    assert cli.main(["calibrate", *words, "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "Gauss-Newton 1" in out and "weak.GF = 0.09" in out and "[materials.weak] band = {law" in out
    written = json.loads((tmp_path / "fit.json").read_text())
    assert written["parameters"]["weak.GF"] == pytest.approx(0.0993, rel=0.02)
    assert written["free"] == ["weak.GF"] and written["truth"]["weak.GF"] == pytest.approx(0.0993, rel=1e-3)
    assert len(written["covariance"]) == 1 and len(written["specimens"][0]["fitted"]) == 100
    assert "solver.viscosity=0.1" in written["specimens"][0]["overrides"] and len(written["starts"]) == 2
    assert (tmp_path / "fit.png").stat().st_size > 5000 and len(figures) == 1


BEAM = "specimen beam --set grid.cell=5 --set parameters.half=2.5"


@pytest.mark.parametrize(
    "words, parts",
    [
        ("specimen --free concrete.ft", ["SCENE", "--specimens"]),
        ("specimen beam", ["--free", "concrete.ft"]),
        (f"{BEAM} --free concrete.Ft", ["concrete.Ft", "did you mean concrete.ft"]),
        (f"{BEAM} --free concrete.ft --start concrete.ft=-3", ["start concrete.ft = -3", "above 0"]),
        (f"{BEAM} --free concrete.ft --start concrete.ft=x", ["--start concrete.ft=x", "NAME=VALUE"]),
        (f"{BEAM} --free concrete.ft --start concrete.E=3", ["start concrete.E", "free"]),
        (f"{BEAM} --free concrete.n --start concrete.n=0.7", ["concrete.n = 0.7", "between 0 and 0.5"]),
        (f"{BEAM} --free concrete.n --free concrete.GF", ["concrete.n", "not both"]),
        (f"{BEAM} --free concrete.ft --bounds concrete.ft=5:2", ["--bounds concrete.ft=5:2", "LOW:HIGH"]),
        (f"{BEAM} --free concrete.ft --window 0.2 0.1", ["window = 0.2 0.1"]),
        (f"{BEAM} --free concrete.ft --window 5 6", ["window = 5 6", "beam_tests.csv"]),
        (f"{BEAM} --free concrete.ft --data none.csv", ["none.csv", "No such file"]),
        ("specimen bar --free weak.ft", ["response.reference absent", "--data"]),
        ("specimen --specimens none.toml --free weak.ft", ["none.toml", "TOML"]),
    ],
)
def test_bad_input_is_one_line_and_status_2(words, parts, capsys):
    assert cli.main(["calibrate", *words.split()]) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert not out and err.count("\n") == 1 and all(part in err for part in parts), err


def test_a_file_of_specimens(tmp_path):
    """Scenes and data lie beside it or have bundled names; the command's changes come last."""
    (tmp_path / "a.csv").write_text("delta_mm,load_N\n0,0\n0.02,200\n")
    file = tmp_path / "fit.toml"
    file.write_text('[[specimens]]\nscene = "bar"\nset = ["grid.cell=5"]\ndata = "a.csv"\nwindow = [0, 0.1]\n')
    options = type("Options", (), {"scene": None, "specimens": str(file), "overrides": ["a=1"], "smooth": 0.0})
    (one,) = specimen_cli._several(options)
    assert one == {
        "scene": "bar", "overrides": ("grid.cell=5", "a=1"), "data": str(tmp_path / "a.csv"), "window": (0, 0.1),
        "smooth": 0.0,
    }  # fmt: skip
    file.write_text('[[specimens]]\nscene = "bar"\ndat = "a.csv"\n')
    with pytest.raises(SceneError, match="specimens.0.dat: unknown, expected data"):
        specimen_cli._several(options)


STATIC = ["parameters.cell=10", 'solver.kind="quasistatic"', "output.samples=20"]


def test_a_specimen_in_equilibrium_has_its_gradient_in_reverse():
    """The gradient of the loss in reverse against differences of it."""
    one = Specimen.of(Source("bar", tuple(STATIC)), twin=True)
    problem = twin_of(Problem([one], leaves.parameters([one.run], NAMES, {}, {}, {})), 0.0)
    away = problem.parameters.theta({"weak.ft": 2.6, "weak.GF": 0.11})
    loss, slope = problem.slope(away)
    value = lambda theta: float(problem.value(theta) @ problem.value(theta)) / 2  # noqa: E731
    assert loss == pytest.approx(value(away), rel=1e-9)
    for k in range(2):
        step = 2e-3 * jnp.eye(2)[k]
        assert slope[k] == pytest.approx((value(away + step) - value(away - step)) / 4e-3, rel=0.05)


def test_what_equilibrium_cannot_do_is_refused():
    with pytest.raises(SceneError, match="smooth = 0.001: expected none"):
        Specimen.of(Source("bar", tuple(STATIC), smooth=1e-3), twin=True)
    one = Specimen.of(Source("bar", tuple(STATIC)), twin=True)
    problem = Problem([one], leaves.parameters([one.run], NAMES, {}, {}, {}), jacobian="tangent")
    with pytest.raises(SceneError, match='--jacobian = "tangent": expected "secant"'):
        check_reach(problem)
