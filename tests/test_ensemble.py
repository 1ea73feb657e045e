"""Ensembles: seeds, one program for all, failures, interruptions, statistics and pictures."""

import csv
import json
import os

import numpy as np
import pytest
from test_macro import volume

from jaxmpm import cli, ensemble, ensemble_statistics as stats, observe, results
from jaxmpm.ensemble import folder, run_ensemble, with_seed
from jaxmpm.ensemble_sizes import write_sizes
from jaxmpm.ensemble_workers import run_beside
from jaxmpm.errors import RunError, SceneError
from jaxmpm.run import run_scene
from jaxmpm.scene import Scene
from jaxmpm.simulation import Simulation

SEEDS, WRONG = range(1, 5), 3


def scattered():
    """24 cells, each with a strength of its own, pulled until they crack."""
    tree = volume("edges", duration=2e-4, ft=1.0, xx=2.0).to_dict()
    tree["materials"]["one"]["scatter"] = {"modulus": 6.0, "length": 0.0}
    tree["solver"]["frame"] = "total"
    tree["output"] = {"samples": 20, "frames": 2}
    return Scene.from_dict(tree)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """An ensemble of four, of which one cannot be trusted from some time on."""
    directory, check = tmp_path_factory.mktemp("ensemble"), Simulation.check

    def checked(self, reading, error):
        if self.scene.materials["one"].scatter.seed == WRONG and reading.time > 1e-4:
            raise RunError("not to be trusted")
        check(self, reading, error)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Simulation, "check", checked)
        found = run_ensemble(scattered(), SEEDS, directory, progress=False)
    return directory, found


def test_a_seed_goes_wherever_something_is_drawn_and_nowhere_else():
    tree = scattered().to_dict()
    tree["materials"]["two"]["scatter"] = {"modulus": 6.0, "length": 2.0, "seed": 9}
    tree["bodies"][1]["material"] = "two"
    seeded = with_seed(Scene.from_dict(tree), 7).to_dict()
    assert [seeded["materials"][name]["scatter"]["seed"] for name in ("one", "two")] == [7, 7]
    for name in ("one", "two"):
        seeded["materials"][name]["scatter"].pop("seed")
        tree["materials"][name]["scatter"].pop("seed", None)
    assert seeded == tree
    strength = Simulation.of(with_seed(Scene.from_dict(tree), 7)).layout.local.strength
    assert abs(np.corrcoef(strength[:3].ravel(), strength[3:].ravel())[0, 1]) < 0.9  # fields of their own


def test_a_scene_without_anything_random_is_refused_before_it_runs(tmp_path):
    with pytest.raises(SceneError, match="mesostructure.inclusions: absent.*materials.NAME.scatter"):
        run_ensemble(volume("edges", xx=1.0), SEEDS, tmp_path / "none", progress=False)
    assert not (tmp_path / "none").exists()


def test_samples_share_their_programs():
    first, second = (Simulation.of(with_seed(scattered(), seed)) for seed in (1, 2))
    assert first.compiled(observe.read) is second.compiled(observe.read)
    tree = scattered().to_dict()
    tree["solver"]["precision"] = "float32"
    assert Simulation.of(Scene.from_dict(tree)).compiled(observe.read) is not first.compiled(observe.read)


def test_a_sample_is_an_ordinary_run_with_its_seed(done, tmp_path):
    directory, _ = done
    run_scene(with_seed(scattered(), 2), tmp_path, progress=False)
    name = "history.csv"
    assert (folder(directory, 2) / name).read_bytes() == (tmp_path / name).read_bytes()
    assert (folder(directory, 2) / name).read_bytes() != (folder(directory, 1) / name).read_bytes()


def test_a_failed_sample_is_recorded_and_does_not_lose_the_others(done):
    directory, found = done
    assert found["completed"] == 3 and found["failed"] == {WRONG: "stopped: not to be trusted"}
    with open(directory / "ensemble.csv", newline="") as file:
        rows = {int(row["seed"]): row for row in csv.DictReader(file)}
    assert [rows[seed]["status"] for seed in (2, 3, 4)] == ["completed", "stopped: not to be trusted", "completed"]
    peaks = [results.read_history(folder(directory, seed) / "history.csv")["stress_xx"].max() for seed in (1, 2, 4)]
    assert [float(rows[seed]["peak_load [MPa]"]) for seed in (1, 2, 4)] == pytest.approx(peaks, rel=1e-12)
    peak = json.loads((directory / "ensemble.json").read_text())["numbers"]["peak_load"]
    assert peak["count"] == 3 and peak["mean"] == pytest.approx(np.mean(peaks))
    assert peak["std"] == pytest.approx(np.std(peaks, ddof=1)) and peak["unit"] == "MPa"
    assert np.ptp(peaks) > 0.01  # they do scatter


