"""The sure way to equilibrium: walks along the softening curve, and what a jump sets free."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm.laws.energies import freed
from jaxmpm.laws.equilibrium import FAILS, JUMPS, LOADS, RESTS, Leap, Solution, on_the_way, way_from_rest
from jaxmpm.laws.walk import walk

WALKS = 60  # before a point counts as failed; three are usual where equilibrium is lost
LEAST = 1e-10  # share of the way that is as good as none
PINCHED = 1e-4  # difference of shares of the way between which equilibrium is lost

STEP, WHERE, OVER, BETWEEN, DONE = 0, 1, 2, 3, 4  # what a point is after in a walk


class Course(NamedTuple):
    """The walks of a point, one after the other."""

    stage: jax.Array
    share: jax.Array  # of the way to the strain asked for, where it walks
    low: jax.Array  # share up to which equilibrium can be followed
    high: jax.Array  # and at which it has been lost
    last: jax.Array  # the share before, and the gap there
    gap: jax.Array
    jump: jax.Array  # where the walk starts
    softening: jax.Array
    found: Solution
    walks: jax.Array


def search(embedding, band, strain, precision, found, settled):
    """The `Solution` of those points that are not `settled`, and what was `found` of the others.

    Where a walk cannot be followed it is walked again, to see what energy that sets free: from
    rest to WHERE on the way the band was about to load, and OVER that by next to nothing. Where
    the band can still be followed then, it is BETWEEN there and the end that it is lost; or
    never, where a bulk yielded only because the step was long.
    """
    # gap, or difference in the share of the way, that is next to nothing
    apart = max(8 * float(jnp.finfo(strain.dtype).eps) ** 0.5, 4 * precision)

    way = way_from_rest(embedding, band, strain)

    def go(course):
        return (course.stage != DONE).any() & (course.walks < WALKS)

    def next_walk(c):
        first, holds = c.stage == STEP, c.stage == WHERE
        at = on_the_way(strain, way, c.share)
        start = band._replace(jump=c.jump, softening=c.softening)
        w = walk(embedding, start, at, precision, c.stage == DONE, holds)
        new = _judged_walk(c, w, apart)
        unknowns = jnp.concatenate([w.jump, w.softening[None]])
        said = jnp.where(w.rests, RESTS, jnp.where(w.jumps, JUMPS, LOADS))
        lost = w.jumps & w.settled
        # the last walk tells whether it is lost at all
        after = jnp.where(lost, JUMPS, LOADS)
        status = jnp.where(first, said, jnp.where(holds, c.found.status, after))
        status = jnp.where(w.settled, status, FAILS).astype(jnp.int32)
        leap = Leap(c.share, w.held, c.softening, w.jump, w.softening)
        found = Solution(
            jnp.where(first, unknowns, c.found.unknowns),
            status,
            c.found.free,
            jax.tree.map(lambda old, new: jnp.where(lost, new, old), c.found.leap, leap),
        )
        new = new._replace(found=found, stage=jnp.where(w.settled, new.stage, DONE))
        kept = jax.tree.map(lambda old, fresh: jnp.where(c.stage == DONE, old, fresh), c, new)
        return kept._replace(walks=c.walks + 1)

    one, infinite = jnp.ones_like(band.softening), jnp.full_like(band.softening, jnp.inf)
    course = Course(
        stage=jnp.where(settled, DONE, STEP),
        share=one,
        low=0 * one,
        high=one,
        last=one,
        gap=infinite,
        jump=band.jump,
        softening=band.softening,
        found=found,
        walks=jnp.zeros((), int),
    )
    course = lax.while_loop(go, next_walk, course)
    # what is not known after so many walks has no status that is true
    status = jnp.where(course.stage == DONE, course.found.status, FAILS).astype(jnp.int32)
    leap = course.found.leap
    at = on_the_way(strain, way, leap.share)
    free = freed(embedding, band._replace(softening=leap.before), at, leap)
    return course.found._replace(status=status, free=jnp.where(status == JUMPS, free, 0.0))


def _judged_walk(c, w, apart):
    """The `Course` after a walk: what a point is after next, and where."""
    first, holds, over, between = (c.stage == k for k in (STEP, WHERE, OVER, BETWEEN))
    lost = w.jumps
    # the gap at the last softening tells where the band is about to load; an oblique one may be
    # from the very begin
    gap = jnp.where(first, w.first_gap, w.gap)
    low = jnp.where(holds & (gap <= 0) | (over | between) & ~lost, c.share, c.low)
    high = jnp.where(holds & (gap > 0) | between & lost, c.share, c.high)
    pinched_here = high - low <= apart / 4 * high
    here = pinched_here | ((gap > 0) & ((gap <= apart) | (high <= LEAST)))
    pinched = high - low <= PINCHED * high
    stage = jnp.where(first & lost | holds & ~here, WHERE, DONE)
    stage = jnp.where(holds & here, OVER, stage)
    stage = jnp.where(over & ~lost | between & ~(pinched & lost) & (low < 1), BETWEEN, stage)
    # it may be lost anywhere up to the end, once it is not lost where the band begins to load
    high = jnp.where(over & ~lost, 1.0, high)
    middle = jnp.where(pinched, high, jnp.sqrt(low * high))
    share = jnp.where(pinched_here, high, c.share)
    share = jnp.where(stage == WHERE, _share(c, gap - apart / 2, low, high), share)
    follows = (over | between) & ~lost
    return c._replace(
        stage=jnp.where(between & ~lost & pinched & (c.share >= high), DONE, stage),
        share=jnp.where(stage == BETWEEN, middle, share),
        low=low,
        high=high,
        last=c.share,
        gap=gap - apart / 2,
        jump=jnp.where(follows | holds, w.jump, c.jump),
        softening=jnp.where(follows, w.softening, c.softening),
    )


def _share(c, gap, low, high):
    """The share of the way to try next for a gap of zero: by the secant, or less of the bracket."""
    known = jnp.isfinite(c.gap) & (c.gap != gap)
    secant = c.share - gap * (c.share - c.last) / jnp.where(known, gap - c.gap, 1.0)
    # alone, as if what drives the band grew with the share
    to = jnp.where(known, secant, c.share * jnp.exp(-gap))
    good = (to > low) & (to < high) & (jnp.abs(gap) <= jnp.abs(c.gap) / 2)
    return jnp.where(good, to, jnp.where(low > 0, (low + high) / 2, high / 16))
