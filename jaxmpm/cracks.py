"""Bands in points that move: one band for the matter of a cell, whose points merge when it cracks.

A band at each of a cell's points would dissipate G_F several times over a crack. So where the mean
stress of a cell reaches onset its uncracked points become one point in their centre of mass that
has their mean deformation, and the band. What they lose by it in energy is booked as released.

The frame of a band turns with the faces of the crack: a line of material along the crack is not
stretched by a jump across it, so R takes the direction m along the crack to that of F m, however far
the crack has opened or slid. In that frame the strain is sym(Rᵀ F) − I, which the jump enters
linearly, as the laws have it.
"""

from dataclasses import dataclass, field
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import bands, tensor
from jaxmpm.explicit import PRECISION, averaged, most_critical
from jaxmpm.laws import band as band_law
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.finite import plus_one, rotation, strain_in, turned, turned_stress
from jaxmpm.points import joined, separate
from jaxmpm.transfer import sums


BROKEN = 1e-2  # cohesion of a band, over its strength, below which its point is two


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Cracking:
    """What cracks become."""

    law: Any  # band law, leaves (materials,)
    release: Any  # exponent of the release of crack-parallel stress, (materials,) or None
    thickness: float = field(metadata={"static": True})  # mm
    size: int = field(metadata={"static": True})  # length of a strain vector
    effective_size: str = field(metadata={"static": True})  # rule for H
    normal_window: int = field(metadata={"static": True})  # cells over which the onset stress is averaged
    closes: bool = field(metadata={"static": True})


def embedding(model):
    """The `Embedding` of the model's materials."""
    c = model.cracking
    return band_law.Embedding(Elastic(model.law.E, model.law.nu), c.law, c.release, closes=c.closes)


def gathered(points, values, address):
    """A field, whole or by components, (..., slots, *bins) at the points of bands (..., capacity)."""

    def take(a):
        flat = a.reshape(*a.shape[: a.ndim - points.mass.ndim], -1)
        return flat.at[..., jnp.maximum(address, 0)].get(mode="promise_in_bounds")

    return jax.tree.map(take, values)


def frames(normal, gradient):
    """Rotation R (2, 2, k) of the faces of cracks with reference normals (2, k)."""
    along = jnp.stack([-normal[1], normal[0]])
    now = [sum(row[j] * along[j] for j in range(2)) for row in plus_one(gradient)]
    return turned(along[0] * now[0] + along[1] * now[1], along[0] * now[1] - along[1] * now[0])


class Lanes:
    """The points of all bands of a pool, as the laws need them."""

    def __init__(self, model, points, pool):
        self.size = size = model.cracking.size
        self.address = pool.cell
        self.used = (jnp.arange(pool.cell.shape[0]) < pool.count) & (pool.cell >= 0)
        self.gradient = gathered(points, points.gradient, pool.cell)
        self.material = gathered(points, points.material, pool.cell)
        self.volume = jnp.where(self.used, gathered(points, points.volume, pool.cell), 0.0)
        self.normal = bands.unpacked(pool.records, size)[0].normal
        self.turn = frames(self.normal, self.gradient)
        self.strain = [jnp.where(self.used, e, 0.0) for e in strain_in(self.turn, self.gradient)]
        self.laws = bands.laws_of(embedding(model), self.material, jnp.arange(pool.cell.shape[0]))


def solve(model, points, pool):
    """Answer of every band to the deformation of its point, points by components.

    Returns:
        (points with the stress of the bands, pool, place of a band that did not converge or -1)
    """
    lanes = Lanes(model, points, pool)
    own = pool._replace(cell=jnp.arange(pool.cell.shape[0], dtype=jnp.int32))
    solved, failed = bands.solve(
        own, embedding(model), lanes.material, tuple(lanes.strain), model.cracking.size, PRECISION
    )
    target = jnp.where(lanes.used, pool.cell, points.mass.size)
    put = lambda a, own: a.reshape(-1).at[target].set(own, mode="drop").reshape(a.shape)  # noqa: E731
    stress = turned_stress(lanes.turn, solved.stress, lanes.gradient)
    points = points._replace(stress=tuple(map(put, points.stress, stress)))
    return _still(points, lanes, solved), solved._replace(cell=pool.cell), failed


def _still(points, lanes, pool):
    """Points whose band is broken bring no velocity gradient to the nodes.

    Nothing holds back the free motion of such a point, which in the end would be drawn to nothing or
    turned inside out by it.
    """
    if not jax.tree.leaves(points.affine):
        return points
    softening = bands.unpacked(pool.records, lanes.size)[0].softening
    ratio, integrity = lanes.laws.law.soften(softening, lanes.laws.bulk)
    broken = lanes.used & (ratio * integrity < BROKEN)
    target = jnp.where(broken, lanes.address, points.mass.size)
    put = lambda a: a.reshape(-1).at[target].set(0.0, mode="drop").reshape(a.shape)  # noqa: E731
    return points._replace(affine=jax.tree.map(put, points.affine))


