"""Bars around H_max = h (1 + E/E_p), the length beyond which the response of a bar with one crack snaps back.

With ν = 0 the bar is the uniaxial law: elongation δ = σ L/E + w(σ). Up to H_max it falls steadily as the ends are drawn apart,
and their work is G_F × area. Beyond, the load falls at once, at constant δ, to where the curve is met again, and the
area passed over is work besides, which goes to waves. Equilibria follow the curve back instead.
"""

import jax.numpy as jnp
import numpy as np

from jaxmpm import verify
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic
from jaxmpm.scene import Scene, load_scene
from jaxmpm.stability_page.looks import curves, plain

NAME, TITLE = "h_max", r"Bars beyond $H_\mathrm{max}$ snap back: work to break them"
E, FT, EP, N, H, AREA = 32000.0, 2.85, 8.184, 0.128, 0.05, 100.0  # of the weak column of the scene `bar`
LENGTHS = (60, 195, 400, 800, 1600)  # mm
END = 0.21  # mm: opening at which 99.9 % of G_F is spent
STATIC, MOTION = "in equilibrium", "in motion"
WAYS = {STATIC: 'solver.kind="quasistatic"', MOTION: "solver.damping=0.05"}
FALL = "fall of the load"


def law() -> Damage:
    """The band of the weak column."""
    return Damage(*map(jnp.asarray, (FT, EP, N, H)))


def fracture_energy() -> float:
    """G_F, N/mm."""
    return float(law().fracture_energy(Elastic(E, 0.0)))


def largest_length() -> float:
    """H_max, mm."""
    return float(law().largest_size(Elastic(E, 0.0)))


def bar_scene(length: float, *changes) -> Scene:
    """The scene `bar` in uniaxial stress, its length in mm, on cells of 5 mm, drawn apart until it is broken."""
    peak = FT / E * length
    more = [f"grid.size=[{length:g}, 10.0]", f"bodies.0.shapes.0.max=[{length:g}, 10.0]", "parameters.cell=5"]
    more += [f"sets.right.inside.0.{side}=[{length:g}, {y}]" for side, y in (("min", 0.0), ("max", 10.0))]
    more += [f"materials.{name}.bulk.nu=0.0" for name in ("concrete", "weak")]
    slow = length / 100
    more += [f"displacements.0.history.value=[0.0, {2 * peak}, {2 * peak + END}]", f"displacements.0.history.time=[0.0, {4e-3 * slow}, {8e-3 * slow}]"]
    return load_scene("bar", [*more, f"solver.duration={8e-3 * slow}", "output.samples=60", "output.frames=2", *changes])


def curve(length: float):
    """Stress (MPa) and elongation (mm) of the closed form, from onset to `END`."""
    s = np.geomspace(1.0, 1e-12, 20001)
    stress, opening = verify.closed_form(s, E, FT, EP, N, H)
    return stress, opening + stress / E * length


def met_again(length: float) -> tuple[float, float]:
    """Where the elongation may not go back: the fall of the load over the strength, and the whole work over G_F × area."""
    stress, elongation = curve(length)
    reached = np.maximum.accumulate(elongation)
    beyond = np.flatnonzero(elongation > elongation[0])[0]
    work = FT**2 * length / (2 * E) + np.trapezoid(stress, reached)
    return float(1 - stress[beyond] / FT), float(work / fracture_energy())


def measure(say) -> dict:
    """Work and energy dissipated over G_F × area, by length, in equilibrium and in motion; the fall of the load over the strength."""
    whole, limit = fracture_energy() * AREA, largest_length()
    rows = []
    for way, change in WAYS.items():
        for length in LENGTHS:
            found = verify.summary_of(bar_scene(length, change))
            values = {"work": found["external_work"] / whole, "dissipated": found["dissipated_energy"] / whole}
            rows += [{"series": f"{name}, {way}", "x": length / limit, "y": value} for name, value in values.items()]
        say(_told(way, rows))
    for ratio in np.geomspace(0.25, LENGTHS[-1] / limit, 100).tolist():
        rows += [{"series": f"{name}, closed form", "x": ratio, "y": y} for name, y in zip((FALL, "work"), met_again(ratio * limit), strict=True)]
    return {"rows": rows, "largest_length": limit, "fracture_energy": fracture_energy()}


def _told(way, rows) -> str:
    span = lambda name: [row["y"] for row in rows if row["series"] == f"{name}, {way}"]  # noqa: E731
    work, spent = span("work"), span("dissipated")
    return f"{way}: dissipated {min(spent):.3f} to {max(spent):.3f} of G_F × area, work {work[0]:.3f} to {work[-1]:.3f}"


def lines(found):
    """What each way gives, in words, and the closed form at the longest bar."""
    for way in WAYS:
        yield _told(way, found["rows"])
    fall, work = met_again(LENGTHS[-1])
    yield f"closed form of the longest bar: the load falls by {fall:.0%}, work {work:.3f}; H_max = {found['largest_length']:.1f} mm"


def draw(axes, found):
    """Work as open markers over the closed form, energy dissipated as small full ones, and the fall of the load."""
    own = lambda series: [row for row in found["rows"] if row["series"] == series]  # noqa: E731
    curves(axes, own("work, closed form"), 5, marker="", label="work, closed form, no way back")
    for k, way in enumerate(WAYS):
        curves(axes, own(f"work, {way}"), k, ls="", mfc="none", ms=6)
        curves(axes, own(f"dissipated, {way}"), k, ls="", ms=3)
    curves(axes, own(f"{FALL}, closed form"), 3, marker="", label="fall of the load / strength")
    axes.axvline(1.0, color="#444444", lw=0.9, ls="--", zorder=1)
    axes.set(xlabel=r"length / $H_\mathrm{max}$", ylabel=r"energy / ($G_F$ × area)", xlim=(0, None), ylim=(0, 4))
    axes.legend(fontsize=7, loc="upper left")
    plain(axes)
