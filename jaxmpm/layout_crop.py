"""Rows and columns of a grid that no body fills, left out in the total frame and put back where points begin to move."""

from dataclasses import replace

import numpy as np


def filled_window(layout) -> tuple[slice, slice]:
    """Columns and rows of cells between the outermost filled ones; the low edge of a half, its plane of symmetry, stays."""
    filled = layout.material >= 0
    found = []
    for axis in (0, 1):
        lines = np.flatnonzero(filled.any(axis=1 - axis))
        first = 0 if layout.half and layout.half.axis == axis else lines[0]
        found.append(slice(int(first), int(lines[-1]) + 1))
    return tuple(found)


def cropped(layout):
    """The layout of what lies between the outermost filled cells, on a smaller grid; nothing that acts or is measured is lost."""
    window = filled_window(layout)
    shape = tuple(part.stop - part.start for part in window)
    if shape == tuple(layout.shape):
        return layout
    nodes = tuple(slice(part.start, part.stop + 1) for part in window)
    number = np.full((2, layout.shape[0] + 1, layout.shape[1] + 1), -1)
    number[(slice(None), *nodes)] = np.arange(2 * (shape[0] + 1) * (shape[1] + 1)).reshape(2, shape[0] + 1, shape[1] + 1)
    number = number.reshape(-1)  # of each degree of freedom; a node has that of its component along x
    cut = lambda field: None if field is None else field[(..., *window)]  # noqa: E731
    renumbered = lambda what: replace(what, dofs=number[what.dofs])  # noqa: E731
    local = layout.local and replace(layout.local, strength=cut(layout.local.strength), shares=cut(layout.local.shares))
    return replace(
        layout, shape=shape, origin=tuple(o + part.start * layout.cell for o, part in zip(layout.origin, window, strict=True)),
        material=cut(layout.material), owner=cut(layout.owner), velocity=layout.velocity[(slice(None), *nodes)],
        sets={name: number[chosen] for name, chosen in layout.sets.items()}, held=number[layout.held],
        displacements=tuple(map(renumbered, layout.displacements)), forces=tuple(map(renumbered, layout.forces)),
        gauges=tuple(map(renumbered, layout.gauges)), local=local,
    )  # fmt: skip


def padded(state, layout, whole):
    """A state of the total frame (`model.State`) on the `whole` grid, of which `layout` is the cropped one."""
    first = [round((o - before) / whole.cell) for o, before in zip(layout.origin, whole.origin, strict=True)]
    nodes = [(low, all_ - own - low) for low, own, all_ in zip(first, layout.shape, whole.shape, strict=True)]
    wide = lambda field, fill=0: np.pad(np.asarray(field), [(0, 0)] * (field.ndim - 2) + nodes, constant_values=fill)  # noqa: E731
    i, j = np.divmod(np.asarray(state.pool.cell), layout.shape[1])
    cell = ((i + first[0]) * whole.shape[1] + j + first[1]).astype(state.pool.cell.dtype)
    used = np.arange(len(cell)) < int(state.pool.count)
    return state._replace(
        displacement=wide(state.displacement), velocity=wide(state.velocity), intact=wide(state.intact),
        grip=wide(state.grip), place=wide(state.place, -1), pool=state.pool._replace(cell=np.where(used, cell, 0)),
    )  # fmt: skip
