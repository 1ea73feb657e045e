"""The local solver: jump and softening that balance the tractions of band and bulk.

Unknowns are the jump [u] and, where the band loads, its softening p:

    r([u], p; ε) = 0,      gap([u], p) = ln(what drives softening) − ln(what resists it) = 0

Along the jumps that balance r the gap is a function of p alone. It is positive at the last p
where the band loads, and negative in the end, since a band without cohesion opens no further:
so there is always a solution (in a bulk that is elastic or hardens), and the first one beyond
the last p is the state that the point comes to. A slope of the gap that is not negative means
that equilibrium cannot be followed (beyond H_max, or where a band with an oblique normal sheds
its shear): the state jumps to the next solution, and the energy that comes free is accounted for.

Newton on both unknowns settles nearly every point in a few steps. What it does not settle, or
settles across a jump, goes to a bracketed search on p.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import tensor
from jaxmpm.laws import band as bands
from jaxmpm.laws.band import Band
from jaxmpm.laws.energies import booked, freed
from jaxmpm.laws.equilibrium import (
    FAILS,
    JUMPS,
    LOADS,
    RESTS,
    Solution,
    by_unknowns,
    followed,
    gap_tolerance,
    largest,
    linearised,
    on_the_way,
    parts_of,
    tolerance,
    way_from_rest,
)
from jaxmpm.laws.law import jacobian
from jaxmpm.laws.search import search

__all__ = [
    "FAILS", "JUMPS", "LOADS", "RESTS", "Response", "Solution",
    "respond", "respond_with_tangent", "slopes", "solve", "stress_at", "tolerance",
]  # fmt: skip

NEWTON = 4  # steps of Newton before a point goes to the search
LEAP = 1.0  # change of softening in one step that Newton is not trusted with
LANES = 64  # points that are searched together


class Response(NamedTuple):
    """What a band answers to a strain."""

    band: Band  # new state; of no use where the status is FAILS: keep the old one
    stress: jax.Array  # macroscopic stress (size,), MPa; NaN where the status is FAILS
    status: jax.Array  # RESTS, LOADS, JUMPS or FAILS


def respond(embedding, band, strain, precision=1e-11):
    """Answer of a band, or of many along a trailing axis of every array, to a strain.

    Args:
        embedding: the laws; parameters are scalars, or one for each band.
        band: state at the end of the last step.
        strain: macroscopic strain (size,), or (size, many).
        precision: out-of-balance traction that is accepted, as a share of f_t, or round-off.

    Returns:
        Response; differentiable in embedding, band and strain, forward and in reverse.
    """
    return settled(embedding, band, strain, solve(embedding, band, strain, precision))


def stress_at(strain, embedding, band, precision=1e-11):
    """Macroscopic stress (size,) at a strain: the function whose `jacfwd` is the tangent."""
    found, *_ = solve(embedding, band, strain, precision)
    return bands.answer(embedding, band, strain, found[:-1], found[-1]).stress


def respond_with_tangent(embedding, band, strain, precision=1e-11):
    """`respond`, and the consistent tangent dσ/dε (size, size) of the same step, MPa.

    One linearisation of both laws by strain, jump and softening gives all columns: what
    `jax.jacfwd(stress_at)` says, at a fraction of its cost. With many bands it is
    (size, size, many).
    """
    found = solve(embedding, band, strain, precision)
    return settled(embedding, band, strain, found), slopes(embedding, band, strain, found)[0]


def slopes(embedding, band, strain, found):
    """Consistent tangent dσ/dε (size, size), MPa, and dp/dε (size,) of the softening, at a `Solution`.

    Of a band that rests dp/dε is zero; where the status is FAILS the tangent is not finite.
    """
    size = len(strain)

    def residual(x):
        reached = bands.answer(embedding, band, x[:size], x[size:-1], x[-1])
        return jnp.concatenate([reached.out_of_balance, reached.gap[None], reached.stress]), None

    matrix, *_ = jacobian(residual, jnp.concatenate([strain, found.unknowns]))
    count = len(found.unknowns)
    laws, stress = matrix[:count], matrix[count:]
    parts = parts_of(laws[:, size:])
    columns, softening = [], []
    for k in range(size):
        change = by_unknowns(parts, laws[:-1, k], laws[-1, k], found.status, 0.0)
        by = stress[:, k]
        for j in range(count):
            by = by + stress[:, size + j] * change[j]
        columns.append(by)
        softening.append(change[-1])
    failed = found.status == FAILS
    return jnp.where(failed, jnp.nan, jnp.stack(columns, axis=1)), jnp.stack(softening)


def settled(embedding, band, strain, found):
    """The `Response` at a `Solution`, with its energies."""
    jump, softening = found.unknowns[:-1], found.unknowns[-1]
    reached = bands.answer(embedding, band, strain, jump, softening)
    moved = band._replace(jump=jump, softening=softening, bulk=reached.bulk)
    moved = booked(embedding, band, moved, strain, reached.bulk_stress, found)
    failed = found.status == FAILS
    return Response(moved, jnp.where(failed, jnp.nan, reached.stress), found.status)


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def solve(embedding, band, strain, precision):
    """The `Solution` at a macroscopic strain (size,), or of many at (size, many).

    The few of many that need the search are searched by themselves, so that one of them does
    not make the others wait. The derivative is that of the implicit function, whatever the
    iteration did.
    """
    found, settled = _newton(embedding, band, strain, precision)
    if settled.ndim == 0:
        return search(embedding, band, strain, precision, found, settled)
    count = settled.shape[0]
    lanes = min(LANES, count)
    number = count - settled.sum()
    # places of those to be searched; sorting the others away is left undone where there are none
    first = lambda: jnp.argsort(settled, stable=True).astype(jnp.int32)  # noqa: E731
    order = lax.cond(number > 0, first, lambda: jnp.zeros(count, jnp.int32))
    order = jnp.pad(order, (0, lanes))
    laws = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, settled.shape), embedding)
    everything = laws, band, strain, found, settled

    def block(k, found):
        place = lax.dynamic_slice_in_dim(order, k * lanes, lanes)
        laws, state, ask, start, done = jax.tree.map(lambda leaf: leaf[..., place], everything)
        done |= k * lanes + jnp.arange(lanes) >= number
        answer = search(laws, state, ask, precision, start, done)
        target = jnp.where(done, count, place)
        put = lambda old, new: old.at[..., target].set(new, mode="drop")  # noqa: E731
        return jax.tree.map(put, found, answer)

    return lax.fori_loop(0, (number + lanes - 1) // lanes, block, found)


@solve.defjvp
def _solve_jvp(precision, primals, tangents):
    found = solve(*primals, precision)
    return found, _change(found, primals, tangents)


@jax.custom_jvp
def known(embedding, band, strain, found):
    """A `Solution` that has been found before, differentiable as `solve` is."""
    return found


@known.defjvp
def _known_jvp(primals, tangents):
    return primals[3], _change(primals[3], primals[:3], tangents[:3])


def _change(found, primals, tangents):
    """Change of a `Solution` with all that it depends on, by the implicit function."""
    jump, softening = found.unknowns[:-1], found.unknowns[-1]

    def balance(embedding, band, strain):
        reached = bands.answer(embedding, band, strain, jump, softening)
        return reached.out_of_balance, reached.gap

    _, (by_balance, by_gap) = jax.jvp(balance, primals, tangents)
    matrix, _ = linearised(*primals, found.unknowns)
    last = tangents[1].softening
    change = by_unknowns(parts_of(matrix), by_balance, by_gap, found.status, last)
    by_free = _freed_jvp(found, primals, tangents)
    no_status = np.zeros(found.status.shape, jax.dtypes.float0)
    return Solution(change, no_status, by_free, jax.tree.map(jnp.zeros_like, found.leap))


def _freed_jvp(found, primals, tangents):
    """Change of the energy set free; without more ado where nothing jumps."""
    change = lambda tangents: jax.jvp(lambda *at: _freed(*at, found), primals, tangents)[1]  # noqa: E731
    none = lambda tangents: jnp.zeros_like(found.free)  # noqa: E731
    return lax.cond((found.status == JUMPS).any(), change, none, tangents)


def _freed(embedding, band, strain, found):
    """Energy set free, as a function of all that may change.

    On either side of the leap tractions are in balance, and the band is about to load: there the
    energies are stationary in jump and softening. What changes is the strain where that is.
    """
    jumps, still = found.status == JUMPS, lax.stop_gradient
    leap = jax.tree.map(lambda leaf: jnp.where(jumps, leaf, 0.0), found.leap)
    lost = band._replace(softening=leap.before)
    way = way_from_rest(embedding, band, strain)
    laws, ends = still((embedding, lost)), still((strain, way))
    unknowns = jnp.concatenate([leap.held, leap.before[None]])
    matrix, _ = linearised(*laws, on_the_way(*ends, leap.share), unknowns)
    adjoint = tensor.solve(jnp.swapaxes(matrix[:-1, :-1], 0, 1), matrix[-1, :-1])

    def gap(embedding, band, at):
        reached = bands.answer(embedding, band, at, leap.held, leap.before)
        return reached.gap - tensor.dot(adjoint, reached.out_of_balance)

    along = lambda share: gap(*laws, on_the_way(*ends, share))  # noqa: E731
    _, growth = jax.jvp(along, (leap.share,), (jnp.ones_like(leap.share),))
    here = gap(embedding, lost, on_the_way(strain, way, leap.share))
    share = leap.share - (here - still(here)) / jnp.where(jumps, still(growth), 1.0)
    free = freed(embedding, lost, on_the_way(strain, way, share), leap)
    return jnp.where(jumps, free, 0.0)


def _newton(embedding, band, strain, precision):
    """Newton on the softening from the last state: a `Solution`, and whether it can be trusted.

    The tractions are taken as linear in the jump, which they mostly are; then the jump that
    balances them follows from the softening, and what is left is one unknown. What was not
    linear shows in the residuals at the end.
    """
    law, elastic = embedding.law, embedding.bulk.elastic
    count = len(band.jump)

    def both(jump):
        pull = bands.pulls(embedding, band, strain, jump)
        return jnp.concatenate([pull.outside, pull.cohesive]), None

    slopes, value, _ = jacobian(both, band.jump)
    outside, cohesive = value[:count], value[count:]

    def gap_at(softening):
        ratio, integrity = law.soften(softening, elastic)
        stiffness = slopes[:count] - integrity * slopes[count:]
        move = tensor.solve(stiffness, outside - integrity * cohesive)
        jump = band.jump - move
        _, drive = law.effective(bands.inside(band, jump), elastic)
        return bands.gap(drive, ratio), jump

    last, close = band.softening, gap_tolerance(precision, band.softening)
    one = jnp.ones_like(last)

    def iterate(k, carry):
        softening, rests, stable = carry
        gap, slope, _ = jax.jvp(gap_at, (softening,), (one,), has_aux=True)
        falls = slope < 0
        softening = softening - gap / jnp.where(falls, slope, -1.0)
        return softening, jnp.where(k == 0, gap <= close, rests), stable & falls

    yes = jnp.ones_like(last, bool)
    softening, rests, stable = lax.fori_loop(0, NEWTON, iterate, (last, yes, yes))
    softening = jnp.where(rests, last, softening)
    _, jump = gap_at(softening)
    reached = bands.answer(embedding, band, strain, jump, softening)
    limit = tolerance(embedding, band, strain, jump, precision)
    even = largest(reached.out_of_balance) <= limit
    settled = even & (jnp.abs(reached.gap) <= close) & stable
    settled &= (softening >= last) & (softening - last <= LEAP)
    status = jnp.where(rests, RESTS, LOADS).astype(jnp.int32)
    found = followed(jnp.concatenate([jump, softening[None]]), status)
    return found, settled | (rests & even)
