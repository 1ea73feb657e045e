"""Plane shapes that bodies, notches and node sets are made of (mm, degrees)."""

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
Pair = tuple[Number, Number]


class Table(BaseModel):
    """A table of a scene: no key it does not know, and no change once read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def cosines(angle: float) -> tuple[float, float]:
    """Components of the unit vector at `angle` degrees from the x axis, exact on the axes."""
    radians = np.deg2rad(angle)
    # cos(90 degrees) is 6e-17 in floating point: a load along y must not touch x.
    c, s = (0.0 if abs(v) < 1e-12 else float(v) for v in (np.cos(radians), np.sin(radians)))
    return c, s


class Rectangle(Table):
    """An upright rectangle; flat ones (min equal to max) are lines and points, for node sets."""

    kind: Literal["rectangle"]
    min: Pair = Field(description="lower left corner [x, y], mm")
    max: Pair = Field(description="upper right corner [x, y], mm")

    @field_validator("max")
    @classmethod
    def _ordered(cls, value, info):
        low = info.data.get("min")
        if low is not None and (value[0] < low[0] or value[1] < low[1]):
            raise ValueError(f"no coordinate below min = {list(low)}")
        return value

    def covers(self, x, y):
        """Whether points lie in min <= p < max."""
        return (x >= self.min[0]) & (x < self.max[0]) & (y >= self.min[1]) & (y < self.max[1])

    def touches(self, x, y, tolerance):
        """Whether points lie in or within `tolerance` mm of the closed shape."""
        inside_x = (x >= self.min[0] - tolerance) & (x <= self.max[0] + tolerance)
        return inside_x & (y >= self.min[1] - tolerance) & (y <= self.max[1] + tolerance)

    def bounds(self):
        """(x min, y min, x max, y max), mm."""
        return (*self.min, *self.max)

    def width(self):
        """The narrowest extent, mm."""
        return min(self.max[0] - self.min[0], self.max[1] - self.min[1])


class Circle(Table):
    """A disc."""

    kind: Literal["circle"]
    center: Pair = Field(description="centre [x, y], mm")
    radius: Positive = Field(description="radius, mm")

    def covers(self, x, y):
        """Whether points lie inside."""
        return np.hypot(x - self.center[0], y - self.center[1]) < self.radius

    def touches(self, x, y, tolerance):
        """Whether points lie in or within `tolerance` mm of the closed shape."""
        return np.hypot(x - self.center[0], y - self.center[1]) <= self.radius + tolerance

    def bounds(self):
        """(x min, y min, x max, y max), mm."""
        (x, y), r = self.center, self.radius
        return (x - r, y - r, x + r, y + r)

    def width(self):
        """The narrowest extent, mm."""
        return 2.0 * self.radius


class Polygon(Table):
    """A polygon, closed by itself; where it crosses itself the even-odd rule holds."""

    kind: Literal["polygon"]
    points: tuple[Pair, ...] = Field(min_length=3, description="corners [x, y] in turn, mm")

    @field_validator("points")
    @classmethod
    def _has_area(cls, value):
        p = np.array(value)
        spread = p - p[0]
        if np.linalg.matrix_rank(spread, tol=1e-9 * max(np.abs(spread).max(), 1e-300)) < 2:
            raise ValueError("corners that do not all lie on one line")
        return value

    def _edges(self):
        p = np.array(self.points)
        return zip(p, np.roll(p, -1, axis=0), strict=True)

    def covers(self, x, y):
        """Whether points lie inside, by the number of edges a ray along +x crosses."""
        inside = np.zeros(np.broadcast(x, y).shape, dtype=bool)
        for (x0, y0), (x1, y1) in self._edges():
            if y0 != y1:
                crosses = ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
                inside ^= crosses
        return inside

    def touches(self, x, y, tolerance):
        """Whether points lie in or within `tolerance` mm of the closed shape."""
        hit = self.covers(x, y)
        for a, b in self._edges():
            d = b - a
            along = ((x - a[0]) * d[0] + (y - a[1]) * d[1]) / max(d @ d, 1e-300)
            along = np.clip(along, 0.0, 1.0)
            hit |= np.hypot(x - a[0] - along * d[0], y - a[1] - along * d[1]) <= tolerance
        return hit

    def bounds(self):
        """(x min, y min, x max, y max), mm."""
        p = np.array(self.points)
        return (*p.min(axis=0), *p.max(axis=0))

    def width(self):
        """The narrowest extent across any of its edges, mm."""
        p = np.array(self.points)
        extents = []
        for a, b in self._edges():
            length = np.hypot(*(b - a))
            if length > 0.0:
                across = (p - a) @ np.array([a[1] - b[1], b[0] - a[0]]) / length
                extents.append(np.ptp(across))
        return float(min(extents))


class HalfPlane(Table):
    """Everything on the side of a straight line that its normal points to."""

    kind: Literal["half_plane"]
    point: Pair = Field(description="a point [x, y] of the line, mm")
    angle: Number = Field(description="angle of the normal from the x axis, degrees")

    def _distance(self, x, y):
        c, s = cosines(self.angle)
        return (x - self.point[0]) * c + (y - self.point[1]) * s

    def covers(self, x, y):
        """Whether points lie on the line or on the side of its normal."""
        return self._distance(x, y) >= 0.0

    def touches(self, x, y, tolerance):
        """Whether points lie in or within `tolerance` mm of the closed shape."""
        return self._distance(x, y) >= -tolerance

    def bounds(self):
        """None: a half plane has no end."""
        return None

    def width(self):
        """Infinite."""
        return np.inf


Shape = Annotated[Rectangle | Circle | Polygon | HalfPlane, Field(discriminator="kind")]


def cells_in(shapes, x, y, cell):
    """Whether the cells centred at (x, y), with sides of `cell` mm, belong to a union of shapes.

    A centre on an edge belongs to the shape only if the shape lies on its upper side.
    """
    # Half-open against round-off: centres move up by far less than a cell. By different amounts,
    # so that a line at 45 degrees through centres does not keep the tie.
    x, y = x + 1e-6 * cell, y + 0.5e-6 * cell
    return np.logical_or.reduce([shape.covers(x, y) for shape in shapes])


def nodes_in(shapes, x, y, cell):
    """Whether nodes at (x, y) lie in a union of closed shapes, to a millionth of a cell."""
    return np.logical_or.reduce([shape.touches(x, y, 1e-6 * cell) for shape in shapes])
