"""The stability page: limits that are known are found, what was measured is kept, and what is asked wrongly is said."""

import csv
import json

import numpy as np
import pytest
import scipy.linalg

from jaxmpm import cli, verify
from jaxmpm.model import fields
from jaxmpm.stability_page import cfl, h_max, page
from jaxmpm.stability_methods import METHODS
from jaxmpm.stiffness import strain_operator, weights_of

HASTY = True


def known_limit(sim):
    """2/ω of the largest eigenvalue of M⁻¹ K, over the estimate."""
    n, prepared = sim.model.numerics, fields(sim.model)
    shape = sim.model.material.shape
    direct, cross, shear = (np.asarray(c).reshape(-1) for c in (prepared.direct, prepared.cross, prepared.shear))
    none = 0 * direct
    elastic = np.stack([direct, cross, none, cross, direct, none, none, none, shear], axis=1).reshape(-1, 3, 3)
    strain = strain_operator(shape, n.cell)
    weighted = weights_of(n.cell**2 * n.thickness * elastic, np.asarray(prepared.hourglass).reshape(-1) * n.thickness)
    mass = np.tile(np.asarray(prepared.mass).reshape(-1), 2)
    there = np.flatnonzero(mass > 0)
    stiffness = (strain.T @ (weighted @ strain)).tocsr()[there][:, there].toarray()
    largest = scipy.linalg.eigh(stiffness, np.diag(mass[there]), eigvals_only=True)[-1]
    return 2 / np.sqrt(largest) / sim.stable_dt


@pytest.mark.parametrize("cells, nu, limit", [((1, 6), 0.0, 1.0), ((6, 6), 0.2, None)])
def test_bisection_finds_the_limit_that_frequencies_tell(cells, nu, limit):
    """A column without lateral strain is as stiff as its cells alone, a block is less so."""
    sim = cfl.shaken(cfl.block_scene(cells, nu))
    expected = known_limit(sim)
    if limit:
        assert expected == pytest.approx(limit, abs=1e-9)
    else:
        assert 1.05 < expected < 1.1
    assert cfl.critical(lambda factor: cfl.grows(sim, factor), 0.8, 1.3) == pytest.approx(expected, rel=cfl.TOLERANCE)


def test_bisection_says_where_even_the_lowest_step_is_unstable():
    assert cfl.critical(lambda factor: factor > 0.37) == pytest.approx(0.37, rel=cfl.TOLERANCE)
    assert cfl.critical(lambda factor: True) is None


def test_bars_beyond_the_largest_length_take_more_work_than_their_fracture_energy():
    limit = h_max.largest_length()
    assert limit == pytest.approx(h_max.H * (1 + h_max.E / h_max.EP))
    assert h_max.fracture_energy() == pytest.approx(0.110036 * 0.95**2, rel=1e-4)
    for ratio in (0.5, 0.99):
        stress, elongation = h_max.curve(ratio * limit)
        assert (np.diff(elongation) > 0).all()
        fall, work = h_max.met_again(ratio * limit)
        assert work == pytest.approx(1.0, abs=2e-3) and fall < 1e-3
    length = 6 * limit
    stress, elongation = h_max.curve(length)
    assert (np.diff(elongation)[:100] < 0).all()
    # the area passed over, between where the load falls and where the curve is met again
    fall, work = h_max.met_again(length)
    passed = stress > (1 - fall) * h_max.FT
    area = np.trapezoid(-stress[passed], elongation[passed]) / h_max.fracture_energy()
    assert work == pytest.approx(1 + area, abs=2e-3) and area > 0.1


def test_a_long_bar_in_motion_takes_no_less_than_the_closed_form_and_dissipates_as_much_as_any():
    run = verify.summary_of(h_max.bar_scene(800, h_max.WAYS[h_max.MOTION], "parameters.cell=10"))
    whole, closed = h_max.AREA * h_max.fracture_energy(), h_max.met_again(800)[1]
    assert closed > 1.1
    assert 1.0 < run["external_work"] / whole / closed < 1.12  # waves and damping take the rest
    assert run["dissipated_energy"] == pytest.approx(whole, rel=5e-3)


