"""Least squares by descent: from far with Adam, to the end with Gauss-Newton or L-BFGS.

A residual is a function theta (k,) -> r (m,), cheap or a whole simulation; few parameters are
differentiated forward. An evaluation that fails, one that is not finite or that raises
`RunError`, is a step rejected: the next is shorter.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from jaxmpm.errors import RunError

Show = Callable[[str], None]


class Descent(NamedTuple):
    """Where a descent ended."""

    theta: jax.Array  # (k,)
    residual: jax.Array  # (m,)
    jacobian: jax.Array  # (m, k), of the residual in theta
    steps: int
    rejected: int
    converged: bool

    @property
    def loss(self) -> float:
        """½ rᵀr."""
        return float(self.residual @ self.residual) / 2


def linearised(residual):
    """theta (k,) -> (r (m,), dr/dtheta (m, k)), both from one forward differentiation."""

    def evaluate(theta):
        jacobian, value = jax.jacfwd(lambda x: (residual(x),) * 2, has_aux=True)(theta)
        return value, jacobian

    return evaluate


def with_slope(residual):
    """theta (k,) -> (½ rᵀr, its gradient (k,)), by forward differentiation."""

    def evaluate(theta):
        value, jacobian = linearised(residual)(theta)
        return value @ value / 2, value @ jacobian

    return evaluate


def adam(evaluate, theta, steps=200, rate=0.1, show: Show | None = None, name=lambda theta: ""):
    """Adam from one start, or from many at once; the rate falls to a hundredth of its value.

    Args:
        evaluate: theta (..., k) -> (loss (...), gradient (..., k)).
        theta: (k,), or (starts, k) if `evaluate` takes that.
        steps, rate: how many, and how long at first.
        show: takes a line of progress now and then.
        name: theta (k,) -> the parameters in words, for that line.

    Returns:
        the best theta that was met, of the same shape, and its loss.
    """
    moments = optax.scale_by_adam().init(theta)
    loss, slope = _attempt(evaluate, theta, jnp.inf + theta[..., 0])
    best, least = theta, jnp.where(jnp.isfinite(loss), loss, jnp.inf)
    length = jnp.full_like(loss, rate)
    for count in range(steps):
        now = length * 100.0 ** (-count / steps)
        trial, ahead = _step(slope, moments, theta, now)
        new_loss, new_slope = _attempt(evaluate, trial, loss)
        good = jnp.isfinite(new_loss) & jnp.isfinite(new_slope).all(-1)
        theta, slope, moments, length = _take(
            good, (trial, new_slope, ahead, length), (theta, slope, moments, length / 2)
        )
        better = good & (new_loss < least)
        best, least = _take(better, (trial, new_loss), (best, least))
        if show and (count + 1) % max(1, steps // 10) == 0:
            at = jnp.unravel_index(jnp.argmin(least), least.shape)
            show(_line(f"Adam {count + 1}", least[at], jnp.linalg.norm(slope[at]), name(best[at])))
    return best, least


@jax.jit
def _step(slope, moments, theta, length):
    update, moments = optax.scale_by_adam().update(jnp.nan_to_num(slope), moments)
    return theta - length[..., None] * update, moments


def _take(good, new, old):
    """`new` where `good` (...), else `old`; leaves (...) or (..., k), counters as they are."""

    def one(x, y):
        if jnp.ndim(x) < good.ndim:
            return x
        return jnp.where(good if jnp.ndim(x) == good.ndim else good[..., None], x, y)

    return jax.tree.map(one, new, old)


def gauss_newton(evaluate, theta, steps=60, tolerance=1e-9, show: Show | None = None, name=lambda theta: ""):
    """Gauss-Newton with the damping of Levenberg and Marquardt, to the end.

    Args:
        evaluate: theta (k,) -> (r (m,), dr/dtheta (m, k)), see `linearised`.
        theta: (k,).
        steps: at most.
        tolerance: done where a step, or the cosine between the residual and what steps can
            change, is less.
        show, name: as for `adam`.

    Returns:
        Descent; its residual is not finite if the start cannot be evaluated.
    """
    value, jacobian = _attempt(evaluate, theta, jnp.full(1, jnp.nan))
    damping, rejected, converged, count = 1e-3, 0, False, 0
    for count in range(1, steps + 1):
        slope = value @ jacobian
        move = _damped(jacobian, slope, damping)
        small = jnp.abs(move).max() < tolerance
        if not jnp.isfinite(slope).all() or small or _orthogonal(value, jacobian, tolerance):
            converged = bool(jnp.isfinite(slope).all())
            break
        new_value, new_jacobian = _attempt(evaluate, theta + move, value)
        good = jnp.isfinite(new_value).all() & jnp.isfinite(new_jacobian).all()
        if good and new_value @ new_value <= value @ value:
            theta, value, jacobian, damping = theta + move, new_value, new_jacobian, damping / 10
        else:
            damping, rejected = max(10 * damping, 1e-9), rejected + 1
            if damping > 1e12:
                break
        if show:
            show(_line(f"Gauss-Newton {count}", value @ value / 2, jnp.linalg.norm(slope), name(theta)))
    return Descent(theta, value, jacobian, count, rejected, converged)


def _damped(jacobian, slope, damping):
    """Step (k,) of the normal equations, at most 2 in any direction."""
    square = jacobian.T @ jacobian
    scale = jnp.maximum(jnp.diag(square), 1e-12 * jnp.trace(square) + 1e-300)
    move = -jnp.linalg.solve(square + damping * jnp.diag(scale), slope)
    return move * jnp.minimum(1.0, 2.0 / jnp.maximum(jnp.abs(move).max(), 1e-300))


def _orthogonal(value, jacobian, tolerance):
    size = jnp.linalg.norm(value) * jnp.linalg.norm(jacobian, axis=0)
    return bool((jnp.abs(value @ jacobian) <= tolerance * size).all())


def lbfgs(loss, theta, steps=100, tolerance=1e-13):
    """L-BFGS of optax on a cheap, compiled loss: theta (k,), and the norm of its gradient."""
    optimiser = optax.lbfgs()
    evaluate = optax.value_and_grad_from_state(loss)

    def going(carry):
        _, slope, _, count = carry
        return (jnp.linalg.norm(slope) > tolerance) & (count < steps)

    def closer(carry):
        theta, _, state, count = carry
        value, slope = evaluate(theta, state=state)
        update, state = optimiser.update(slope, state, theta, value=value, grad=slope, value_fn=loss)
        trial = theta + update
        good = jnp.isfinite(trial).all()
        return jnp.where(good, trial, theta), jnp.where(good, slope, 0.0), state, count + 1

    start = (theta, jnp.full_like(theta, jnp.inf), optimiser.init(theta), 0)
    theta, slope, *_ = jax.jit(lambda start: jax.lax.while_loop(going, closer, start))(start)
    return theta, jnp.linalg.norm(slope)


def _attempt(evaluate, theta, like):
    """An evaluation; where it fails, NaN in its place."""
    try:
        return evaluate(theta)
    except (RunError, FloatingPointError):
        nothing = jnp.full_like(like, jnp.nan)
        return nothing, jnp.full((*nothing.shape, theta.shape[-1]), jnp.nan)


def _line(step, loss, slope, parameters):
    return f"{step:16}  loss {float(loss):.4e}  |gradient| {float(slope):.2e}  {parameters}"
