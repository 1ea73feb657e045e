"""Scenes in equilibrium: the closed form, snap-back, energy, quadratic convergence, and what is refused."""

import json

import numpy as np
import pytest
from static_scenes import STATIC, bar, plate

from jaxmpm import follow, results
from jaxmpm.errors import RunError, SceneError
from jaxmpm.newton import Control, Newton
from jaxmpm.quasistatic import QuasiStatic
from jaxmpm.run import run_scene
from jaxmpm.scene import load_scene

HASTY = True  # see conftest.py
E, FT, EP, N, H = 32000.0, 2.85, 8.184, 0.128, 0.05


def opening(load):
    """Opening w (mm) of the weak column at a share of its strength, theory §2, by bisection on s."""
    e = EP / E
    low, high = 1e-12, 1.0
    for _ in range(200):
        s = (low + high) / 2
        low, high = (s, high) if s * (1 + e * s**N) / (s + e * s**N) < load else (low, s)
    stress = load * FT
    return H * (stress / (s * E) - stress / E)


def test_bar_follows_the_closed_form(tmp_path):
    """With ν = 0 a band is in uniaxial stress: elongation is that of the bar and of the opening."""
    summary = run_scene(bar(100, "materials.weak.bulk.nu=0.0", "materials.concrete.bulk.nu=0.0", "output.samples=60"), tmp_path, progress=False)
    assert summary["status"] == "completed"
    history = results.read_history(tmp_path / "history.csv")
    load, delta, cracked = (history[name] for name in ("load", "delta", "cracked"))
    behind = (cracked > 0) & (load < 0.95 * FT * 100) & (load > 2)
    assert behind.sum() > 8
    stress = load[behind] / 100
    expected = stress / E * 100 + np.array([opening(s / FT) for s in stress])
    np.testing.assert_allclose(delta[behind], expected, rtol=2e-3)
    assert summary["peak_load"] <= FT * 100 * 1.001
    assert history["external_work"][-1] == pytest.approx(9.93, rel=0.01)
    assert summary["quasistatic"]["bridges"] == 0


