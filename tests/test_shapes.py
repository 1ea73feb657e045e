"""Shapes: which cells and nodes are theirs, ties and round-off included."""

import numpy as np
import pytest

from jaxmpm.shapes import Circle, HalfPlane, Polygon, Rectangle, cells_in, nodes_in


def test_half_open_rectangles_tile_without_gap_or_overlap():
    centres = np.arange(0.05, 1.0, 0.1)
    x, y = centres[:, None], centres[None, :]
    parts = [(0.0, 0.35), (0.35, 0.75), (0.75, 1.0)]
    counts = np.zeros((10, 10), dtype=int)
    for x0, x1 in parts:
        for y0, y1 in parts:
            shape = Rectangle(kind="rectangle", min=(x0, y0), max=(x1, y1))
            counts += cells_in([shape], x, y, 0.1)
    assert (counts == 1).all()


def test_two_half_planes_share_the_cells_even_on_the_diagonal():
    centres = np.arange(0.5, 8.0)
    x, y = centres[:, None], centres[None, :]
    sides = [HalfPlane(kind="half_plane", point=(4, 4), angle=a) for a in (135.0, -45.0)]
    one, other = (cells_in([side], x, y, 1.0) for side in sides)
    assert (one ^ other).all()


def test_polygon_agrees_with_the_rectangle_and_the_circle_it_traces():
    x, y = np.arange(0.25, 10, 0.5)[:, None], np.arange(0.25, 10, 0.5)[None, :]
    square = Rectangle(kind="rectangle", min=(2.25, 1.0), max=(7.25, 6.75))
    corners = ((2.25, 1.0), (7.25, 1.0), (7.25, 6.75), (2.25, 6.75))
    traced = Polygon(kind="polygon", points=corners)
    assert np.array_equal(cells_in([square], x, y, 0.5), cells_in([traced], x, y, 0.5))
    assert np.array_equal(nodes_in([square], x, y, 0.5), nodes_in([traced], x, y, 0.5))
    assert traced.width() == square.width() == 5.0
    disc = Circle(kind="circle", center=(5.03, 4.96), radius=3.0)
    t = np.linspace(0, 2 * np.pi, 721)[:-1]
    rim = zip(5.03 + 3 * np.cos(t), 4.96 + 3 * np.sin(t), strict=True)
    round_polygon = Polygon(kind="polygon", points=tuple((float(a), float(b)) for a, b in rim))
    inside = cells_in([disc], x, y, 0.5)
    assert np.array_equal(inside, cells_in([round_polygon], x, y, 0.5))
    assert inside.sum() * 0.25 == pytest.approx(np.pi * 9, rel=0.05)


def test_nodes_on_an_edge_count_despite_round_off():
    x = np.arange(11) * 0.1
    line = Rectangle(kind="rectangle", min=(0.3, 0.6), max=(0.7, 0.6))
    chosen = nodes_in([line], x[:, None], x[None, :], 0.1)
    assert np.argwhere(chosen).tolist() == [[i, 6] for i in range(3, 8)]
