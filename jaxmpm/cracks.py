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
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import bands, tensor
from jaxmpm.explicit import PRECISION, most_critical, normals
from jaxmpm.laws import band as band_law
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.finite import plus_one, rotation, strain_in, turned, turned_stress


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
    """A field (..., slots, *bins) at the points of bands (..., capacity)."""
    rank = values.ndim - points.mass.ndim
    return values.reshape(*values.shape[:rank], -1)[..., jnp.maximum(address, 0)]


def frames(normal, gradient):
    """Rotation R (2, 2, k) of the faces of cracks with reference normals (2, k)."""
    along = jnp.stack([-normal[1], normal[0]])
    now = [sum(row[j] * along[j] for j in range(2)) for row in plus_one(gradient)]
    return turned(along[0] * now[0] + along[1] * now[1], along[0] * now[1] - along[1] * now[0])


class Lanes:
    """The points of all bands of a pool, as the laws need them."""

    def __init__(self, model, points, pool):
        size = model.cracking.size
        self.used = (jnp.arange(pool.cell.shape[0]) < pool.count) & (pool.cell >= 0)
        self.gradient = gathered(points, points.gradient, pool.cell)
        self.material = gathered(points, points.material, pool.cell)
        self.volume = jnp.where(self.used, gathered(points, points.volume, pool.cell), 0.0)
        self.normal = bands.unpacked(pool.records, size)[0].normal
        self.turn = frames(self.normal, self.gradient)
        self.strain = jnp.where(self.used, strain_in(self.turn, self.gradient), 0.0)
        self.laws = bands.laws_of(embedding(model), self.material, jnp.arange(pool.cell.shape[0]))


def solve(model, points, pool):
    """Answer of every band to the deformation of its point.

    Returns:
        (points with the stress of the bands, pool, place of a band that did not converge or -1)
    """
    lanes = Lanes(model, points, pool)
    own = pool._replace(cell=jnp.arange(pool.cell.shape[0], dtype=jnp.int32))
    solved, failed = bands.solve(
        own, embedding(model), lanes.material, tuple(lanes.strain), model.cracking.size, PRECISION
    )
    stress = turned_stress(lanes.turn, solved.stress, lanes.gradient)
    flat = points.stress.reshape(len(points.stress), -1)
    target = jnp.where(lanes.used, pool.cell, flat.shape[1])
    flat = flat.at[:, target].set(stress, mode="drop")
    points = points._replace(stress=flat.reshape(points.stress.shape))
    return points, solved._replace(cell=pool.cell), failed


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


def onset_ratio(model, points):
    """Strength ratio r̂ of the mean stress of the uncracked points of each bin, and of all of them.

    Returns:
        (ratio (*bins), mean stress of all its points (3, *bins), MPa)
    """
    intact = jnp.where(points.band == 0, points.volume, 0.0)
    mean = _mean(points.stress, intact)
    size = model.cracking.size
    # the material of the first uncracked point; those of others wait for their turn
    first = jnp.argmax(intact > 0, axis=0)
    material = jnp.take_along_axis(points.material, first[None], axis=0)[0]
    laws = _laws(embedding(model), material)
    ratio = laws.law.onset(_full(mean, laws, size), laws.bulk)
    ratio = jnp.where(intact.sum(0) > 0, ratio, 0.0)
    return ratio, _mean(points.stress, points.volume)


def _mean(values, weight):
    total = weight.sum(0)
    return (values * weight).sum(1) / jnp.where(total > 0, total, 1.0)


def _laws(laws, material):
    if all(leaf.shape[-1] == 1 for leaf in jax.tree.leaves(laws)):
        return bands.at(laws, 0)
    return bands.at(laws, material)


def _full(stress, laws, size):
    """Stress vector of in-plane components; in plane strain with that along the thickness."""
    if size == 3:
        return stress
    xx, yy, xy = stress
    return jnp.stack([xx, yy, laws.bulk.nu * (xx + yy), xy])


def open_bands(model, points, pool):
    """Give a band to the matter of every bin that has reached onset."""
    ratio, mean = onset_ratio(model, points)
    number = (ratio >= 1).sum()

    def open_them(points, pool):
        cells, new = most_critical(ratio, number)
        return _open(model, points, pool, mean, cells, new)

    return lax.cond(number > 0, open_them, lambda *parts: parts, points, pool)


