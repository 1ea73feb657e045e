"""A mesostructure as made, in continuous coordinates: where inclusions are, and how far a place is from them."""

from dataclasses import dataclass, replace

import numpy as np

from jaxmpm.mesostructure import outlines

# from a rectangle to itself and its neighbours, in its sides
SHIFTS = np.array([(i, j) for i in (0, -1, 1) for j in (0, -1, 1)])


def reach_of(sizes: np.ndarray, corners: np.ndarray | None) -> np.ndarray:
    """Radii (n,) of the circles around the centres that hold each inclusion."""
    return sizes / 2 if corners is None else np.hypot(corners[..., 0], corners[..., 1]).max(axis=1)


@dataclass(frozen=True, eq=False)
class Structure:
    """Inclusions in a rectangle; lengths in mm."""

    box: tuple[float, float, float, float]  # x min, y min, x max, y max
    periodic: bool
    sizes: np.ndarray  # (n,), diameters of circles of the same area
    centres: np.ndarray  # (n, 2)
    corners: np.ndarray | None  # (n, k, 2) about the centres; None: circles

    @property
    def span(self) -> np.ndarray:
        """Sides of the rectangle, (2,)."""
        return np.subtract(self.box[2:], self.box[:2])

    def outline(self, index: int):
        """Radius and corners of one inclusion, as `outlines.distance` takes them."""
        return self.sizes[index] / 2, None if self.corners is None else self.corners[index]

    def with_images(self, margin: float) -> "Structure":
        """With what lies within `margin` beyond the edges too, where the structure is periodic."""
        if not self.periodic:
            return self
        far = (reach_of(self.sizes, self.corners) + margin)[:, None]
        index, centres = [], []
        for shift in SHIFTS * self.span:
            moved = self.centres + shift
            near = ((moved + far > self.box[:2]) & (moved - far < self.box[2:])).all(axis=1)
            index.append(np.flatnonzero(near))
            centres.append(moved[near])
        index = np.concatenate(index)
        corners = None if self.corners is None else self.corners[index]
        return replace(self, sizes=self.sizes[index], centres=np.concatenate(centres), corners=corners)

    def distance(self, x: np.ndarray, y: np.ndarray, most: float) -> np.ndarray:
        """Distance, mm, of the places x × y from the nearest outline, negative inside, at most `most`.

        Args:
            x, y: (nx,) and (ny,), mm, increasing.
            most: mm; farther places are not told apart.

        Returns:
            (nx, ny)
        """
        found = np.full((len(x), len(y)), float(most))
        everything = self.with_images(most)
        reaches = reach_of(everything.sizes, everything.corners) + most
        for k, (centre, reach) in enumerate(zip(everything.centres, reaches, strict=True)):
            lower(found, x, y, centre, reach, *everything.outline(k))
        return found


def lower(found, x, y, centre, reach, radius, corners) -> None:
    """Put the distance from one outline into `found` (nx, ny), within `reach` of its centre, where it is less."""
    i, j = (
        slice(*np.searchsorted(line, (middle - reach, middle + reach)))
        for line, middle in zip((x, y), centre, strict=True)
    )
    part = found[i, j]
    if part.size:
        own = outlines.distance(x[i, None] - centre[0], y[None, j] - centre[1], radius, corners)
        np.minimum(part, own, out=part)
