"""What a constitutive law is, and how it is differentiated.

Every law is a frozen dataclass of parameters, written for one point with components first, so
that it holds as well for many points along a trailing axis (index components, stack on axis 0,
no reductions over whole arrays). Its parameters are leaves of a pytree: differentiate with
respect to any of them, or stack them to give every point its own. Histories are pytrees too.

A **point law** answers a strain by itself, and serves as the bulk around a band:

    initial(size) -> history
    respond(strain, history) -> (stress, history)          (size,) MPa
    stored(strain, history), dissipated(history)           energy per volume, N/mm²
    elastic                                                its `Elastic` part

A **band law** describes the material inside a localisation band, scaled by an integrity s that
falls from 1 to 0. How far it has fallen is one number p, the *softening*, 0 at onset:

    h, ft                                                  width of the band, mm; strength, MPa
    onset(stress, bulk) -> r̂                               1 where a band opens
    effective(inside, bulk) -> (traction, r̂)               as if s were 1; what drives softening
    soften(p, bulk) -> (r̂, s)                              the softening curve; p loads where
                                                           the effective r̂ passes this r̂
    stored(inside, s, closes, bulk)                        energy per area of the crack, N/mm
    given_up(p, bulk)                                      energy per area dissipated so far
    largest_size(bulk)                                     H_max, mm

`bulk` is the `Elastic` part of the bulk, `inside` an `Inside`; `closes` tells whether a closed
crack carries compression. What balances band and bulk is `band.py`; a new law is one file.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp


def law(cls):
    """Class decorator: a frozen dataclass of parameters that is a JAX pytree."""
    return jax.tree_util.register_dataclass(dataclass(frozen=True)(cls))


class Inside(NamedTuple):
    """Deformation of a band, as its law sees it."""

    jump: jax.Array  # displacement jump [u] since onset (dimension,), mm
    onset_strain: jax.Array  # ε_c (size,)
    normal: jax.Array  # unit normal n (dimension,)


def tangent(response, strain, *args):
    """Tangent dσ/dε (size, size) of `response(strain, *args) -> stress`, by `jax.jacfwd`."""
    return jax.jacfwd(response)(strain, *args)


def jacobian(function, x):
    """`jax.jacfwd(function, has_aux=True)(x)` and the value, its columns one after the other.

    The same forward differentiation; but a column is a whole array over the points that the
    function is mapped over, where `jacfwd` weaves the columns into the batch (8 times slower).

    Returns:
        (matrix, value, aux) for a `function(x) -> (value, aux)` of a short vector x.
    """
    value, push, aux = jax.linearize(function, x, has_aux=True)
    one, zero = jnp.ones_like(x[0]), jnp.zeros_like(x[0])
    unit = lambda k: jnp.stack([one if i == k else zero for i in range(len(x))])  # noqa: E731
    return jnp.stack([push(unit(k)) for k in range(len(x))], axis=1), value, aux
