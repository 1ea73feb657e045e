"""Fills the grid's cells with the bodies of a scene, and says which nodes and edges are where."""

import numpy as np

from jaxmpm.errors import Problems
from jaxmpm.scene import Body, Grid, Scene
from jaxmpm.shapes import cells_in


def fill(scene: Scene, problems: Problems) -> np.ndarray:
    """Index of the body in each cell, (nx, ny), -1 where there is none; adds what is wrong."""
    grid = scene.grid
    nx, ny = grid.shape
    x = grid.origin[0] + (np.arange(nx) + 0.5) * grid.cell
    y = grid.origin[1] + (np.arange(ny) + 0.5) * grid.cell
    centres = x[:, None], y[None, :]
    owner = np.full(grid.shape, -1)
    for index, body in enumerate(scene.bodies):
        cells = _body_cells(index, body, grid, centres, problems)
        owner[cells] = index
    for index in range(len(scene.bodies)):
        if not problems.lines and not (owner == index).any():
            advice = "later bodies cover all of it"
            problems.add(("bodies", index, "shapes"), "shapes that fill at least one cell", advice)
    return owner


def _body_cells(index: int, body: Body, grid: Grid, centres, problems: Problems) -> np.ndarray:
    cell = grid.cell
    cells = np.zeros(grid.shape, dtype=bool)
    found = len(problems.lines)
    for i, shape in enumerate(body.shapes):
        path = ("bodies", index, "shapes", i)
        covered = cells_in([shape], *centres, cell)
        _check_inside(path, shape, grid, problems)
        _check_size(path, shape, covered, "covers", cell, problems)
        cells |= covered
    removed = np.zeros(grid.shape, dtype=bool)
    for i, shape in enumerate(body.minus):
        covered = cells_in([shape], *centres, cell) & cells
        _check_size(("bodies", index, "minus", i), shape, covered, "removes", cell, problems)
        removed |= covered
    cells &= ~removed
    if not cells.any() and len(problems.lines) == found:
        expected = "shapes that leave the body at least one cell"
        problems.add(("bodies", index, "minus"), expected, "cut less out of it")
    return cells


def owners(bodies, x, y) -> np.ndarray:
    """Index of the body that covers each of some places (mm), -1 where there is none."""
    owner = np.full(np.shape(x), -1)
    for index, body in enumerate(bodies):
        covered = np.logical_or.reduce([shape.covers(x, y) for shape in body.shapes])
        for shape in body.minus:
            covered &= ~shape.covers(x, y)
        owner[covered] = index
    return owner


def _check_inside(path: tuple, shape, grid: Grid, problems: Problems) -> None:
    bounds = shape.bounds()
    if bounds is None:
        return
    (x0, y0), slack = grid.origin, 1e-6 * grid.cell
    x1, y1 = x0 + grid.size[0], y0 + grid.size[1]
    low = bounds[0] < x0 - slack or bounds[1] < y0 - slack
    if low or bounds[2] > x1 + slack or bounds[3] > y1 + slack:
        expected = f"to lie inside the grid, x {x0:g} to {x1:g} and y {y0:g} to {y1:g} mm"
        problems.add(path, expected, "shrink it, or change grid.size or grid.origin")


def _check_size(path: tuple, shape, covered, verb: str, cell: float, problems: Problems) -> None:
    width = shape.width()
    if width < cell * (1.0 - 1e-6):
        expected = f"to be at least a cell wide, {cell:g} mm; it is {width:g} mm"
        advice = f"widen it, or set grid.cell to {width:g} or less" if width > 0 else "widen it"
        problems.add(path, expected, advice)
    elif not covered.any():
        expected = f"a shape that {verb} at least one cell of {cell:g} mm"
        problems.add(path, expected, "move or widen it, or use a smaller grid.cell")


def cells_at_nodes(values: np.ndarray) -> np.ndarray:
    """Sum over the cells that touch each node of a cell value, (nx, ny) to (nx + 1, ny + 1)."""
    padded = np.pad(values, 1)
    return padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:]


def boundary_length(filled: np.ndarray, chosen: np.ndarray, cell: float) -> np.ndarray:
    """Each node's share of the boundary edges (mm) whose both nodes are chosen, (nx + 1, ny + 1).

    `filled`: (nx, ny), whether a cell is filled; `chosen`: (nx + 1, ny + 1); `cell`: mm.
    """
    length = np.zeros(chosen.shape)
    padded = np.pad(filled, 1)
    # An edge is on the boundary where exactly one of the two cells beside it is filled.
    along_x = (padded[1:-1, :-1] != padded[1:-1, 1:]) & chosen[:-1, :] & chosen[1:, :]
    along_y = (padded[:-1, 1:-1] != padded[1:, 1:-1]) & chosen[:, :-1] & chosen[:, 1:]
    length[:-1, :] += along_x
    length[1:, :] += along_x
    length[:, :-1] += along_y
    length[:, 1:] += along_y
    return 0.5 * cell * length
