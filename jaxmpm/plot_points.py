"""Points that move, as a picture shows them: each a square of the side that it stands for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxmpm.plot_body import directions
from jaxmpm.plot_style import EDGE
from jaxmpm.results import ResultError

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, Normalize

CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
# Neighbours whose distance has changed by more than this share no longer hold together.
HELD = 0.3
# A run has points of a cell and of its parts; where there are more kinds, the commonest are turned.
MOST_SIDES = 8
# Squares are drawn so much wider, of their side, that points a little apart still touch: no rims between.
WIDER = 0.12


@dataclass(frozen=True)
class Squares:
    """Squares about the points of a plane body: `centre` (N, 2) and `side` (N,) in mm.

    `turn` (N,): the angle of each, in radians; `ahead` (N,): of it what the drawn square has turned
    more than the point itself, where displacements are drawn larger or smaller than they are.
    """

    centre: np.ndarray
    side: np.ndarray
    turn: np.ndarray
    ahead: np.ndarray

    def corners(self) -> np.ndarray:
        """Of each square, anticlockwise, (N, 4, 2) in mm."""
        return self._corners(self.side)

    def _corners(self, side: np.ndarray) -> np.ndarray:
        return self.centre[:, None] + _turned(side[:, None, None] * CORNERS, self.turn[:, None])

    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower left and upper right, each (2,), of all that is drawn, in mm."""
        corners = self.corners().reshape(-1, 2)
        return corners.min(axis=0), corners.max(axis=0)

    def sizes(self, points: np.ndarray) -> np.ndarray:
        """Side of the squares about the `points` (M,), in mm."""
        return self.side[points]

    def crack_segments(self, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The cracked points (M,), and in each the segment across its square, (M, 2, 2) in mm.

        `normal` (N, 2 or 3): of the crack as it now stands, zero where there is none.
        """
        cracked, along = directions(normal)
        along = _turned(along, self.ahead[cracked])
        reach = np.abs(_turned(along, -self.turn[cracked])).max(axis=1)
        end = along * (0.5 * self.side[cracked] / reach)[:, None]
        return cracked, self.centre[cracked, None] + np.stack([-end, end], axis=1)

    def draw(
        self, axes: Axes, values: np.ndarray, colours: Colormap, norm: Normalize
    ) -> list[Artist]:
        """Draw the squares, coloured by `values` (N,), outlined; returns what was added."""
        from matplotlib.collections import PolyCollection

        # Dark rims below all squares remain in sight only where no neighbour covers them: the
        # outline of every piece. The squares' own thin rims close the seams between them, and wider
        # squares below them narrow gaps, of the least side, so that outlines are as thick everywhere.
        wide = self._corners(self.side + WIDER * self.side.min())
        rims = PolyCollection(wide, facecolors=EDGE, edgecolors=EDGE, linewidths=2.4, zorder=1)
        below, squares = (
            PolyCollection(each, edgecolors="face", linewidths=0.3, antialiaseds=False, zorder=z)
            for each, z in ((wide, 1.5), (self.corners(), 2))
        )
        for collection in (rims, below, squares):
            if collection is not rims:
                collection.set(array=values, cmap=colours, norm=norm)
            # Snapped to pixels, rims would stand out on one side only.
            collection.set(rasterized=True, snap=False)
            axes.add_collection(collection, autolim=False)
        return [rims, below, squares]


def find_squares(
    points: np.ndarray, displacement: np.ndarray, side: np.ndarray, factor: float = 1.0
) -> Squares:
    """The squares of points that are now at `points` (N, 2 or 3), in mm.

    `displacement` (N, 2 or 3) from home, in mm; `side` (N,) in mm; `factor`: on the displacements,
    1 for the squares where they are. Raises ResultError for points off a plane, no sides.
    """
    points, displacement = np.asarray(points, float), np.asarray(displacement, float)[:, :2]
    side = np.asarray(side, float)
    if not len(points) or np.ptp(points[:, 2:], axis=0).any():
        raise ResultError("the picture of moving points needs those of a plane body")
    if not (side > 0).all():
        raise ResultError(f"side = {side[~(side > 0)][0]:g} of a point: expected more than 0 mm")
    home = points[:, :2] - displacement
    centre = home + factor * displacement
    turn = turns(home, centre, side)
    ahead = turn - turns(home, points[:, :2], side) if factor != 1 else np.zeros(len(turn))
    return Squares(centre, side, turn, ahead)


def turns(home: np.ndarray, moved: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Angle (N,) by which each point's surroundings have turned, radians.

    `home`, `moved` (N, 2) and `side` (N,) in mm. The mean over the neighbours at home, a side away
    along x or y, that still hold to the point; where there are none, over those near it.
    """
    before, after = (place[:, 0] + 1j * place[:, 1] for place in (home, moved))
    total = np.zeros(len(side), complex)
    sides, counts = np.unique(side, return_counts=True)
    for size in sides[np.argsort(-counts)[:MOST_SIDES]]:
        own = np.flatnonzero(side == size)
        for one, other in _neighbours(home[own], size):
            one, other = own[one], own[other]
            edge, now = before[other] - before[one], after[other] - after[one]
            held = (np.abs(np.abs(edge) / size - 1) < HELD) & (np.abs(np.abs(now) / size - 1) < HELD)
            turn = np.where(held, now * edge.conj(), 0) / size**2
            np.add.at(total, one, turn)
            np.add.at(total, other, turn)
    alone = total == 0
    if alone.any() and not alone.all():
        total[alone] = _nearby(home, total, 2 * side.max())[alone]
    return np.angle(total)


def _neighbours(home: np.ndarray, size: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pairs of points a step of `size` apart at home, along x and along y, as two index arrays."""
    place = np.rint((home - home[0]) / size).astype(np.int64)
    place -= place.min(axis=0)
    number = place @ (place[:, 1].max() + 2, 1)
    order = np.argsort(number, kind="stable")
    ordered, pairs = number[order], []
    for step in (place[:, 1].max() + 2, 1):
        found = np.minimum(np.searchsorted(ordered, number + step), len(order) - 1)
        one = np.flatnonzero(ordered[found] == number + step)
        pairs.append((one, order[found[one]]))
    return pairs


def _nearby(home: np.ndarray, turn: np.ndarray, size: float) -> np.ndarray:
    """For each point the sum of all turns in its square of `size` at home."""
    square = np.floor((home - home.min(axis=0)) / size).astype(np.int64)
    _, which = np.unique(square, axis=0, return_inverse=True)
    which = which.reshape(-1)
    total = np.zeros(which.max() + 1, complex)
    np.add.at(total, which, turn)
    return total[which]


def _turned(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    x, y = vectors[..., 0], vectors[..., 1]
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