def _open(model, points, pool, mean, cells, new):
    c, cell = model.cracking, model.numerics.cell
    group = _group(points, cells, new)
    one, released = _merged(model, points, cells, group)
    turn = rotation(one["gradient"])
    spatial = normals(mean, cells, c.normal_window)
    normal = jnp.stack([sum(turn[i, j] * spatial[i] for i in range(2)) for j in range(2)])
    side = jnp.sqrt(one["volume"] / c.thickness)
    size = bands.effective_size(c.effective_size, normal, jnp.where(new, side, cell))
    strain = strain_in(frames(normal, one["gradient"]), one["gradient"])
    laws = _laws(embedding(model), one["material"])
    fresh = band_law.open_band(laws, tensor.from_plane(tuple(strain), c.size), normal, size)
    fresh = fresh._replace(released=released)
    slot = jnp.argmax(group, axis=0)
    address = slot * mean[0].size + cells
    pool, place = bands.add(pool, bands.unsolved(fresh, c.size), address, new, one["stress"])
    one["band"] = place.astype(points.band.dtype) + 1
    return _put(points, one, cells, slot, group, new), pool


def _take(points, name, cells):
    """A field (..., slots, k) of all points of some bins."""
    values = getattr(points, name)
    bins = points.mass.ndim - 1
    return values.reshape(*values.shape[: values.ndim - bins], -1)[..., cells]


def _group(points, cells, new):
    """Which points of each bin become one (slots, k): those uncracked, of the first one's kind."""
    take = lambda name: _take(points, name, cells)  # noqa: E731
    intact = (take("mass") > 0) & (take("band") == 0) & new
    first = jnp.argmax(intact, axis=0)
    same = jnp.ones_like(intact)
    for name in ("material", "body"):
        kind = take(name)
        same &= kind == jnp.take_along_axis(kind, first[None], axis=0)
    return intact & same


def _merged(model, points, cells, group):
    """The one point of each group by field, and the energy it has less, per volume, N/mm²."""
    take = lambda name: _take(points, name, cells)  # noqa: E731
    mass, volume = jnp.where(group, take("mass"), 0.0), jnp.where(group, take("volume"), 0.0)
    mean = lambda values, weight: _mean(jnp.where(group, values, 0.0), weight)  # noqa: E731
    one = {"mass": mass.sum(0), "volume": volume.sum(0)}
    for name in ("velocity", "place"):
        one[name] = mean(take(name), mass)
    for name, weight in (("affine", mass), ("gradient", volume)):
        one[name] = jnp.stack([mean(row, weight) for row in take(name)]) if take(name).size else take(name)[:, :, 0]
    for name in ("home", "stress"):
        one[name] = mean(take(name), volume)
    gradient = take("gradient")
    one["share"] = jnp.where(group, take("share"), 0.0).sum(-2)
    first = jnp.argmax(group, axis=0)
    for name in ("material", "body"):
        one[name] = jnp.take_along_axis(take(name), first[None], axis=0)[0]
    law = _laws(model.law, one["material"])
    stored = (volume * law.energy(gradient)).sum(0) - one["volume"] * law.energy(one["gradient"])
    moving = (mass * (take("velocity") ** 2).sum(0)).sum(0) - one["mass"] * (one["velocity"] ** 2).sum(0)
    size = jnp.where(one["volume"] > 0, one["volume"], 1.0)
    return one, (stored + moving / 2) / size


def _put(points, one, cells, slot, group, new):
    """The points with the merged ones in place of their groups."""
    slots = points.mass.shape[0]
    total = points.mass[0].size
    everywhere = jnp.arange(slots)[:, None] * total + cells
    gone = jnp.where(group, everywhere, slots * total).reshape(-1)
    here = jnp.where(new, slot * total + cells, slots * total)
    changed = {}
    for name, value in one.items():
        old = getattr(points, name)
        if old.size == 0:
            continue
        flat = old.reshape(-1, slots * total)
        if name in ("mass", "volume", "band"):
            flat = flat.at[:, gone].set(0, mode="drop")
        flat = flat.at[:, here].set(value.reshape(-1, len(cells)), mode="drop")
        changed[name] = flat.reshape(old.shape)
    return points._replace(**changed)
