"""Distances between outlines and from places to them, against dense samples of the outlines."""

import numpy as np
import pytest
from matplotlib.path import Path

from jaxmpm.mesostructure import outlines
from jaxmpm.mesostructure.tables import Circle, Ellipse, Polygon

ELLIPSE = Ellipse(kind="ellipse", aspect=2.0)
POLYGON = Polygon(kind="polygon", corners=[3, 8], irregularity=1.0)


def drawn(shape, count=40, seed=0):
    random = np.random.default_rng(seed)
    sizes = random.uniform(1.0, 5.0, count)
    return sizes, outlines.draw_corners(shape, sizes, random)


def dense(corners, count=400):
    """Points along the outline of a polygon."""
    t = np.linspace(0.0, 1.0, count, endpoint=False)[:, None, None]
    return (corners + t * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)


@pytest.mark.parametrize("shape", [ELLIPSE, POLYGON])
def test_areas_are_those_of_circles_about_the_centroid(shape):
    sizes, corners = drawn(shape)
    for size, polygon in zip(sizes, corners, strict=True):
        x, y = polygon.T
        assert 0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() == pytest.approx(np.pi / 4 * size**2)
    # first moments by triangles from the origin
    a, b = corners, np.roll(corners, -1, axis=1)
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    assert ((a + b) * cross[..., None]).sum(axis=1) == pytest.approx(0.0, abs=1e-9)
    assert (cross >= -1e-12).all()  # counter-clockwise


def test_polygons_are_convex_and_irregular():
    _, corners = drawn(POLYGON, 200)
    edge = np.roll(corners, -1, axis=1) - corners
    following = np.roll(edge, -1, axis=1)
    assert (edge[..., 0] * following[..., 1] - edge[..., 1] * following[..., 0] >= -1e-9).all()
    counts = [len(np.unique(polygon.round(9), axis=0)) for polygon in corners]
    assert set(counts) == set(range(3, 9))


def test_an_ellipse_has_its_aspect():
    _, corners = drawn(ELLIPSE)
    reach = np.hypot(corners[..., 0], corners[..., 1])
    assert reach.max(axis=1) / reach.min(axis=1) == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize("shape", [ELLIPSE, POLYGON])
def test_distance_of_places(shape):
    _, corners = drawn(shape, 5)
    random = np.random.default_rng(1)
    for polygon in corners:
        places = random.uniform(-5.0, 5.0, (300, 2))
        nearest = np.hypot(*(places[:, None] - dense(polygon)).transpose(2, 0, 1)).min(axis=1)
        inside = Path(polygon).contains_points(places)
        found = outlines.distance(*places.T, 1.0, polygon)
        assert np.abs(found) == pytest.approx(nearest, abs=0.01)
        assert ((found < 0) == inside).all()


def test_distance_of_a_circle():
    assert outlines.draw_corners(Circle(kind="circle"), np.ones(3), np.random.default_rng()) is None
    assert outlines.distance(np.array([0.0, 3.0]), np.array([0.0, 4.0]), 2.0, None).tolist() == [-2.0, 3.0]


def test_separation_of_polygons_is_a_little_less_than_their_distance():
    _, corners = drawn(POLYGON, 30)
    random = np.random.default_rng(2)
    first, second = random.integers(0, 30, (2, 60))
    between = random.uniform(-9.0, 9.0, (60, 2))
    reach = outlines.support(corners)
    found, _ = outlines.separation(between, reach[first], reach[second])
    for k, (i, j) in enumerate(zip(first, second, strict=True)):
        a, b = dense(corners[i], 60), dense(corners[j], 60) + between[k]
        exact = np.hypot(*(a[:, None] - b).transpose(2, 0, 1)).min()
        if Path(corners[i]).contains_points(b).any() or Path(corners[j]).contains_points(a - between[k]).any():
            assert found[k] < 0.05
        else:
            assert found[k] <= exact + 1e-9 and found[k] > exact - 0.3


def test_separation_of_circles():
    found, way = outlines.separation(np.array([[3.0, 4.0], [0.0, 0.0]]), np.ones(2), np.full(2, 2.0))
    assert found.tolist() == [2.0, -3.0]
    assert way[0] == pytest.approx([0.6, 0.8])
