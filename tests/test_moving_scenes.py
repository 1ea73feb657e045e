"""Scenes of points that move: walls, contact, what leaves, what must stop a run."""

import numpy as np
import pytest
from moving_scenes import block, scene

from jaxmpm.errors import RunError, SceneError
from jaxmpm.moving_simulation import MovingSimulation
from jaxmpm.points import listed
from jaxmpm.run import energy_error
from jaxmpm.scene import load_scene
from jaxmpm.simulation import Simulation

HASTY = True  # see conftest.py


def simulation(*args, **kwargs):
    return MovingSimulation.of(Simulation.of(scene(*args, **kwargs)))


def points_of(sim):
    n = sim.model.numerics
    return listed(sim.state.points, sim.layout.origin, n.cell, n.shape.centred)


def to_end(sim):
    sim.advance(sim.steps)
    return sim.read()


def test_points_leave_across_an_open_edge_and_are_counted():
    sim = simulation(
        [block((40, 20), (55, 35), velocity=(3e4, 0.0))], walls={"right": "open"}, solver={"duration": 6e-4}
    )
    whole = float(np.asarray(sim.state.points.mass).sum())
    start = float(sim.read().kinetic)
    sim.advance(sim.steps // 2)
    reading = sim.read()
    inside = float(np.asarray(sim.state.points.mass).sum())
    assert 0 < sim.left["points"] < 36 and sim.count() + sim.left["points"] == 36
    assert inside + sim.left["mass"] == pytest.approx(whole, rel=1e-12)
    assert sim.left["energy"] == pytest.approx(start * sim.left["points"] / 36, rel=1e-6)
    assert abs(energy_error(reading, start)) < 1e-9


def test_a_run_stops_before_a_point_leaves():
    sim = simulation([block((40, 20), (55, 35), velocity=(3e4, 0.0))])
    with pytest.raises(RunError, match='across its right edge at t = .* grid.walls.right = "stop"'):
        to_end(sim)
    assert sim.count() == 36  # none is lost


def test_a_block_bounces_off_slip_walls_and_stays():
    sim = simulation(
        [block((40, 20), (55, 35), velocity=(3e4, 1e4))], walls=dict.fromkeys(("left", "right", "bottom", "top"), "slip"),
        solver={"duration": 2e-3},
    )  # fmt: skip
    start = float(sim.read().kinetic)
    reading = to_end(sim)
    x, fields = points_of(sim)
    assert x.shape[1] == 36 and (x > 0).all() and (x < 60).all()
    assert fields["velocity"][0].mean() < -1e4  # it has come back from the right
    assert abs(energy_error(reading, start)) < 0.15


def slid(friction, g=1e7):
    """Speeds of a block that slides on another, what friction took, and the time."""
    sim = simulation(
        [block((10, 25), (30, 35), velocity=(1e4, 0.0), name="upper"), block((5, 0), (55, 25), name="lower")],
        walls={"bottom": "slip", "left": "open", "right": "open", "top": "open"},
        contact={"kind": "friction", "friction": friction}, gravity=[0.0, -g], solver={"duration": 1.5e-3, "damping": 0.0},
    )  # fmt: skip
    reading = to_end(sim)
    x, fields = points_of(sim)
    first = fields["body"] == 0
    mass, speed = fields["mass"], fields["velocity"][0]
    upper, lower = ((mass * speed)[k].sum() / mass[k].sum() for k in (first, ~first))
    assert (mass * speed).sum() == pytest.approx(1e4 * mass[first].sum(), rel=1e-9)
    return upper, lower, float(reading.contact), float(reading.time)


def test_a_block_slides_on_another_with_friction():
    """Pressed down by gravity g it slows down by μ g; momentum goes to the other.

    Without friction it slows down too, as the normal at its corners is not upright: 20 % on four cells.
    """
    smooth, rough = slid(0.0), slid(0.3)
    assert smooth[0] - rough[0] == pytest.approx(0.3 * 1e7 * rough[3], rel=0.08)
    assert smooth[0] > 7500 and rough[1] - smooth[1] > 700
    assert 0 < smooth[2] < 0.1 * rough[2]


def test_bodies_that_only_pass_each_other_do_not_touch():
    """With fields of their own, bodies that move apart feel nothing of each other."""
    sim = simulation(
        [block((10, 20), (30, 40), velocity=(-1e4, 0.0)), block((30, 20), (50, 40), velocity=(1e4, 0.0), name="b")],
        contact={"kind": "friction"}, solver={"duration": 4e-4},
    )  # fmt: skip
    start = float(sim.read().kinetic)
    reading = to_end(sim)
    assert float(reading.kinetic) == pytest.approx(start, rel=1e-9)
    assert abs(float(reading.stored)) < 1e-6 * start


def test_a_wall_holds_in_the_total_frame_too():
    tree = scene(
        [block((20, 0), (40, 15))], walls={"bottom": "slip"}, gravity=[0.0, -1e6],
        solver={"frame": "total", "duration": 2e-3, "damping": 0.2},
    )  # fmt: skip
    sim = Simulation.of(tree)
    sim.advance(sim.steps)
    assert np.abs(np.asarray(sim.state.displacement)[1, :, 0]).max() == 0.0


def test_a_body_outside_the_grid_at_the_hand_over_stops_the_run():
    tree = scene([block((20, 0), (40, 15))], gravity=[0.0, -1e7], solver={"frame": "total", "duration": 1e-3})
    sim = Simulation.of(tree)
    sim.advance(sim.steps)
    with pytest.raises(RunError, match="is outside the grid at t = .* where the total frame hands over"):
        MovingSimulation.of(sim)


def test_gravity_is_the_same_in_both_frames():
    bodies = [block((20, 40), (40, 55))]
    found = []
    for frame in ("total", "updated"):
        tree = scene(bodies, gravity=[0.0, -1e6], solver={"frame": frame, "duration": 4e-3})
        sim = Simulation.of(tree)
        if frame == "updated":
            sim = MovingSimulation.of(sim)
        reading = to_end(sim)
        found.append(float(reading.kinetic) / float(reading.time) ** 2)
        assert abs(energy_error(reading)) < 0.02
    fallen = 1e-9 * 20 * 15 * 1e6**2 / 2
    np.testing.assert_allclose(found, fallen, rtol=0.04)  # velocities are half a step behind


@pytest.mark.parametrize(
    "name, changes, expected",
    [
        ("den", ['points.shape="cubic"'], '"linear" or "gimp" with materials.concrete'),
        ("discs", ['solver.frame="auto"'], '"elastic" in this frame'),
        ("brazil", ['solver.frame="updated"'], '"bodies" with solver.frame = "updated"'),
        ("den", ['points.fill="shapes"'], '"cells" in this frame'),
        ("den", ['solver.frame="total"', "points.per_side=3"], "points.per_side = 3: expected none in the total frame"),
        ("den", ['contact.kind="friction"'], '"stick" with one body'),
        ("bar", ['solver.frame="updated"', "displacements.0.history.value=[0.1,0.2,0.3]"], "begin with 0"),
        ("discs", ['points.transfer="xpic"', "points.fmpm_order=2"], "1 with points.transfer"),
        ("discs", ['contact.kind="friction"', "points.fmpm_order=2"], "1 with contact.kind"),
        ("discs", ['points.order="musl"'], '"usl" with points.transfer'),
        ("discs", ['grid.stress_state="plane_stress"'], '"plane_strain" with law'),
    ],
)
def test_choices_that_do_not_go_together_are_refused(name, changes, expected):
    with pytest.raises(SceneError, match=expected.replace("(", "\\(")):
        load_scene(name, changes)
