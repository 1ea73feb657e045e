"""The picture of the stability map: one panel for each method, path and precision."""

from itertools import product
from pathlib import Path

import numpy as np

from jaxmpm import stability
from jaxmpm.plot import DPI, STYLE
from jaxmpm.stability_methods import METHODS

# Told apart by readers with any kind of colour vision, and by lightness.
COLOURS = ("#44aa99", "#e8d88a", "#cc6677", "#332288", "#111111")
MEANING = ("right (within 1 %)", "drifts (1–10 %)", "wrong (> 10 %)", "not converged", "not finite")


def draw(table, path) -> Path:
    """Draw the rows of a map and return the picture's path."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    ways = list(dict.fromkeys((row["path"], row["precision"]) for row in table))
    ways.sort(key=lambda way: list(stability.PATHS).index(way[0]))
    high = 2.1 * len(ways) + 1.6
    with rc_context(STYLE):
        figure = Figure(figsize=(10.6, high))
        grid = figure.subplots(len(ways), len(METHODS), sharex=True, sharey=True)
        figure.subplots_adjust(0.085, 1.2 / high, 0.965, 1 - 0.4 / high, wspace=0.07, hspace=0.09)
        for (row, way), (column, name) in product(enumerate(ways), enumerate(METHODS)):
            panel(grid[row, column], [r for r in table if stability.panel_of(r) == (name, *way)])
        for axes, method in zip(grid[0], METHODS.values(), strict=True):
            axes.set_title(method.title, fontsize=10, fontweight="bold", pad=7)
        for axes, (way, precision) in zip(grid[:, -1], ways, strict=True):
            axes.annotate(
                f"{way}, {precision}", (1, 0.5), (9, 0), "axes fraction", "offset points",
                rotation=-90, ha="left", va="center", fontsize=10, fontweight="bold",
            )  # fmt: skip
        figure.supxlabel(r"effective size $H/H_\mathrm{max}$", y=0.66 / high, fontsize=10.5)
        figure.supylabel("strain increment / onset strain", x=0.017, fontsize=10.5)
        _legend(figure)
        figure.savefig(path, dpi=DPI)
    return Path(path)


def panel(axes, rows) -> None:
    """Draw the rows of one panel of a map."""
    from matplotlib.colors import ListedColormap
    from matplotlib.ticker import LogLocator, NullLocator

    sizes = np.unique([row["size_ratio"] for row in rows])
    increments = np.unique([row["increment"] for row in rows])
    number = [stability.VERDICTS.index(row["verdict"]) for row in rows]
    number = np.reshape(number, (len(increments), len(sizes)))
    axes.pcolormesh(
        _edges(sizes), _edges(increments), number, cmap=ListedColormap(COLOURS),
        vmin=-0.5, vmax=len(COLOURS) - 0.5, rasterized=True, edgecolors="#ffffff55", linewidth=0.3,
    )  # fmt: skip
    axes.set(xscale="log", yscale="log", xlim=_edges(sizes)[[0, -1]])
    axes.set_ylim(_edges(increments)[[0, -1]])
    axes.xaxis.set_major_locator(LogLocator(10))
    axes.yaxis.set_major_locator(LogLocator(10, numticks=9))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.axvline(1.0, color="black", lw=1.2, ls=(0, (4, 2)))
    _hatch(axes, rows)
    right = (number == 0).mean()
    axes.text(
        0.97, 0.04, f"{100 * right:.0f} % right", transform=axes.transAxes, ha="right", fontsize=8.5,
        bbox={"boxstyle": "round,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.88},
    )  # fmt: skip


def _hatch(axes, rows):
    """Hatch where the increment was enlarged: its least value falls with the size."""
    enlarged = [row for row in rows if row["enlarged"]]
    if not enlarged:
        return
    least = stability.OPENING / (stability.largest_size() * stability.FT / stability.E)
    left, right = axes.get_xlim()
    at = np.geomspace(left, right, 200)
    floor = axes.get_ylim()[0]
    limit = np.maximum(least / at / enlarged[0]["steps"], floor)
    axes.fill_between(
        at, floor, limit, fc="none", ec="#00000070", hatch="////", lw=0.0, rasterized=True
    )


def _legend(figure):
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    marks = [Patch(fc=colour, ec="#888888", lw=0.5) for colour in COLOURS]
    marks.append(Line2D([], [], color="black", lw=1.2, ls=(0, (4, 2))))
    marks.append(Patch(fc="white", ec="#00000070", hatch="////", lw=0.5))
    words = (*MEANING, r"$H = H_\mathrm{max}$", "increment enlarged")
    figure.legend(
        marks, words, loc="lower center", ncols=len(words), frameon=False, fontsize=9,
        bbox_to_anchor=(0.5, 0.1 / figure.get_figheight()), columnspacing=1.4, handlelength=1.6, handletextpad=0.5,
    )  # fmt: skip


def _edges(centres):
    """Edges of cells from their centres, evenly spaced in the logarithm."""
    logs = np.log(centres)
    half = (logs[1] - logs[0]) / 2
    return np.exp(np.append(logs - half, logs[-1] + half))
