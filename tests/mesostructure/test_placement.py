"""Placed inclusions: their area, gaps by brute force, edges, seeds, dense packings."""

import time

import numpy as np
import pytest

from jaxmpm.errors import SceneError
from jaxmpm.mesostructure.placement import place
from jaxmpm.mesostructure.tables import Inclusions

BOX = (2.0, -3.0, 27.0, 22.0)
FULLER = {"kind": "fuller", "smallest": 1.5, "largest": 6.0}
BROAD = {"kind": "fuller", "smallest": 0.5, "largest": 8.0}
NARROW = {"kind": "fuller", "smallest": 1.0, "largest": 1.1}
SHAPES = [{"kind": "circle"}, {"kind": "ellipse", "aspect": 1.8}, {"kind": "polygon", "irregularity": 0.8}]


def placed(seed=1, **changes):
    table = {"fraction": 0.37, "grading": FULLER, "gap": 0.3} | changes
    return place(Inclusions.model_validate(table), BOX, seed)


def outlines_of(structure, images):
    """Points on all outlines (n, k, 2), with those of periodic images after them."""
    if structure.corners is None:
        angle = 2 * np.pi * np.arange(120) / 120
        about = structure.sizes[:, None, None] / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    else:
        t = np.linspace(0.0, 1.0, 12, endpoint=False)[:, None]
        edge = np.roll(structure.corners, -1, axis=1) - structure.corners
        about = (structure.corners[:, :, None] + t * edge[:, :, None]).reshape(len(edge), -1, 2)
    found = structure.centres[:, None] + about
    if images:
        shifts = [(i, j) for i in (0, -1, 1) for j in (0, -1, 1)]
        found = np.concatenate([found + np.multiply(shift, structure.span) for shift in shifts])
    return found


def least_gap(structure):
    """Least distance between the outlines of two inclusions, by their points alone."""
    points = outlines_of(structure, structure.periodic)
    middle, reach = points.mean(axis=1), np.ptp(points, axis=1).max(axis=1)
    least = np.inf
    for i in range(len(structure.sizes)):
        for j in range(i + 1, len(points)):
            if np.hypot(*(middle[i] - middle[j])) < reach[i] + reach[j]:
                least = min(least, np.hypot(*(points[i][:, None] - points[j]).transpose(2, 0, 1)).min())
    return least


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("edges", ["inside", "periodic"])
def test_gaps_are_kept(shape, edges):
    structure = placed(shape=shape, edges=edges)
    # the points of outlines that touch are no nearer than the outlines, so the check is strict
    assert least_gap(structure) >= 0.3 - 1e-9
    if edges == "inside":
        points = outlines_of(structure, images=False).reshape(-1, 2)
        assert (points.min(axis=0) >= np.add(BOX[:2], 0.3 - 1e-9)).all()
        assert (points.max(axis=0) <= np.subtract(BOX[2:], 0.3 - 1e-9)).all()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("edges", ["inside", "periodic"])
def test_no_inclusion_lies_within_another(shape, edges):
    structure = placed(shape=shape, edges=edges, fraction=0.5)
    x = BOX[0] + (np.arange(500) + 0.5) * 25 / 500
    y = BOX[1] + (np.arange(500) + 0.5) * 25 / 500
    inside = (structure.distance(x, y, 1.0) < 0).mean()
    assert inside == pytest.approx(0.5, abs=2e-3)  # overlaps would be missing


@pytest.mark.parametrize("edges", ["inside", "periodic"])
@pytest.mark.parametrize(
    "changes",
    [
        {"grading": BROAD, "gap": 0.05},
        {"grading": FULLER, "gap": 0.3},
        {"grading": NARROW, "gap": 0.0},
        {"grading": BROAD, "gap": 0.05, "shape": SHAPES[2]},
        {"grading": FULLER, "gap": 0.1, "shape": SHAPES[1]},
    ],
)
def test_sixty_per_cent_in_seconds(changes, edges):
    began = time.process_time()
    structure = placed(fraction=0.6, edges=edges, **changes)
    assert time.process_time() - began < 20.0  # 0.02 to 1 s on a quiet core
    assert np.pi / 4 * (structure.sizes**2).sum() == pytest.approx(0.6 * 625, rel=1e-12)
    assert least_gap(structure) >= changes["gap"] - 1e-9


def test_seeds():
    one, again, other = placed(), place.__wrapped__(placed_table(), BOX, 1), placed(seed=2)
    assert (one.centres == again.centres).all()
    assert one.centres.shape != other.centres.shape or (one.centres != other.centres).any()


def placed_table():
    return Inclusions.model_validate({"fraction": 0.37, "grading": FULLER, "gap": 0.3})


def test_what_does_not_fit_is_said_with_what_was_reached():
    with pytest.raises(SceneError) as caught:
        placed(fraction=0.7, grading=NARROW, gap=0.4)
    (line,) = caught.value.lines
    assert line.startswith("mesostructure.inclusions.fraction = 0.7: expected no more than fits in with gap = 0.4 mm")
    reached = float(line.split("reached ")[1].split()[0])
    assert 0.2 < reached < 0.5  # saturation at 0.547 of discs that are 1.9 times as large with their gap


def test_too_little_for_one_is_said_with_what_one_takes():
    with pytest.raises(SceneError, match="fraction = 0.01: expected at least 0.[0-9]+, what one inclusion"):
        placed(fraction=0.01, grading={"kind": "fuller", "smallest": 2.0, "largest": 6.0})


@pytest.mark.parametrize(("edges", "largest"), [("inside", 25.2), ("periodic", 14.0)])
def test_inclusions_as_large_as_the_body(edges, largest):
    with pytest.raises(SceneError, match="grading = .*: expected inclusions no wider than"):
        placed(fraction=0.8, edges=edges, grading={"kind": "fuller", "smallest": largest, "largest": largest})


def test_a_periodic_structure_goes_on_at_the_opposite_edge():
    structure = placed(edges="periodic")
    x, y = np.array([BOX[0], BOX[2]]), np.linspace(BOX[1], BOX[3], 301)
    left, right = structure.distance(x, y, 2.0)
    assert left == pytest.approx(right, abs=1e-9)
    assert (left < 0).any()
    x, y = np.linspace(BOX[0], BOX[2], 301), np.array([BOX[1], BOX[3]])
    bottom, top = structure.distance(x, y, 2.0).T
    assert bottom == pytest.approx(top, abs=1e-9)
