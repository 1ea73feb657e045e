"""From points to nodes and back, as shifted slices of whole arrays.

Nodal fields are (..., *nodes): a window of bins with `count − 1` nodes more along each axis, the
first of them node `window − lead`.
"""

from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp


class Weights(NamedTuple):
    """Shape functions of every point along each axis: lists of arrays (slots, *bins)."""

    value: list  # [axis][node]
    slope: list  # [axis][node], 1/mm


def weights(shape, place, cell, *own):
    """`Weights` of points at a place (d, slots, *bins); `own` is what a shape asks for of each."""
    value, slope = zip(*(shape.weights(y, *own) for y in place), strict=True)
    return Weights(list(value), [[s / cell for s in axis] for axis in slope])


def _product(parts):
    total = parts[0]
    for part in parts[1:]:
        total = total * part
    return total


def value_at(w, node):
    """Value of the function of a `node` of the bin (one number an axis), (slots, *bins)."""
    return _product([w.value[a][k] for a, k in enumerate(node)])


def slope_at(w, node, axis):
    """Its derivative along an axis, 1/mm."""
    return _product([(w.slope if a == axis else w.value)[a][k] for a, k in enumerate(node)])


def stencil(shape, dimension):
    """The nodes of a bin."""
    return list(product(range(shape.count), repeat=dimension))


def to_nodes(shape, contribution, dimension):
    """Sum over points of `contribution(node) -> (..., slots, *bins)`: nodal fields (..., *nodes)."""
    total = None
    for node in stencil(shape, dimension):
        part = contribution(node)
        axis = part.ndim - dimension - 1
        part = sum(jax.lax.index_in_dim(part, s, axis, False) for s in range(part.shape[axis]))
        pads = [(0, 0)] * (part.ndim - dimension) + [(k, shape.count - 1 - k) for k in node]
        part = jnp.pad(part, pads)
        total = part if total is None else total + part
    return total


def at_bins(shape, field, node, dimension):
    """What a nodal field (..., *nodes) is at one `node` of every bin, (..., 1, *bins)."""
    cut = field
    for a, k in enumerate(node):
        axis = field.ndim - dimension + a
        cut = jax.lax.slice_in_dim(cut, k, cut.shape[axis] - (shape.count - 1 - k), axis=axis)
    return jnp.expand_dims(cut, field.ndim - dimension)


def to_points(shape, w, field, dimension):
    """Σ N_i f_i of a nodal field (..., *nodes), at points (..., slots, *bins)."""
    return sum(
        value_at(w, node) * at_bins(shape, field, node, dimension)
        for node in stencil(shape, dimension)
    )


def gradient(shape, w, field, dimension):
    """∂f_a/∂x_b (a, b, slots, *bins) of a nodal vector field (a, *nodes)."""
    rows = []
    for b in range(dimension):
        rows.append(
            sum(
                slope_at(w, node, b) * at_bins(shape, field, node, dimension)
                for node in stencil(shape, dimension)
            )
        )
    return jnp.stack(rows, 1)


# ------------------------------------------------------------------ the edges of the grid


def _edges(shape, window, nodes, cells):
    """(axis, place of the ghost, first and second node inside) for each side, in the window."""
    if shape.lead == 0:
        return
    for axis, count in enumerate(nodes):
        first = window[axis] - shape.lead  # number of the node at place 0
        yield axis, -1 - first, 1, count
        yield axis, cells[axis] + 1 - first, -1, count


def _line(axis, place, rank):
    return (slice(None),) * (rank + axis) + (place,)


def fold(shape, field, window, cells):
    """Nodal sums (..., *nodes) with those of the ghosts handed on to the nodes inside.

    Args:
        window: number of the first bin (d,).
        cells: of the whole grid along each axis, static.
    """
    dimension = len(cells)
    rank = field.ndim - dimension
    for axis, ghost, inwards, count in _edges(shape, window, field.shape[rank:], cells):
        there = (ghost >= 0) & (ghost < count)
        at = lambda k: _line(axis, jnp.where(there, ghost + k * inwards, count), rank)  # noqa: B023, E731
        carried = field.at[at(0)].get(mode="fill", fill_value=0)
        field = field.at[at(1)].add(2 * carried, mode="drop")
        field = field.at[at(2)].add(-carried, mode="drop")
        field = field.at[at(0)].set(0, mode="drop")
    return field


def unfold(shape, field, window, cells):
    """Nodal values (..., *nodes) with the ghosts as the linear continuation of those inside."""
    dimension = len(cells)
    rank = field.ndim - dimension
    for axis, ghost, inwards, count in _edges(shape, window, field.shape[rank:], cells):
        there = (ghost >= 0) & (ghost < count)
        at = lambda k: _line(axis, jnp.where(there, ghost + k * inwards, count), rank)  # noqa: B023, E731
        get = lambda k: field.at[at(k)].get(mode="fill", fill_value=0)  # noqa: B023, E731
        field = field.at[at(0)].set(2 * get(1) - get(2), mode="drop")
    return field
