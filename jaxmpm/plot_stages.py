"""The stages of a response as a picture: the curve with their numbers, and the cells at each."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpm import plot_style
from jaxmpm.plot import label, load_scale, peak_row, response
from jaxmpm.plot_body import find_body
from jaxmpm.plot_style import ACCENT, INK, PHASES, shades, styled_figure, title
from jaxmpm.results import read_summary, read_units
from jaxmpm.stages import Stage, find_stages, write_stages
from jaxmpm.vtkhdf import read_frame

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PANEL, CURVE = 1.75, 2.7  # inches
PATTERN = 0.98  # quantile of what was added that has the darkest colour: only patterns matter


def plot_stages(directory: str | os.PathLike, path: str | os.PathLike | None = None) -> Path:
    """Draw the response with numbered stages; below damage, and what was added, at each.

    Returns the picture's path, and writes stages.csv beside the results. `directory`: of a run;
    `path`: of the picture (.png, .pdf, .svg), stages.png in the directory if None. Raises
    ResultError where the results are missing, have no response or points that move.
    """
    directory = Path(directory)
    stages = find_stages(directory)
    write_stages(stages, directory / "stages.csv")
    summary, first = read_summary(directory), read_frame(directory / "result.vtkhdf", 0)
    body = find_body(first["points"], summary["cell_size"])
    width = PANEL * len(stages) + 0.1 * (len(stages) - 1)
    tall = np.ptp(body.nodes[..., 1]) / np.ptp(body.nodes[..., 0])
    row = min(PANEL * tall, 2.5 * PANEL) + 0.36
    height = CURVE + 0.75 + 3 * row
    with styled_figure() as figure:
        figure.set_size_inches(width, height)

        def axes_at(left, top, wide, high):
            return figure.add_axes((left / width, 1 - (top + high) / height, wide / width, high / height))

        curve = axes_at(0.55, 0.0, width - 0.55, CURVE)
        _curve(curve, directory, summary, stages)
        for k, stage in enumerate(stages):
            panels = [axes_at(k * (PANEL + 0.1), CURVE + 0.75 + r * row, PANEL, row - 0.36) for r in range(3)]
            _panels(panels, body, first["material"], stage, k == 0)
        title(curve, summary, [])
        return plot_style.save(figure, Path(path or directory / "stages.png"))


def _curve(axes: Axes, directory: Path, summary: dict, stages: list[Stage]) -> None:
    load, displacement = response(directory, summary)
    names, units = summary["response"], read_units(directory / "history.csv")
    factor, unit = load_scale(load, units[names["load"]])
    axes.plot(displacement, load * factor, color=INK, lw=1.4)
    peak = peak_row(load)
    right, up = (1 if value[peak] >= 0 else -1 for value in (displacement, load))  # which way the curve goes
    for stage in stages:
        x, y = stage.displacement, stage.load * factor
        axes.plot([x], [y], "o", color=ACCENT, ms=4.5, zorder=3)
        side = -right if abs(x) < abs(displacement[peak]) else right  # outside the curve
        look = {"ha": "left" if side > 0 else "right", "va": "baseline" if up > 0 else "top"}
        axes.annotate(
            str(stage.number), (x, y), (7 * side, 3 * up), textcoords="offset points", color=ACCENT, fontweight="bold", **look
        )
    axes.ticklabel_format(axis="x", scilimits=(-3, 4), useMathText=True)
    axes.set_xlabel(label(names["displacement"], units[names["displacement"]]))
    axes.set_ylabel(label(names["load"], unit))
    axes.grid(color="#dddddd", lw=0.6)
    axes.set_axisbelow(True)
    axes.margins(x=0.05, y=0.1)
    axes.spines[["top", "right"]].set_visible(False)


def _panels(panels: list[Axes], body, material: np.ndarray, stage: Stage, first: bool) -> None:
    from matplotlib.colors import ListedColormap

    rows = (
        ("damage D", stage.damage, f"{stage.cracked} cells cracked", 1.0),
        ("added damage ΔD", stage.more_damage, _words(stage.share_of_damage), None),
        ("added opening Δw", stage.more_opening, _words(stage.share_of_opening), None),
    )
    for axes, (name, values, words, most) in zip(panels, rows, strict=True):
        grids = np.full((2, *body.filled.shape), np.nan)
        grids[0][tuple(body.index.T)] = material % len(PHASES)
        grids[1][tuple(body.index.T)] = np.where(values > 0, values, np.nan)
        mesh = dict(zip(("x", "y"), np.moveaxis(body.nodes, -1, 0), strict=True))
        draw = lambda grid, **look: axes.pcolormesh(mesh["x"], mesh["y"], grid, rasterized=True, **look)  # noqa: B023, E731
        draw(grids[0], cmap=ListedColormap(PHASES), vmin=-0.5, vmax=len(PHASES) - 0.5)
        added = values[values > 0]
        most = most or (float(np.quantile(added, PATTERN)) if len(added) else 1.0)
        draw(grids[1], cmap=shades("inferno_r", 0.2, 0.95), vmin=0.0, vmax=most)
        axes.set_aspect("equal")
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_linewidth(0.5)
        axes.set_xlabel(words, fontsize=7.5, labelpad=3)
        if name.startswith("damage"):
            axes.set_title(str(stage.number), color=ACCENT, fontweight="bold", fontsize=9, pad=3)
        if first:
            axes.set_ylabel(name)


def _words(share: float) -> str:
    return "nothing added" if np.isnan(share) else f"{share:.0%} in the final crack"