def test_an_interrupted_ensemble_goes_on_as_if_nothing_had_been(done, tmp_path, monkeypatch):
    directory, _ = done
    advance = Simulation.advance

    def interrupted(self, until):
        if self.scene.materials["one"].scatter.seed == 2 and until > 0.6 * self.steps:
            raise KeyboardInterrupt
        advance(self, until)

    monkeypatch.setattr(Simulation, "advance", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_ensemble(scattered(), (1, 2, 4), tmp_path, progress=False)
    halfway = json.loads((tmp_path / "ensemble.json").read_text())
    assert halfway["completed"] == 1 and halfway["unfinished"] == [2, 4]
    monkeypatch.setattr(Simulation, "advance", advance)
    ran, steps = [], []
    monkeypatch.setattr(ensemble, "run_scene", lambda scene, at, **o: (ran.append(at.name), run_scene(scene, at, **o)))
    monkeypatch.setattr(Simulation, "advance", lambda self, until: (steps.append(until), advance(self, until)))
    found = run_ensemble(scattered(), (1, 2, 4), tmp_path, resume=True, progress=False)
    assert ran == ["seed_0002", "seed_0004"] and found["completed"] == 3
    assert steps[0] > 0.5 * max(steps)  # on from where it was, not anew
    for seed in (1, 2, 4):
        mine, other = ((folder(d, seed) / "history.csv").read_bytes() for d in (tmp_path, directory))
        assert mine == other


def test_resuming_with_another_scene_is_refused_before_anything_runs(done):
    directory, _ = done
    tree = scattered().to_dict()
    tree["solver"]["damping"] = 0.1
    with pytest.raises(results.ResultError, match=r"seed_0001.*solver\.damping was 0\.2 and is 0\.1"):
        run_ensemble(Scene.from_dict(tree), SEEDS, directory, resume=True, progress=False)
    assert json.loads((directory / "ensemble.json").read_text())["completed"] == 3


def test_where_no_sample_can_be_built_the_scene_is_refused(tmp_path):
    tree = scattered().to_dict()
    tree["solver"]["duration"] = 1e6
    with pytest.raises(SceneError, match=r"solver\.duration = 1000000\.0"):
        run_ensemble(Scene.from_dict(tree), (1, 2), tmp_path, progress=False)


def test_the_picture_shows_every_sample_the_mean_and_its_peak(done, figures):
    from jaxmpm.plot_ensemble import plot_ensemble

    directory, found = done
    plot_ensemble(directory, directory / "again.png")
    axes = figures[0].axes[0]
    thin = [line for line in axes.lines if len(line.get_xdata()) == 21]
    mean = next(line for line in axes.lines if len(line.get_xdata()) == stats.AXIS)
    assert len(thin) == 3
    each = [np.interp(mean.get_xdata(), *line.get_data()) for line in thin]
    np.testing.assert_allclose(mean.get_ydata(), np.mean(each, axis=0), atol=1e-12)
    assert axes.containers[0].lines[0].get_ydata() == pytest.approx(found["numbers"]["peak_load"]["mean"])


def worker(tree, directory):
    """A sample for `run_beside` whose process dies if it is told to."""
    if tree["dies"]:
        os._exit(3)
    directory.mkdir()
    (directory / "threads").write_text(os.environ["NPROC"])


def test_a_process_that_dies_loses_its_own_sample_alone(tmp_path):
    ended, before = [], os.environ.get("NPROC")
    run_beside(worker, {k: {"dies": k == 2} for k in (1, 2, 3)}, tmp_path, 2, ended.append)
    assert sorted(ended[:2]) == [1, 3] and ended[2] == 2
    assert (folder(tmp_path, 3) / "threads").read_text() == "1" and not folder(tmp_path, 2).exists()
    assert os.environ.get("NPROC") == before


def test_spread_is_that_of_textbooks():
    found = stats.spread([1.0, 2.0, 3.0, 4.0])
    std = np.sqrt(5 / 3)
    expected = {"count": 4, "mean": 2.5, "std": std, "cov": std / 2.5, "standard_error": std / 2, "q05": 1.15, "q95": 3.85}
    assert found == pytest.approx(expected)
    assert stats.spread([2.0])["std"] is None


def test_curves_meet_on_the_displacements_that_all_have():
    """Straight lines stay straight; what goes back is passed over; in compression the axis is negative."""
    axis, loads = stats.common_axis([(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0])),
                                     (np.array([0.0, 1.0, 0.5, 3.0]), np.array([0.0, 3.0, 9.0, 9.0]))])  # fmt: skip
    assert axis[0] == 0.0 and axis[-1] == 2.0 and (np.diff(axis) >= 0).all()
    np.testing.assert_allclose(loads, [axis, 3 * axis], atol=1e-12)
    axis, loads = stats.common_axis([(np.array([0.0, -2.0]), np.array([0.0, -1.0]))])
    assert axis[-1] == -2.0 and loads[0, -1] == -1.0