def test_long_bar_snaps_back_and_is_followed(tmp_path):
    """800 mm, four times H_max: load and elongation go back together, and the work is that of one crack."""
    scene = bar(800, 'solver.control="dissipation"', "displacements.0.history.value=[0.0, 0.06, 0.2]", "output.samples=40")
    summary = run_scene(scene, tmp_path, progress=False)
    assert summary["status"] == "completed"
    history = results.read_history(tmp_path / "history.csv")
    load, delta, spent = (history[name] for name in ("load", "delta", "dissipated_energy"))
    peak = load.argmax()
    assert load[peak] == pytest.approx(290, rel=0.01)
    assert delta[peak:].min() < 0.9 * delta[peak]  # back …
    assert delta[-1] == pytest.approx(0.2)  # … and forth to the end
    assert (np.diff(spent) > -1e-9).all()
    assert history["external_work"][-1] == pytest.approx(9.93, rel=0.01)
    assert abs(history["energy_error"]).max() < 0.01
    assert summary["quasistatic"]["by_energy"] > 20 and summary["quasistatic"]["bridges"] == 0
    assert summary["final_load"] < 0.01 * summary["peak_load"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    directory = tmp_path_factory.mktemp("plate")
    return directory, run_scene(plate("output.samples=30", "output.frames=3"), directory, progress=False)


def test_plate_from_peak_to_tail(run):
    directory, summary = run
    assert summary["status"] == "completed"
    assert summary["final_displacement"] == pytest.approx(0.06)
    assert 16e3 < summary["peak_load"] < 20e3
    assert summary["final_load"] < 0.6 * summary["peak_load"]
    assert summary["largest_energy_error"] < 0.01 and summary["kinetic_energy"] == 0
    parts = ("stored_energy", "dissipated_energy", "damping_work")
    assert sum(summary[part] for part in parts) == pytest.approx(summary["external_work"], rel=0.01)
    effort = json.loads((directory / "summary.json").read_text())["quasistatic"]
    assert effort["median_iterations"] <= 5 and effort["increments"] >= 30
    history = results.read_history(directory / "history.csv")
    np.testing.assert_allclose(np.diff(history["time"]), 5e-3 / 30, rtol=1e-9)


def test_newton_converges_quadratically():
    """Several bands that load: every residual is about the square of the one before."""
    sim = QuasiStatic.of(plate("solver.tolerance=1e-11"))
    follower, eq = sim.follower, sim.follower.equilibria
    follower.begin()
    while follower.time < 1.6e-3:
        follower.increment(1.6e-3)
    system, now = eq.system, eq.now
    newton = Newton(system, eq.respond, eq.strength, eq.stiffness, 1e-11)
    ahead = 0.5 * eq.last.displacement
    found = newton.solve(
        system.unknowns(now.displacement + ahead, now.amplitude), now.amplitude, 0.6 * eq.last.amplitude, Control("load", 1.0)
    )
    assert found.converged
    assert (found.answers.status[: len(system.cells)] == 1).sum() >= 5
    errors = [error for error in found.history if error > 1e-10]
    assert len(errors) >= 2
    assert found.history[len(errors)] < 20 * errors[-1] ** 2 + 1e-11


def test_a_restart_goes_on_where_it_was(run, tmp_path):
    """Half the run, then the rest from the restart file."""
    _, whole = run
    scene = plate("output.samples=30", "output.frames=3")
    calls, old = [], QuasiStatic.advance

    def advance(self, until):
        if until == 16 and not calls:
            calls.append(until)
            raise KeyboardInterrupt
        return old(self, until)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(QuasiStatic, "advance", advance)
        with pytest.raises(KeyboardInterrupt):
            run_scene(scene, tmp_path, progress=False)
    again = run_scene(scene, tmp_path, resume=True, progress=False)
    assert again["status"] == "completed"
    assert again["final_load"] == pytest.approx(whole["final_load"], rel=0.02)
    assert again["external_work"] == pytest.approx(whole["external_work"], rel=0.01)


def test_a_restart_in_a_snap_back_goes_on_by_energy():
    """The loads went back when it was written: they do so from there, with increments as large."""
    scene = bar(800, "displacements.0.history.value=[0.0, 0.06, 0.2]")
    sim, other = QuasiStatic.of(scene), QuasiStatic.of(scene)
    sim.at_rest()
    while not (sim.follower.line and sim.follower.line.increments > 5):
        sim.follower.increment(scene.solver.duration)
        sim._take_over()
    other.state = sim.state
    other.resume(json.loads(json.dumps(sim.meta())))
    before = sim.follower.line.factor
    assert other.follower.line.factor == before
    for each in (sim, other):
        each.follower.increment(scene.solver.duration)
    assert other.follower.line.factor == pytest.approx(sim.follower.line.factor, rel=1e-4)
    assert other.follower.line.factor < before - 1e-4
    assert other.follower.size == pytest.approx(sim.follower.size) and other.follower.by_energy == sim.follower.by_energy


@pytest.mark.parametrize("control", ["time", "dissipation", "delta"])
def test_loads_that_turn_back_take_the_structure_along(control):
    """Opened to 0.06 mm, closed, opened again: the energy that a crack as far open has taken, whatever is under control."""
    history = "displacements.0.history={time=[0.0, 3e-3, 5e-3, 8e-3, 12e-3], value=[0.0, 0.03, -0.005, 0.06, 0.0]}"
    intact = [f"materials.{name}.bulk.nu=0.0" for name in ("weak", "concrete")]
    sim = QuasiStatic.of(bar(100, history, f'solver.control="{control}"', "output.samples=50", *intact))
    sim.at_rest()
    sample, farthest = 0, 0.0
    while not sim.finished:
        sample += 1
        sim.advance(sample)
        farthest = max(farthest, float(sim.read().gauges["delta"]))
    load = np.linspace(1.0, 0.0, 2000, endpoint=False)
    delta = np.array([share * FT / E * 100 + opening(share) for share in load])
    last = np.searchsorted(delta, 0.06)
    spent = FT * 100 * (np.trapezoid(load[:last], delta[:last]) + delta[0] / 2 - load[last] * delta[last] / 2)
    assert 0.05 < farthest <= 0.06 + 1e-9
    assert float(sim.read().dissipated) == pytest.approx(spent, rel=3e-3)


def test_the_farthest_that_a_load_goes_is_not_passed_over():
    """A quick pull between two samples, in increments that are longer: the crack that it opens is there."""
    history = "displacements.0.history={time=[0.0, 1e-3, 2e-3, 12e-3], value=[0.0, 0.012, 0.0, 0.0]}"
    sim = QuasiStatic.of(bar(100, history, "solver.largest_increment=1.0", "solver.first_increment=0.3", "output.samples=2"))
    sim.at_rest()
    sim.advance(1)
    assert sim.cracked() == 2 and sim.follower.equilibria.now.ratio.max() < 1.03
    assert float(sim.read().dissipated) > 0.3


def test_loads_may_end_just_where_energy_has_taken_over():
    """Held just behind onset: the first increment under control of energy is the last of the loads that grow."""
    history = "displacements.0.history.value=[0.0, 0.00895, 0.00895]"
    sim = QuasiStatic.of(bar(100, history, 'solver.control="dissipation"', "output.samples=20"))
    sim.at_rest()
    while not sim.finished:
        sim.advance(20)
    reading = sim.read()
    assert int(reading.cracked) == 2 and float(reading.dissipated) > 0
    np.testing.assert_allclose(float(reading.gauges["delta"]), 0.00895, rtol=1e-9)


def test_loads_that_crack_at_once_are_refused(tmp_path):
    """What no increment leads to is no equilibrium to begin with, though uncracked cells would bear it."""
    with pytest.raises(RunError, match="loads at t = 0 stress a cell to 2.25 times what it bears"):
        run_scene(bar(100, "displacements.0.history.value=[0.02, 0.06, 0.2]"), tmp_path, progress=False)


def pulled_by_a_force(*more):
    """A bar under more than it bears."""
    tree = bar(100, *more).to_dict()
    (load,) = tree.pop("displacements")
    tree["forces"] = [load | {"kind": "force", "history": {"time": [0.0, 12e-3], "value": [0.0, 600.0]}}]
    tree["gauges"]["load"]["set"] = "left"
    return type(bar(100)).from_dict(tree | {"output": {"samples": 20, "frames": 2}})


def test_a_force_that_has_come_back_to_nothing_ends_the_run(tmp_path):
    """The opening under control: the force goes to its peak and back to zero, and its history is never gone to the end."""
    with pytest.raises(RunError, match="loads have come back to nothing"):
        run_scene(pulled_by_a_force('solver.control="delta"', "solver.largest_increment=0.2"), tmp_path, progress=False)
    history = results.read_history(tmp_path / "history.csv")
    assert 280 < np.abs(history["load"]).max() < 291
    assert history["external_work"][-1] == pytest.approx(9.93, rel=0.01)


def test_no_equilibrium_stops_with_all_on_disk(tmp_path, monkeypatch):
    """A bar pulled by a force that it cannot bear: no equilibrium, and no bridge leads to one."""
    from jaxmpm import bridge

    monkeypatch.setattr(bridge, "LOOKS", 2)
    monkeypatch.setattr(follow.Follower, "_by_energy", lambda *args, **more: False)
    scene = pulled_by_a_force()
    with pytest.raises(RunError, match="no equilibrium after t = "):
        run_scene(scene, tmp_path, progress=False)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["status"].startswith("stopped: no equilibrium")
    history = results.read_history(tmp_path / "history.csv")
    assert 265 < np.abs(history["load"]).max() < 291  # no state beyond what the bar bears
    assert history["step"][-1] == summary["quasistatic"]["increments"]  # the last equilibrium is there
    assert abs(history["energy_error"]).max() < 0.01


@pytest.mark.parametrize(
    ("set_", "says"),
    [
        ("solver.damping=0.1", "solver.damping = 0.1: expected none with solver.kind"),
        ('solver.precision="float32"', "solver.precision"),
        ("solver.viscosity=0.2", "solver.viscosity"),
        ("solver.time_step_factor=0.5", "there are no time steps"),
        ('solver.control="cmod"', "solver.control"),
        ("solver.smallest_increment=0.5", "less than solver.largest_increment"),
        ("solver.largest_increment=1e-7", "solver.largest_increment = 1e-07: expected more than solver.smallest_increment = 1e-06"),
        ("bodies.0.velocity=[1.0, 0.0]", "bodies.0.velocity"),
    ],
)
def test_what_does_nothing_is_refused(set_, says):
    with pytest.raises(SceneError) as error:
        load_scene("den", [*STATIC, set_])
    assert says in str(error.value)


def test_explicit_refuses_what_only_equilibrium_uses():
    with pytest.raises(SceneError, match='solver.tolerance = 1e-05: expected none without solver.kind = "quasistatic"'):
        load_scene("den", ["solver.tolerance=1e-5"])


def test_bridge_is_the_last_resort(monkeypatch):
    """With control by energy taken away the snap-back of a bar is a fall, whose energy is accounted for."""
    monkeypatch.setattr(follow.Follower, "_by_energy", lambda *args, **more: False)
    sim = QuasiStatic.of(bar(800, "displacements.0.history.value=[0.0, 0.06, 0.2]", "output.samples=20"))
    sim.at_rest()
    for sample in range(1, 21):
        sim.advance(sample)
    reading = sim.read()
    external, *parts = (float(value) for value in reading.energies())
    assert sim.follower.bridges and sim.report()["bridge_energy"] > 0
    assert sum(parts) == pytest.approx(external, rel=0.01)
    assert float(reading.dissipated) == pytest.approx(9.93, rel=0.01)
