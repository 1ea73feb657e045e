"""The body of the total frame as a picture shows it: a mesh of cells, its outline, its cracks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxmpm.plot_style import EDGE
from jaxmpm.results import ResultError

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, Normalize


@dataclass(frozen=True)
class Body:
    """The filled cells of a plane grid, cropped to them, with what moves them.

    `size` and `origin` (lower left corner) in mm; `index` (N, 2) of each cell; `filled` (nx, ny);
    `nodes` (nx + 1, ny + 1, 2), the drawn position of each node in mm.
    """

    size: float
    origin: np.ndarray
    index: np.ndarray
    filled: np.ndarray
    nodes: np.ndarray

    def place(self, cells: np.ndarray, local: np.ndarray) -> np.ndarray:
        """Drawn positions, in mm, of the `local` (M, 2) points, -1 to 1, in `cells` (M,)."""
        i, j = self.index[cells].T
        (s, t), nodes = (0.5 * (1 + local.T))[..., None], self.nodes
        low = (1 - s) * nodes[i, j] + s * nodes[i + 1, j]
        high = (1 - s) * nodes[i, j + 1] + s * nodes[i + 1, j + 1]
        return (1 - t) * low + t * high

    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower left and upper right, each (2,), of all that is drawn, in mm."""
        corners = self.nodes.reshape(-1, 2)
        return corners.min(axis=0), corners.max(axis=0)

    def sizes(self, cells: np.ndarray) -> np.ndarray:
        """Side of each of the `cells` (M,), in mm."""
        return np.full(len(cells), self.size)

    def crack_segments(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The cracked cells (M,), and in each the segment across its square, (M, 2, 2) in mm.

        `normal` (N, 2 or 3): of the band in each cell, zero where there is none.
        """
        cracked, along = directions(normal)
        end = along / np.abs(along).max(axis=1, keepdims=True)
        return cracked, np.stack([self.place(cracked, -end), self.place(cracked, end)], axis=1)

    def draw(
        self, axes: Axes, values: np.ndarray, colours: Colormap, norm: Normalize
    ) -> list[Artist]:
        """Draw the cells, coloured by `values` (N,), and their outline; returns what was added."""
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path as Trace

        grid = np.ma.masked_all(self.filled.shape)
        grid[tuple(self.index.T)] = values
        mesh = axes.pcolormesh(
            *np.moveaxis(self.nodes, -1, 0), grid, cmap=colours, norm=norm, rasterized=True, zorder=1
        )
        # One path, stroked at once, with ends that do not overlap: else every node shows as a dot.
        corners = outline(self).reshape(-1, 2)
        trace = Trace(corners, np.tile([Trace.MOVETO, Trace.LINETO], len(corners) // 2))
        return [mesh, axes.add_artist(PathPatch(trace, fill=False, ec=EDGE, lw=0.9, capstyle="butt"))]


def find_body(centres: np.ndarray, size: float, displacement: np.ndarray | None = None) -> Body:
    """The body whose filled cells have these centres.

    `centres` (N, 2 or 3) in mm; `size` of a cell in mm; `displacement` (N, 2) in mm as drawn; a
    node moves by the mean of its filled cells. Raises ResultError for cells off a plane grid.
    """
    centres = np.asarray(centres, float)
    if not len(centres) or np.ptp(centres[:, 2:], axis=0).any():
        raise ResultError("the picture of cracks needs the cells of a plane body")
    low = centres[:, :2].min(axis=0)
    place = (centres[:, :2] - low) / size
    index = np.rint(place).astype(int)
    if np.abs(place - index).max() > 0.1:
        raise ResultError(f"the points are not the cell centres of a grid of {size:g} mm")
    filled = np.zeros(index.max(axis=0) + 1, bool)
    filled[tuple(index.T)] = True
    origin = low - 0.5 * size
    nodes = origin + size * np.stack(np.indices(np.add(filled.shape, 1)), axis=-1)
    if displacement is not None:
        nodes = nodes + _nodal_mean(index, filled.shape, np.asarray(displacement, float))
    return Body(size, origin, index, filled, nodes)


def outline(body: Body) -> np.ndarray:
    """The cell edges between filled and empty, as drawn: (E, 2, 2), in mm."""
    padded = np.pad(body.filled, 1)
    i, j = np.nonzero(padded[:-1, 1:-1] != padded[1:, 1:-1])
    upright = np.stack([body.nodes[i, j], body.nodes[i, j + 1]], axis=1)
    i, j = np.nonzero(padded[1:-1, :-1] != padded[1:-1, 1:])
    return np.concatenate([upright, np.stack([body.nodes[i, j], body.nodes[i + 1, j]], axis=1)])


def directions(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the `normal` (N, 2 or 3) are of a crack (M,), and the way along it, (M, 2)."""
    along = np.asarray(normal, float)[:, 1::-1] * (-1.0, 1.0)
    cracked = np.flatnonzero(np.hypot(*along.T) > 1e-6)
    return cracked, along[cracked]


def _nodal_mean(index: np.ndarray, shape: tuple[int, ...], values: np.ndarray) -> np.ndarray:
    total, count = np.zeros((*np.add(shape, 1), 2)), np.zeros((*np.add(shape, 1), 1))
    for corner in ((0, 0), (1, 0), (0, 1), (1, 1)):
        node = tuple((index + corner).T)
        np.add.at(total, node, values)
        np.add.at(count, node, 1)
    return total / np.maximum(count, 1)