@pytest.mark.parametrize(
    ("mean", "std", "text"),
    [(1.5096, 0.00743, "1.5096 ± 0.0074"), (34726.6, 23.1, "34727 ± 23"), (4.95e-5, 1.06e-6, "(4.95 ± 0.11)e-5"), (2.0, None, "2")],
)
def test_a_mean_is_printed_to_two_digits_of_its_scatter(mean, std, text):
    assert stats.with_scatter(mean, std) == text


def test_sizes_are_compared(done, tmp_path, figures):
    directory, found = done
    for value in ("10", "20"):
        (tmp_path / f"side_{value}").symlink_to(directory)
    write_sizes("parameters.side", {"10": found, "20": found}, tmp_path)
    with open(tmp_path / "sizes.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["number"] == "peak_load"]
    assert [row["parameters.side"] for row in rows] == ["10", "20"]
    assert float(rows[1]["std"]) == found["numbers"]["peak_load"]["std"]
    left, right, _ = figures[0].axes
    np.testing.assert_allclose(right.lines[0].get_ydata(), 100 * found["numbers"]["peak_load"]["cov"])
    assert left.lines[0].get_ydata().mean() == pytest.approx(found["numbers"]["peak_load"]["mean"])


def test_the_command_names_failed_samples_in_one_line(done, capsys, monkeypatch):
    directory, _ = done
    monkeypatch.setattr("jaxmpm.scene.load_scene", lambda *_: scattered())
    arguments = ["run", "volume", "--samples", "4", "--resume", "--out", str(directory)]
    assert cli.main(arguments) == cli.STOPPED
    out, err = capsys.readouterr()
    assert "3 of 4 samples completed" in out and "peak load" not in out and "  strength " in out
    assert "4 of 4 samples are there already" in err
    assert "jaxmpm: stopped: 1 of 4 samples did not complete: seed 3" in err.splitlines()[-1]
    assert cli.main(["run", "volume", "--samples", "2", "--resume", "--out", str(directory), "--quiet"]) == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--samples 0", "--samples = 0: expected a whole number from 1"),
        ("--samples 2 --jobs 0", "--jobs = 0: expected"),
        ("--samples 2 --seed -1", "--seed = -1: expected"),
        ("--seed 4", "--seed = 4: expected only with --samples"),
        ("--vary grid.cell=1,2", "--vary = grid.cell=1,2: expected only with --samples"),
        ("--samples 2 --vary grid.cell", "expected KEY=V1,V2"),
        ("--samples 2 --vary grid.cell=1,,2", "expected KEY=V1,V2"),
        ("--samples 2 --vary grid.cell=1,1", "expected values that differ"),
        ("--samples 2 --vary grid.cell=1,1.0", "expected values that differ"),
        ("--samples 2 --vary mesostructure.seed=1,2", "expected another key"),
        ("--samples 2 --vary grid.cel=0.5,1", "grid.cel = 0.5"),
        ("--samples 2", "mesostructure.inclusions: absent"),
    ],
)
def test_options_of_an_ensemble_are_refused_by_name(options, words, tmp_path, capsys):
    assert cli.main(["run", "bar", "--out", str(tmp_path / "none"), *options.split()]) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert words in err and not out and len(err.splitlines()) == 1
    assert not (tmp_path / "none").exists()
