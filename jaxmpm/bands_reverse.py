"""`bands.solve` for differentiation in reverse.

Its loops run as often as there are bands in use, which reverse mode cannot see through. But bands
know nothing of each other: the derivative of the loop is a loop over the same blocks, each
differentiated by itself.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import bands, tensor
from jaxmpm.laws import balance
from jaxmpm.laws import band as band_law
from jaxmpm.laws import equilibrium


def solve(pool, embedding, material, mean, size, precision):
    """As `bands.solve`, in reverse too."""
    whole = (pool.cell, pool.count, material)
    records, stress, failed = _solve(pool.records, pool.stress, embedding, mean, whole, size, precision)
    return pool._replace(records=records, stress=stress), failed


@partial(jax.custom_vjp, nondiff_argnums=(5, 6))
def _solve(records, stress, embedding, mean, whole, size, precision):
    return _forward(records, stress, embedding, mean, whole, size, precision)[0]


class Kept(NamedTuple):
    """What the way back needs."""

    records: jax.Array
    embedding: band_law.Embedding
    mean: tuple
    whole: tuple  # cell and count of the pool, material of the cells
    loading: jax.Array  # places of the bands that loaded
    number: jax.Array
    found: equilibrium.Solution  # of those, by place


def _forward(records, stress, embedding, mean, whole, size, precision):
    cell, count, material = whole
    pool = bands.Pool(records, cell, count, stress)
    answer, loading, number = bands._rest(pool, embedding, material, mean, size)
    pool = pool._replace(stress=answer)
    none = jnp.zeros_like(stress, shape=(len(bands.bands_of(pool, size).normal) + 1, len(records)))
    found = equilibrium.followed(none, jnp.zeros(len(records), jnp.int32))
    pool, failed, found = bands._load(
        pool, embedding, material, mean, size, precision, loading, number, found
    )
    kept = Kept(records, embedding, mean, whole, loading, number, found)
    return (pool.records, pool.stress, failed), kept


def _backward(size, precision, kept, by):
    by_records, by_stress, _ = by
    by_mean = tuple(jnp.zeros_like(component) for component in kept.mean)
    loads = jnp.zeros(kept.records.shape[0], bool)
    loads = loads.at[_listed(kept)].set(True, mode="drop")
    start = by_records, by_stress, by_mean
    by_records, by_rest, by_mean = _rest_back(kept, loads, size, *start)
    by_records, by_embedding, by_mean = _load_back(kept, size, by_records, by_stress, by_mean)
    return by_records, by_rest, by_embedding, by_mean, None


def _listed(kept):
    """Places of the bands that loaded, past the end where there are no more."""
    lanes = jnp.arange(kept.loading.shape[0])
    return jnp.where(lanes < kept.number, kept.loading, kept.records.shape[0])


def _rest_back(kept, loads, size, by_records, by_stress, by_mean):
    """Bands at rest: their stress is affine in the strain, by their secant."""
    cell, count, _ = kept.whole
    lanes = jnp.arange(bands.BLOCK, dtype=jnp.int32)

    def block(k, carry):
        by_records, by_old, by_mean = carry
        start = k * bands.BLOCK
        take = lambda a, axis=0: lax.dynamic_slice_in_dim(a, start, bands.BLOCK, axis)  # noqa: E731
        rests = (start + lanes < count) & ~take(loads)
        cells = take(cell)
        strain = bands._strain(kept.mean, cells, rests)

        def stress_of(rows, strain):
            return band_law.affine(bands.unpacked(rows, size)[1].stress, strain)

        _, back = jax.vjp(stress_of, take(kept.records), strain)
        push = jnp.where(rests, take(by_stress, 1), 0.0)
        by_rows, by_strain = back(push)
        by_rows = take(by_records) + jnp.where(rests[:, None], by_rows, 0.0)
        by_records = lax.dynamic_update_slice_in_dim(by_records, by_rows, start, 0)
        used = (start + lanes < count)[None]
        by_old = lax.dynamic_update_slice_in_dim(by_old, jnp.where(used, 0.0, take(by_old, 1)), start, 1)
        return by_records, by_old, _added(by_mean, by_strain, cells, rests)

    return lax.fori_loop(0, bands._blocks(count, bands.BLOCK), block, (by_records, by_stress, by_mean))


def _load_back(kept, size, by_records, by_stress, by_mean):
    """Bands that load: by the implicit function of their balance."""
    cell, _, material = kept.whole
    capacity = kept.records.shape[0]

    def block(k, carry):
        by_records, by_embedding, by_mean = carry
        start = k * bands.LOADING
        used = start + jnp.arange(bands.LOADING) < kept.number
        listed = lax.dynamic_slice_in_dim(kept.loading, start, bands.LOADING)
        place = jnp.where(used, listed, listed[0])  # lanes to spare do as the first: all are finite
        cells = cell[place]
        strain = jnp.stack([component[cells] for component in kept.mean])
        found = bands.at(kept.found, place)

        def answer_of(rows, embedding, strain):
            laws = bands.laws_of(embedding, material, cells)
            band, whole = bands.unpacked(rows, size)[0], tensor.from_plane(strain, size)
            solved = balance.known(laws, band, whole, found)
            return bands.answered(laws, band, whole, solved, size)[:2]

        _, back = jax.vjp(answer_of, kept.records[place], kept.embedding, strain)
        push = jnp.where(used[:, None], by_records[place], 0.0), jnp.where(used, by_stress[:, place], 0.0)
        by_rows, by_laws, by_strain = back(push)
        target = jnp.where(used, place, capacity)
        by_records = by_records.at[target].set(by_rows, mode="drop")
        by_embedding = jax.tree.map(jnp.add, by_embedding, by_laws)
        return by_records, by_embedding, _added(by_mean, by_strain, cells, used)

    none = jax.tree.map(jnp.zeros_like, kept.embedding)
    return lax.fori_loop(0, bands._blocks(kept.number, bands.LOADING), block, (by_records, none, by_mean))


def _added(by_mean, by_strain, cells, used):
    """Cotangents of the cells' mean strain with those of some bands."""
    target = jnp.where(used, cells, by_mean[0].shape[0])
    parts = zip(by_mean, by_strain, strict=True)
    return tuple(field.at[target].add(jnp.where(used, own, 0.0), mode="drop") for field, own in parts)


_solve.defvjp(_forward, _backward)
