"""From points to nodes and back, as shifted slices of whole arrays.

Points' vectors are lists of components, each (slots, *bins); nodal fields are lists of components
too, each (*nodes): a window of bins with `count − 1` nodes more along each axis, the first of them
node `window − lead`.

What costs time is memory, not arithmetic, so it matters what the compiler makes one loop of.
`together` makes one loop of several results that read the same arrays, `apart` keeps what comes
before it from being computed again in every loop that reads it.
"""

from itertools import product
from operator import add
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

from jaxmpm.tensor import Matrix


class Weights(NamedTuple):
    """Shape functions of every point along each axis: lists of arrays (slots, *bins)."""

    value: list  # [axis][node]
    slope: list  # [axis][node], 1/mm


def weights(shape, place, cell, *own):
    """`Weights` of points at a place, (slots, *bins) along each axis; `own` is what a shape asks for of each."""
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


# ------------------------------------------------------------------ what becomes one loop


def sums(operands, axis):
    """Sums of arrays of one shape over an axis, in one loop over all of them, a list."""
    zeros = [jnp.zeros((), a.dtype) for a in operands]
    return list(lax.reduce(operands, zeros, lambda a, b: tuple(map(add, a, b)), (axis,)))


def together(arrays):
    """The same arrays of one shape, computed in one loop.

    A loop with several results is made of a sum with several operands only: here over an axis
    of two, the second of them zero, which costs nothing once the loop over it is unrolled.
    """
    first = lax.broadcasted_iota(jnp.int32, (2, *arrays[0].shape), 0) == 0
    return sums([jnp.where(first, a, jnp.zeros((), a.dtype)) for a in arrays], 0)


def apart(arrays):
    """The same arrays of one shape, written to memory as one before they are read."""
    whole = jnp.zeros((len(arrays), *arrays[0].shape), arrays[0].dtype)
    for k, array in enumerate(arrays):
        whole = lax.dynamic_update_index_in_dim(whole, array, k, 0)
    return whole


# ------------------------------------------------------------------ points to nodes, nodes to points


def to_nodes(shape, contribution, dimension):
    """Sums over points of `contribution(node)`, a list of (slots, *bins): (k, *nodes)."""
    nodes = stencil(shape, dimension)
    parts = [list(contribution(node)) for node in nodes]
    count = len(parts[0])
    total = {}
    for some, low, high in _loops(len(nodes), count, parts[0][0].shape[0]):
        got = sums([parts[node][k][low:high] for node, k in some], 0)
        total |= {key: total[key] + own if key in total else own for key, own in zip(some, got, strict=True)}
    pads = [[(k, shape.count - 1 - k) for k in node] for node in nodes]
    return apart([sum(jnp.pad(total[i, k], pad) for i, pad in enumerate(pads)) for k in range(count)])


def _loops(nodes, components, slots):
    """What each loop over points sums: (node, component) pairs, and its first and last slot.

    A loop over slots is fast where the compiler unrolls it, and that has limits (measured: two
    to four times slower beyond them).
    """
    results, most = (12, 6) if nodes <= 4 else (nodes, 3)
    pairs = [(node, k) for k in range(components) for node in range(nodes)]
    pieces = -(-slots // most)
    for begin in range(0, len(pairs), results):
        for piece in range(pieces):
            low, high = (slots * p // pieces for p in (piece, piece + 1))
            yield pairs[begin : begin + results], low, high


def at_bins(shape, field, node):
    """What a nodal field (*nodes) is at one `node` of every bin, (1, *bins)."""
    ends = [k + n - (shape.count - 1) for k, n in zip(node, field.shape, strict=True)]
    return lax.slice(field, node, ends)[None]


def _contract(shape, factors, field, node=()):
    """Σ over nodes of the product of their factors along each axis, times a field (*nodes)."""
    if len(node) == len(factors):
        return at_bins(shape, field, node)
    own = factors[len(node)]
    return sum(own[k] * _contract(shape, factors, field, (*node, k)) for k in range(shape.count))


def to_points(shape, w, field):
    """Σ N_i f_i of nodal components, each (*nodes): a list of (slots, *bins)."""
    return [_contract(shape, w.value, component) for component in field]


def gradient(shape, w, field):
    """∂f_a/∂x_b, `Matrix` [a][b] of (slots, *bins), of nodal components, each (*nodes)."""
    axes = range(len(w.value))
    mixed = [[(w.slope if a == b else w.value)[a] for a in axes] for b in axes]
    return Matrix([_contract(shape, factors, component) for factors in mixed] for component in field)


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
