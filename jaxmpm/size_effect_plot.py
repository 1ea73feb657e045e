"""The picture of the size effect: nominal strength over depth, with Bažant's law and both its asymptotes."""

from pathlib import Path

import numpy as np

from jaxmpm import plot_style
from jaxmpm.plot_style import FAINT, INK, styled_figure

# Okabe and Ito's colours, a marker and a line of its own for each besides.
LOOKS = (("#0072B2", "o", "-"), ("#009E73", "D", "-"), ("#E69F00", "s", "--"), ("#D55E00", "^", ":"), ("#56B4E9", "x", ""))
BEYOND = 1.6  # times the range of depths that is drawn
ELSEWHERE = ", other cells"  # how a series ends whose cells differ in one size


def plot_size_effect(rows: list[dict], fits: dict, path) -> Path:
    """Draw the rows of `size_effect.measure` and their fits; returns the picture's path (.png, .pdf, .svg)."""
    depths = np.array(sorted({row["depth"] for row in rows}))
    along = np.geomspace(depths[0] / BEYOND, depths[-1] * BEYOND, 200)
    main = next(iter(fits.values()))
    with styled_figure() as figure:
        several = any(row["law"].endswith(ELSEWHERE) for row in rows)
        figure.set_size_inches(6.6 if several else 4.6, 3.3)
        axes, *more = figure.subplots(1, 2, width_ratios=[2.2, 1]) if several else [figure.add_subplot()]
        for (name, fit), (colour, marker, line) in zip(fits.items(), LOOKS, strict=False):
            points = [(row["depth"], row["strength"]) for row in rows if row["law"] == name]
            inside = {"s": "none"}.get(marker, colour)  # what hides nothing below
            axes.plot(*zip(*points, strict=True), marker, color=colour, mfc=inside, ms=7 if inside == "none" else 5.5, mew=1.2, label=name, zorder=3)
            if line:
                axes.plot(along, fit.at(along), line, color=colour, lw=1.1, zorder=2)
        axes.set(xscale="log", yscale="log", xlabel="depth D [mm]", ylabel=r"nominal strength $\sigma_N$ [MPa]")
        low, high = axes.get_ylim()
        _asymptotes(axes, main, along)
        axes.set_ylim(low, max(high, 1.12 * main.plastic))
        _ticks(axes, depths)
        axes.legend(frameon=False, fontsize=8, loc="lower left")
        for beside in more:
            _over_cells(beside, rows, [name for name in fits if any(row["law"] == name + ELSEWHERE for row in rows)], list(fits))
        figure.tight_layout()
        return plot_style.save(figure, Path(path))


def _asymptotes(axes, fit, along) -> None:
    """Of the first series: no size effect for small beams, a slope of −1/2 for large ones."""
    axes.axhline(fit.plastic, color=FAINT, lw=0.9, ls="-.", zorder=1)
    axes.plot(along, fit.asymptote(along), color=FAINT, lw=0.9, ls="-.", zorder=1)
    axes.annotate(r"strength alone, $B f_t$", (along[-1], fit.plastic), (-2, 3), textcoords="offset points", ha="right", color=INK, fontsize=8)
    axes.annotate(
        "linear elastic\nfracture mechanics", (1.5 * fit.transition, fit.asymptote(1.5 * fit.transition)), (4, 1), textcoords="offset points",
        va="bottom", color=INK, fontsize=8,
    )  # fmt: skip


def _over_cells(axes, rows, names, order) -> None:
    """Of one beam the strength over the size of its cells."""
    elsewhere = [row for row in rows if row["law"].endswith(ELSEWHERE)]
    depth = elsewhere[0]["depth"]
    for name in names:
        colour, marker, line = LOOKS[order.index(name)]
        points = sorted((row["cell"], row["strength"]) for row in rows if row["law"] in (name, name + ELSEWHERE) and row["depth"] == depth)
        axes.plot(*zip(*points, strict=True), marker=marker, ls=line, color=colour, ms=6, lw=1.1)
    axes.set(xlabel="cell [mm]", title=f"D = {depth:g} mm", xlim=(0, None), ylim=(0, None))
    axes.title.set_fontsize(9)
    axes.grid(color="#e4e4e4", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _ticks(axes, depths) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter

    axes.xaxis.set_major_locator(FixedLocator(depths))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0)))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(color="#e4e4e4", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
