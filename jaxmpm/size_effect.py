"""The size effect: geometrically similar notched beams, and what a law with a width of its own has to do with it.

Beams in three-point bending, half-notched, of depths D over a range of 1:16 (the proportions of Grégoire et al. 2013: span 2.5 D,
length 3.5 D). The nominal strength σ_N = 3 P S / (2 b D²) at the peak is held against the size effect law of Bažant (1984),

    σ_N = B f_t / sqrt(1 + D/D₀),        G_f = (B f_t)² D₀ k(α₀)² / E,

whose fit gives a fracture energy: the one that peaks depend on, of the first slope of the softening curve (Bažant and Planas 1998).
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from jaxmpm.errors import RunError
from jaxmpm.scene import Scene

SIZES = (50.0, 100.0, 200.0, 400.0, 800.0)  # depths D, mm
SPAN, LENGTH, NOTCH = 2.5, 3.5, 0.5  # over D
WIDTH = 50.0  # b, mm
E, NU, FT = 37000.0, 0.2, 3.9
DAMAGE = {"law": "damage", "ft": FT, "Ep": 10.625, "n": 0.12933, "h": 0.05}  # of the scene `beam`: G_F = 0.1432 N/mm
INITIAL = 0.1432 / 4  # N/mm: below the first slope of its curve, 2 f_t²/G_F, which a straight curve keeps
LINEAR = {"law": "cohesive", "curve": "linear", "ft": FT, "GF": INITIAL, "h": 0.05}
ROWS = 46  # cells over the depth: of 4k + 2 a notch, supports and a column in the middle fit
ALIKE = {100.0: 14, 200.0: 26, 400.0: 50, 800.0: 102}  # rows of cells of 7 to 8 mm, by depth
OTHERS, AT = (10, 14, 22, 30), 200.0  # rows of a beam of one depth (mm) on other cells
WHOLE = 0.99  # of a cell that a smeared law fills
SAMPLES, FURTHEST = 200, 0.1  # of a path, and deflection at its end over D/50, mm
BEHIND = 0.97  # of the peak: there a path has passed it
LARGEST_D0 = 1e7  # mm: no size effect


@dataclass(frozen=True)
class Series:
    """Beams with one kind of law.

    `band`: its table, of the cell's size in mm; `beams`: depth (mm) and rows of cells over it, of each.
    """

    name: str
    band: Callable[[float], dict]
    beams: list[tuple[float, int]]


def smeared(cell: float, fitted_to: float | None = None) -> dict:
    """The damage law smeared over whole cells, without a width of its own.

    Scaled so that cells of a size (mm) dissipate G_F (the crack band model of Bažant and Oh 1983): of the cell that it is used
    on, or of another one that it was `fitted_to`.
    """
    from jaxmpm.laws.damage import Damage
    from jaxmpm.laws.elastic import Elastic
    from jaxmpm.laws.smeared import scaled_softening

    law = Damage(*(np.float64(DAMAGE[name]) for name in ("ft", "Ep", "n", "h")))
    size = WHOLE * (cell if fitted_to is None else fitted_to)
    return DAMAGE | {"Ep": math.exp(float(scaled_softening(law, Elastic(np.float64(E), np.float64(NU)), np.float64(size)))), "h": WHOLE * cell}


def series(sizes=SIZES, rows: int = ROWS) -> list[Series]:
    """What is compared on cells in proportion to the beam: bands, the smeared law scaled, and the smeared law as it is."""
    beams, first = [(depth, rows) for depth in sizes], sizes[0] / rows
    return [
        Series("band", lambda cell: DAMAGE, beams),
        Series("band, straight curve", lambda cell: LINEAR, beams),
        Series("smeared, scaled to the cell", smeared, beams),
        Series(f"smeared, as for {first:.3g} mm", lambda cell: smeared(cell, first), beams),
    ]


def on_other_cells() -> list[Series]:
    """The first of `series` on cells that are alike in all sizes, and that differ in one."""
    return [
        Series("band, cells alike", lambda cell: DAMAGE, list(ALIKE.items())),
        Series("band, other cells", lambda cell: DAMAGE, [(AT, rows) for rows in OTHERS]),
    ]


def beam(depth: float, rows: int, band: dict) -> Scene:
    """A beam of a depth (mm) on so many rows of cells, pressed down at mid-span through equilibria."""
    cell, length, middle = depth / rows, LENGTH * depth, LENGTH * depth / 2
    lips = middle - cell / 2, middle + cell / 2  # the notch is the column in the middle, as the load is its width
    at = lambda x0, x1, y: {"inside": [{"kind": "rectangle", "min": [x0, y], "max": [x1, y]}]}  # noqa: E731
    supports = [middle - SPAN * depth / 2, middle + SPAN * depth / 2]
    return Scene.from_dict({
        "name": "size_effect", "title": f"A half-notched beam {depth:g} mm high",
        "grid": {"size": [length, depth], "cell": cell, "stress_state": "plane_stress", "thickness": WIDTH},
        "materials": {"concrete": {"density": 2.4e-9, "bulk": {"law": "elastic", "E": E, "nu": NU}, "band": band}},
        "bodies": [{
            "name": "beam", "material": "concrete",
            "shapes": [{"kind": "rectangle", "min": [0.0, 0.0], "max": [length, depth]}],
            "minus": [{"kind": "rectangle", "min": [lips[0], 0.0], "max": [lips[1], NOTCH * depth]}],
        }],
        "sets": {"left": at(supports[0], supports[0], 0.0), "right": at(supports[1], supports[1], 0.0), "top": at(*lips, depth)},
        "supports": [{"set": "left", "fix": ["x", "y"]}, {"set": "right", "fix": ["y"]}],
        "displacements": [{"set": "top", "direction": "y", "history": {"time": [0.0, 1.0], "value": [0.0, -FURTHEST * depth / 50]}}],
        "gauges": {
            "load": {"kind": "reaction", "set": "top", "direction": -90.0},
            "deflection": {"kind": "displacement", "set": "top", "direction": -90.0},
        },
        "response": {"load": "load", "displacement": "deflection"},
        "bands": {"normal_window": 1},  # as in the scene `beam`
        "solver": {"kind": "quasistatic", "duration": 1.0},
        "output": {"samples": SAMPLES, "frames": 2},
    })  # fmt: skip


def peak_of(scene: Scene) -> float:
    """The peak load (N) on the way through equilibria, which is followed no further; raises RunError where it is not passed."""
    from jaxmpm.quasistatic import QuasiStatic
    from jaxmpm.run import energy_error

    path = QuasiStatic.of(scene)
    path.at_rest()
    highest = 0.0
    for sample in range(1, SAMPLES + 1):
        path.advance(sample)
        reading = path.read()
        path.check(reading, energy_error(reading))
        load = float(reading.gauges["load"])
        highest = max(highest, load)
        if load < BEHIND * highest:
            return highest
    raise RunError(f"{scene.title}: {load:.5g} N at the end of the path, no peak passed before: enlarge size_effect.FURTHEST")


def nominal(load: float, depth: float) -> float:
    """Nominal strength σ_N, MPa, of a peak load."""
    return 1.5 * load * SPAN / (WIDTH * depth)


def measure(many: list[Series], known=()) -> Iterator[dict]:
    """A row for each beam: `law`, `depth` and `cell` in mm, `rows`, `strength` σ_N in MPa, `seconds`; those of `known` rows are not run again."""
    known = {(row["law"], row["depth"], row["rows"]): row for row in known}
    for one in many:
        for depth, rows in one.beams:
            if (row := known.get((one.name, depth, rows))) is not None:
                yield row
                continue
            began = time.perf_counter()
            cell = depth / rows
            strength = nominal(peak_of(beam(depth, rows, one.band(cell))), depth)
            yield {"law": one.name, "depth": depth, "rows": rows, "cell": cell, "strength": strength, "seconds": time.perf_counter() - began}


# -- Bažant's law -------------------------------------------------------------------------------------


def intensity(alpha: float, span: float = SPAN) -> float:
    """k(α) of K_I = σ_N sqrt(D) k, three-point bending, α = a/D, span over depth from 2.5 (Guinea et al. 1998).

    For a span of 4 that of ASTM E399; the compliance of elastic beams here gives 1.722 at α = 0.5 and a span of 2.5, this 1.721.
    """
    rest = 1 - alpha
    four = 1.900 - alpha * (-0.089 + 0.603 * rest - 0.441 * rest**2 + 1.223 * rest**3)
    long = 1.989 - alpha * rest * (0.448 - 0.458 * rest + 1.226 * rest**2)
    return math.sqrt(alpha) / (rest**1.5 * (1 + 2 * alpha)) * (long + 4 / span * (four - long))


@dataclass(frozen=True)
class Fit:
    """Bažant's law through strengths: `plastic` B f_t in MPa, `transition` D₀ in mm, `deviation` the largest, relative."""

    plastic: float
    transition: float
    deviation: float

    def at(self, depth):
        """σ_N, MPa, of a depth, mm."""
        return self.plastic / np.sqrt(1 + depth / self.transition)

    @property
    def energy(self) -> float:
        """The fracture energy G_f, N/mm, that it stands for; infinite where there is no size effect."""
        return self.plastic**2 * self.transition * intensity(NOTCH) ** 2 / E if self.transition < LARGEST_D0 else math.inf

    def asymptote(self, depth):
        """σ_N, MPa, of linear elastic fracture mechanics with that energy."""
        return self.plastic * np.sqrt(self.transition / depth)


def fit(depths, strengths) -> Fit:
    """Bažant's law by least squares of the logarithms."""
    from scipy.optimize import least_squares

    depths, strengths = np.asarray(depths, float), np.asarray(strengths, float)
    law = lambda p: Fit(math.exp(p[0]), math.exp(p[1]), 0.0)  # noqa: E731
    first = [math.log(strengths.max()), math.log(depths.mean())]
    bounds = [-math.inf, math.log(depths.min() / 1e3)], [math.inf, math.log(LARGEST_D0)]
    found = law(least_squares(lambda p: np.log(law(p).at(depths) / strengths), first, bounds=bounds, xtol=1e-12).x)
    transition = found.transition if found.transition < 0.5 * LARGEST_D0 else math.inf
    return Fit(found.plastic, transition, float(np.abs(strengths / found.at(depths) - 1).max()))


def fits(rows: list[dict]) -> dict[str, Fit]:
    """Of each series of rows that has more than one size."""
    found = {}
    for name in dict.fromkeys(row["law"] for row in rows):
        points = [(row["depth"], row["strength"]) for row in rows if row["law"] == name]
        if len({depth for depth, _ in points}) > 1:
            found[name] = fit(*zip(*points, strict=True))
    return found
