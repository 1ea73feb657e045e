"""Bodies that fall to walls, and what the total frame may not be asked for."""

import pytest
from moving_scenes import block, interrupted, scene

from jaxmpm import results, walls
from jaxmpm.errors import RunError, SceneError
from jaxmpm.layout import lay_out
from jaxmpm.run import run_scene

HASTY = True  # see conftest.py


def dropped(height, frame="auto", duration=0.2, modulus=1.0, **more):
    """A soft block under gravity, some mm above a floor."""
    edges = {"bottom": "slip", "left": "open", "right": "open"} | more.pop("walls", {})
    soft = {"density": 1e-9, "bulk": {"law": "elastic", "E": modulus, "nu": 0.3}}
    return scene(
        [block((30, height), (70, height + 20))], size=(100.0, 100.0), walls=edges, materials={"rubber": soft},
        gravity=[0.0, -9810.0], solver={"frame": frame, "duration": duration}, **more,
    )  # fmt: skip


def test_a_soft_block_falls_bounces_and_rises_again(tmp_path):
    tree = dropped(40, output={"samples": 60, "frames": 3})
    summary = run_scene(tree, tmp_path, progress=False)
    assert summary["status"] == "completed" and summary["frame"] == "updated"
    begins, lost = summary["messages"]
    assert 'gravity pulls "block" to grid.walls.bottom = "slip"' in begins
    assert "of the energy is lost between points and grid" in lost
    history = results.read_history(tmp_path / "history.csv")
    work = history["external_work"]
    # it has risen to most of its height when the work of gravity is least, and the error has not grown by that
    assert work[30:].min() < 0.2 * work.max()
    assert 0.05 < summary["largest_energy_error"] < 0.12


def test_the_error_is_relative_to_the_most_energy_met_after_a_restart_too(tmp_path, monkeypatch):
    tree = dropped(40, frame="updated", duration=0.14, output={"samples": 20, "frames": 2})
    whole = run_scene(tree, tmp_path / "whole", progress=False)
    with interrupted(monkeypatch, 17):
        run_scene(tree, tmp_path / "parts", progress=False)
    assert run_scene(tree, tmp_path / "parts", resume=True, progress=False)["energy_error"] == whole["energy_error"]
    assert whole["external_work"] < 0.5 * 2.8  # what it has met before is more


def test_a_block_at_rest_on_the_floor_goes_on(tmp_path):
    tree = dropped(0, frame="updated", duration=1e-3, modulus=1000.0, output={"samples": 20, "frames": 2})
    summary = run_scene(tree, tmp_path, progress=False)
    assert summary["status"] == "completed" and summary["largest_energy_error"] < 0.01


def test_a_body_that_falls_to_a_wall_is_refused_in_the_total_frame(tmp_path):
    with pytest.raises(SceneError, match='solver.frame = "total": expected "auto" or "updated", as gravity pulls "block"'):
        run_scene(dropped(40, frame="total"), tmp_path, progress=False)


def test_a_body_that_leaves_the_grid_stops_the_total_frame(tmp_path):
    with pytest.raises(RunError, match='gone beyond grid.walls.bottom = "stop" at t = .* in the total frame'):
        run_scene(dropped(40, frame="total", walls={"bottom": "stop"}), tmp_path, progress=False)


@pytest.mark.parametrize(
    "height, gravity, velocity, walls_, said",
    [
        (40, -1.0, (0.0, 0.0), {"bottom": "stick"}, "gravity pulls"),
        (40, 1.0, (0.0, 0.0), {"bottom": "slip"}, ""),
        (0, -1.0, (0.0, 0.0), {"bottom": "slip"}, ""),  # rests
        (40, -1.0, (0.0, 0.0), {"bottom": "stop"}, ""),
        (40, 0.0, (1.0, 0.0), {"right": "slip"}, '"block" is thrown at grid.walls.right'),
    ],
)
def test_who_comes_to_a_wall(height, gravity, velocity, walls_, said):
    tree = scene([block((30, height), (70, height + 20), velocity=velocity)], size=(100.0, 100.0), walls=walls_,
                 gravity=[0.0, gravity] if gravity else [-1e-9, 0.0])  # fmt: skip
    found = walls.heading(tree, lay_out(tree))
    assert found.startswith(said) and bool(found) == bool(said)


def test_a_body_that_is_held_does_not_fall():
    inside = {"inside": [{"kind": "rectangle", "min": [30.0, 60.0], "max": [70.0, 60.0]}]}
    tree = dropped(40, sets={"top": inside}, supports=[{"set": "top", "fix": ["y"]}])
    assert walls.heading(tree, lay_out(tree)) == ""
