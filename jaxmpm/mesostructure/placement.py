"""Places inclusions: the largest first, each where there is room; where there is none they are pushed apart.

Room is known on a fine lattice that holds the distance to what has been placed, so that a place is
drawn from those that are free instead of guessed (random sequential addition up to its saturation). That
alone fills 55 % with circles of one size and more with a broad grading. Beyond it the rest goes into the
largest holes, and `relaxation` makes room.
"""

from functools import lru_cache

import numpy as np

from jaxmpm.errors import SceneError, written
from jaxmpm.mesostructure import outlines, relaxation
from jaxmpm.mesostructure.grading import circle, draw_sizes
from jaxmpm.mesostructure.structure import SHIFTS, Structure, lower, reach_of
from jaxmpm.mesostructure.tables import Inclusions

FINEST = 4e5  # places of the lattice at most
PROBES = 64  # places of the lattice that are looked at before all are
TRIES = 40  # places and angles that are tried for a shape that is no circle
ATTEMPTS = 2  # at all of it


@lru_cache(maxsize=8)
def place(table: Inclusions, box: tuple[float, float, float, float], seed: int) -> Structure:
    """The inclusions of a table in a rectangle (x min, y min, x max, y max), mm.

    Raises SceneError where they do not fit in, or the area asked for is less than one of them.
    """
    random = np.random.default_rng(seed)
    whole = (box[2] - box[0]) * (box[3] - box[1])
    least = circle(table.grading.largest) / whole
    if table.fraction < least:
        raise SceneError(
            f"mesostructure.inclusions.fraction = {table.fraction:g}: expected at least {least:.4g}, what one inclusion "
            "of the largest size takes (use smaller inclusions)"
        )
    sizes = draw_sizes(table.grading, table.fraction * whole, random)
    reached = 0.0
    for _ in range(ATTEMPTS):
        room = Room(table, box, sizes, random)
        if room.fill() or relaxation.push_apart(room):
            return Structure(box, room.periodic, sizes, room.centres, room.corners)
        reached = max(reached, circle(sizes[room.found]).sum() / whole)
    raise SceneError(
        f"mesostructure.inclusions.fraction = {table.fraction:g}: expected no more than fits in with gap = "
        f"{table.gap:g} mm (reached {reached:.3f} by placing at random, and pushing inclusions apart made no room "
        "for the rest; use a smaller gap or a broader grading)"
    )


