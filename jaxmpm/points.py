"""Material points in the order of the grid: every array is (..., slots, *bins).

A point lives in a bin of the grid and knows its place in it only, y in [0, 1) along each axis:
so its neighbours are shifted slices, nothing is scattered over points, and single precision is
as good far from the origin as near it. A slot without a point has no mass and no volume, and adds
nothing.

Bins cover a window of the grid, the part that holds points; `window` says where it begins. A
point that leaves its bin is put into a free slot of the next one (`rebinning`), the few that do by
themselves. Where there is no free slot, or the next bin is outside the window, the point stays
as it is and `Room` says so: the driver makes room before the next step. None is ever lost.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm.tensor import Matrix

class Points(NamedTuple):
    """Points of a body or several; d is the dimension, bins the shape of the window."""

    place: jax.Array  # y in the bin (d, slots, *bins), dimensionless
    velocity: jax.Array  # (d, slots, *bins), mm/s
    gradient: jax.Array  # of the displacement, H = F − I (d, d, slots, *bins)
    stress: jax.Array  # Kirchhoff stress τ = J σ (size, slots, *bins), MPa
    mass: jax.Array  # 0 where a slot is free (slots, *bins), tonne
    volume: jax.Array  # of the undeformed point (slots, *bins), mm³
    material: jax.Array  # index (slots, *bins)
    home: jax.Array  # position of the undeformed point, from the corner of the grid (d, slots, *bins), mm
    affine: jax.Array  # velocity gradient that some transfers keep (d, d, slots, *bins), 1/s; d = 0 without
    band: jax.Array  # place of its band in the pool plus 1, 0 without one (slots, *bins)
    body: jax.Array  # which velocity field it moves in (slots, *bins)
    share: jax.Array  # of forces and gauges, see `hand_over` (k, slots, *bins)
    window: jax.Array  # number of the first bin along each axis (d,)


class Room(NamedTuple):
    """What there was no room for."""

    slots: jax.Array  # a bin is full
    window: jax.Array  # a point wants to leave the window
    wild: jax.Array  # a point has moved by more than a cell in one step, which no stable one does


INTEGERS = ("material", "band", "body")
PER_POINT = (
    "place", "velocity", "gradient", "stress", "mass", "volume", "material", "home", "affine",
    "band", "body", "share",
)  # fmt: skip


def slots_of(points):
    """How many slots a bin has."""
    return points.mass.shape[0]


def bins_of(points):
    """Shape of the window."""
    return points.mass.shape[1:]


def in_bins(position, fields, origin, cell, centred, slots=None, bins=None, window=None):
    """Points from plain lists, in NumPy; window, slots and bins as small as they can be if None.

    Args:
        position: (d, count), mm.
        fields: the other fields of `Points` by name, (..., count); `affine`, `band`, `body` and
            `share` may be left out.
        origin: of the grid (d,), mm.
        cell: side of a cell, mm.
        centred: whether bins surround nodes, see `shape_functions`.
        slots, bins, window: as in `Points`.
    """
    dtype = fields["mass"].dtype
    dimension, count = position.shape
    none = {name: np.zeros(count, int) for name in INTEGERS}
    none |= {"share": np.zeros((0, count)), "affine": np.zeros((0, 0, count))}
    fields = none | fields
    y = (position - np.reshape(origin, (-1, 1))) / cell + (0.5 if centred else 0.0)
    bin_of = np.floor(y).astype(int)
    y = y - bin_of
    window = bin_of.min(1) if window is None else np.asarray(window)
    local = bin_of - window[:, None]
    bins = tuple(local.max(1) + 1) if bins is None else tuple(bins)
    flat = np.ravel_multi_index(tuple(local), bins)  # raises where a point is outside
    order = np.argsort(flat, kind="stable")
    first = np.searchsorted(flat[order], flat[order])
    slot = np.empty(count, int)
    slot[order] = np.arange(count) - first
    slots = max(slots or 0, slot.max() + 1)

    def put(values, kind):
        values = np.asarray(values)
        out = np.zeros((*values.shape[:-1], slots, int(np.prod(bins))), kind)
        out[..., slot, flat] = values
        return jnp.asarray(out.reshape(*values.shape[:-1], slots, *bins))

    kind = lambda name: np.int32 if name in INTEGERS else dtype  # noqa: E731
    rest = {name: put(fields[name], kind(name)) for name in PER_POINT[1:]}
    return Points(place=put(y, dtype), window=jnp.asarray(window, jnp.int32), **rest)


def positions(points, origin, cell, centred):
    """Positions (d, slots, *bins), mm, in double precision."""
    bins = bins_of(points)
    axes = [np.arange(n) + float(w) for n, w in zip(bins, np.asarray(points.window), strict=True)]
    first = np.stack(np.meshgrid(*axes, indexing="ij"))[:, None]
    y = np.asarray(points.place, float) + first - (0.5 if centred else 0.0)
    return y * cell + np.reshape(origin, (-1, *[1] * (1 + len(bins))))


def listed(points, origin, cell, centred):
    """Plain lists again, in NumPy: positions (d, count), mm, and the other fields by name."""
    used = np.asarray(points.mass) > 0
    take = lambda a: np.asarray(a)[..., used]  # noqa: E731
    fields = {name: take(getattr(points, name)) for name in PER_POINT[1:]}
    return take(positions(points, origin, cell, centred)), fields


# ------------------------------------------------------------------ points by components


VECTORS = ("place", "velocity", "stress", "home", "share")
MATRICES = ("gradient", "affine")


def separate(points):
    """Points whose vectors are tuples of components and whose matrices are `Matrix`, as a step has them.

    A loop that needs one component then does not pass over the others, and a point that changes
    bins is written into each array where it lies.
    """
    parts = {name: tuple(getattr(points, name)) for name in VECTORS}
    parts |= {name: Matrix(getattr(points, name)) for name in MATRICES}
    return points._replace(**parts)


def joined(parts):
    """`Points` of whole arrays again."""
    none = jnp.zeros((0, *parts.mass.shape), parts.mass.dtype)
    whole = {name: jnp.stack(getattr(parts, name)) if getattr(parts, name) else none for name in VECTORS}
    for name in MATRICES:
        rows = getattr(parts, name)
        whole[name] = jnp.stack([jnp.stack(row) for row in rows]) if rows else none[None][:0]
    return parts._replace(**whole)
