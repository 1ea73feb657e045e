"""A scalar root, bracketed: safe to compile, to map and to differentiate."""

import jax
import jax.numpy as jnp
from jax import lax

MOST = 120  # steps; bisection alone needs about 60 for 40 units in double precision


def root(function, low, high):
    """Where an increasing scalar `function` is zero between `low` and `high`; else the nearer end.

    Newton, replaced by bisection where it leaves the bracket or does not halve its step. The
    derivative with respect to all that `function` closes over is that of the implicit function.
    Wherever the answer is an end of the bracket, its derivative has no meaning.
    """
    low, high = (lax.stop_gradient(jnp.asarray(end)) for end in (low, high))

    def divide(linear, right):
        return right / linear(jnp.ones_like(right))

    return lax.custom_root(
        function, (low + high) / 2, lambda f, _: _bracketed(f, low, high), divide
    )


def _bracketed(function, low, high):
    eps = jnp.finfo(low.dtype).eps

    def going(state):
        *_, x, step, count = state
        return (jnp.abs(step) > 2 * eps * (1 + jnp.abs(x))) & (count < MOST)

    def closer(state):
        low, high, x, step, count = state
        value, slope = jax.jvp(function, (x,), (jnp.ones_like(x),))
        low, high = jnp.where(value <= 0, x, low), jnp.where(value >= 0, x, high)
        newton = -value / slope
        good = (x + newton > low) & (x + newton < high) & (jnp.abs(newton) < jnp.abs(step) / 2)
        step = jnp.where(good, newton, (low + high) / 2 - x)
        return low, high, x + step, step, count + 1

    start = (low, high, (low + high) / 2, high - low, 0)
    return lax.while_loop(going, closer, start)[2]
