"""The picture of a chart: error against time, the Pareto front named, and each measure by itself below."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from jaxmpm import plot_style
from jaxmpm.chart.front import SHORT, front, percent, seconds
from jaxmpm.chart.outcome import WORDS
from jaxmpm.chart.settings import MODEL, OF_POINTS, rest
from jaxmpm.plot_style import ACCENT, FAINT, INK, styled_figure, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's colours, told apart by all; a marker of its own for each besides.
FAMILIES = {
    "cells alone": (INK, "o"), "loading rate": ("#E69F00", "^"), "precision": ("#56B4E9", "s"), "time step": ("#999999", "v"),
    "less modelled": ("#7B3294", "p"), "equilibrium": ("#009E73", "D"), "points that move": ("#D55E00", "P"), "what is modelled": ("#CC79A7", "X"),
    "several at once": ("#0072B2", "*"),
}  # fmt: skip
BY_AXIS = {
    "speed": "loading rate", "precision": "precision", "step": "time step", "rise": "less modelled", "half": "less modelled",
    "solver": "equilibrium", "frame": "points that move",
    **dict.fromkeys(OF_POINTS, "points that move"),
    **dict.fromkeys(MODEL, "what is modelled"),
}  # fmt: skip
LEAST = 1e-5  # relative: the reference itself, and what is as near to it, lies on the lower edge of the chart
ROOM = 2.0  # between the lower edge and the smallest error above
UNSURE = "#efefef"
LONGEST_NAME = 34  # characters of a line of the list of names


def family(record: dict) -> str:
    """What kind of choice a setting is, for its colour."""
    names = list(rest(record["setting"]))
    return "cells alone" if not names else BY_AXIS[names[0]] if len(names) == 1 else "several at once"


def measured(record: dict, measure: str) -> float | None:
    """An error of a record, "error" for the largest of its numbers, in magnitude; None where it has none."""
    value = record.get("error") if measure == "error" else (record.get("errors") or {}).get(measure)
    return None if value is None else abs(value)


def draw_chart(axes: Axes, chart: dict, measure: str = "error", numbered: bool = True) -> None:
    """Draw a chart on axes: a mark and its bar for each setting, the front as steps, its members numbered.

    `chart`: as of `read_chart`; `measure`: "error" (the largest error of peak and work), "peak", "work", "curve",
    "path" (mm), or of a motion "end" and "balance".
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    there = [(record, measured(record, measure)) for record in chart["runs"] if "seconds" in record]
    there = [(record, value) for record, value in there if value is not None]
    above = [value for _, value in there if value > LEAST]
    edge = min(above, default=LEAST) / ROOM
    there = [(record, max(value, edge)) for record, value in there]
    axes.set(xscale="log", yscale="log", xlabel="time of the run [s]")
    for record, value in there:
        _mark(axes, record, value, 6.5 if numbered else 4.5)
    _join_cells(axes, there)
    if numbered:
        _draw_front(axes, [(one["seconds"], max(measured(one, measure), edge)) for one in front(chart["runs"])], measure)
    axes.margins(0.06, 0.12)
    axes.set_ylim(edge, None)
    if numbered:
        _draw_failed(axes, chart["runs"])
    _draw_floor(axes, chart["reference"], measure)
    axes.grid(color="#e4e4e4", lw=0.6, which="major")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    if numbered:
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    in_mm = measure == "path"
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}" if in_mm else f"{100 * value:g} %"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())


def _mark(axes: Axes, record: dict, value: float, size: float) -> None:
    colour, marker = FAMILIES[family(record)]
    bars = [[record["seconds"] - record["low"]], [record["high"] - record["seconds"]]]
    hollow = family(record) == "what is modelled"
    axes.errorbar(
        record["seconds"], value, xerr=bars, fmt=marker, ms=size * (1.5 if marker == "*" else 1.0), color=colour, mew=0.8,
        mfc="white" if hollow else colour, mec=colour if hollow or marker == "*" else "white", ecolor=colour, elinewidth=0.9,
        clip_on=False, zorder=3,
    )  # fmt: skip


def _join_cells(axes: Axes, there: list) -> None:
    line = sorted((record["cell_size"], record["seconds"], value) for record, value in there if family(record) == "cells alone")
    axes.plot([time for _, time, _ in line], [value for *_, value in line], color=INK, lw=1.0, zorder=2)


def _draw_front(axes: Axes, points: list[tuple[float, float]], measure: str) -> None:
    if measure == "error":
        axes.step(*zip(*points, strict=True), where="post", color=ACCENT, lw=1.2, alpha=0.75, zorder=1)
    for number, (x, y) in enumerate(points, 1):
        axes.plot(x, y, "o", ms=12, mfc="none", mec=ACCENT, mew=1.1, clip_on=False, zorder=4)
        axes.annotate(
            str(number), (x, y), xytext=(-6, -5), textcoords="offset points", ha="right", va="top", color=ACCENT,
            fontweight="bold", annotation_clip=False,
        )  # fmt: skip


