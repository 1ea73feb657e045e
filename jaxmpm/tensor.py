"""Strain and stress as vectors, and the few operations the laws need of them.

Components are ordered xx, yy, (zz,) xy and the shear strain is the engineering one, 2 e_xy.
A vector of 3 is plane stress (zz strain free), one of 4 is plane strain (zz kept, because
the out-of-plane stress takes part in damage). Functions read the case from the length, so a
law is written once. All act on one point; `jax.vmap` maps them over many.
"""

import jax
import jax.numpy as jnp

# Double precision is the default of the project; a scene asks for float32 by name.
jax.config.update("jax_enable_x64", True)

STRAIN_SIZE = {"plane_stress": 3, "plane_strain": 4}


def dot(a, b):
    """Sum of a[i] b[i] over the first axis, unrolled: vectors here are short, batches long."""
    return sum(a[i] * b[i] for i in range(1, len(a))) + a[0] * b[0]


def from_plane(components, size):
    """Strain vector (size,) from its in-plane components xx, yy, xy; a zz strain is zero."""
    xx, yy, xy = components
    return jnp.stack([xx, yy, xy] if size == 3 else [xx, yy, jnp.zeros_like(xx), xy])


def to_plane(vector):
    """In-plane components xx, yy, xy of a strain or stress vector."""
    return jnp.stack([vector[0], vector[1], vector[-1]])


def symmetric_product(normal, jump, size):
    """Strain vector (size,) of the symmetric dyad (n ⊗ [u])^s, with engineering shear."""
    n, w = normal, jump
    return from_plane((n[0] * w[0], n[1] * w[1], n[0] * w[1] + n[1] * w[0]), size)


def traction(stress, normal):
    """Traction (2,) of a stress vector on the plane with in-plane normal (2,)."""
    xx, yy, xy = to_plane(stress)
    return jnp.stack([xx * normal[0] + xy * normal[1], xy * normal[0] + yy * normal[1]])


def along(direction, size):
    """Vector p (size,) that picks the direct stress along a unit direction (2,): p·σ = d·σ·d."""
    d = direction
    return from_plane((d[0] * d[0], d[1] * d[1], 2 * d[0] * d[1]), size)


def principal_values(stress):
    """Principal values (3,) of a stress vector, the in-plane pair first and in falling order.

    The radius of Mohr's circle is guarded at zero, so that the derivative is finite (and
    right for symmetric functions of the pair) when the two values coincide.
    """
    xx, yy, xy = to_plane(stress)
    out_of_plane = jnp.zeros_like(xx) if stress.shape[0] == 3 else stress[2]
    centre, half = (xx + yy) / 2, (xx - yy) / 2
    square = half * half + xy * xy
    round_circle = square == 0
    radius = jnp.where(round_circle, 0.0, jnp.sqrt(jnp.where(round_circle, 1.0, square)))
    return jnp.stack([centre + radius, centre - radius, out_of_plane])


def first_principal_direction(stress):
    """Unit direction (2,) of the largest in-plane principal stress; x where the two coincide."""
    xx, yy, xy = to_plane(stress)
    angle = jnp.arctan2(2 * xy, xx - yy) / 2
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)])
