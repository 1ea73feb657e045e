"""Bands on the way back: what an answer depends on, by the implicit function of its balance."""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import bands, tensor
from jaxmpm.bands_static import LANES, fresh
from jaxmpm.grid import CellStrain
from jaxmpm.laws import balance
from jaxmpm.laws import band as band_law
from jaxmpm.laws.equilibrium import followed
from jaxmpm.model import fields


class Lasting(NamedTuple):
    """What a band keeps from its onset on, bands last, or how an answer depends on it."""

    normal: jax.Array
    size: jax.Array
    onset_strain: jax.Array


class Answered(NamedTuple):
    """An answer of some bands, bands first, or how something depends on it."""

    softening: jax.Array  # (k,)
    stress: jax.Array  # in-plane, MPa, (k, 3)
    spent: jax.Array  # energy that softening has taken, N·mm, (k,)


@jax.jit
def pulled_back(model, laws, pool, before, unknowns, status, strain, by: Answered):
    """How something that depends on answers of bands depends on what they followed from.

    Args:
        laws: derivatives by the model's laws (`Embedding`) so far, to which theirs are added.
        pool: the bands, with what they have kept from onset on.
        before: softening p at the equilibrium before (capacity,).
        unknowns: jump, mm, and softening now (capacity, dimension + 1); status (capacity,).
        strain: in-plane, of their cells (capacity, 3).
        by: derivatives by the answers.

    Returns:
        derivatives by the model's laws (`Embedding`), by `Lasting`, and by the softening before (capacity,).
    """
    n = model.numerics
    material = model.material.reshape(-1)
    band = bands.bands_of(pool, n.size)
    lasting = Lasting(band.normal, band.size, band.onset_strain)
    none = laws, *jax.tree.map(jnp.zeros_like, (lasting, before))

    def block(k, found):
        start = k * LANES
        used = start + jnp.arange(LANES) < pool.count
        take = lambda a, axis=-1: lax.dynamic_slice_in_dim(a, start, LANES, axis % a.ndim)  # noqa: E731
        cells = material[take(pool.cell)]
        own, kept = jax.tree.map(take, band), jax.tree.map(take, lasting)
        at = take(unknowns, 0).T, take(status), take(strain, 0).T
        answer = partial(_answer, own, at, cells, n)
        _, back = jax.vjp(answer, model.embedding, kept, take(before))
        push = jax.tree.map(lambda a: jnp.where(used.reshape(-1, *[1] * (a.ndim - 1)), take(a, 0), 0.0), by)
        by_laws, by_kept, by_before = back(push)
        put = lambda all, part: lax.dynamic_update_slice_in_dim(all, part, start, all.ndim - 1)  # noqa: E731
        laws, *rest = found
        return (jax.tree.map(jnp.add, laws, by_laws), *jax.tree.map(put, tuple(rest), (by_kept, by_before)))

    return lax.fori_loop(0, (pool.count + LANES - 1) // LANES, block, none)


def _answer(band, at, cells, n, embedding, lasting, before):
    """`Answered` at a solution that is known."""
    unknowns, status, strain = at
    laws, vector = bands.at(embedding, cells), tensor.from_plane(strain, n.size)
    band = band._replace(**lasting._asdict(), softening=before)
    found = balance.known(laws, band, vector, followed(unknowns, status)).unknowns
    reached = band_law.answer(laws, band, vector, found[:-1], found[-1])
    area = n.cell**2 * n.thickness / band.size
    return Answered(found[-1], tensor.to_plane(reached.stress).T, area * laws.law.given_up(found[-1], laws.bulk.elastic))


@jax.jit
def onset_pulled_back(model, laws, state, mean, cells, by: Lasting):
    """How what depends on bands at their onset depends on the state in which their cells cracked.

    Args:
        laws: derivatives by the model's laws so far, to which theirs are added.
        state: before.
        mean: in-plane strain of all cells, xx, yy, xy, each (nx, ny).
        cells: that cracked (j,).
        by: derivatives by their bands, bands last.

    Returns:
        derivatives by the model's laws, by `mean`, and by the stress of the bands that there were, (3, capacity).
    """

    def begun(embedding, mean, stress):
        changed = replace(model, embedding=embedding)
        before = state._replace(pool=state.pool._replace(stress=stress))
        strain = CellStrain(mean, (0 * mean[0], 0 * mean[0]))
        band, _ = fresh(changed, fields(changed), before, strain, cells)
        return Lasting(band.normal, band.size, band.onset_strain)

    _, back = jax.vjp(begun, model.embedding, tuple(mean), state.pool.stress)
    own, *rest = back(by)
    return jax.tree.map(jnp.add, laws, own), *rest


@jax.jit
def less(total, share, own):
    """total − share · own of trees alike."""
    return jax.tree.map(lambda a, b: a - share * b, total, own)


@jax.jit
def ratio_slopes(model, strain, cell):
    """How the strength ratio r̂ of an intact cell (its flat index) depends on the model's laws and on its in-plane strain (3,)."""

    def ratio(embedding, strain):
        laws = bands.at(embedding, model.material.reshape(-1)[cell])
        return laws.law.onset(laws.bulk.stress(tensor.from_plane(strain, model.numerics.size)), laws.bulk)

    return jax.grad(ratio, (0, 1))(model.embedding, strain)


@jax.jit
def elastic_pulled_back(model, by):
    """Derivatives by the model's laws of what depends on the stiffness of cells.

    `by`: derivatives by C₁₁, C₁₂, C₃₃ and the hourglass stiffness, each (nx, ny).
    """

    def stiffness(embedding):
        found = fields(replace(model, embedding=embedding))
        return found.direct, found.cross, found.shear, found.hourglass

    return jax.vjp(stiffness, model.embedding)[1](by)[0]
