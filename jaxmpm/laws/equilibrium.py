"""Equations of a band in its bulk: what is out of balance, how that changes, how small is zero.

The unknowns are the jump [u] and the softening p; the residuals the out-of-balance traction r
and the gap, ln(what drives softening) − ln(what resists it). Where a band rests p stays and the
gap is not zero but negative.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxmpm import tensor
from jaxmpm.laws import band as bands
from jaxmpm.laws.law import jacobian

RESTS, LOADS, JUMPS, FAILS = 0, 1, 2, 3  # what may come of a point: its status


class Solution(NamedTuple):
    """What balances the tractions at a macroscopic strain."""

    unknowns: jax.Array  # jump and softening (dimension + 1,)
    fall: jax.Array  # where equilibrium jumped: fall of the energies over the jump, N/mm²
    status: jax.Array  # RESTS, LOADS, JUMPS or FAILS


class Parts(NamedTuple):
    """How the residuals change with the unknowns."""

    stiffness: jax.Array  # ∂r/∂[u] (d, d)
    by_softening: jax.Array  # (∂r/∂[u])⁻¹ ∂r/∂p (d,): −d[u]/dp at balance
    gap_by_jump: jax.Array  # (d,)
    own: jax.Array  # ∂gap/∂p
    slope: jax.Array  # dgap/dp along the jumps that balance


def linearised(embedding, band, strain, unknowns, closed=None):
    """Derivatives (d + 1, d + 1) of the residuals by the unknowns, and the residuals (d + 1,).

    `closed` as in `band.pulls`.
    """

    def residual(unknowns):
        reached = bands.answer(embedding, band, strain, unknowns[:-1], unknowns[-1], closed)
        return jnp.concatenate([reached.out_of_balance, reached.gap[None]]), None

    matrix, value, _ = jacobian(residual, unknowns)
    return matrix, value


def parts_of(matrix):
    """The `Parts` of a matrix (d + 1, d + 1)."""
    stiffness, by_jump, own = matrix[:-1, :-1], matrix[-1, :-1], matrix[-1, -1]
    by_softening = tensor.solve(stiffness, matrix[:-1, -1])
    return Parts(stiffness, by_softening, by_jump, own, own - tensor.dot(by_jump, by_softening))


def by_unknowns(parts, by_balance, by_gap, status, last):
    """Change of the unknowns that keeps the residuals at zero as all else changes.

    `by_balance` and `by_gap` are their changes at fixed unknowns, `last` that of the softening
    before, which stays where the band rests.
    """
    first = tensor.solve(parts.stiffness, by_balance)
    loads = (status == LOADS) | (status == JUMPS)
    change = -(by_gap - tensor.dot(parts.gap_by_jump, first)) / jnp.where(loads, parts.slope, 1.0)
    change = jnp.where(loads, change, last)
    return jnp.concatenate([-first - parts.by_softening * change, change[None]])


def largest(vector):
    """Largest component by size."""
    found = jnp.abs(vector[0])
    for component in vector[1:]:
        found = jnp.maximum(found, jnp.abs(component))
    return found


def tolerance(embedding, band, strain, jump, precision):
    """Out-of-balance traction (MPa) that is as good as zero: a share of f_t, or round-off."""
    eps = jnp.finfo(strain.dtype).eps
    law = embedding.law
    size = sum(jnp.abs(component) for component in strain) / (1 - law.h / band.size)
    if embedding.closes:  # faces that are pressed together know their jump to round-off only
        size += sum(jnp.abs(component) for component in jump) / law.h
    direct, *_ = embedding.bulk.elastic.coefficients(len(strain))
    return precision * law.ft + 16 * eps * direct * size


def gap_tolerance(precision, softening):
    """Gap that is as good as zero."""
    eps = jnp.finfo(softening.dtype).eps
    return jnp.maximum(precision, 64 * eps) * jnp.ones_like(softening)
