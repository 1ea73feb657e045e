"""Draws what a scene is made of: its phases, their shares, the grading of inclusions, the scatter of strength."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpm.layout import Layout, lay_out
from jaxmpm.layout_half import AXES, symmetries
from jaxmpm.mesostructure.grading import measured
from jaxmpm.mesostructure.sampling import structure_of
from jaxmpm.mesostructure.structure import Structure
from jaxmpm.plot_scene import COLOURS, draw_legend, draw_loads, draw_map, limits, lines, materials_in_order
from jaxmpm.plot_style import ACCENT, BAND, EDGE, FAINT, INK, colour_bar, save, shades, styled_figure, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jaxmpm.scene import Scene

MAP, SIDE, HEAD, FOOT, SPACE = 4.6, 2.7, 0.75, 0.6, 0.95  # inches


def plot_phases(scene: Scene, path: Path) -> Path:
    """Draw the phases of a scene on its grid into a file (png, pdf, svg) and return its path.

    Raises SceneError where the scene cannot be laid out.
    """
    layout, structure = lay_out(scene), structure_of(scene)
    strength = layout.local.strength if layout.local else None
    order = materials_in_order(scene, layout)
    with styled_figure() as figure:
        low, high = limits(layout)
        span = high - low
        high, wide = MAP * np.minimum(1.0, (span[1] / span[0], span[0] / span[1]))
        tall = max(high, 2.6)
        wide_all = wide + SPACE + SIDE + (0 if strength is None else wide + 1.3 * SPACE)
        figure.set_size_inches(wide_all + 1.0, tall + HEAD + FOOT)

        def axes_at(left, bottom, width, height):
            return figure.add_axes((*np.divide((left, bottom), figure.get_size_inches()),
                                    *np.divide((width, height), figure.get_size_inches())))  # fmt: skip

        main = axes_at(0.6, FOOT + (tall - high), wide, high)
        draw_map(main, layout, order)
        if structure is not None:
            _draw_outlines(main, structure)
        draw_loads(main, scene, layout)
        draw_legend(main)
        title(main, {"title": scene.title}, [_about(scene, layout, structure)])
        left = 0.6 + wide + SPACE
        bars = 0.24 * len(order) + 0.1
        _draw_shares(axes_at(left, FOOT + tall - bars, SIDE, bars), scene, layout, order)
        if structure is not None:
            curve = axes_at(left, FOOT, SIDE, tall - bars - 0.35)
            _draw_grading(curve, scene.mesostructure.inclusions, structure)
        if strength is not None:
            more = axes_at(left + SIDE + 0.8 * SPACE, FOOT + (tall - high), wide, high)
            _draw_strength(more, scene, layout)
        return save(figure, Path(path))


def _about(scene, layout, structure) -> str:
    what = f"cells of {layout.cell:g} mm"
    if scene.mesostructure is not None and scene.mesostructure.sampling == "mixed":
        what += ", mixed (drawn by their band)"
    if layout.half:
        what += f", half of the scene ({AXES[layout.half.axis]} > {layout.half.plane:g} mm)"
    elif symmetries(scene, layout):
        what += ", half of it will do (grid.half)"
    if structure is None:
        return what
    kind = {"circle": "circles", "ellipse": "ellipses", "polygon": "polygons"}[scene.mesostructure.inclusions.shape.kind]
    return f"{len(structure.sizes)} {kind}, {what}"


def _draw_outlines(axes: Axes, structure: Structure) -> None:
    from matplotlib.collections import PolyCollection

    shown = structure.with_images(0.0)
    corners = shown.corners
    if corners is None:
        angle = np.linspace(0.0, 2 * np.pi, 90, endpoint=False)
        corners = shown.sizes[:, None, None] / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outlines = PolyCollection(shown.centres[:, None] + corners, facecolors="none", edgecolors=EDGE, linewidths=0.5)
    axes.add_collection(outlines, autolim=False)


def _draw_shares(axes: Axes, scene, layout, order) -> None:
    shares = np.array(list(layout.shares().values()))
    rows = np.arange(len(order))
    axes.barh(rows, 100 * shares[order], height=0.62, edgecolor=EDGE, linewidth=0.5,
              color=[COLOURS[k % len(COLOURS)] for k in rows])  # fmt: skip
    table = scene.mesostructure
    for row, k in zip(rows, order, strict=True):
        text = f"{layout.materials[k]}  {shares[k]:.1%}"
        if table is not None and table.inclusions is not None and layout.materials[k] == table.inclusion:
            text += f" (placed {table.inclusions.fraction:.1%})"
        axes.annotate(text, (100 * shares[k], row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set(ylim=(len(order) - 0.4, -0.6), xlim=(0, 100), xticks=[], yticks=[])
    axes.set_title("share of the area", fontsize=9, loc="left", color="#444444")
    axes.spines[["top", "right", "bottom"]].set_visible(False)


def _draw_grading(axes: Axes, table, structure: Structure) -> None:
    grading = table.grading
    sizes, share = measured(structure.sizes)
    line = np.geomspace(grading.smallest, grading.largest, 200)
    axes.plot(line, 100 * grading.share_below(line), color=INK, lw=1.4, label="asked for")
    axes.step([sizes[0], *sizes], 100 * np.array([0.0, *share]), where="post", color=ACCENT, lw=1.0, label="placed")
    axes.set(xscale="log", ylim=(0, 102), xlabel="size [mm]", ylabel="smaller, % of the area")
    _label_sizes(axes, grading)
    axes.grid(color=FAINT, alpha=0.25, lw=0.5)
    axes.legend(loc="upper left", frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def _label_sizes(axes: Axes, grading) -> None:
    """Ticks at round sizes between the smallest and the largest."""
    from matplotlib.ticker import NullLocator

    ratio = grading.largest / grading.smallest
    few = (1, 2, 5) if ratio > 20 else (1, 1.5, 2, 3, 4, 6, 8)
    powers = np.arange(np.floor(np.log10(grading.smallest)), np.ceil(np.log10(grading.largest)) + 1)
    ticks = np.outer(10.0**powers, few).reshape(-1)
    ticks = ticks[(ticks >= 0.99 * grading.smallest) & (ticks <= 1.01 * grading.largest)]
    ticks = ticks if len(ticks) > 1 else np.array([grading.smallest, grading.largest])
    axes.set_xticks(ticks, [f"{tick:.3g}" for tick in ticks])
    axes.xaxis.set_minor_locator(NullLocator())


def _draw_strength(axes: Axes, scene, layout: Layout) -> None:
    """The factor on the strength, where it varies."""
    (left, bottom), (right, top) = limits(layout)
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x [mm]")
    axes.locator_params(nbins="auto", steps=[1, 2, 5, 10])
    varies = np.array([*(scene.materials[name].scatter is not None for name in layout.materials), False])
    values = np.ma.masked_array(layout.local.strength, ~varies[layout.material])
    axes.set_facecolor(BAND)
    mesh = axes.pcolormesh(*lines(layout), values.T, cmap=shades("viridis", 0.0, 1.0), rasterized=True)
    colour_bar(axes, mesh, "factor on the strength")
