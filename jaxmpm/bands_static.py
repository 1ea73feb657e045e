"""Bands as equilibrium asks for them: all in use at once, with their tangents, from the records of the last equilibrium.

Nothing is remembered until the caller takes over the rows: iterations that lead nowhere leave no trace.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import bands, explicit, tensor
from jaxmpm.condensed import GRIP
from jaxmpm.laws import balance
from jaxmpm.laws import band as band_law
from jaxmpm.model import cell_strain_vectors

LANES = 64  # bands that are solved together
PRECISION = 1e-10  # traction left over in a band, as a share of its strength
TOGETHER = 16  # cells that are opened together, at most


class Answers(NamedTuple):
    """What bands answer to strains; bands first."""

    rows: jax.Array  # records that would be theirs, (capacity, r)
    stress: jax.Array  # in-plane, MPa, (capacity, 3)
    tangent: jax.Array  # of it by the in-plane strain, MPa, (capacity, 3, 3)
    spent: jax.Array  # energy that softening has taken, N·mm, (capacity,)
    spends: jax.Array  # how it grows with the strain, N·mm, (capacity, 3)
    softens: jax.Array  # how the softening p does, (capacity, 3)
    unknowns: jax.Array  # jump, mm, and softening, (capacity, dimension + 1)
    status: jax.Array  # (capacity,)


@jax.jit
def answers(model, pool, strain) -> Answers:
    """Answers of the bands in use to in-plane strains (capacity, 3) of their cells."""
    n, capacity = model.numerics, pool.cell.shape[0]
    material = model.material.reshape(-1)
    table = jnp.zeros((capacity, 3), strain.dtype)
    none = jnp.zeros((capacity,), jnp.int32)
    empty = Answers(pool.records, table, jnp.zeros((capacity, 3, 3), strain.dtype), table[:, 0], table, table, table, none)

    def block(k, found):
        start = k * LANES
        used = start + jnp.arange(LANES) < pool.count
        take = lambda a: lax.dynamic_slice_in_dim(a, start, LANES)  # noqa: E731
        asked = jnp.where(used[:, None], take(strain), 0.0)
        own = _block(model, take(pool.records), material[take(pool.cell)], asked.T, n)
        put = lambda all, part: lax.dynamic_update_slice_in_dim(all, part, start, 0)  # noqa: E731
        return jax.tree.map(put, found, own)

    return lax.fori_loop(0, (pool.count + LANES - 1) // LANES, block, empty)


def _block(model, rows, material, strain, n):
    """`Answers` of some bands."""
    laws = bands.at(model.embedding, material)
    band = bands.unpacked(rows, n.size)[0]
    vector = tensor.from_plane(strain, n.size)
    found = balance.solve(laws, band, vector, PRECISION)
    new, stress, status = bands.answered(laws, band, vector, found, n.size)
    tangent, by_strain = balance.slopes(laws, band, vector, found)
    plane = np.array([0, 1, n.size - 1])
    area = n.cell**2 * n.thickness / band.size
    elastic = laws.bulk.elastic
    given_up = lambda p: laws.law.given_up(p, elastic)  # noqa: E731
    softening = found.unknowns[-1]
    spent, slope = jax.jvp(given_up, (softening,), (jnp.ones_like(softening),))
    last = lambda a: jnp.moveaxis(a, -1, 0)  # noqa: E731
    return Answers(
        rows=new, stress=last(stress), tangent=last(tangent[plane][:, plane]),
        spent=area * spent, spends=last(area * slope * by_strain[plane]),
        softens=last(by_strain[plane]), unknowns=last(found.unknowns), status=status,
    )  # fmt: skip


def strains_of(pool, strain):
    """In-plane strains (capacity, 3) for `answers` from those of the cracked cells (3k,), in the order of the pool."""
    found = np.zeros((pool.cell.shape[0], 3))
    found[: len(strain) // 3] = strain.reshape(-1, 3)
    return found


@jax.jit
def opened(model, prepared, state, strain, cells, new):
    """The state with bands in those of `cells` (TOGETHER,) that are `new`, from the mean strains of all cells."""
    n = model.numerics
    cells = jnp.where(new, cells, cells[0])
    band, own = fresh(model, prepared, state, strain, cells)
    pool, places = bands.add(state.pool, bands.unsolved(band, n.size), cells, new, own)
    index = jnp.where(new, cells, state.intact.size)
    put = lambda field, value: field.reshape(-1).at[index].set(value, mode="drop").reshape(field.shape)  # noqa: E731
    return state._replace(
        intact=put(state.intact, 0.0), grip=put(state.grip, GRIP),
        place=put(state.place, places.astype(state.place.dtype)), pool=pool,
    )  # fmt: skip


def fresh(model, prepared, state, strain, cells):
    """Bands at onset for some cells, and the in-plane stress that these bear (3, j), MPa.

    The strain stored as that of onset is scaled back to where the strength ratio is exactly 1.
    """
    n = model.numerics
    elastic = explicit.intact_stress(prepared, state, strain, n.size)
    borne = explicit.with_bands(elastic, state.place, state.pool.stress).mean
    normal = tensor.first_principal_direction(explicit.averaged(borne, cells, n.normal_window, half=n.half))
    size = explicit.effective_size(n, normal, cells, state.intact.shape[1])
    laws = bands.at(model.embedding, model.material.reshape(-1)[cells])
    vectors = cell_strain_vectors(strain.mean, cells, n.size)
    return band_law.open_band(laws, vectors, normal, size), jnp.stack([component.reshape(-1)[cells] for component in borne])


@jax.jit
def ratios(model, prepared, state, strain):
    """Strength ratio r̂ of the intact cells (nx, ny), zero elsewhere."""
    elastic = explicit.intact_stress(prepared, state, strain, model.numerics.size)
    return explicit.onset_ratio(prepared, elastic, model.numerics.size)


@jax.jit
def held_energy(model, pool, strain):
    """Stored and dissipated energy of every band's cell, N·mm, as recorded, at in-plane strains (capacity, 3); (capacity,)."""
    n = model.numerics
    laws = bands.at(model.embedding, model.material.reshape(-1)[pool.cell])
    band = bands.bands_of(pool, n.size)
    stored, dissipated = band_law.energies(laws, band, tensor.from_plane(strain.T, n.size))
    return n.cell**2 * n.thickness * (stored + dissipated)
