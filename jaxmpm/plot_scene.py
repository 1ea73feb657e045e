"""A scene before it runs: its materials on the grid, what holds and what moves it; one, or all that are bundled."""

from __future__ import annotations

import io
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpm.layout import Layout, lay_out
from jaxmpm.plot_body import find_body, outline
from jaxmpm.plot_style import ACCENT, EDGE, INK, save, styled_figure
from jaxmpm.scene import direction_cosines, load_scene, scene_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jaxmpm.scene import Scene

# Told apart by lightness too: matrix, inclusion, interface, and what an image has more.
COLOURS = ("#e8e4da", "#5f7f9c", "#d9822b", "#1f2f3f", "#a9d1b5", "#6e3b57", "#f2d38b", "#9aa0b5")
MARGIN, ARROW = 0.13, 0.09  # of the longer side: room for arrows, and their length
MOST = 9  # markers or arrows along a set
LARGEST = 1_000_000  # cells of a scene that is drawn without being asked
TILE, COLUMNS = (3.0, 2.7), 3  # of the sheet, inches


def scene_picture(scene: Scene, dpi: int = 90) -> bytes:
    """A PNG of a scene; raises SceneError where it cannot be laid out."""
    layout, target = lay_out(scene), io.BytesIO()
    with styled_figure() as figure:
        low, high = limits(layout)
        figure.set_size_inches(4.6 * (high - low) / (high - low).max())
        axes = figure.add_axes((0, 0, 1, 1))
        draw_map(axes, layout, materials_in_order(scene, layout))
        draw_loads(axes, scene, layout)
        draw_legend(axes)
        figure.savefig(target, format="png", dpi=dpi, bbox_inches="tight", pad_inches=0.05)
    return target.getvalue()


def plot_sheet(path: Path) -> Path:
    """Draw all bundled scenes, small, each with its name and title, into one picture; returns its path."""
    titles = scene_names()
    rows = -(-len(titles) // COLUMNS)
    with styled_figure() as figure:
        figure.set_size_inches(COLUMNS * TILE[0], rows * TILE[1])
        tiles = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
        figure.subplots_adjust(0.02, 0.02, 0.98, 0.94, wspace=0.12, hspace=0.36)
        for axes in tiles:
            axes.set_axis_off()
        for axes, (name, title) in zip(tiles, titles.items(), strict=False):
            scene = load_scene(name)
            layout = lay_out(scene)
            draw_map(axes, layout, materials_in_order(scene, layout))
            draw_loads(axes, scene, layout)
            axes.set_aspect("equal", anchor="N")
            words = textwrap.wrap(title, 46)
            axes.set_title("\n".join(words), fontsize=7.5, color="#444444", pad=4)
            above = (0, 8 + 9.5 * len(words))
            axes.annotate(name, (0.5, 1), above, "axes fraction", "offset points", ha="center", fontweight="bold", color=INK)
        return save(figure, Path(path))


def materials_in_order(scene: Scene, layout: Layout) -> list[int]:
    """Materials in the order of the colours: matrix, inclusion, interface, then as the scene has them."""
    table, names = scene.mesostructure, list(layout.materials)
    first = [scene.bodies[0].material]
    if table is not None:
        first = [body.material for body in scene.bodies if body.name == table.body]
        first += [table.inclusion, table.interface]
    chosen = [name for name in first if name in names]
    return [names.index(name) for name in dict.fromkeys([*chosen, *names])]


def limits(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Corners (2,), mm, of what is shown: the grid and room for arrows around it."""
    low = np.array(layout.origin, float)
    high = low + layout.cell * np.array(layout.shape)
    margin = MARGIN * (high - low).max()
    return low - margin, high + margin


def draw_map(axes: Axes, layout: Layout, order: list[int]) -> None:
    """Draw every cell in the colour of its material, and the outline of what is filled."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import ListedColormap

    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order))
    values = np.ma.masked_array(rank[layout.material], layout.material < 0)
    colours = ListedColormap([COLOURS[k % len(COLOURS)] for k in range(len(order))])
    axes.pcolormesh(*lines(layout), values.T, cmap=colours, vmin=-0.5, vmax=len(order) - 0.5, rasterized=True)
    centres = np.array(layout.origin) + layout.cell * (np.argwhere(layout.material >= 0) + 0.5)
    edges = outline(find_body(centres, layout.cell))
    axes.add_collection(LineCollection(edges, colors=EDGE, linewidths=0.7), autolim=False)
    (left, bottom), (right, top) = limits(layout)
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x [mm]", ylabel="y [mm]")
    axes.locator_params(nbins="auto", steps=[1, 2, 5, 10])


