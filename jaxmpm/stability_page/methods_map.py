"""The coarse map of `jaxmpm stability`: one cracked point under uniaxial strain, by four methods."""

from jaxmpm import stability, stability_plot
from jaxmpm.stability_methods import METHODS

NAME, TITLE = "map", "Is the fracture energy of one cracked point right? By its size and the strain increment, for four methods"
PATH = "uniaxial"
KEPT = ("method", "path", "precision", "size_ratio", "increment", "verdict", "energy_ratio", "steps", "enlarged")


def measure(say) -> dict:
    """The cells of the coarse map; x is H/H_max, y the energy over G_F, each row a strain increment over that at onset."""
    rows = []
    for method in METHODS:
        cells = [{name: row[name] for name in KEPT} for row in stability.cells(True, (method,)) if row["path"] == PATH]
        rows += [{"series": f"{method}, increment {c['increment']:g}", "x": c["size_ratio"], "y": c["energy_ratio"]} | c for c in cells]
        say(_share(method, cells))
    return {"rows": rows}


def _share(method, cells) -> str:
    right = sum(cell["verdict"] == "right" for cell in cells) / len(cells)
    return f"{METHODS[method].title}: right within 1 % in {right:.0%} of the map"


def lines(found):
    """The share of each method's map that is right."""
    for method in METHODS:
        yield _share(method, [row for row in found["rows"] if row["method"] == method])


def draw(axes, found):
    """A strip of four maps, `axes` one for each method."""
    for one, (method, about) in zip(axes, METHODS.items(), strict=True):
        stability_plot.panel(one, [row for row in found["rows"] if row["method"] == method])
        one.set_title(about.title, fontsize=8.5, pad=4)
        one.set_xlabel(r"size $H/H_\mathrm{max}$")
        one.tick_params(labelleft=one is axes[0])
    axes[0].set_ylabel("increment / onset strain")


def legend(figure) -> None:
    """What the colours mean, below the maps."""
    from matplotlib.patches import Patch

    marks = [Patch(fc=colour, ec="#888888", lw=0.5) for colour in stability_plot.COLOURS]
    figure.legend(
        marks[:-1], stability_plot.MEANING[:-1], loc="lower center", bbox_to_anchor=(0.54, -0.02), ncols=4, frameon=False, fontsize=7.5,
        handlelength=1.4, columnspacing=1.6,
    )  # fmt: skip
