"""Checks of whole scenes whose points move: two frames, a cracked body that turns, debris, a split disc."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import moving
from jaxmpm.moving_simulation import MovingSimulation
from jaxmpm.points import joined, listed, separate
from jaxmpm.scene import Scene, load_scene
from jaxmpm.simulation import Simulation
from jaxmpm.verify_points import row

ANGLES = (30.0, 135.0, 260.0)
STEPS = 100_000  # of the box of debris


def _summary(name, changes=()) -> dict:
    from jaxmpm.run import run_scene

    with tempfile.TemporaryDirectory() as directory:
        return run_scene(load_scene(name, changes), Path(directory), progress=False)


def frames(cell=5.0) -> Iterator[dict]:
    """Peak of the double-edge-notched plate in the total frame, in points that move, and handed over."""
    changes = [f"grid.cell={cell}", "output.samples=200", "output.frames=2"]
    total = _summary("den", [*changes, 'solver.frame="total"'])["peak_load"]
    for name, more in (
        ("updated frame", ['solver.frame="updated"']),
        ("handed over at 0.01 mm", ["solver.hand_over_displacement=0.01"]),
    ):
        found = _summary("den", [*changes, *more])
        yield row(f"peak of den {cell:g} mm, {name}", found["peak_load"], total, 0.01)
        yield row(f"energy balance, den {cell:g} mm, {name}", found["largest_energy_error"], 0.0, 2e-3)


def turned(scene=None, share=0.35) -> Iterator[dict]:
    """A cracked plate that is turned as a whole: stresses turn with it, nothing else changes.

    A `scene` (the double-edge-notched plate if None) after a `share` of its duration.
    """
    sim = Simulation.of(scene or load_scene("den", ["grid.cell=5"]))
    sim.advance(int(share * sim.steps))
    sim = MovingSimulation.of(sim)
    model, state = sim.model, _stressed(sim.model, sim.state)
    before = _energies(model, state)
    for degrees in ANGLES:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turn = jnp.array([[c, -s], [s, c]])
        points = state.points
        one = jnp.eye(2).reshape(2, 2, *[1] * points.mass.ndim)
        whole = jnp.einsum("ij,jk...->ik...", turn, points.gradient + one)
        points = points._replace(gradient=jnp.where(points.mass > 0, whole - one, 0.0))
        now = _stressed(model, state._replace(points=points))
        xx, yy, xy = state.points.stress
        expected = jnp.stack([
            c * c * xx - 2 * c * s * xy + s * s * yy,
            s * s * xx + 2 * c * s * xy + c * c * yy,
            c * s * (xx - yy) + (c * c - s * s) * xy,
        ])  # fmt: skip
        miss = jnp.abs(now.points.stress - expected).max() / jnp.abs(expected).max()
        yield row(f"cracked body turned by {degrees:g}, stress", miss, 0.0, 1e-9)
        change = max(abs(a - b) for a, b in zip(before, _energies(model, now), strict=True))
        yield row(f"cracked body turned by {degrees:g}, energy", change / before[0], 0.0, 1e-9)


@jax.jit
def _stressed(model, state):
    points, pool, failed = moving.stressed(model, separate(state.points), state.pool)
    return state._replace(points=joined(points), pool=pool, failed=failed)


def _energies(model, state):
    return [float(each) for each in jax.jit(moving.energies)(model, state.points, state.pool)[1:]]


def debris_scene(blocks=14, cells=24) -> Scene:
    """A closed box in which elastic blocks tumble, fall and collide."""
    rng = np.random.default_rng(0)
    bodies, side = [], 4
    places = [(i, j) for i in range(1, cells - side, side + 1) for j in range(1, cells - side, side + 1)]
    for k, place in enumerate(rng.permutation(places)[:blocks]):
        low = [float(p) for p in place]
        high = [p + int(rng.integers(2, side + 1)) for p in low]
        speed = (2e4 * rng.normal(size=2)).tolist()
        shape = {"kind": "rectangle", "min": low, "max": high}
        bodies.append({"name": f"block {k}", "material": "rubber", "shapes": [shape], "velocity": speed})
    return Scene.from_dict({
        "name": "debris", "title": "Debris that tumbles in a box",
        "grid": {
            "size": [float(cells)] * 2, "cell": 1.0, "stress_state": "plane_stress", "thickness": 1.0,
            "walls": dict.fromkeys(("left", "right", "bottom", "top"), "slip"),
        },
        "materials": {"rubber": {"density": 1e-9, "bulk": {"law": "elastic", "E": 10.0, "nu": 0.3}}},
        "bodies": bodies, "gravity": [0.0, -2e6],
        "solver": {"frame": "updated", "duration": 1.0, "time_step_factor": 0.8, "damping": 0.0},
    })  # fmt: skip


def debris(steps=STEPS) -> Iterator[dict]:
    """Points of a box of tumbling debris after many steps: none lost, all inside, mass as it was."""
    sim = MovingSimulation.of(Simulation.of(debris_scene()))
    count, mass = sim.count(), float(sim.state.points.mass.sum())
    for k in range(1, 11):
        sim.advance(min(k * steps // 10, sim.steps))
    n = sim.model.numerics
    x, fields = listed(sim.state.points, sim.layout.origin, n.cell, n.shape.centred)
    outside = ((x < 0) | (x > np.reshape(n.cells, (2, 1)) * n.cell) | ~np.isfinite(x)).any(0).sum()
    yield row(f"debris, points lost in {int(sim.state.step)} steps", count - x.shape[1] + outside, 0.0, 0.0)
    yield row("debris, mass", float(fields["mass"].sum()), mass, 1e-12)
    energies = sim.read().energies()
    lost = (float(energies[0]) - sum(map(float, energies[1:]))) / float(energies[0])
    yield row("debris, energy made", max(-lost, 0.0), 0.0, 1e-3)


def brazil() -> Iterator[dict]:
    """Energy balance of the disc that splits and flies apart."""
    summary = _summary("brazil", ["output.frames=2"])  # its own samples: between them it must not pass a cell
    yield row("energy balance, brazil", summary["largest_energy_error"], 0.0, 0.02)
    yield row("points lost, brazil", summary["points_left"]["points"], 0.0, 0.0)


def cantilever() -> Iterator[dict]:
    """Tip of a beam bent by P = 3 E I / L², against the elastica (Mattiasson 1981).

    The elastica does not shear; this beam, ten times as long as thick, bends by 1 % more for it.
    """
    from jaxmpm.results import read_history
    from jaxmpm.run import run_scene

    with tempfile.TemporaryDirectory() as directory:
        run_scene(load_scene("cantilever", ["output.frames=2"]), Path(directory), progress=False)
        history = read_history(Path(directory) / "history.csv")
    late = history["time"] > 0.105
    for name, expected in (("deflection", 60.325), ("shortening", 25.442)):
        yield row(f"cantilever, {name}", history[name][late].mean(), expected, 0.05)
