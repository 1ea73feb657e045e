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


class Leap(NamedTuple):
    """Where equilibrium was lost on the way and found again; zeros where it was followed."""

    share: jax.Array  # of the way from rest to the strain asked for, see `on_the_way`
    held: jax.Array  # jump [u] before (dimension,), mm
    before: jax.Array  # softening before
    jump: jax.Array  # and after, at the same strain
    after: jax.Array


class Solution(NamedTuple):
    """What balances the tractions at a macroscopic strain."""

    unknowns: jax.Array  # jump and softening (dimension + 1,)
    status: jax.Array  # RESTS, LOADS, JUMPS or FAILS
    free: jax.Array  # energy that the leap sets free per volume of the cell, N/mm²
    leap: Leap


def followed(unknowns, status):
    """The `Solution` of a point whose equilibrium was followed all the way."""
    none, no_jump = jnp.zeros_like(unknowns[-1]), jnp.zeros_like(unknowns[:-1])
    return Solution(unknowns, status, none, Leap(none, no_jump, none, no_jump, none))


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


def way_from_rest(embedding, band, strain):
    """The way from a strain at rest to the one asked for, (size,); see `on_the_way`.

    The strain of the last step is not known, but one at which its jump and softening are in
    balance is: the strain asked for less an opening. In a bulk that remembers, it is no strain.
    """
    if embedding.bulk is not embedding.bulk.elastic:
        return strain

    def pull(jump):
        outside = bands.bulk_strain(embedding, band, strain, jump)
        return tensor.traction(bands.bulk_stress(embedding, band, outside)[0], band.normal), None

    stiffness, *_ = jacobian(pull, band.jump)
    reached = bands.answer(embedding, band, strain, band.jump, band.softening)
    less = -tensor.solve(stiffness, reached.out_of_balance)
    return tensor.symmetric_product(band.normal, less, len(strain)) / band.size


def on_the_way(strain, way, share):
    """Strain at a share of the `way` to the strain asked for, (size,)."""
    return strain - (1 - share) * way


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
    """Out-of-balance traction (MPa) that is as good as zero: a share of f_t, or round-off.

    The round-off is that of all terms of the strain in the bulk and in the band.
    """
    eps = jnp.finfo(strain.dtype).eps
    law, dims = embedding.law, band.size.ndim
    size = lambda vector: sum(jnp.abs(component) for component in vector)  # noqa: E731
    fraction = law.h / band.size
    strains = size(strain) + fraction * size(band.onset_strain) + size(jump) / band.size
    for leaf in (band.flowed, *jax.tree.leaves(band.bulk)):
        if leaf is not None and leaf.ndim > dims and len(leaf) == len(strain):
            strains += size(leaf)
    _, integrity = law.soften(band.softening, embedding.bulk.elastic)
    share = 1.0 if embedding.closes else integrity  # closed faces press with all there is
    inside = share * (size(band.onset_strain) + size(jump) / law.h)
    direct, *_ = embedding.bulk.elastic.coefficients(len(strain))
    stress = direct * (strains / (1 - fraction) + inside)
    if embedding.drag is not None:
        stress += embedding.drag * size(jump - band.jump)
    return precision * law.ft + 16 * eps * stress


def gap_tolerance(precision, softening):
    """Gap that is as good as zero."""
    eps = jnp.finfo(softening.dtype).eps
    return jnp.maximum(precision, 64 * eps) * jnp.ones_like(softening)