def current(model, points, pool):
    """All bands as they are now, and their `Lanes`."""
    lanes = Lanes(model, points, pool)
    own = pool._replace(cell=jnp.arange(pool.cell.shape[0], dtype=jnp.int32))
    found = bands.current(own, embedding(model), lanes.material, tuple(lanes.strain), model.cracking.size)
    return found, lanes


def energies(model, points, pool):
    """Stored and dissipated energy of all cracked points, N·mm."""
    found, lanes = current(model, points, pool)
    strain = tensor.from_plane(tuple(lanes.strain), model.cracking.size)
    parts = band_law.energies(lanes.laws, found, strain)
    return tuple(jnp.where(lanes.used, lanes.volume * each, 0.0).sum() for each in parts)


# ------------------------------------------------------------------ onset


def cell_sums(n, points, values):
    """Sums of values, a list of (slots, *bins), over the points of each cell of the grid (*cells).

    Where bins surround cells' corners there is one cell more than bins along each axis, the first of
    them half a bin before the first bin.
    """
    if not n.shape.centred:
        return sums(values, 0)
    total = [0.0] * len(values)
    for upper in product((0, 1), repeat=n.dimension):
        half = _in_half(points.place, upper)
        pads = [(u, 1 - u) for u in upper]
        parts = sums([jnp.where(half, value, 0.0) for value in values], 0)
        total = [t + jnp.pad(part, pads) for t, part in zip(total, parts, strict=True)]
    return total


def _in_half(place, upper):
    """Points in the given half of their bin along each axis."""
    inside = True
    for y, u in zip(place, upper, strict=True):
        inside &= (y >= 0.5) if u else (y < 0.5)
    return inside


def _mean(values, weight):
    total = weight.sum(0)
    return (values * weight).sum(1) / jnp.where(total > 0, total, 1.0)


def onset_ratio(model, points):
    """Strength ratio r̂ of the mean stress of the uncracked points of each cell (*cells)."""
    n, size = model.numerics, model.cracking.size
    intact = jnp.where(points.band == 0, points.volume, 0.0)
    laws = embedding(model)
    parts = [intact, *(s * intact for s in points.stress)]
    if len(model.law.E) > 1:
        parts.append(points.material * intact)
    volume, *mean = cell_sums(n, points, parts)
    some = volume > 0
    mean = [value / jnp.where(some, volume, 1.0) for value in mean]
    if len(model.law.E) == 1:
        laws = bands.at(laws, 0)
    else:  # where materials meet that of the nearest number: the points that crack are of one kind
        laws = bands.at(laws, jnp.round(mean.pop()).astype(jnp.int32))
    return jnp.where(some, laws.law.onset(_full(jnp.stack(mean), laws, size), laws.bulk), 0.0)


def mean_stress(n, points):
    """Mean stress of all points of each cell (3, *cells), MPa."""
    volume, *total = cell_sums(n, points, [points.volume, *(s * points.volume for s in points.stress)])
    return jnp.stack([part / jnp.where(volume > 0, volume, 1.0) for part in total])


def _full(stress, laws, size):
    """Stress vector of in-plane components; in plane strain with that along the thickness."""
    if size == 3:
        return stress
    xx, yy, xy = stress
    return jnp.stack([xx, yy, laws.bulk.nu * (xx + yy), xy])


def open_bands(model, points, pool):
    """Give a band to the matter of every cell that has reached onset; points by components."""
    ratio = onset_ratio(model, points)
    number = (ratio >= 1).sum()

    def open_them(carry):
        _, points, pool = carry
        cells, new = most_critical(ratio, number)
        points, pool = opened(model, joined(points), pool, cells, new)
        return jnp.zeros((), bool), separate(points), pool

    # a loop of one turn or none: a condition would copy all points in every step
    return lax.while_loop(lambda carry: carry[0], open_them, (number > 0, points, pool))[1:]


def opened(model, points, pool, cells, new):
    """Points, whole arrays, and pool with bands in those of some `cells` (k,) of the window that are `new`."""
    c, cell = model.cracking, model.numerics.cell
    mean = mean_stress(model.numerics, points)
    group = Group(model.numerics, points, mean.shape[1:], cells, new)
    new = group.some
    one, released = group.merged(model)
    turn = rotation(one["gradient"])
    spatial = tensor.first_principal_direction(averaged(mean, cells, c.normal_window))
    normal = jnp.stack([sum(turn[i, j] * spatial[i] for i in range(2)) for j in range(2)])
    side = jnp.sqrt(one["volume"] / c.thickness)
    size = bands.effective_size(c.effective_size, normal, jnp.where(new, side, cell))
    strain = strain_in(frames(normal, one["gradient"]), one["gradient"])
    laws = bands.laws_of(embedding(model), one["material"], jnp.arange(len(cells)))
    fresh = band_law.open_band(laws, tensor.from_plane(tuple(strain), c.size), normal, size)
    fresh = fresh._replace(released=released)
    pool, place = bands.add(pool, bands.unsolved(fresh, c.size), group.lead, new, one["stress"])
    one["band"] = place.astype(points.band.dtype) + 1
    return group.replaced(one), pool


