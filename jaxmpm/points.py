"""Material points in the order of the grid: every array is (..., slots, *bins).

A point lives in a bin of the grid and knows its place in it only, y in [0, 1) along each axis:
so its neighbours are shifted slices, nothing is scattered over points, and single precision is
as good far from the origin as near it. A slot without a point has no mass and no volume, and adds
nothing.

Bins cover a window of the grid, the part that holds points; `window` says where it begins. A
point that leaves its bin is put into a free slot of the next one (`rebin`), the few that do by
themselves. Where there is no free slot, or the next bin is outside the window, the point stays
as it is and `Room` says so: the driver makes room before the next step. None is ever lost.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

MOVERS = 256  # points that change bins together


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


# ------------------------------------------------------------------ changing bins


def rebin(points, address=None):
    """Put points whose place has left their bin into the bin where they are.

    Args:
        points: with places that may be outside [0, 1).
        address: flat index over (slots, *bins) of the point of each band, kept up to date.

    Returns:
        (points, address, the `Room` there was not)
    """
    address = jnp.zeros((0,), jnp.int32) if address is None else address
    outside = ~((points.place >= 0) & (points.place < 1)).all(0) & (points.mass > 0)
    full = jnp.zeros((), bool)
    rest = Room(full, full, full)
    stay = lambda points, address, _: (points, address, rest)  # noqa: E731
    return lax.cond(outside.any(), _move_all, stay, points, address, outside)


def _move_all(points, address, outside):
    """Move those outside in batches; each batch sees where the ones before it have gone."""
    waiting = outside.reshape(-1)

    def go(carry):
        return carry[2].any()

    def batch(carry):
        points, address, waiting, room = carry
        count = waiting.shape[0]
        index = jnp.nonzero(waiting, size=min(MOVERS, count), fill_value=count)[0]
        points, address, more = _move(points, address, index)
        room = Room(*(a | b for a, b in zip(room, more, strict=True)))
        return points, address, waiting.at[index].set(False, mode="drop"), room

    no = jnp.zeros((), bool)
    points, address, _, room = lax.while_loop(go, batch, (points, address, waiting, Room(no, no, no)))
    return points, address, room


def _move(points, address, index):
    """Move the points with flat indices `index` over (slots, *bins), the number of all for none."""
    bins, slots = bins_of(points), slots_of(points)
    total = int(np.prod(bins))
    meant = index < slots * total
    flat = {name: _flat(getattr(points, name), bins) for name in PER_POINT}
    taken = {name: a[:, jnp.minimum(index, slots * total - 1)] for name, a in flat.items()}
    step = jnp.floor(taken["place"]).astype(jnp.int32)
    here = jnp.unravel_index(jnp.minimum(index, slots * total - 1) % total, bins)
    there = [h + s for h, s in zip(here, step, strict=True)]
    inside = jnp.ones_like(meant)
    for t, n in zip(there, bins, strict=True):
        inside &= (t >= 0) & (t < n)
    target = jnp.ravel_multi_index(there, bins, mode="clip")
    # those that go to the same bin take its free slots one after the other
    free = points.mass.reshape(slots, total)[:, target] == 0
    wants = meant & inside
    same = (target[:, None] == target[None, :]) & wants[None, :]
    rank = jnp.tril(same, -1).sum(1)
    nth = jnp.cumsum(free, 0) - 1
    chosen = free & (nth == rank[None, :])
    fits = wants & chosen.any(0)
    end = slots * total
    to = jnp.where(fits, chosen.argmax(0) * total + target, end)
    moved = taken | {"place": _in_bin(taken["place"], step)}
    new = {}
    for name, a in flat.items():
        if name in ("mass", "volume", "band"):
            a = a.at[:, jnp.where(fits, index, end)].set(0, mode="drop")
        new[name] = a.at[:, to].set(moved[name], mode="drop").reshape(getattr(points, name).shape)
    band = jnp.where(fits & (taken["band"][0] > 0), taken["band"][0] - 1, address.shape[0])
    address = address.at[band].set(to.astype(address.dtype), mode="drop")
    far = (jnp.abs(step) > 1).any(0) | ~jnp.isfinite(taken["place"]).all(0)
    room = Room((wants & ~fits).any(), (meant & ~inside).any(), (meant & far).any())
    return points._replace(**new), address, room


def _in_bin(place, step):
    """Place in the next bin; kept from rounding up to 1."""
    y = place - step.astype(place.dtype)
    return jnp.minimum(y, 1 - jnp.finfo(y.dtype).epsneg)


def _flat(field, bins):
    """(k, slots · bins) of a field (..., slots, *bins)."""
    return field.reshape(-1, field.shape[-1 - len(bins)] * int(np.prod(bins)))
