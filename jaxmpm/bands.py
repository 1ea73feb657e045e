"""The pool of bands: a cell gets one when it cracks, and only then costs anything.

The pool is a set of arrays with room for `capacity` bands, the first `count` in use; whole
blocks of them are answered together, and only as many blocks as are in use. A band at rest
answers by its secant, a few multiplications; only those that load are solved. When the pool is
full no cell is allowed to crack unseen: the state says so before anything is lost, the driver
grows the pool and goes on.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import tensor
from jaxmpm.laws import balance
from jaxmpm.laws import band as band_law
from jaxmpm.laws.band import Band, Secant

BLOCK = 512  # bands that are answered together; the room for bands is a multiple of it
LOADING = 128  # bands that load are solved together


class Pool(NamedTuple):
    """Room for bands; the first `count` are in use."""

    records: jax.Array  # one row a band, see `packed`, (capacity, k)
    cell: jax.Array  # flat index of the cell of each band, (capacity,)
    count: jax.Array  # how many are in use
    stress: jax.Array  # in-plane stress of the cell of each, MPa, (3, capacity)


def _blank(size):
    """A harmless unstrained band in an elastic bulk and its in-plane secant, one row of each."""
    zeros = np.zeros
    band = Band(
        np.array([1.0, 0.0]), np.array([1e6]), zeros(size), zeros(2), zeros(1), (), zeros(1), zeros(1)
    )
    return band, Secant(zeros((2, 4)), zeros((3, 4)), zeros(1))


def packed(band, secant):
    """Rows (bands, k) of all numbers of bands and their secants, for one read and write each."""
    leaves = jax.tree.leaves((band, secant))
    return jnp.concatenate([leaf.reshape(-1, leaf.shape[-1]) for leaf in leaves]).T


def unpacked(records, size):
    """Bands and secants, bands last, from rows (bands, k)."""
    leaves, tree = jax.tree.flatten(_blank(size))
    pieces = jnp.split(records.T, np.cumsum([leaf.size for leaf in leaves])[:-1])
    shapes = [leaf.shape if leaf.size > 1 else () for leaf in leaves]
    parts = [piece.reshape(*shape, -1) for piece, shape in zip(pieces, shapes, strict=True)]
    return jax.tree.unflatten(tree, parts)


def unsolved(band, size):
    """Rows of bands that have no secant yet: any strain counts as loading, and gives them one."""
    count = band.size.shape[0]
    fill = lambda leaf: jnp.full((*leaf.shape, count), -1.0, band.size.dtype)  # noqa: E731
    return packed(band, jax.tree.map(fill, _blank(size)[1]))


def bands_of(pool, size):
    """Every band of a pool as a `Band` whose arrays have the bands last."""
    return unpacked(pool.records, size)[0]


def empty_pool(capacity, size, dtype):
    """A pool without bands; spare places hold harmless unstrained bands."""
    capacity = -(-capacity // BLOCK) * BLOCK
    row = packed(*jax.tree.map(lambda leaf: leaf[..., None], _blank(size))).astype(dtype)
    zero = jnp.zeros((), jnp.int32)
    return Pool(
        records=jnp.broadcast_to(row, (capacity, row.shape[1])),
        cell=jnp.zeros((capacity,), jnp.int32),
        count=zero,
        stress=jnp.zeros((3, capacity), dtype),
    )


def joined(pool, spare):
    """The bands of `pool` in order, with the empty pool `spare` behind them as further room."""
    return Pool(
        jnp.concatenate([pool.records, spare.records]),
        jnp.concatenate([pool.cell, spare.cell]),
        pool.count,
        jnp.concatenate([pool.stress, spare.stress], axis=1),
    )


def at(tree, index):
    """Leaves of a pytree of arrays taken at `index` along their last axis."""
    return jax.tree.map(lambda leaf: leaf[..., index], tree)


def laws_of(embedding, material, cells):
    """Laws of some cells; where there is one material only, one for all."""
    if all(leaf.shape[-1] == 1 for leaf in jax.tree.leaves(embedding)):
        return at(embedding, 0)
    return at(embedding, material[cells])


def solve(pool, embedding, material, mean, size, precision):
    """Solve every band in use at the mean strain of its cell.

    Args:
        pool: the bands.
        embedding: laws of each material, leaves (materials,).
        material: material of each cell, flat (cells,).
        mean: in-plane strain of the cells xx, yy, xy, each flat (cells,).
        size: length of a strain vector.
        precision: out-of-balance traction that is accepted, as a share of the strength.

    Returns:
        (pool, place of a band that did not converge or -1)
    """
    stress, loading, number = _rest(pool, embedding, material, mean, size)
    pool = pool._replace(stress=stress)
    return _load(pool, embedding, material, mean, size, precision, loading, number)[:2]


def _blocks(number, block):
    return (number + block - 1) // block


def _strain(mean, cells, used):
    """In-plane strain (3, k) of cells; zero where not used."""
    return jnp.stack([jnp.where(used, component[cells], 0.0) for component in mean])


def _rest(pool, embedding, material, mean, size):
    """Stress of every band as if it did not load, and the places of those that do."""
    capacity = pool.cell.shape[0]
    lanes = jnp.arange(BLOCK, dtype=jnp.int32)

    def block(k, carry):
        stress, loading, number = carry
        start = k * BLOCK
        used = start + lanes < pool.count
        cells = lax.dynamic_slice_in_dim(pool.cell, start, BLOCK)
        rows = lax.dynamic_slice_in_dim(pool.records, start, BLOCK)
        band, secant = unpacked(rows, size)
        laws = laws_of(embedding, material, cells)
        strain = _strain(mean, cells, used)
        _, answer, loads = band_law.at_rest(secant, laws, band, strain)
        stress = lax.dynamic_update_slice_in_dim(stress, answer, start, 1)
        loads &= used
        listed = lax.sort(jnp.where(loads, start + lanes, capacity))  # the loading ones first
        loading = lax.dynamic_update_slice_in_dim(loading, listed, number, 0)
        return stress, loading, number + loads.sum(dtype=number.dtype)

    # a block behind the last one may write past what is listed
    loading = jnp.zeros((capacity + BLOCK,), jnp.int32)
    none = jnp.zeros((), jnp.int32)
    carry = (pool.stress, loading, none)
    return lax.fori_loop(0, _blocks(pool.count, BLOCK), block, carry)


def _load(pool, embedding, material, mean, size, precision, loading, number, kept=None):
    """Solve the bands listed in `loading` with all there is.

    Returns:
        (pool, place of a band that did not converge or -1, `kept` with the solutions found by place)
    """
    capacity = pool.cell.shape[0]

    def block(k, carry):
        records, stress, failed, kept = carry
        start = k * LOADING
        used = start + jnp.arange(LOADING) < number
        place = jnp.where(used, lax.dynamic_slice_in_dim(loading, start, LOADING), 0)
        cells = pool.cell[place]
        laws = laws_of(embedding, material, cells)
        band = unpacked(records[place], size)[0]
        strain = tensor.from_plane(_strain(mean, cells, used), size)
        found = balance.solve(laws, band, strain, precision)
        rows, in_plane, status = answered(laws, band, strain, found, size)
        bad = used & (status == balance.FAILS)
        failed = jnp.where(bad.any(), place[jnp.argmax(bad)].astype(failed.dtype), failed)
        target = jnp.where(used, place, capacity)
        records = records.at[target].set(rows, mode="drop")
        stress = stress.at[:, target].set(in_plane, mode="drop")
        if kept is not None:
            kept = jax.tree.map(lambda all, own: all.at[..., target].set(own, mode="drop"), kept, found)
        return records, stress, failed, kept

    carry = (pool.records, pool.stress, jnp.full((), -1, jnp.int32), kept)
    records, stress, failed, kept = lax.fori_loop(0, _blocks(number, LOADING), block, carry)
    return pool._replace(records=records, stress=stress), failed, kept


def answered(laws, band, strain, found, size):
    """Rows, in-plane stress and status of bands that have been solved."""
    answer = balance.settled(laws, band, strain, found)
    rows = packed(answer.band, in_plane_secant(laws, answer.band, size))
    return rows, tensor.to_plane(answer.stress), answer.status


def in_plane_secant(laws, band, size):
    """`Secant` of bands by the in-plane strain of their cells, stress in-plane too."""
    basis = np.eye(size)[[0, 1, size - 1]]
    secant = band_law.secant(laws, band, basis)
    return secant._replace(stress=secant.stress[np.array([0, 1, size - 1])])


def current(pool, embedding, material, mean, size):
    """All bands (`Band`, bands last) as they are at the mean strain of their cells.

    A band that rests keeps the jump it was last solved with; here it has that of its secant. One
    that loads or has closed was solved at this strain.
    """
    band, secant = unpacked(pool.records, size)
    used = jnp.arange(pool.cell.shape[0]) < pool.count
    laws = laws_of(embedding, material, pool.cell)
    strain = _strain(mean, pool.cell, used)
    jump, _, loads = band_law.at_rest(secant, laws, band, strain)
    resting = used & (secant.ratio > 0) & ~loads
    return band._replace(jump=jnp.where(resting, jump, band.jump))


def add(pool, fresh, cells, new, stress):
    """Put those of the `fresh` records (j, k) that are `new` behind the others, if there is room.

    Their cells bear the in-plane `stress` (3, j) until they are solved.

    Returns the pool and the place of each, the capacity for those that are not new.
    """
    capacity = pool.cell.shape[0]
    place = jnp.where(new, pool.count + jnp.cumsum(new, dtype=pool.count.dtype) - 1, capacity)
    records = pool.records.at[place].set(fresh, mode="drop")
    cell = pool.cell.at[place].set(cells.astype(pool.cell.dtype), mode="drop")
    count = pool.count + new.sum(dtype=pool.count.dtype)
    borne = pool.stress.at[:, place].set(stress, mode="drop")
    return Pool(records, cell, count, borne), place


def effective_size(rule, normal, cell):
    """Effective size H = Ω/A of a square cell (mm) cut by a band with normal (2, ...) (Eq. 1, Fig. 2).

    "projected": A is the mean length of the cuts through the cell by lines with this normal,
    H = c (|n_x| + |n_y|); "centreline": A is the length of the cut through the centre,
    H = c max(|n_x|, |n_y|); "sqrt_area": H = c.
    """
    x, y = jnp.abs(normal[0]), jnp.abs(normal[1])
    factor = {"projected": x + y, "centreline": jnp.maximum(x, y), "sqrt_area": jnp.ones_like(x)}
    return cell * factor[rule]
