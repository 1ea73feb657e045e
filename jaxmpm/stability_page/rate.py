"""The double-edge-notched plate at several loading rates, against its path through equilibria."""

from jaxmpm import verify
from jaxmpm.chart import settings
from jaxmpm.stability_page.looks import curves, plain

NAME, TITLE = "rate", "Loading rate: a plate against equilibrium"
SOURCE = settings.Source("den", ("grid.cell=5", "output.samples=200", "output.frames=2"))
STATIC = settings.Source("den", (*SOURCE.overrides, 'solver.kind="quasistatic"'))
SPEEDS = (8.0, 4.0, 2.0, 1.0, 0.5, 0.25)  # over that of the scene, 0.06 mm in 5 ms
KINETIC = "kinetic / stored energy at the peak"


def scene(speed: float):
    """The plate loaded at a speed over that of the scene."""
    return settings.apply(SOURCE, {"speed": speed})


def measure(say) -> dict:
    """How far peak and work are above those in equilibrium, by speed."""
    static = verify.summary_of(STATIC.scene())
    rows = []
    for speed in SPEEDS:
        found = verify.summary_of(scene(speed))
        for name, key in (("peak", "peak_load"), ("work", "external_work")):
            rows.append({"series": name, "x": speed, "y": found[key] / static[key] - 1})
        rows.append({"series": KINETIC, "x": speed, "y": found["kinetic_share_at_peak"]})
        say(_told(rows, speed))
    return {"rows": rows, "static": {key: static[key] for key in ("peak_load", "external_work", "wall_seconds")}}


def _told(rows, speed) -> str:
    at = {row["series"]: row["y"] for row in rows if row["x"] == speed}
    return f"{speed:g} times the scene's rate: peak {at['peak']:+.2%}, work {at['work']:+.2%}, kinetic share {at[KINETIC]:.1e}"


def lines(found):
    """What each rate adds, in words."""
    yield f"in equilibrium: peak {found['static']['peak_load'] / 1e3:.3f} kN, work {found['static']['external_work']:.1f} N mm"
    for speed in dict.fromkeys(row["x"] for row in found["rows"]):
        yield _told(found["rows"], speed)


def draw(axes, found):
    """Differences in per cent on the left, the share of kinetic energy on the right."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    rows = [row | {"y": 100 * row["y"]} for row in found["rows"]]
    curves(axes, [row for row in rows if row["series"] != KINETIC])
    kinetic = [row for row in rows if row["series"] == KINETIC]
    curves(axes, kinetic, 2)
    axes.set(xscale="log", yscale="log", xlabel="loading rate / the scene's (0.06 mm in 5 ms)", ylabel="above equilibrium; share [%]")
    axes.xaxis.set_major_locator(FixedLocator(sorted({row["x"] for row in rows})))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.legend(fontsize=7.5, loc="upper left")
    plain(axes)
