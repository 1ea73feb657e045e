"""What a constitutive law is, and its tangent.

A *bulk law* is a pytree dataclass of parameters with

    stress(strain) -> stress                               one point, no history (yet)
    coefficients(size) -> C₁₁, C₁₂, C₃₃                    elastic stiffness, MPa

A *band law* describes the material inside a localisation band:

    initial() -> history                                   a pytree of scalars, at onset
    respond(strain, history, bulk) -> (stress, history)    one point
    frozen(strain, history, bulk) -> stress                the same with the history held
    loads(strain, history, bulk) -> bool                   the history would change
    onset(stress, bulk) -> scalar                          1 where a band opens
    cohesion(history) -> scalar                            traction over strength, 1 .. 0
    stored(strain, history, bulk), dissipated(history)     energy per band volume, N/mm²

Parameters are leaves: differentiate with respect to any of them, or stack them to give
every point its own.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp


def law(cls):
    """Class decorator: a frozen dataclass of parameters that is a JAX pytree."""
    return jax.tree_util.register_dataclass(dataclass(frozen=True)(cls))


def tangent(response, strain, *args):
    """Tangent dσ/dε (size, size) of `response(strain, *args) -> stress`, by `jax.jacfwd`."""
    return jax.jacfwd(response)(strain, *args)


def jacobian(function, x):
    """`jax.jacfwd(function, has_aux=True)(x)` for a vector of 2, its columns one after the other.

    The same forward differentiation; but a column is a whole array over the points that the
    function is mapped over, where `jacfwd` weaves the columns into the batch (8 times slower).
    """
    _, push, aux = jax.linearize(function, x, has_aux=True)
    one, zero = jnp.ones_like(x[0]), jnp.zeros_like(x[0])
    columns = push(jnp.stack([one, zero])), push(jnp.stack([zero, one]))
    return jnp.stack(columns, axis=1), aux