class Group:
    """The uncracked points of one kind in each of some cells, which become one point."""

    def __init__(self, n, points, shape, cells, new):
        self.points, self.bins, d = points, points.mass.shape[1:], n.dimension
        self.slots = points.mass.shape[0]
        where = jnp.unravel_index(cells, shape)
        halves = list(product((0, 1), repeat=d)) if n.shape.centred else [(None,) * d]
        address, inside, shift = [], [], []
        for upper in halves:
            one = self._candidates(where, upper)
            for group, part in zip((address, inside, shift), one, strict=True):
                group.append(part)
        self.address = jnp.concatenate(address)  # flat, of every candidate (m, k)
        self.shift = jnp.concatenate(shift, 1)  # from place in its bin to place in the cell (d, m, k)
        inside = jnp.concatenate(inside) & new
        intact = inside & (self.take("mass") > 0) & (self.take("band") == 0)
        self.first = jnp.argmax(intact, axis=0)
        for name in ("material", "body"):
            intact &= self.take(name) == self.of_first(self.take(name))
        self.members = intact
        self.some = intact.any(0)
        self.lead = self.of_first(self.address)

    def _candidates(self, where, upper):
        """Flat indices of all slots of a bin, which of them are in the cell, and their shift."""
        fits, bin_of = True, []
        for axis, u in enumerate(upper):
            index = where[axis] - (u or 0)
            fits &= (index >= 0) & (index < self.bins[axis])
            bin_of.append(jnp.clip(index, 0, self.bins[axis] - 1))
        flat = jnp.ravel_multi_index(tuple(bin_of), self.bins, mode="clip")
        address = jnp.arange(self.slots)[:, None] * int(np.prod(self.bins)) + flat
        inside = jnp.broadcast_to(fits, address.shape)
        shift = jnp.zeros((len(upper), *address.shape), self.points.place.dtype)
        if upper[0] is not None:
            inside &= _in_half(self._at("place", address), upper)
            moved = jnp.array([-0.5 if u else 0.5 for u in upper], shift.dtype)
            shift = shift + moved[:, None, None]
        return address, inside, shift

    def _at(self, name, address):
        values = getattr(self.points, name)
        rank = values.ndim - self.points.mass.ndim
        return values.reshape(*values.shape[:rank], -1)[..., address]

    def take(self, name):
        """A field of every candidate (..., m, k)."""
        return self._at(name, self.address)

    def of_first(self, values):
        """What the first member has, (k,)."""
        return jnp.take_along_axis(values, self.first[None], axis=0)[0]

    def merged(self, model):
        """The one point of each group by field, and the energy it has less, per volume, N/mm²."""
        take, g = self.take, self.members
        mass, volume = jnp.where(g, take("mass"), 0.0), jnp.where(g, take("volume"), 0.0)
        mean = lambda values, weight: _mean(jnp.where(g, values, 0.0), weight)  # noqa: E731
        one = {"mass": mass.sum(0), "volume": volume.sum(0)}
        one["velocity"] = mean(take("velocity"), mass)
        # in the bin of the first one, though it may lie outside: it is put where it belongs at once
        first = jnp.stack([self.of_first(s) for s in self.shift])
        one["place"] = mean(take("place") + self.shift, mass) - first
        gradient = take("gradient")
        one["gradient"] = jnp.stack([mean(row, volume) for row in gradient])
        if self.points.affine.size:
            one["affine"] = jnp.stack([mean(row, mass) for row in take("affine")])
        for name in ("home", "stress"):
            one[name] = mean(take(name), volume)
        one["share"] = jnp.where(g, take("share"), 0.0).sum(-2)
        for name in ("material", "body"):
            one[name] = self.of_first(take(name))
        law = jax.tree.map(lambda leaf: leaf[one["material"]] if jnp.ndim(leaf) else leaf, model.law)
        stored = (volume * law.energy(gradient)).sum(0) - one["volume"] * law.energy(one["gradient"])
        moving = (mass * (take("velocity") ** 2).sum(0)).sum(0) - one["mass"] * (one["velocity"] ** 2).sum(0)
        return one, (stored + moving / 2) / jnp.where(self.some, one["volume"], 1.0)

    def replaced(self, one):
        """The points with the merged ones in place of their groups."""
        total = self.points.mass.size
        gone = jnp.where(self.members, self.address, total).reshape(-1)
        here = jnp.where(self.some, self.lead, total)
        changed = {}
        for name, value in one.items():
            old = getattr(self.points, name)
            if old.size == 0:
                continue
            flat = old.reshape(-1, total)
            if name in ("mass", "volume", "band"):
                flat = flat.at[:, gone].set(0, mode="drop")
            flat = flat.at[:, here].set(value.reshape(-1, len(self.lead)), mode="drop")
            changed[name] = flat.reshape(old.shape)
        return self.points._replace(**changed)
