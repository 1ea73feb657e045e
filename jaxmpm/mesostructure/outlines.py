"""Outlines of inclusions: circles, or convex polygons (ellipses are polygons of 36 corners).

Two convex shapes are n · (c₂ − c₁) − s₁(n) − s₂(−n) apart along a unit vector n, where s(n) is the
support function, how far a shape reaches along n; the distance between them is the maximum over n.
Its maximum over some fixed n is a little less: a gap that is kept there is kept.
"""

import numpy as np

CORNERS = 36  # of an ellipse
DIRECTIONS = 72  # in which distances between polygons are looked at, a multiple of 4
NORMALS = np.stack([f(2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS) for f in (np.cos, np.sin)], axis=1)


def draw_corners(shape, sizes: np.ndarray, random: np.random.Generator) -> np.ndarray | None:
    """Corners (n, k, 2), mm, about the origin and counter-clockwise, of shapes of `sizes`; None for circles.

    Their areas are those of circles of these sizes. A polygon of few corners repeats its last one.
    """
    if shape.kind == "circle":
        return None
    if shape.kind == "ellipse":
        angle = np.tile(2 * np.pi * np.arange(CORNERS) / CORNERS, (len(sizes), 1))
    else:
        angle = np.stack([_polygon_angles(shape, random) for _ in sizes])
    corners = np.stack([shape.aspect * np.cos(angle), np.sin(angle)], axis=2)
    corners -= _centroid(corners)[:, None]
    corners *= np.sqrt(np.pi / 4 * sizes**2 / area(corners))[:, None, None]
    return turned(corners, random.uniform(0.0, 2 * np.pi, len(sizes)))


def _polygon_angles(shape, random) -> np.ndarray:
    fewest, most = shape.corners
    count = random.integers(fewest, most + 1)
    # Each less than half a step away, so that they stay in order.
    moved = 0.45 * shape.irregularity * random.uniform(-1.0, 1.0, count)
    angle = 2 * np.pi * (np.arange(count) + moved) / count
    return np.pad(angle, (0, most - count), mode="edge")


def turned(corners: np.ndarray, angle) -> np.ndarray:
    """Corners (..., k, 2) turned by an angle (...), radians."""
    c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
    x, y = corners[..., 0], corners[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def area(corners: np.ndarray) -> np.ndarray:
    """Areas (...,) of polygons (..., k, 2)."""
    return 0.5 * _cross(corners, np.roll(corners, -1, axis=-2)).sum(axis=-1)


def _centroid(corners):
    following = np.roll(corners, -1, axis=-2)
    cross = _cross(corners, following)[..., None]
    return ((corners + following) * cross).sum(axis=-2) / (3 * cross.sum(axis=-2))


def _cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def support(corners: np.ndarray) -> np.ndarray:
    """How far polygons (..., k, 2) reach from their centres in each direction, (..., DIRECTIONS)."""
    return (corners @ NORMALS.T).max(axis=-2)


def separation(between: np.ndarray, first, second) -> tuple[np.ndarray, np.ndarray]:
    """How far pairs of shapes are apart, (pairs,), mm, and the direction (pairs, 2) from the first to the second.

    Negative where they overlap. Exact for circles; for polygons a little less than the distance.

    Args:
        between: from the first centre to the second, (pairs, 2).
        first, second: radii (pairs,) of circles, or supports (pairs, DIRECTIONS).
    """
    if first.ndim == 1:
        length = np.hypot(*between.T)
        still = length == 0.0
        direction = np.where(still[:, None], (1.0, 0.0), between / np.where(still, 1.0, length)[:, None])
        return length - first - second, direction
    apart = between @ NORMALS.T - first - np.roll(second, DIRECTIONS // 2, axis=1)
    best = apart.argmax(axis=1)
    return apart[np.arange(len(apart)), best], NORMALS[best]


def distance(x: np.ndarray, y: np.ndarray, radius: float, corners: np.ndarray | None) -> np.ndarray:
    """Distance, mm, of places from the outline of a shape about the origin, negative inside.

    Args:
        x, y: the places, mm, of any shapes that go together.
        radius: of the circle, where there are no corners.
        corners: (k, 2) of a convex polygon.
    """
    if corners is None:
        return np.hypot(x, y) - radius
    nearest, inside = np.inf, True
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        dx, dy = bx - ax, by - ay
        square = dx * dx + dy * dy
        if square == 0.0:  # a corner repeated
            continue
        u, v = x - ax, y - ay
        along = np.clip((u * dx + v * dy) / square, 0.0, 1.0)
        nearest = np.minimum(nearest, (u - along * dx) ** 2 + (v - along * dy) ** 2)
        inside = inside & (dx * v - dy * u >= 0.0)
    nearest = np.sqrt(nearest)
    return np.where(inside, -nearest, nearest)
