"""Friction between bodies that move in velocity fields of their own (Bardenhagen et al. 2000, 2001).

Where two fields share a node and approach each other, impulses stop the approach, and a tangential
one at most μ times as large stops the sliding. Both act along a common normal, the difference of the
gradients of their masses, so that momentum is kept to round-off. Bodies count as near where the
distance of their masses, as a node sees it, is at most that of two rows of points in touch.
"""

from itertools import combinations

import jax.numpy as jnp
from jax import lax

NEAR = 0.9  # of a cell: distance of two bodies' centres of mass at a node when their faces touch


def rub(n, mass, arm, velocity, friction):
    """Velocities (fields, d, *nodes) after contact.

    Args:
        n: `Numerics`.
        mass: of each field (fields, *nodes), tonne.
        arm: mass times where it is from the node (fields, d, *nodes), tonne mm.
        velocity: before contact, mm/s.
        friction: coefficient μ.
    """
    for a, b in combinations(range(len(mass)), 2):
        together = _together(n, mass, arm, a, b)
        velocity = _pair(n, mass, velocity, friction, a, b, together)
    return velocity


def _safe(value):
    return jnp.where(value > 0, value, 1.0)


def _normal(n, mass, a, b):
    """From a to b (d, *nodes): down the mass of a and up that of b."""
    d = n.dimension
    difference = mass[b] / _safe(mass[b].max()) - mass[a] / _safe(mass[a].max())
    slope = jnp.stack([_central(difference, axis) for axis in range(d)])
    size = jnp.sqrt((slope**2).sum(0))
    return slope / _safe(size), size > 0


def _central(field, axis):
    wide = jnp.pad(field, [(1, 1) if a == axis else (0, 0) for a in range(field.ndim)], mode="edge")
    count = field.shape[axis]
    return lax.slice_in_dim(wide, 2, count + 2, axis=axis) - lax.slice_in_dim(wide, 0, count, axis=axis)


def _together(n, mass, arm, a, b):
    """Where a and b both have mass at a node and touch, and the normal."""
    tiny = jnp.finfo(mass.dtype).eps * mass.max()
    both = (mass[a] > tiny) & (mass[b] > tiny)
    normal, known = _normal(n, mass, a, b)
    apart = arm[b] / _safe(mass[b]) - arm[a] / _safe(mass[a])
    near = (apart * normal).sum(0) <= NEAR * n.cell
    return both & known & near, normal


def _pair(n, mass, velocity, friction, a, b, where):
    touching, normal = where
    reduced = mass[a] * mass[b] / _safe(mass[a] + mass[b])
    relative = velocity[a] - velocity[b]
    approach = (relative * normal).sum(0)
    sliding = relative - approach * normal
    speed = jnp.sqrt((sliding**2).sum(0))
    hits = touching & (approach > 0)
    share = jnp.minimum(1.0, friction * approach / _safe(speed))
    impulse = jnp.where(hits, reduced * (approach * normal + share * sliding), 0.0)
    velocity = velocity.at[a].add(-impulse / _safe(mass[a]))
    return velocity.at[b].add(impulse / _safe(mass[b]))
