"""A walk along the softening curve at one macroscopic strain, that balances from anywhere.

At a softening that is held the tractions derive from a convex potential (elastic or hardening
bulk, open or closed faces), and Newton's method with a search along its step finds the jump that
balances them. Then the gap tells whether the band loads on. A step in p that what drives
softening would pay for at once never passes the first solution; it is taken over and over, twice
as long each time, until the solution is bracketed, and then the bracket is closed by Newton and
bisection.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import tensor
from jaxmpm.laws import band as bands
from jaxmpm.laws.equilibrium import gap_tolerance, largest, linearised, parts_of, tolerance

STEPS = 400  # of a walk before a point counts as failed
INNER = 60  # steps of Newton on the jump at one softening
NEAR = 0.5  # share of the traction at its begin that a step on the jump may leave along itself
GUESS = 1.0  # change of softening over which the jump is extrapolated


class Step(NamedTuple):
    """A step on the jump at one softening, and the search along it."""

    base: jax.Array  # jump where it began
    whole: jax.Array  # that of Newton's method
    pull: jax.Array  # out-of-balance traction at the base, along the step
    share: jax.Array  # of the whole step that has been taken
    lower: jax.Array  # share that is known to be too little
    upper: jax.Array  # and too much, or infinite


class Walk(NamedTuple):
    """Where the search stands."""

    jump: jax.Array
    softening: jax.Array
    step: Step  # that led to the jump
    closed: jax.Array  # the faces of a closing band are taken as closed
    turned: jax.Array  # they have been taken otherwise at this softening
    held: jax.Array  # the jump that balances the last softening
    low: jax.Array  # largest p at which the band is known to load further
    high: jax.Array  # smallest p at which it is known not to, or infinite
    pace: jax.Array
    gap: jax.Array  # at the softening that was balanced last
    slow: jax.Array  # it has not halved since the one before
    jumps: jax.Array  # equilibrium could not be followed somewhere on the way
    first_gap: jax.Array  # the gap at the last softening
    rests: jax.Array
    settled: jax.Array
    inner: jax.Array  # steps at this softening so far
    count: jax.Array


def walk(embedding, band, strain, precision, settled, holds):
    """The `Walk` from a band at a strain; those that it `holds` only balance their jump."""
    close = gap_tolerance(precision, band.softening)
    least = _least_stiffness(embedding, band, strain)

    def iterate(w):
        unknowns = jnp.concatenate([w.jump, w.softening[None]])
        matrix, value = linearised(embedding, band, strain, unknowns, w.closed)
        parts, rest, gap = parts_of(matrix - least), value[:-1], value[-1]
        even = largest(rest) <= tolerance(embedding, band, strain, w.jump, precision)
        # of both potentials, that of open and of closed faces, one holds the solution
        turns = even & (w.closed != _closed(embedding, band, w.jump)) & ~w.turned
        even &= ~turns
        w, loads, settled = _judged(w, even, gap, close, band.softening)
        settled |= even & holds
        softening = jnp.where(even & ~settled, _next(w, parts, gap), w.softening)
        step = _along(w.step, w.jump, rest, -tensor.solve(parts.stiffness, rest), even | turns)
        ahead = jnp.clip(softening - w.softening, -GUESS, GUESS)
        to = step.base + step.share * step.whole - parts.by_softening * ahead
        lost = loads & ~(parts.slope < 0) & ~settled
        at_first = even & (w.softening == band.softening)
        return w._replace(
            jump=jnp.where(settled | turns, w.jump, to),
            softening=softening,
            step=step,
            closed=w.closed != turns,
            turned=~even & (w.turned | turns),
            pace=jnp.where(even, 2 * w.pace, w.pace),
            jumps=w.jumps | lost,
            first_gap=jnp.where(at_first, gap, w.first_gap),
            settled=settled,
            inner=jnp.where(even, 0, w.inner + 1),
        )

    def kept(w):
        new = iterate(w)
        new = jax.tree.map(lambda old, fresh: jnp.where(w.settled, old, fresh), w, new)
        return new._replace(count=w.count + 1)

    go = lambda w: ((~w.settled) & (w.inner < INNER)).any() & (w.count < STEPS)  # noqa: E731
    return lax.while_loop(go, kept, _start(embedding, band, settled))


def _start(embedding, band, settled):
    one, no, last = jnp.ones_like(band.softening), jnp.zeros_like(settled), band.softening
    return Walk(
        jump=band.jump,
        softening=last,
        step=Step(band.jump, 0 * band.jump, jnp.inf * one, one, 0 * one, jnp.inf * one),
        closed=_closed(embedding, band, band.jump),
        turned=no,
        held=band.jump,
        low=last,
        high=jnp.inf * one,
        pace=one,
        gap=jnp.inf * one,
        slow=no,
        jumps=no,
        first_gap=0 * one,
        rests=no,
        settled=settled,
        inner=0 * no,
        count=jnp.zeros((), int),
    )


def _closed(embedding, band, jump):
    """Whether the faces of a band that closes are pressed together."""
    traction, _ = embedding.law.effective(bands.inside(band, jump), embedding.bulk.elastic)
    return (tensor.dot(traction, band.normal) < 0) & embedding.closes


def _least_stiffness(embedding, band, strain):
    """A stiffness next to nothing, for a bulk that yields where nothing is left of its band.

    It guides the search only, the solution does not know of it.
    """
    direct, *_ = embedding.bulk.elastic.coefficients(len(strain))
    unit = np.diag([1.0] * len(band.jump) + [0.0]).astype(strain.dtype)
    scale = jnp.finfo(strain.dtype).eps ** 0.5 * direct / band.size
    return unit.reshape(*unit.shape, *[1] * band.size.ndim) * scale


def _judged(w, even, gap, close, last):
    """What a balanced jump says: the `Walk` with its bracket, which load on, which have settled."""
    eps = jnp.finfo(gap.dtype).eps
    first = w.softening == last
    loads, rests = even & (gap > 0), even & first & (gap <= close)
    low = jnp.where(loads, w.softening, w.low)
    high = jnp.where(even & ~loads, w.softening, w.high)
    pinched = jnp.isfinite(high) & (high - low <= 4 * eps * (1 + high))
    settled = even & (rests | (jnp.abs(gap) <= close) | pinched)
    held = jnp.where(even & first, w.jump, w.held)
    slow = jnp.abs(gap) > jnp.abs(w.gap) / 2
    w = w._replace(gap=jnp.where(even, gap, w.gap), slow=jnp.where(even, slow, w.slow))
    return w._replace(held=held, low=low, high=high, rests=rests), loads, settled


def _next(w, parts, gap):
    """The softening to try after a balanced one."""
    bracketed, stable = jnp.isfinite(w.high), parts.slope < 0
    newton = w.softening - gap / jnp.where(stable, parts.slope, -1.0)
    safe = w.pace * gap / jnp.where(parts.own < 0, -parts.own, 1.0)
    ahead = w.softening + jnp.where(stable, jnp.minimum(newton - w.softening, safe), safe)
    middle = w.low + (jnp.where(bracketed, w.high, w.low) - w.low) / 2
    good = stable & (newton > w.low) & (newton < w.high) & ~w.slow
    return jnp.where(bracketed, jnp.where(good, newton, middle), ahead)


def _along(step, jump, rest, newton, anew):
    """The `Step` from here: a better share of the last, or a new one, as always `anew`.

    The traction along a step falls monotonically. A step that leaves more than a part of it, on
    the other side, or on this one after it has been cut, goes on being cut.
    """
    left = tensor.dot(rest, step.whole)
    beyond = ~anew & (left < -NEAR * step.pull)
    short = ~anew & jnp.isfinite(step.upper) & (left > NEAR * step.pull)
    again = beyond | short
    lower = jnp.where(short, step.share, step.lower)
    upper = jnp.where(beyond, step.share, step.upper)
    cut = step.pull / jnp.where(beyond, step.pull - left, 1.0)
    shorter = step.share * jnp.clip(cut, 0.1, 0.5)
    share = jnp.where(lower > 0, (lower + upper) / 2, shorter)
    onwards = jnp.where(anew, jnp.inf, tensor.dot(rest, newton))
    return Step(
        base=jnp.where(again, step.base, jump),
        whole=jnp.where(again, step.whole, newton),
        pull=jnp.where(again, step.pull, onwards),
        share=jnp.where(again, share, 1.0),
        lower=jnp.where(again, lower, 0.0),
        upper=jnp.where(again, upper, jnp.inf),
    )