def found(name):
    """Numbers as a panel would have them, made up."""
    line = lambda series, xs, y=0.1: [{"series": series, "x": x, "y": y} for x in xs]  # noqa: E731
    if name == "map":
        cell = {"path": "uniaxial", "verdict": "right", "energy_ratio": 1.0, "steps": 5, "enlarged": False, "series": "m", "y": 1.0}
        sizes = [{"size_ratio": x, "increment": y, "x": x} for x in (0.1, 1.0) for y in (1.0, 10.0)]
        return {"rows": [cell | size | {"method": method} for method in METHODS for size in sizes]}
    if name == "cfl":
        return {"rows": [{"series": "at rest", "x": "gimp", "y": 1.5}, {"series": "crossing cells", "x": "linear", "y": None}]}
    series = {
        "crossing": ["linear", "quadratic B-spline"], "locking": ["bands.release = 0"], "rate": ["peak", "work", page.rate.KINETIC],
        "float32": ["one band: energy"], "h_max": [f"{what}, {way}" for what in ("work", "dissipated") for way in h_max.WAYS],
    }[name]  # fmt: skip
    more = {"locking": {"traction_left": {"bands.release = 0": 0.05}}, "rate": {"static": {"peak_load": 1e4, "external_work": 1.0}}, "float32": {"stops": []}, "h_max": {"largest_length": 195.6}}
    return {"rows": [row for one in series for row in line(one, (8, 16))]} | more.get(name, {})


@pytest.fixture
def made_up(monkeypatch):
    """Panels that do not compute; the names of those that were asked."""
    asked = []
    for name, panel in page.PANELS.items():
        monkeypatch.setattr(panel, "measure", lambda say, name=name: asked.append(name) or found(name))
    return asked


def test_the_page_is_drawn_from_what_is_kept(tmp_path, made_up, figures, capsys):
    command = ["stability", "--page", "--out", str(tmp_path)]
    assert cli.main([*command, "--only", "crossing", "cfl"]) == 0
    assert made_up == ["cfl", "crossing"]
    assert [axes.get_title(loc="left")[:1] for axes in figures[0].axes] == ["a", "b"]
    assert cli.main([*command, "--resume"]) == 0
    assert made_up == ["cfl", "crossing", "map", "locking", "rate", "float32", "h_max"]  # what was known is not measured again
    assert "linear: unstable at 0.1 too" in capsys.readouterr().out
    assert len(figures[-1].axes) == 4 + 6 and (tmp_path / "stability_page.pdf").stat().st_size > 10_000
    panels = json.loads((tmp_path / "stability_page.json").read_text())["panels"]
    with open(tmp_path / "stability_page.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert set(panels) == set(page.PANELS) and len(rows) == sum(len(panel["rows"]) for panel in panels.values())


def test_what_was_measured_is_kept_where_a_panel_stops(tmp_path, made_up, monkeypatch):
    def stops(say):
        raise KeyboardInterrupt

    monkeypatch.setattr(page.locking, "measure", stops)
    assert cli.main(["stability", "--page", "--out", str(tmp_path)]) == cli.INTERRUPTED
    assert set(json.loads((tmp_path / "stability_page.json").read_text())["panels"]) == {"map", "cfl", "crossing"}


def test_bad_input_is_one_line(tmp_path, capsys):
    said = lambda *words: (cli.main(["stability", "--out", str(tmp_path), *words]), capsys.readouterr().err)  # noqa: E731
    for words, part in (
        (("--page", "--only", "clf"), "--only clf: did you mean cfl?"), (("--only", "cfl"), "--only: expected only with --page"),
        (("--page", "--coarse"), "--coarse: expected only without --page"), (("--resume",), "--resume: expected only with --page"),
    ):  # fmt: skip
        code, error = said(*words)
        assert code == cli.BAD_INPUT and part in error and error.count("\n") == 1
    (tmp_path / "stability_page.json").write_text('{"panels": {"cfl": 3}}')
    code, error = said("--page", "--resume")
    assert code == cli.BAD_INPUT and "without --resume" in error
