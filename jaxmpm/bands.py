"""The pool of bands: a cell gets one when it cracks, and only then costs anything.

The pool is a set of arrays with room for `capacity` bands, the first `count` in use. Bands are
solved in blocks, and only as many blocks as are in use, so spare room costs nothing. When it
is full no cell is allowed to crack unseen: the state says so before anything is lost, the
driver grows the pool and goes on.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import tensor
from jaxmpm.laws import band as band_law
from jaxmpm.laws.band import Band

BLOCK = 256  # bands that are answered together; the room for bands is a multiple of it
LOADING = 256  # bands that load are solved together


class Pool(NamedTuple):
    """Room for bands, the last axis of every array; the first `count` are in use."""

    bands: Band  # every leaf (..., capacity)
    cell: jax.Array  # flat index of the cell of each band, (capacity,)
    count: jax.Array  # how many are in use
    stress: jax.Array  # in-plane stress of the cell of each, MPa, (3, capacity)


def over_bands(function):
    """Map a function of one point over many, which lie along the last axis of every array."""
    return jax.vmap(function, in_axes=-1, out_axes=-1)


def empty_pool(law, capacity, size, dtype):
    """A pool without bands; spare places hold a harmless unstrained band.

    `law` is one band law (scalar leaves), to know the shape of its history.
    """
    capacity = -(-capacity // BLOCK) * BLOCK
    history = jax.tree.map(
        lambda leaf: jnp.broadcast_to(jnp.asarray(leaf, dtype), (capacity,)), law.initial()
    )
    bands = Band(
        normal=jnp.zeros((2, capacity), dtype).at[0].set(1.0),
        size=jnp.full((capacity,), 1.0e6, dtype),
        onset_strain=jnp.zeros((size, capacity), dtype),
        strain=jnp.zeros((size, capacity), dtype),
        jump=jnp.zeros((2, capacity), dtype),
        history=history,
        released=jnp.zeros((capacity,), dtype),
    )
    cell, count = jnp.zeros((capacity,), jnp.int32), jnp.zeros((), jnp.int32)
    return Pool(bands, cell, count, jnp.zeros((3, capacity), dtype))


def joined(pool, spare):
    """The bands of `pool` in order, with the empty pool `spare` behind them as further room."""
    join = lambda a, b: jnp.concatenate([a, b], axis=-1)  # noqa: E731
    return Pool(
        jax.tree.map(join, pool.bands, spare.bands),
        join(pool.cell, spare.cell),
        pool.count,
        join(pool.stress, spare.stress),
    )


def at(tree, index):
    """Leaves of a pytree of arrays taken at `index` along their last axis."""
    return jax.tree.map(lambda leaf: leaf[..., index], tree)


def solve(pool, embedding, material, mean, precision):
    """Solve every band in use at the mean strain of its cell.

    Most bands rest at any moment: they are answered by one linear solve, and only those that
    load are taken through Newton. Whole blocks are read and written as slices, and the list of
    the loading ones is gathered, because scattering is slow on CPUs.

    Args:
        pool: the bands.
        embedding: laws of each material, leaves (materials,).
        material: material of each cell, flat (cells,).
        mean: in-plane strain of the cells xx, yy, xy, each flat (cells,).
        precision: out-of-balance traction that is accepted, as a share of the strength.

    Returns:
        (pool, place of a band that did not converge or -1)
    """
    pool, loading, number = _rest(pool, embedding, material, mean, precision)
    return _load(pool, embedding, material, mean, precision, loading, number)


def _blocks(number, block):
    return (number + block - 1) // block


def _strain(pool, mean, cells, used):
    """Strain vectors (size, k) of cells; zero where not used."""
    size = pool.bands.onset_strain.shape[0]
    picked = [jnp.where(used, component[cells], 0.0) for component in mean]
    return tensor.from_plane(picked, size)


def _rest(pool, embedding, material, mean, precision):
    """Answer every band as if it did not load, and list those that do."""
    capacity = pool.cell.shape[0]
    lanes = jnp.arange(BLOCK, dtype=jnp.int32)

    def block(k, carry):
        jumps, strains, stress, loading, number = carry
        start = k * BLOCK
        cut = lambda leaf: lax.dynamic_slice_in_dim(leaf, start, BLOCK, -1)  # noqa: E731
        paste = lambda leaf, new: lax.dynamic_update_slice_in_dim(leaf, new, start, -1)  # noqa: E731
        used = start + lanes < pool.count
        cells, mine = cut(pool.cell), jax.tree.map(cut, pool.bands)
        strain = _strain(pool, mean, cells, used)
        answer = over_bands(partial(band_law.rest, precision=precision))(
            at(embedding, material[cells]), mine, strain
        )
        rests = used & ~answer.loads
        jumps = paste(jumps, jnp.where(rests, answer.jump, mine.jump))
        strains = paste(strains, jnp.where(rests, strain, mine.strain))
        stress = paste(stress, tensor.to_plane(answer.stress))
        loads = used & answer.loads
        listed = lax.sort(jnp.where(loads, start + lanes, capacity))  # the loading ones first
        loading = lax.dynamic_update_slice_in_dim(loading, listed, number, 0)
        return jumps, strains, stress, loading, number + loads.sum(dtype=number.dtype)

    # a block behind the last one may write past what is listed
    loading = jnp.zeros((capacity + BLOCK,), jnp.int32)
    none = jnp.zeros((), jnp.int32)
    carry = (pool.bands.jump, pool.bands.strain, pool.stress, loading, none)
    jumps, strains, stress, loading, number = lax.fori_loop(0, _blocks(pool.count, BLOCK), block, carry)
    bands = pool.bands._replace(jump=jumps, strain=strains)
    return pool._replace(bands=bands, stress=stress), loading, number


def _load(pool, embedding, material, mean, precision, loading, number):
    """Solve the bands listed in `loading` with all there is."""
    capacity = pool.cell.shape[0]

    def block(k, carry):
        bands, stress, failed = carry
        start = k * LOADING
        used = start + jnp.arange(LOADING) < number
        place = jnp.where(used, lax.dynamic_slice_in_dim(loading, start, LOADING), 0)
        cells = pool.cell[place]
        answer = over_bands(partial(band_law.respond, precision=precision))(
            at(embedding, material[cells]), at(bands, place), _strain(pool, mean, cells, used)
        )
        bad = used & ~(answer.residual <= answer.tolerance)
        failed = jnp.where(bad.any(), place[jnp.argmax(bad)].astype(failed.dtype), failed)
        target = jnp.where(used, place, capacity)
        put = lambda leaf, new: leaf.at[..., target].set(new, mode="drop")  # noqa: E731
        stress = put(stress, tensor.to_plane(answer.stress))
        return jax.tree.map(put, bands, answer.band), stress, failed

    carry = (pool.bands, pool.stress, jnp.full((), -1, jnp.int32))
    bands, stress, failed = lax.fori_loop(0, _blocks(number, LOADING), block, carry)
    return pool._replace(bands=bands, stress=stress), failed


def add(pool, fresh, cells, new):
    """Put those of the `fresh` bands (k) that are `new` behind the others; there must be room.

    Returns the pool and the place of each, the capacity for those that are not new.
    """
    capacity = pool.cell.shape[0]
    place = jnp.where(new, pool.count + jnp.cumsum(new, dtype=pool.count.dtype) - 1, capacity)
    put = lambda leaf, value: leaf.at[..., place].set(value, mode="drop")  # noqa: E731
    count = pool.count + new.sum(dtype=pool.count.dtype)
    cell = put(pool.cell, cells.astype(pool.cell.dtype))
    return pool._replace(bands=jax.tree.map(put, pool.bands, fresh), cell=cell, count=count), place


def effective_size(rule, normal, cell):
    """Effective size H = Ω/A of a square cell (mm) cut by a band with normal (2, ...) (Eq. 1, Fig. 2).

    "projected": A is the mean length of the cuts through the cell by lines with this normal,
    H = c (|n_x| + |n_y|); "centreline": A is the length of the cut through the centre,
    H = c max(|n_x|, |n_y|); "sqrt_area": H = c.
    """
    x, y = jnp.abs(normal[0]), jnp.abs(normal[1])
    factor = {"projected": x + y, "centreline": jnp.maximum(x, y), "sqrt_area": jnp.ones_like(x)}
    return cell * factor[rule]
