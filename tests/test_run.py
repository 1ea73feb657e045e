"""Whole runs: DEN on 5 mm cells, and restart."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from jaxmpm import results, vtkhdf
from jaxmpm.run import run_scene
from jaxmpm.scene import load_scene

DEN = ["grid.cell=5", "output.samples=60", "output.frames=4"]


@pytest.fixture(scope="module")
def den(tmp_path_factory):
    directory = tmp_path_factory.mktemp("den")
    return directory, run_scene(load_scene("den", DEN), directory, progress=False)


def test_den_peak_tail_and_energy(den):
    _, summary = den
    assert summary["status"] == "completed"
    # 17.4 kN on every mesh; f_t × ligament = 22.5 kN bounds it from above
    assert 17.1e3 < summary["peak_load"] < 17.8e3
    assert 0.014 < summary["displacement_at_peak"] < 0.020
    assert summary["final_displacement"] == pytest.approx(0.06, rel=1e-9)
    assert 0 < summary["final_load"] < 0.5 * summary["peak_load"]
    assert summary["largest_energy_error"] < 0.01
    parts = ("stored_energy", "kinetic_energy", "dissipated_energy", "damping_work")
    assert sum(summary[part] for part in parts) == pytest.approx(summary["external_work"], rel=0.01)


def test_den_has_a_crack_from_each_notch(den):
    directory, _ = den
    frame = vtkhdf.read_frame(directory / "result.vtkhdf")
    x, y, _ = frame["points"][frame["opening"] > 0.01].T
    assert ((x < 50) & (abs(y - 100) < 25)).any() and ((x > 150) & (abs(y - 100) < 25)).any()
    assert len(x) < 120  # two lines of cells, not a cloud
    # they curve apart: between the notches the two cracks lie on different heights
    middle = (x > 80) & (x < 120)
    assert np.ptp(y[middle]) > 20


def test_files_of_a_run(den):
    directory, summary = den
    history = results.read_history(directory / "history.csv")
    assert len(history["time"]) == 61
    assert results.read_units(directory / "history.csv")["load"] == "N"
    assert history["time"][-1] == pytest.approx(5e-3, rel=1e-9)
    assert history["delta"][-1] == pytest.approx(0.06, rel=1e-9)
    assert np.abs(history["load"]).max() == summary["peak_load"]
    assert vtkhdf.read_frames(directory / "result.vtkhdf")[0] == 4
    for name in ("response.png", "cracks.png", "scene.json", "restart.h5"):
        assert (directory / name).stat().st_size > 500
    needed = (
        "scene status cell_size cells cracked steps peak_load displacement_at_peak final_load "
        "external_work stored_energy kinetic_energy dissipated_energy energy_error damping_work "
        "wall_seconds compile_seconds precision device"
    ).split()
    assert set(needed) <= set(json.loads((directory / "summary.json").read_text()))


def test_float32_agrees(den, tmp_path):
    _, double = den
    single = run_scene(
        load_scene("den", [*DEN, 'solver.precision="float32"']), tmp_path, progress=False
    )
    assert single["precision"] == "float32"
    assert single["peak_load"] == pytest.approx(double["peak_load"], rel=2e-3)
    assert abs(single["energy_error"]) < 0.01


def test_a_killed_run_resumes_bit_for_bit(den, tmp_path, monkeypatch):
    """kill -9 in the middle, then --resume: the same history to the last digit."""
    directory, _ = den
    script = (
        "import sys; from jaxmpm import run; from jaxmpm.scene import load_scene\n"
        "run.CHECKPOINT_SECONDS = 0.0\n"
        "run.run_scene(load_scene('den', sys.argv[2:]), sys.argv[1], progress=False)"
    )
    process = subprocess.Popen([sys.executable, "-c", script, str(tmp_path), *DEN])
    deadline = time.monotonic() + 240
    while time.monotonic() < deadline and process.poll() is None:
        history = tmp_path / "history.csv"
        if history.exists() and history.read_bytes().count(b"\n") > 20:
            break
        time.sleep(0.02)
    assert process.poll() is None, "the run ended before it could be killed"
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (tmp_path / "summary.json").exists()
    monkeypatch.setattr("jaxmpm.run.CHECKPOINT_SECONDS", 1e9)
    run_scene(load_scene("den", DEN), tmp_path, resume=True, progress=False)
    for name in ("history.csv",):
        assert (tmp_path / name).read_bytes() == (directory / name).read_bytes()
    for k in range(4):
        mine, other = (vtkhdf.read_frame(d / "result.vtkhdf", k) for d in (tmp_path, directory))
        for key in mine:
            np.testing.assert_array_equal(mine[key], other[key])


def test_resuming_another_scene_is_refused(den):
    directory, _ = den
    with pytest.raises(results.ResultError, match="differs"):
        run_scene(load_scene("den", [*DEN, "solver.damping=0.03"]), directory, resume=True)