def _draw_failed(axes: Axes, records: list[dict]) -> None:
    """Crosses at the upper edge, as long after the start as they were given up."""
    for record in records:
        if "seconds" not in record:
            axes.plot(record["wall_seconds"], 0.985, "x", color=FAINT, ms=6, mew=1.4, transform=axes.get_xaxis_transform(), zorder=3)


def _draw_floor(axes: Axes, reference: dict, measure: str) -> None:
    """Shade what is nearer to the reference than that may be to the truth."""
    floors = reference["floor"]
    floor = max((floors[name] or 0.0 for name in reference["numbers"]), default=0.0) if measure == "error" else floors.get(measure)
    low, high = axes.get_ylim()
    if floor and floor > low:
        axes.axhspan(low, min(floor, high), color=UNSURE, lw=0, zorder=0)
        axes.set_ylim(low, high)


# -- the whole picture --------------------------------------------------------------------------------


def plot_chart(chart: dict, path: str | os.PathLike) -> Path:
    """Draw a chart with each measure below it; returns the picture's path (.png, .pdf, .svg)."""
    names = [*chart["reference"]["numbers"], "curve", "path"]
    names = [name for name in names if any(measured(record, name) is not None for record in chart["runs"])]
    with styled_figure() as figure:
        figure.set_size_inches(9.0, 6.6)
        axes = figure.add_axes((0.075, 0.41, 0.58, 0.47))
        draw_chart(axes, chart)
        axes.set_ylabel(f"largest error of {' and '.join(SHORT[name] for name in chart['reference']['numbers'])}")
        _list_names(figure, chart)
        width = 0.92 / len(names)
        for index, name in enumerate(names):
            small = figure.add_axes((0.075 + index * width, 0.075, width - 0.07, 0.2))
            draw_chart(small, chart, name, numbered=False)
            small.set_title(_heading(chart, name), fontsize=8.5, loc="left")
            small.tick_params(labelsize=7.5)
            small.set_xlabel("s", fontsize=8)
        whole = figure.add_axes((0.075, 0.41, 0.9, 0.47))
        whole.set_axis_off()
        title(whole, chart, [chart["says"]])
        return plot_style.save(figure, Path(path))


def _heading(chart: dict, name: str) -> str:
    unit = next((record["displacement_unit"] for record in chart["runs"] if record.get("displacement_unit")), "")
    more = {"work": f" to {chart['reference']['until']:.3g} {unit}".rstrip(), "path": " [mm]"}
    return WORDS[name] + more.get(name, "")


def _list_names(figure, chart: dict) -> None:
    """The members of the front and what the marks mean, right of the chart."""
    import textwrap

    from matplotlib.patches import Rectangle

    y, x = 0.875, 0.685
    figure.text(x, y, "on the front", color=ACCENT, fontweight="bold", va="top")
    for number, record in enumerate(front(chart["runs"]), 1):
        lines = textwrap.wrap(record["label"], LONGEST_NAME)
        y -= 0.029
        figure.text(x, y, str(number), color=ACCENT, fontweight="bold", va="top", fontsize=8)
        error = percent(record["error"]) if record["error"] > LEAST else "the reference"
        figure.text(x + 0.022, y, "\n".join([*lines[:-1], f"{lines[-1]}: {seconds(record['seconds'])}, {error}"]), va="top", fontsize=8)
        y -= 0.022 * (len(lines) - 1)
    y -= 0.055
    used = {family(record) for record in chart["runs"] if "seconds" in record}
    for name, (colour, marker) in FAMILIES.items():
        if name in used:
            hollow = name == "what is modelled"
            mark = {"marker": marker, "color": colour, "mfc": "white" if hollow else colour, "ms": 6, "ls": "none"}
            figure.add_artist(_point(x + 0.008, y, mark))
            figure.text(x + 0.025, y, name, va="center", fontsize=8)
            y -= 0.026
    y -= 0.01
    figure.add_artist(Rectangle((x, y - 0.008), 0.016, 0.016, color=UNSURE, lw=0, transform=figure.transFigure))
    figure.text(x + 0.025, y, "nearer to the reference than that was\nto the run on cells twice as large", va="center", fontsize=8)
    y -= 0.042
    if any("seconds" not in record for record in chart["runs"]):
        figure.add_artist(_point(x + 0.008, y, {"marker": "x", "color": FAINT, "ms": 6, "ls": "none"}))
        figure.text(x + 0.025, y, "stopped or given up (why: chart.csv)", va="center", fontsize=8)


def _point(x: float, y: float, look: dict):
    from matplotlib.lines import Line2D

    return Line2D([x], [y], **look)
