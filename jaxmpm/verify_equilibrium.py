"""Checks of equilibrium in points that move: a column under its own weight, a cantilever bent far, a cracked plate."""

from collections.abc import Iterator

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from jaxmpm.moving_equilibrium import Newton
from jaxmpm.moving_static import MovingStatic
from jaxmpm.points import listed
from jaxmpm.scene import Scene, load_scene
from jaxmpm.verify_moving import ORDER, fitted_order
from jaxmpm.verify_points import row

STATIC = ('solver.kind="quasistatic"', 'solver.frame="updated"', "solver.damping=0.02")
TALL, WEIGHT, YOUNG = 50.0, 8e-7 * 9810.0, 1.0  # mm, N/mm³, MPa


def column_scene(cells: int, increments: int, shape="gimp") -> Scene:
    """A neo-Hookean column one cell wide between slippery walls, so heavy that it loses a sixth of its height."""
    side = TALL / cells
    return Scene.from_dict({
        "name": "column", "title": "A column under its own weight", "gravity": [0.0, -9810.0],
        "grid": {"size": [side, TALL], "cell": side, "stress_state": "plane_strain", "thickness": 1.0,
                 "walls": {"left": "slip", "right": "slip", "bottom": "slip"}},
        "materials": {"soft": {"density": 8e-7, "bulk": {"law": "neo_hookean", "E": YOUNG, "nu": 0.0}}},
        "bodies": [{"name": "column", "material": "soft", "shapes": [{"kind": "rectangle", "min": [0.0, 0.0], "max": [side, TALL]}]}],
        "points": {"shape": shape},
        "solver": {"kind": "quasistatic", "frame": "updated", "duration": 1.0,
                   "first_increment": 1 / increments, "largest_increment": 1 / increments},
        "output": {"samples": 2, "frames": 2},
    })  # fmt: skip


def column_exact(home):
    """Stress (MPa) and displacement (mm) of a column at undeformed heights (mm).

    The first Piola-Kirchhoff stress is P = −ρ g (L − X) whatever the law; ν = 0 makes P = E/2 (λ − 1/λ), and x follows by
    integration of the stretch λ.
    """
    p = lambda x: -WEIGHT * (TALL - x) / YOUNG  # noqa: E731
    whole = lambda p: (p * np.sqrt(p * p + 1) + np.arcsinh(p) + p * p) / 2  # noqa: E731
    return YOUNG * p(home), YOUNG / WEIGHT * (whole(p(home)) - whole(p(0.0))) - home


def settled(cells: int, increments: int, shape="gimp") -> MovingStatic:
    """The column under all of its weight."""
    sim = MovingStatic.of(column_scene(cells, increments, shape))
    sim.at_rest()
    return sim


def column_errors(sim: MovingStatic) -> tuple[float, float]:
    """Rms error of the displacement over the height, and mean error of the stress over the largest."""
    n = sim.model.numerics
    position, fields = listed(sim.state.points, sim.layout.origin, n.cell, n.shape.centred)
    home, gradient = fields["home"][1], fields["gradient"]
    stress, moved = column_exact(home)
    own = fields["stress"][1] / ((1 + gradient[0, 0]) * (1 + gradient[1, 1]) - gradient[0, 1] * gradient[1, 0])
    miss = np.sqrt(((position[1] - home - moved) ** 2).mean()) / TALL
    return float(miss), float(np.abs(own - stress).mean() / (WEIGHT * TALL))


def elastica(load, young=100.0, side=10.0, length=100.0):
    """Deflection and shortening (mm) of a cantilever of square section, ν = 0, under a dead load (N) at its tip.

    Reissner's beam: with stretch and shear (shear factor 5/6), by a shooting method.
    """
    bend, stretch, shear = young * side**4 / 12, young * side**2, 5 / 6 * young / 2 * side**2

    def along(_, y):
        c, s = np.cos(y[0]), np.sin(y[0])
        e, g = -load * s / stretch, -load * c / shear
        return [y[1] / bend, load * ((1 + e) * c - g * s), (1 + e) * c - g * s, (1 + e) * s + g * c]

    end = lambda moment: solve_ivp(along, (0, length), [0, moment, 0, 0], rtol=1e-9, atol=1e-9).y[:, -1]  # noqa: E731
    _, _, x, y = end(brentq(lambda moment: end(moment)[1], -load * length, 0.0))
    return -y, length - x


def bent(cell: float, increment: float, *changes) -> MovingStatic:
    """The scene cantilever in equilibrium, bent by all of its load; increments over the duration."""
    more = (f"grid.cell={cell}", f"solver.largest_increment={increment}", "output.samples=2", 'points.shape="gimp"')
    sim = MovingStatic.of(load_scene("cantilever", [*STATIC, *more, *changes]))
    sim.at_rest()
    for sample in (1, 2):
        sim.advance(sample)
    return sim


def convergence(sim: MovingStatic, factor: float, tolerance=1e-11) -> list[float]:
    """Errors of Newton's iterations when the loads of an equilibrium are multiplied by a factor at once."""
    asked, _ = sim.path.increment(sim.state, sim.amplitude, factor * sim.amplitude)
    return Newton(asked).solve(tolerance).history


def rate(errors) -> float:
    """Order of convergence by the last three errors above round-off: 2 for Newton's method."""
    a, b, c = [e for e in errors if e > 1e-10][-3:]
    return float(np.log(c / b) / np.log(b / a))


def column(cells=(8, 16, 32, 64)) -> Iterator[dict]:
    """The column on ever smaller cells."""
    sims = [settled(count, 50) for count in cells]
    miss, stress = np.array([column_errors(sim) for sim in sims]).T
    yield row("column, order of displacement", fitted_order(cells, miss), 2.0, 2 - ORDER, side="≥")
    yield row("column, displacement", miss[-1], 0.0, 1e-5)
    yield row("column, stress", stress[-1], 0.0, 2e-3)
    yield row("column, order of Newton", rate(convergence(sims[0], 2.0)), 2.0, 0.3, side="≥")


def slow_cantilever(cells=(5.0, 2.5, 1.25)) -> Iterator[dict]:
    """A cantilever bent by 60 % of its length through equilibria, against Reissner's beam."""
    found, exact = [], elastica(25.0)
    for cell in cells:
        sim = bent(cell, 0.05)
        gauges = sim.read().gauges
        found.append(abs(gauges["deflection"] / exact[0] - 1))
    yield row("slow cantilever, deflection", gauges["deflection"], exact[0], 0.01)
    yield row("slow cantilever, shortening", gauges["shortening"], exact[1], 0.01)
    yield row("slow cantilever, order", fitted_order(1 / np.array(cells), found), 1.0, 0.2, side="≥")


def slow_plate(cell=5.0) -> Iterator[dict]:
    """The double-edge-notched plate in equilibrium in either frame."""
    from jaxmpm.verify_scenes import _summary

    changes = ['solver.kind="quasistatic"', f"grid.cell={cell}", "output.samples=60", "output.frames=2"]
    total, updated = (_summary("den", [*changes, f'solver.frame="{frame}"']) for frame in ("total", "updated"))
    for what in ("peak_load", "final_load"):
        yield row(f"slow plate, {what.replace('_', ' ')}", updated[what], total[what], 0.02)
    yield row("energy balance, slow plate", updated["largest_energy_error"], 0.0, 2e-3)


def equilibrium() -> Iterator[dict]:
    """All of them."""
    for check in (column, slow_cantilever, slow_plate):
        yield from check()
