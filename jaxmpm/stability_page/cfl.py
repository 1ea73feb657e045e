"""The largest stable time step, found by bisection of runs, over the one that the program takes for it.

A free block, or a bar with a crack, is shaken by random velocities, undamped, and goes on by some factor times `stable_dt`. What is unstable grows
without bound: such a run ends with many times the energy that it began with, or with numbers that are not finite, or with
a point that has moved by more than a cell.
"""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from jaxmpm.errors import RunError
from jaxmpm.moving_simulation import MovingSimulation
from jaxmpm.scene import Scene
from jaxmpm.simulation import Simulation
from jaxmpm.stability_page.h_max import bar_scene
from jaxmpm.stability_page.looks import COLOURS, MARKERS, plain
from jaxmpm.stiffness import amplitudes, held_at

NAME, TITLE = "cfl", "Largest stable time step over the program's estimate"
STEPS, LOOKS = 800, 8  # of a run, and how often its energy is looked at
GROWN = 10.0  # times the energy at the begin: beyond it a run is unstable
TOLERANCE = 0.01  # of the factor found
LOW, HIGH = 0.1, 4.0  # between these it is looked for
DENSITY, YOUNG = 2.4e-9, 32000.0
WAVE = np.sqrt(YOUNG / DENSITY)  # mm/s
SHAKE = 1e-6  # random velocities over WAVE, which crack nothing
BAR, OPENED = 60.0, 0.7  # mm, and share of the path to its full separation
ROOM = 12  # cells around a block
FAST = 0.006  # of WAVE: a block crosses some cells in a run
FUNCTIONS = ("linear", "gimp", "quadratic", "cubic")
TOTAL = {"one cell": ((1, 1), 0.2), "column, ν = 0": ((1, 16), 0.0), "12 × 12 cells": ((12, 12), 0.2)}
STATES = {"at rest": 0.0, "crossing cells": FAST}  # speeds over WAVE


def block_scene(cells=(6, 6), nu=0.2, frame="total", shape="gimp", speed=0.0) -> Scene:
    """A free elastic block of cells of 1 mm that flies along the diagonal, `speed` over WAVE along each axis; `shape`: functions of points."""
    high = [float(ROOM + n) for n in cells]
    return Scene.from_dict({
        "name": "block", "title": "A block that is shaken",
        "grid": {"size": [n + ROOM for n in high], "cell": 1.0, "stress_state": "plane_stress", "thickness": 1.0,
                 "walls": dict.fromkeys(("left", "right", "bottom", "top"), "open")},
        "materials": {"concrete": {"density": DENSITY, "bulk": {"law": "elastic", "E": YOUNG, "nu": nu}}},
        "bodies": [{"name": "block", "material": "concrete", "velocity": [(speed or 1e-9) * WAVE] * 2,
                    "shapes": [{"kind": "rectangle", "min": [float(ROOM)] * 2, "max": high}]}],
        "points": {"shape": shape},
        "solver": {"frame": frame, "duration": 1e-3, "damping": 0.0},
    })  # fmt: skip


def shaken(scene: Scene):
    """The scene made ready, its nodes or points with random velocities besides."""
    sim = Simulation.of(scene)
    if scene.solver.frame != "updated":
        sim.state = sim.state._replace(velocity=sim.state.velocity + _noise(sim.state.velocity.shape) * sim.model.free)
        return sim
    sim = MovingSimulation.of(sim)
    points = sim.state.points
    velocity = jnp.where(points.mass > 0, points.velocity + _noise(points.velocity.shape), 0.0)
    sim.state = sim.state._replace(points=points._replace(velocity=velocity))
    return sim


def _noise(shape):
    return SHAKE * WAVE * np.random.default_rng(0).uniform(-1, 1, shape)