class Room:
    """Inclusions on their way into a rectangle: what has a place, and where there is room still."""

    def __init__(self, table: Inclusions, box, sizes: np.ndarray, random: np.random.Generator):
        self.grading = written(table.grading.model_dump())
        self.gap, self.periodic, self.random = table.gap, table.edges == "periodic", random
        self.low, self.high = np.reshape(box, (2, 2))
        self.span = self.high - self.low
        self.corners = outlines.draw_corners(table.shape, sizes, random)
        self.radius = sizes / 2
        self.support = None if self.corners is None else outlines.support(self.corners)
        self.reach = reach_of(sizes, self.corners)
        self.centres = np.zeros((len(sizes), 2))
        self.found = np.zeros(len(sizes), bool)  # which found room at random
        step = max(sizes[-1] / 6, np.sqrt(self.span.prod() / FINEST))
        self.lines = [
            low + (np.arange(n) + 0.5) * span / n
            for low, span, n in zip(self.low, self.span, np.ceil(self.span / step).astype(int), strict=True)
        ]
        self.step = step
        # distance of each place of the lattice from what has been placed, and from the edges that count
        self.free = np.full([len(line) for line in self.lines], np.inf)
        if not self.periodic:
            x, y = (np.minimum(line - low, high - line) for line, low, high in zip(self.lines, self.low, self.high, strict=True))
            self.free = np.minimum(x[:, None], y[None, :])
        self._check_sizes()

    def _check_sizes(self):
        widest = 2 * self.reach.max() + (self.gap if self.periodic else 2 * self.gap)
        # Where it is periodic a pair must not meet on both sides.
        most = self.span.min() / (2 if self.periodic else 1)
        if widest > most:
            raise SceneError(
                f"mesostructure.inclusions.grading = {self.grading}: expected inclusions no wider than {most:.4g} mm, gap included, in "
                f"a body of {self.span[0]:g} by {self.span[1]:g} mm (the widest takes {widest:.4g} mm)"
            )

    def extents(self, index) -> np.ndarray:
        """How far inclusions reach to the left and right, and below and above, (2, ..., 2)."""
        if self.support is None:
            radius = np.broadcast_to(self.radius[index][..., None], (*np.shape(self.radius[index]), 2))
            return np.stack([radius, radius])
        quarter = outlines.DIRECTIONS // 4
        ahead = self.support[index]
        return np.stack([ahead[..., [2 * quarter, 3 * quarter]], ahead[..., [0, quarter]]])

    def limits(self, index) -> tuple[np.ndarray, np.ndarray]:
        """Least and most coordinates (..., 2) of the centres of inclusions."""
        before, after = self.extents(index)
        if self.periodic:
            return np.full_like(before, -np.inf), np.full_like(before, np.inf)
        return self.low + before + self.gap, self.high - after - self.gap

    def separation(self, first, second) -> tuple[np.ndarray, np.ndarray]:
        """Of pairs by index, see `outlines.separation`; the shorter way round where it is periodic."""
        way = self.centres[second] - self.centres[first]
        if self.periodic:
            way -= self.span * np.rint(way / self.span)
        sizes = self.radius if self.support is None else self.support
        return outlines.separation(way, sizes[first], sizes[second])

    def density(self) -> float:
        """Share of the rectangle that inclusions take with half their gap around them, at least."""
        within = self.span if self.periodic else self.span - self.gap
        # Of all shapes of an area circles grow least.
        return float(circle(2 * self.radius + self.gap).sum() / within.prod())

    def fill(self) -> bool:
        """Give every inclusion a place, and say whether all found room; the others overlap what is there."""
        for k in range(len(self.radius)):
            self.found[k] = self._find(k)
            if not self.found[k]:
                self._put_into_hole(k)
            self._take(k)
        return bool(self.found.all())

    def _find(self, k) -> bool:
        """Draw a place for inclusion k that keeps its gap; False where there is none."""
        if self.corners is not None and self._find_turned(k):
            return True
        on_lattice = self._draw(self.reach[k] + self.gap)
        if on_lattice is None:
            return False
        # Anywhere near that place of the lattice, or there itself, where the distance is known.
        self.centres[k] = on_lattice + self.step * self.random.uniform(-0.5, 0.5, 2)
        if not self._fits(k):
            self.centres[k] = on_lattice
        return True

    def _find_turned(self, k) -> bool:
        """The same at angles and places where a shape may fit, though the circle around it does not."""
        for _ in range(TRIES):
            self.corners[k] = outlines.turned(self.corners[k], self.random.uniform(0.0, 2 * np.pi))
            self.support[k] = outlines.support(self.corners[k])
            place = self._draw(self.support[k].min() + self.gap)
            if place is None:
                return False
            self.centres[k] = place + self.step * self.random.uniform(-0.5, 0.5, 2)
            if self._fits(k):
                return True
        return False

    def _draw(self, least: float):
        """A random place of the lattice that is at least so far from all that is there, None without one."""
        probes = self.random.integers(self.free.size, size=PROBES)
        places = probes[self.free.flat[probes] >= least]
        if not len(places):
            places = np.flatnonzero(self.free >= least)
        return self._at(places[self.random.integers(len(places))]) if len(places) else None

    def _at(self, number: int) -> np.ndarray:
        i, j = divmod(int(number), self.free.shape[1])
        return np.array([self.lines[0][i], self.lines[1][j]])

    def _fits(self, k) -> bool:
        """Whether inclusion k keeps its gap from the edges and from those before it."""
        least, most = self.limits(k)
        if (self.centres[k] < least).any() or (self.centres[k] > most).any():
            return False
        apart, _ = self.separation(np.full(k, k), np.arange(k))
        return bool((apart >= self.gap).all())

    def _put_into_hole(self, k):
        self.centres[k] = self._at(self.free.argmax())
        self.centres[k] += self.step * self.random.uniform(-0.5, 0.5, 2)

    def _take(self, k):
        """Note the distance from inclusion k on the lattice, as far as those to come may ask for it."""
        reach = self.reach[k] + self.reach[k:].max() + self.gap
        corners = None if self.corners is None else self.corners[k]
        for shift in SHIFTS if self.periodic else SHIFTS[:1]:
            lower(self.free, *self.lines, self.centres[k] + shift * self.span, reach, self.radius[k], corners)