def lines(layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the lines of the grid, (nx + 1,) and (ny + 1,), mm."""
    x, y = (o + layout.cell * np.arange(n + 1) for o, n in zip(layout.origin, layout.shape, strict=True))
    return x, y


def draw_legend(axes: Axes) -> None:
    """What the marks of `draw_loads` mean, in the margin below the bodies."""
    look = {"ncols": 5, "frameon": False, "fontsize": 8, "handletextpad": 0.4, "columnspacing": 1.2}
    axes.legend(loc="lower left", bbox_to_anchor=(0, 0), borderaxespad=0.2, **look)


def draw_loads(axes: Axes, scene: Scene, layout: Layout) -> None:
    """Mark what is held, moved, pulled, thrown and where openings are measured, each with a label for a legend."""
    draw = _Marks(axes, layout)
    for support in scene.supports:
        draw.held(draw.along(layout.sets[support.set]), support.fix)
    for what, loads in (("moved", scene.displacements), ("pulled", scene.forces)):
        for load in loads:
            most = max(load.history.value, key=abs)
            way = np.sign(most) * np.array(direction_cosines(load.direction))
            draw.arrows(draw.along(layout.sets[load.set]), way, what)
    for body in range(len(scene.bodies)):
        velocity, cells = np.array(scene.bodies[body].velocity), np.argwhere(layout.owner == body)
        if velocity.any() and len(cells):
            draw.arrows([draw.low + layout.cell * (cells.mean(axis=0) + 0.5)], velocity / np.hypot(*velocity), "thrown", inside=True)
    if scene.macro is not None:
        draw.strained(scene.macro.strain.driven())
    points = [point for gauge in scene.gauges.values() if gauge.kind == "relative_displacement" for point in gauge.points]
    draw.mark(points, "x", "measured", color=INK, ms=4, mew=1.1)


class _Marks:
    """Marks on axes, each kind labelled once."""

    def __init__(self, axes: Axes, layout: Layout):
        self.axes, self.labelled = axes, set()
        self.low = np.array(layout.origin, float)
        self.high = self.low + layout.cell * np.array(layout.shape)
        self.length = ARROW * (self.high - self.low).max()
        self.xy = layout.node_coordinates().reshape(2, -1).T
        self.middle = layout.cell * (np.argwhere(layout.material >= 0).mean(axis=0) + 0.5) + self.low

    def along(self, nodes: np.ndarray) -> np.ndarray:
        """Places (M, 2) of a few of the nodes of a set, evenly along it."""
        places = self.xy[nodes]
        places = places[np.lexsort(places.T)]
        return places[np.unique(np.linspace(0, len(places) - 1, min(MOST, len(places))).round().astype(int))]

    def mark(self, places, marker: str, what: str, **look) -> None:
        """A marker at each place."""
        if len(places):
            self.axes.plot(*np.transpose(places), marker, label=self._label(what), zorder=5, clip_on=False, **look)

    def held(self, places: np.ndarray, components: tuple) -> None:
        """Triangles at what is held: full in both components, else pointing the way that is held."""
        both = len(set(components)) == 2
        marker = "^" if both or "y" in components else ">"
        look = {"ms": 5, "color": EDGE, "mfc": EDGE if both else "white", "mew": 0.9}
        self.mark(places, marker, "held" if both else f"held in {components[0]}", **look)

    def arrows(self, places, way: np.ndarray, what: str, inside: bool = False) -> None:
        """Arrows that begin at the places, or end there where they push."""
        look = {"arrowstyle": "-|>", "color": ACCENT, "lw": 1.0, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
        if what == "pulled":
            look["ls"] = (0, (3, 1.5))
        for place in places:
            outwards = inside or way @ (place - self.middle) >= 0
            ends = (place, place + self.length * way) if outwards else (place - self.length * way, place)
            self.axes.annotate("", ends[1], ends[0], arrowprops=look, annotation_clip=False, zorder=6)
        self.axes.plot([], [], color=ACCENT, lw=1.0, ls=look.get("ls", "-"), marker=">", ms=4, label=self._label(what))

    def strained(self, driven: dict) -> None:
        """Arrows at the middles of the edges, the way a mean strain moves them."""
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        gradient = np.array([[driven.get("xx", 0.0), driven.get("xy", 0.0)], [driven.get("xy", 0.0), driven.get("yy", 0.0)]])
        for side in np.array([(1, 0), (-1, 0), (0, 1), (0, -1)]):
            moved = gradient @ side
            if moved.any():
                self.arrows([middle + half * side], moved / np.abs(gradient).max(), "moved")

    def _label(self, what: str) -> str | None:
        new = what not in self.labelled
        self.labelled.add(what)
        return what if new else None