def cracked() -> Simulation:
    """A bar that has been drawn apart until little holds it, its ends now at rest, and shaken."""
    sim = Simulation.of(bar_scene(BAR, "solver.damping=0"))
    sim.advance(round(OPENED * sim.steps))
    sim.model = held_at(sim.model, amplitudes(sim.model, int(sim.state.step) * sim.dt))
    sim.state = sim.state._replace(velocity=_noise(sim.state.velocity.shape) * sim.model.free, step=jnp.zeros_like(sim.state.step))
    return sim


def energy_within(sim) -> float:
    """Stored energy, and kinetic energy but that of the body's flight as a whole, N·mm."""
    reading, flight = sim.read(), 0.0
    if isinstance(sim, MovingSimulation):
        mass = np.asarray(sim.state.points.mass)
        momentum = (mass * np.asarray(sim.state.points.velocity)).sum((1, 2, 3))
        flight = (momentum**2).sum() / (2 * mass.sum())
    return float(reading.kinetic + reading.stored) - float(flight)


def grows(sim, factor, steps=STEPS) -> bool:
    """Whether a run is unstable whose time step is so many times the estimate; `sim` is left as it was.

    Of small time steps there are more: a body that flies comes as far.
    """
    begin, sim.dt, steps = sim.state, factor * sim.stable_dt, round(steps / min(factor, 1.0))
    first = energy_within(sim)
    try:
        for k in range(1, LOOKS + 1):
            sim.advance(steps * k // LOOKS)
            if not energy_within(sim) < GROWN * first:
                return True
        return False
    except RunError:
        return True
    finally:
        sim.state = begin


def critical(unstable: Callable[[float], bool], low=LOW, high=HIGH) -> float | None:
    """The factor above which runs are unstable, by bisection; None where even the lowest one is."""
    if unstable(low):
        return None
    while high / low > 1 + TOLERANCE:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if unstable(middle) else (middle, high)
    return (low * high) ** 0.5


def measure(say) -> dict:
    """The factor of every block."""
    rows = []

    def note(series, x, sim):
        rows.append({"series": series, "x": x, "y": critical(lambda factor: grows(sim, factor))})
        say(f"{series}, {x}: {told(rows[-1]['y'])}")

    for name, (cells, nu) in TOTAL.items():
        note("total frame", name, shaken(block_scene(cells, nu)))
    note("total frame", "bar with a crack", cracked())
    for name, speed in STATES.items():
        for shape in FUNCTIONS:
            note(name, shape, shaken(block_scene(frame="updated", shape=shape, speed=speed)))
    return {"rows": rows}


def told(factor) -> str:
    """A factor in words."""
    return f"{factor:.2f}" if factor else f"unstable at {LOW:g} too"


def lines(found):
    """The factors in words."""
    for row in found["rows"]:
        yield f"{row['series']}, {row['x']}: {told(row['y'])}"


def draw(axes, found):
    """A row for each body or kind of function, a marker for each state."""
    names = list(dict.fromkeys(row["x"] for row in found["rows"]))
    for series, colour, marker in zip(dict.fromkeys(row["series"] for row in found["rows"]), COLOURS, MARKERS, strict=False):
        own = [row for row in found["rows"] if row["series"] == series]
        label = series if series == "total frame" else f"points that move, {series}"
        axes.plot([row["y"] or LOW for row in own], [names.index(row["x"]) for row in own], marker, color=colour, ms=6, label=label)
        for row in own:
            if row["y"] is None:
                axes.annotate("none found", (LOW, names.index(row["x"])), (7, 0), textcoords="offset points", va="center", fontsize=7.5)
    axes.axvline(1.0, color="#444444", lw=0.9, ls="--", zorder=1)
    axes.annotate("estimate", (1.0, 1.0), (-3, -3), ("data", "axes fraction"), "offset points", rotation=90, ha="right", va="top", fontsize=8)
    axes.set(xlim=(0, None), ylim=(len(names) - 0.4, -0.6), xlabel="critical step / estimate")
    axes.set_yticks(range(len(names)), [name.replace("gimp", "GIMP") for name in names])
    axes.legend(fontsize=7.5, loc="upper right")
    plain(axes)
