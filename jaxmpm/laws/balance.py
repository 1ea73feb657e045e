"""The local solver: jump and softening that balance the tractions of band and bulk.

Unknowns are the jump [u] and, where the band loads, its softening p:

    r([u], p; ε) = 0,      gap([u], p) = ln(what drives softening) − ln(what resists it) = 0

Along the jumps that balance r the gap is a function of p alone. It is positive at the last p
where the band loads, and negative in the end, since a band without cohesion opens no further:
so there is always a solution, and the first one beyond the last p is the state that the point
comes to. A slope of the gap that is not negative means that equilibrium cannot be followed
(beyond H_max, or where a band with an oblique normal sheds its shear): the state jumps to the
next solution, and the energy that comes free is accounted for.

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
from jaxmpm.laws.law import jacobian

RESTS, LOADS, JUMPS, FAILS = 0, 1, 2, 3  # what may come of a point: its status
NEWTON = 4  # steps of Newton before a point goes to the search
LEAP = 1.0  # change of softening in one step that Newton is not trusted with
SEARCH = 400  # steps of the search before a point counts as failed
INNER = 40  # steps of Newton on the jump at one softening
LANES = 64  # points that are searched together


class Solution(NamedTuple):
    """What balances the tractions at a macroscopic strain."""

    unknowns: jax.Array  # jump and softening (dimension + 1,)
    fall: jax.Array  # where equilibrium jumped: fall of the energies over the jump, N/mm²
    status: jax.Array  # RESTS, LOADS, JUMPS or FAILS


class Response(NamedTuple):
    """What a band answers to a strain."""

    band: Band  # new state
    stress: jax.Array  # macroscopic stress (size,), MPa; NaN where the status is FAILS
    status: jax.Array  # RESTS, LOADS, JUMPS or FAILS


def respond(embedding, band, strain, precision=1e-11):
    """Answer of a band, or of many along a trailing axis of every array, to a strain.

    Args:
        embedding: the laws; parameters are scalars, or one for each band.
        band: state at the end of the last step.
        strain: macroscopic strain (size,), or (size, many).
        precision: out-of-balance traction that is accepted, as a share of f_t.

    Returns:
        Response; differentiable in embedding, band and strain, forward and in reverse.
    """
    return _settled(embedding, band, strain, solve(embedding, band, strain, precision))


def stress_at(strain, embedding, band, precision=1e-11):
    """Macroscopic stress (size,) at a strain: the function whose `jacfwd` is the tangent."""
    found, *_ = solve(embedding, band, strain, precision)
    return bands.answer(embedding, band, strain, found[:-1], found[-1]).stress


def respond_with_tangent(embedding, band, strain, precision=1e-11):
    """`respond`, and the consistent tangent dσ/dε (size, size) of the same step, MPa.

    One linearisation of both laws by strain, jump and softening gives all columns: what
    `jax.jacfwd(stress_at)` says, at a fraction of its cost.
    """
    found = solve(embedding, band, strain, precision)
    size = len(strain)

    def residual(x):
        reached = bands.answer(embedding, band, x[:size], x[size:-1], x[-1])
        return jnp.concatenate([reached.out_of_balance, reached.gap[None], reached.stress]), None

    matrix, *_ = jacobian(residual, jnp.concatenate([strain, found.unknowns]))
    count = len(found.unknowns)
    laws, stress = matrix[:count], matrix[count:]
    parts = _parts(laws[:, size:])
    columns = []
    for k in range(size):
        change = _by_unknowns(parts, laws[:-1, k], laws[-1, k], found.status, 0.0)
        by = stress[:, k]
        for j in range(count):
            by = by + stress[:, size + j] * change[j]
        columns.append(by)
    failed = found.status == FAILS
    tangent = jnp.where(failed, jnp.nan, jnp.stack(columns, axis=1))
    return _settled(embedding, band, strain, found), tangent


def _settled(embedding, band, strain, found):
    """The `Response` at a `Solution`, with its energies."""
    jump, softening = found.unknowns[:-1], found.unknowns[-1]
    reached = bands.answer(embedding, band, strain, jump, softening)
    moved = band._replace(jump=jump, softening=softening, bulk=reached.bulk)
    spent = _spent(embedding, band, moved)
    released = _softened_bulk(embedding, band, moved, strain, reached.bulk_stress)
    free = found.fall - lax.stop_gradient(spent / band.size + released)
    released += jnp.where(found.status == JUMPS, jnp.maximum(free, 0.0), 0.0)
    moved = moved._replace(spent=band.spent + spent, released=band.released + released)
    failed = found.status == FAILS
    return Response(moved, jnp.where(failed, jnp.nan, reached.stress), found.status)


def _spent(embedding, band, moved):
    """Energy given up in a step besides what the softening curve says, N/mm of crack area.

    Damage lets go of compression too, in proportion to the tension; and a viscous band resists.
    """
    given = _given_up(embedding, band.softening, moved.softening)
    spent = _compressed(embedding, moved) * given
    if embedding.drag is not None:
        move = moved.jump - band.jump
        spent += embedding.drag * tensor.dot(move, move)
    return spent


def _given_up(embedding, before, after):
    """∫ of the tension's energy over the integrity that is lost, N/mm, by Gauss's rule."""
    law, elastic = embedding.law, embedding.bulk.elastic
    total = 0.0 * before
    for node, weight in zip(*_GAUSS, strict=True):
        at = before + (1 + node) / 2 * (after - before)
        soften = lambda p: law.soften(p, elastic)  # noqa: E731
        (ratio, _), (_, fall) = jax.jvp(soften, (at,), (jnp.ones_like(at),))
        total -= weight / 2 * ratio * ratio * fall
    return law.h * law.ft**2 / (2 * elastic.E) * total * (after - before)


_GAUSS = [rule.tolist() for rule in np.polynomial.legendre.leggauss(4)]


def _compressed(embedding, band):
    """Energy that goes with the integrity of a band over that of tension alone, less one.

    Of a band that loads; one at rest may have no tension at all.
    """
    law, elastic = embedding.law, embedding.bulk.elastic
    here = bands.inside(band, band.jump)
    one = jnp.ones_like(band.softening)
    scaled = law.stored(here, one, embedding.closes, elastic)
    scaled -= law.stored(here, 0 * one, embedding.closes, elastic)
    _, drive = law.effective(here, elastic)
    tension = law.h * (law.ft * drive) ** 2 / (2 * elastic.E)
    pulled = tension > 0
    excess = jnp.where(pulled, scaled / jnp.where(pulled, tension, 1.0) - 1, 0.0)
    slack = 64 * jnp.finfo(excess.dtype).eps  # nothing but round-off
    return jnp.where(excess > slack, excess, 0.0)


def _softened_bulk(embedding, band, moved, strain, stress):
    """Energy given up by the release of crack-parallel stress at fixed strain, N/mm²."""
    if embedding.release is None:
        return 0.0
    outside = bands.bulk_strain(embedding, band, strain, moved.jump)
    fraction = embedding.law.h / band.size
    after, _ = bands.bulk_stress(embedding, moved, outside)
    return (1 - fraction) * tensor.dot(stress - after, outside) / 2


def _fall(embedding, band, strain, held, jump, softening):
    """Fall of stored and dissipated energy, N/mm², as a band softens at fixed strain.

    `held` balances the last softening, `jump` the new one.
    """
    before, after = (held, band.softening), (jump, softening)
    both = jax.tree.map(lambda *pair: jnp.stack(pair), before, after)

    def total(state):
        jump, softening = state
        return sum(bands.energies(embedding, band._replace(jump=jump, softening=softening), strain))

    totals = jax.vmap(total)(both)
    return totals[0] - totals[1]


# ------------------------------------------------------------------ the unknowns


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def solve(embedding, band, strain, precision):
    """The `Solution` at a macroscopic strain (size,), or of many at (size, many).

    The few of many that need the search are searched by themselves, so that one of them does
    not make the others wait. The derivative is that of the implicit function, whatever the
    iteration did.
    """
    found, settled = _newton(embedding, band, strain, precision)
    if settled.ndim == 0:
        return _search(embedding, band, strain, precision, found, settled)
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
        answer = _search(laws, state, ask, precision, start, done)
        target = jnp.where(done, count, place)
        put = lambda old, new: old.at[..., target].set(new, mode="drop")  # noqa: E731
        return jax.tree.map(put, found, answer)

    return lax.fori_loop(0, (number + lanes - 1) // lanes, block, found)


@solve.defjvp
def _solve_jvp(precision, primals, tangents):
    embedding, band, strain = primals
    found = solve(*primals, precision)
    jump, softening = found.unknowns[:-1], found.unknowns[-1]

    def balance(embedding, band, strain):
        reached = bands.answer(embedding, band, strain, jump, softening)
        return reached.out_of_balance, reached.gap

    _, (by_balance, by_gap) = jax.jvp(balance, primals, tangents)
    matrix, _ = _linearised(*primals, found.unknowns)
    last = tangents[1].softening
    by_unknowns = _by_unknowns(_parts(matrix), by_balance, by_gap, found.status, last)
    no_status = np.zeros(found.status.shape, jax.dtypes.float0)
    return found, Solution(by_unknowns, jnp.zeros_like(found.fall), no_status)


class _Parts(NamedTuple):
    """How the residuals change with the unknowns."""

    stiffness: jax.Array  # ∂r/∂[u] (d, d)
    by_softening: jax.Array  # (∂r/∂[u])⁻¹ ∂r/∂p (d,): −d[u]/dp at balance
    gap_by_jump: jax.Array  # (d,)
    own: jax.Array  # ∂gap/∂p
    slope: jax.Array  # dgap/dp along the jumps that balance


def _linearised(embedding, band, strain, unknowns):
    """Derivatives (d + 1, d + 1) of the residuals by the unknowns, and the residuals (d + 1,)."""

    def residual(unknowns):
        reached = bands.answer(embedding, band, strain, unknowns[:-1], unknowns[-1])
        return jnp.concatenate([reached.out_of_balance, reached.gap[None]]), None

    matrix, value, _ = jacobian(residual, unknowns)
    return matrix, value


def _parts(matrix):
    """The `_Parts` of a matrix (d + 1, d + 1)."""
    stiffness, by_jump, own = matrix[:-1, :-1], matrix[-1, :-1], matrix[-1, -1]
    by_softening = tensor.solve(stiffness, matrix[:-1, -1])
    return _Parts(stiffness, by_softening, by_jump, own, own - tensor.dot(by_jump, by_softening))


def _by_unknowns(parts, by_balance, by_gap, status, last):
    """Change of the unknowns that keeps the residuals at zero as all else changes.

    `by_balance` and `by_gap` are their changes at fixed unknowns, `last` that of the softening
    before, which stays where the band rests.
    """
    first = tensor.solve(parts.stiffness, by_balance)
    loads = (status == LOADS) | (status == JUMPS)
    change = -(by_gap - tensor.dot(parts.gap_by_jump, first)) / jnp.where(loads, parts.slope, 1.0)
    change = jnp.where(loads, change, last)
    return jnp.concatenate([-first - parts.by_softening * change, change[None]])


def _largest(vector):
    largest = jnp.abs(vector[0])
    for component in vector[1:]:
        largest = jnp.maximum(largest, jnp.abs(component))
    return largest


def tolerance(embedding, band, strain, jump, precision):
    """Out-of-balance traction (MPa) that is as good as zero: a share of f_t, or round-off."""
    eps = jnp.finfo(strain.dtype).eps
    law = embedding.law
    size = sum(jnp.abs(component) for component in strain) / (1 - law.h / band.size)
    if embedding.closes:  # faces that are pressed together know their jump to round-off only
        size += sum(jnp.abs(component) for component in jump) / law.h
    direct, *_ = embedding.bulk.elastic.coefficients(len(strain))
    return precision * law.ft + 16 * eps * direct * size


def _gap_tolerance(precision, softening):
    """Gap that is as good as zero."""
    eps = jnp.finfo(softening.dtype).eps
    return jnp.maximum(precision, 64 * eps) * jnp.ones_like(softening)


# ------------------------------------------------------------------ fast: Newton on both


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

    last, close = band.softening, _gap_tolerance(precision, band.softening)
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
    even = _largest(reached.out_of_balance) <= limit
    settled = even & (jnp.abs(reached.gap) <= close) & stable
    settled &= (softening >= last) & (softening - last <= LEAP)
    status = jnp.where(rests, RESTS, LOADS).astype(jnp.int32)
    unknowns = jnp.concatenate([jump, softening[None]])
    return Solution(unknowns, jnp.zeros_like(last), status), settled | (rests & even)


# ------------------------------------------------------------------ sure: a bracket on p


class _Walk(NamedTuple):
    """Where the search stands."""

    jump: jax.Array
    softening: jax.Array
    held: jax.Array  # the jump that balances the last softening
    low: jax.Array  # largest p at which the band is known to load further
    high: jax.Array  # smallest p at which it is known not to, or infinite
    pace: jax.Array
    jumps: jax.Array  # equilibrium could not be followed somewhere on the way
    rests: jax.Array
    settled: jax.Array
    inner: jax.Array  # steps at this softening so far
    count: jax.Array


def _search(embedding, band, strain, precision, found, settled):
    """Walk along the softening curve to the first p where the band loads no further.

    At each p the jump is balanced first. A step in p that what drives softening would pay for
    at once never passes the first solution; it is taken over and over, twice as long each
    time, until the solution is bracketed, and then the bracket is closed by Newton and
    bisection. Points already `settled` stay.
    """
    close = _gap_tolerance(precision, band.softening)
    eps = jnp.finfo(strain.dtype).eps

    def iterate(w):
        unknowns = jnp.concatenate([w.jump, w.softening[None]])
        matrix, value = _linearised(embedding, band, strain, unknowns)
        parts, rest, gap = _parts(matrix), value[:-1], value[-1]
        limit = tolerance(embedding, band, strain, w.jump, precision)
        even = _largest(rest) <= limit
        first = w.softening == band.softening
        loads, rests = even & (gap > 0), even & first & (gap <= close)
        low = jnp.where(loads, w.softening, w.low)
        high = jnp.where(even & ~loads, w.softening, w.high)
        bracketed = jnp.isfinite(high)
        pinched = bracketed & (high - low <= 4 * eps * (1 + high))
        settled = even & (rests | (jnp.abs(gap) <= close) | pinched)
        stable = parts.slope < 0
        newton = w.softening - gap / jnp.where(stable, parts.slope, -1.0)
        safe = w.pace * gap / jnp.where(parts.own < 0, -parts.own, 1.0)
        ahead = w.softening + jnp.where(stable, jnp.minimum(newton - w.softening, safe), safe)
        middle = low + (jnp.where(bracketed, high, low) - low) / 2
        good = stable & (newton > low) & (newton < high) & (w.count % 3 != 2)
        there = jnp.where(bracketed, jnp.where(good, newton, middle), ahead)
        softening = jnp.where(even & ~settled, there, w.softening)
        shorter = jnp.where(w.inner < INNER // 2, 1.0, 0.5).astype(strain.dtype)
        to_balance = shorter * tensor.solve(parts.stiffness, rest)
        move = to_balance + parts.by_softening * (softening - w.softening)
        new = _Walk(
            jump=jnp.where(settled, w.jump, w.jump - move),
            softening=softening,
            held=jnp.where(even & first, w.jump, w.held),
            low=low,
            high=high,
            pace=jnp.where(even, 2 * w.pace, w.pace),
            jumps=w.jumps | (loads & ~stable & ~settled),
            rests=rests,
            settled=settled,
            inner=jnp.where(even, 0, w.inner + 1),
            count=w.count,
        )
        kept = jax.tree.map(lambda old, fresh: jnp.where(w.settled, old, fresh), w, new)
        return kept._replace(count=w.count + 1)

    last, one, no = band.softening, jnp.ones_like(band.softening), jnp.zeros_like(settled)
    start = _Walk(
        band.jump, last, band.jump, last, jnp.inf * one, one, no, no, settled, 0 * no, jnp.zeros((), int)
    )
    go = lambda w: ((~w.settled) & (w.inner < INNER)).any() & (w.count < SEARCH)  # noqa: E731
    walk = lax.while_loop(go, iterate, start)
    unknowns = jnp.concatenate([walk.jump, walk.softening[None]])
    status = jnp.where(walk.rests, RESTS, jnp.where(walk.jumps, JUMPS, LOADS))
    status = jnp.where(walk.settled, status, FAILS).astype(jnp.int32)
    fall = _fall(embedding, band, strain, walk.held, walk.jump, walk.softening)
    searched = Solution(unknowns, fall, status)
    return jax.tree.map(lambda old, new: jnp.where(settled, old, new), found, searched)
