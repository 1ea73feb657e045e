"""A scalar root, bracketed: safe to compile, to map and to differentiate."""

import jax.numpy as jnp
from jax import lax

MOST = 200  # steps; bisection alone needs about 60 in double precision


def root(function, low, high):
    """Where an increasing scalar `function` is zero between `low` and `high`; else the nearer end.

    T.R. Chandrupatla, Adv. Eng. Softw. 28 (1997) 145–149: inverse quadratic interpolation where it
    is safe, else bisection. The derivative with respect to all that `function` closes over is that
    of the implicit function; where the answer is an end of the bracket it has no meaning.
    """
    low, high = (lax.stop_gradient(jnp.asarray(end)) for end in (low, high))

    def divide(linear, right):
        return right / linear(jnp.ones_like(right))

    return lax.custom_root(
        function, (low + high) / 2, lambda f, _: _bracketed(f, low, high), divide
    )


def _bracketed(function, low, high):
    """x1, the latest, and x2 enclose the root, x3 was given up; ends not evaluated count as infinite."""
    tolerance = lambda x: 2 * jnp.finfo(low.dtype).eps * (1 + jnp.abs(x))  # noqa: E731

    def going(state):
        (x1, x2, _), (f1, _, _), _, count = state
        return (jnp.abs(x2 - x1) > 2 * tolerance(x1)) & (f1 != 0) & (count < MOST)

    def closer(state):
        (x1, x2, _), (f1, f2, _), share, count = state
        x = x1 + share * (x2 - x1)
        f = function(x)
        same = (f > 0) == (f1 > 0)
        xs = x, jnp.where(same, x2, x1), jnp.where(same, x1, x2)
        fs = f, jnp.where(same, f2, f1), jnp.where(same, f1, f2)
        least = tolerance(x) / jnp.maximum(jnp.abs(xs[1] - x), tolerance(x))
        share = jnp.clip(_interpolated(xs, fs), least / 2, 1 - least / 2)
        return xs, fs, share, count + 1

    far = jnp.full_like(low, jnp.inf)
    start = ((low, high, high), (-far, far, far), jnp.full_like(low, 0.5), 0)
    (x1, x2, _), (f1, f2, _), *_ = lax.while_loop(going, closer, start)
    return jnp.where(jnp.abs(f1) < jnp.abs(f2), x1, x2)


def _interpolated(xs, fs):
    """Where between x1 and x2 the root is by the inverse parabola; 1/2 where that is not safe."""
    (x1, x2, x3), (f1, f2, f3) = xs, fs
    across, up = (x1 - x2) / (x3 - x2), (f1 - f2) / (f3 - f2)
    safe = (up**2 < across) & ((1 - up) ** 2 < 1 - across) & jnp.isfinite(f1 * f2 * f3)
    first = f1 / (f2 - f1) * f3 / (f2 - f3)
    second = (x3 - x1) / (x2 - x1) * f1 / (f3 - f1) * f2 / (f3 - f2)
    return jnp.where(safe, first + second, 0.5)
