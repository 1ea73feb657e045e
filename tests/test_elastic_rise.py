"""The elastic rise passed in equilibrium: where it ends, what it has cost, and that motion goes on from there."""

import numpy as np
import pytest

from jaxmpm import results
from jaxmpm.errors import SceneError
from jaxmpm.run import run_scene
from jaxmpm.scene import load_scene
from jaxmpm.simulation import Simulation

RISE = {"solver.elastic_rise": "equilibrium"}


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """Coarse plates with either rise: summary and history."""
    found = []
    for rise in ("motion", "equilibrium"):
        scene = load_scene("den_4a", {"grid.cell": 5, "output.samples": 100, "output.frames": 2, "solver.elastic_rise": rise})
        directory = tmp_path_factory.mktemp(rise)
        summary = run_scene(scene, directory, progress=False)
        found.append((summary, results.read_history(directory / "history.csv")))
    return found


def test_the_response_is_that_of_motion(both):
    (moved, motion), (rested, equilibrium) = both
    assert rested["elastic_rise_steps"] > 0.4 * rested["steps"] and rested["messages"] == []
    np.testing.assert_allclose(rested["peak_load"], moved["peak_load"], rtol=2e-3)
    np.testing.assert_allclose(equilibrium["external_work"][-1], motion["external_work"][-1], rtol=2e-3)


def test_energy_is_accounted_for_from_the_first_step(both):
    assert both[1][0]["largest_energy_error"] < 1e-4


def test_a_bar_is_stretched_as_hooke_says():
    scene = load_scene("bar", {**RISE, "output.samples": 50})
    sim = Simulation.of(scene)
    rise, material = sim.rise, scene.materials["weak"]
    drive = sim.model.displacements[0]
    length, width = scene.grid.size
    pulled = lambda step: float(drive.amplitude(step * sim.dt))  # noqa: E731
    stress = material.bulk.E * np.array([pulled(rise.last), pulled(rise.last + 1)]) / length
    np.testing.assert_array_equal(stress < 0.97 * material.band.ft, [True, False])  # it ends just before onset
    stored = (pulled(rise.last) / length) ** 2 * material.bulk.E * length * width * scene.grid.thickness / 2
    state = rise.state(sim.state, rise.last)
    np.testing.assert_allclose(float(state.work.external), stored, rtol=0.02)  # kinetic energy is the rest
    sim.advance(rise.last)
    assert sim.cracked() == 0 and int(sim.state.step) == rise.last
    np.testing.assert_array_equal(sim.state.displacement, state.displacement)


def test_fast_loads_are_left_to_motion():
    fast = {"displacements.0.history": {"time": [0.0, 2e-5], "value": [0.0, 0.02]}, "solver.duration": 2e-5}
    rise = Simulation.of(load_scene("bar", {**RISE, **fast})).rise
    assert rise.last == 0 and "loads are not slow" in rise.why


@pytest.mark.parametrize(
    ("changes", "why"),
    [({"gravity": [0.0, -9810.0]}, "gravity"), ({"bodies.0.velocity": [1.0, 0.0]}, "velocity"), ({"solver.frame": "updated"}, "frame")],
)
def test_what_is_motion_is_refused(changes, why):
    with pytest.raises(SceneError, match=f'solver.elastic_rise = "equilibrium": expected "motion" with .*{why}'):
        load_scene("bar", {**RISE, **changes})


def test_a_loose_body_is_refused():
    with pytest.raises(SceneError, match='solver.elastic_rise = "equilibrium": expected supports that hold every body'):
        Simulation.of(load_scene("bar", {**RISE, "supports.1.fix": ["x"]}))


@pytest.mark.parametrize("history", [
    {"time": [0.0, 1e-3], "value": [2e-3, 4e-3]}, {"time": [0.0, 4e-4, 4.0001e-4, 1e-3], "value": [0.0, 1e-3, 4e-3, 4e-3]},
    {"time": [0.0, 2e-5, 1e-3], "value": [0.0, 4e-3, 4e-3]},
])  # fmt: skip
def test_a_load_that_jumps_early_is_left_to_motion(history):
    rise = Simulation.of(load_scene("bar", {**RISE, "displacements.0.history": history, "solver.duration": 1e-3})).rise
    assert rise.last == 0 and "loads are not slow" in rise.why


def test_a_load_that_turns_back_between_two_samples_cracks_what_it_cracks():
    peaked = {"time": [0.0, 2e-3, 3e-3, 4e-3, 6e-3], "value": [0.0, 0.0, 0.05, 0.0, 0.0]}
    changes = {**RISE, "displacements.0.history": peaked, "solver.duration": 6e-3, "output.samples": 3}
    sim = Simulation.of(load_scene("bar", changes))
    assert sim.steps / 3 < sim.rise.last < sim.steps / 2
