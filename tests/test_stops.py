"""What must stop a run, and the energy that is booked where a boundary is torn."""

import pytest

from jaxmpm import results
from jaxmpm.errors import RunError, SceneError
from jaxmpm.run import Simulation, run_scene
from jaxmpm.scene import load_scene

HASTY = True  # see conftest.py

BAR = ["output.samples=20", "output.frames=2"]


@pytest.mark.parametrize(
    "change, words",
    [
        ("solver.gradient_limit=1e-9", "gradient_limit"),
        ("solver.energy_error_limit=1e-12", "energy_error_limit"),
    ],
)
def test_a_run_that_must_stop_says_why_and_keeps_its_results(tmp_path, change, words):
    with pytest.raises(RunError, match=words):
        run_scene(load_scene("bar", [*BAR, change]), tmp_path, progress=False)
    summary = results.read_summary(tmp_path)
    assert summary["status"].startswith("stopped: ") and words in summary["status"]
    assert len(results.read_history(tmp_path / "history.csv")["time"]) >= 1
    assert (tmp_path / "cracks.png").exists()


def test_an_unstable_run_stops_on_numbers_that_are_not_finite(tmp_path, monkeypatch):
    """Three times the stable step: NaN must never be written as a result."""
    from jaxmpm import model

    stable = model.stable_time_step
    monkeypatch.setattr("jaxmpm.model.stable_time_step", lambda m: 3 * stable(m))
    with pytest.raises(RunError):
        run_scene(load_scene("bar", BAR), tmp_path, progress=False)
    assert results.read_summary(tmp_path)["status"].startswith("stopped: ")


def test_more_steps_than_can_be_counted_are_refused():
    with pytest.raises(SceneError, match=r"solver\.duration = 1000000.0: expected less than"):
        Simulation.of(load_scene("bar", ["solver.duration=1e6"]))


def test_energy_of_hourglass_modes_is_booked_when_a_cell_cracks(tmp_path):
    """Where the boundary is torn in two, the first cells to crack are bent more than strained."""
    scene = load_scene("opening", ["grid.cell=5", "solver.duration=1.2e-3", "output.frames=2"])
    summary = run_scene(scene, tmp_path, progress=False)  # the first hundredth of the opening
    assert summary["cracked"] > 20
    assert summary["largest_energy_error"] < 2e-3
    changed = load_scene("opening", ["grid.cell=5", "solver.duration=1.3e-3", "output.frames=2"])
    with pytest.raises(results.ResultError, match=r"solver\.duration was 0\.0012 and is 0\.0013"):
        run_scene(changed, tmp_path, resume=True, progress=False)
