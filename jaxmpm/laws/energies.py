"""What a step of a band gives up besides what its softening curve says, and what a jump sets free."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import tensor
from jaxmpm.laws import band as bands


def booked(embedding, band, moved, strain, stress, found):
    """The state `moved` to, with the energies of the step from `band` in its books.

    Args:
        embedding: the laws.
        band, moved: state before the step and after.
        strain: macroscopic strain after it (size,).
        stress: of the bulk (size,), MPa.
        found: the `Solution` that it moved to.
    """
    spent = _spent(embedding, band, moved)
    released = _softened_bulk(embedding, band, moved, strain, stress) + found.free
    return moved._replace(spent=band.spent + spent, released=band.released + released)


def freed(embedding, band, at, leap):
    """Energy per volume of the cell that a `Leap` sets free, N/mm².

    The fall of stored and dissipated energy at the strain where equilibrium is lost, less what
    is booked as spent and released of any step.
    """
    before = band._replace(jump=leap.held, softening=leap.before)
    after = band._replace(jump=leap.jump, softening=leap.after)
    both = jax.tree.map(lambda *pair: jnp.stack(pair), before, after)
    total = jax.vmap(lambda band: sum(bands.energies(embedding, band, at)))(both)
    spent = _spent(embedding, before, after)
    outside = bands.bulk_strain(embedding, band, at, leap.jump)
    stress, _ = bands.bulk_stress(embedding, before, outside)
    released = _softened_bulk(embedding, before, after, at, stress)
    return jnp.maximum(total[0] - total[1] - spent / band.size - released, 0.0)


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
