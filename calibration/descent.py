"""Least squares by descent: from far with Adam, to the end with Gauss-Newton or L-BFGS.

A residual is a function theta (k,) -> r (m,), cheap or a whole simulation; few parameters are
differentiated forward. An evaluation that fails, one that is not finite or that raises
`RunError`, is a step rejected: the next is shorter.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxmpm.errors import RunError

Show = Callable[[str], None]


class Descent(NamedTuple):
    """Where a descent ended."""

    theta: np.ndarray  # (k,)
    residual: np.ndarray  # (m,)
    jacobian: np.ndarray  # (m, k), of the residual in theta
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
    loss, slope = _attempt(evaluate, theta, jnp.inf + theta[..., 0])
    least = jnp.where(jnp.isfinite(loss), loss, jnp.inf)
    moments = optax.scale_by_adam().init(theta)
    state = Adam(theta, slope, moments, jnp.full_like(loss, rate), theta, least)
    for count in range(steps):
        trial, moments = _ahead(state, 100.0 ** (-count / steps))
        state = _settled(state, trial, moments, *_attempt(evaluate, trial, loss))
        if show and (count + 1) % max(1, steps // 10) == 0:
            at = np.unravel_index(np.argmin(state.least), state.least.shape)
            slope = np.linalg.norm(state.slope[at])
            show(_line(f"Adam {count + 1}", state.least[at], slope, name(state.best[at])))
    return state.best, state.least


class Adam(NamedTuple):
    """Where Adam is: (..., k), or (...) for lengths of steps and losses."""

    theta: jax.Array
    slope: jax.Array
    moments: optax.OptState
    length: jax.Array
    best: jax.Array
    least: jax.Array


@jax.jit
def _ahead(state, share):
    """The next theta to try, and the moments there."""
    update, moments = optax.scale_by_adam().update(jnp.nan_to_num(state.slope), state.moments)
    return state.theta - (share * state.length)[..., None] * update, moments


@jax.jit
def _settled(state, trial, moments, loss, slope):
    """After an evaluation at `trial`: there, or where it was with steps half as long."""
    good = jnp.isfinite(loss) & jnp.isfinite(slope).all(-1)
    better = good & (loss < state.least)
    at = lambda mask, new, old: jnp.where(mask[..., None], new, old)  # noqa: E731
    keep = lambda new, old: new if jnp.ndim(new) < jnp.ndim(trial) else at(good, new, old)  # noqa: E731
    return Adam(
        at(good, trial, state.theta), at(good, slope, state.slope),
        jax.tree.map(keep, moments, state.moments), jnp.where(good, state.length, state.length / 2),
        at(better, trial, state.best), jnp.where(better, loss, state.least),
    )  # fmt: skip


def gauss_newton(
    evaluate, theta, steps=60, tolerance=1e-9, show: Show | None = None, name=lambda theta: "",
    flat=0.0, trial=None,
):  # fmt: skip
    """Gauss-Newton with the damping of Levenberg and Marquardt, to the end.

    Args:
        evaluate, theta: theta (k,) -> (r (m,), dr/dtheta (m, k)), see `linearised`, and (k,).
        steps: at most.
        tolerance: done where a step, or the cosine between the residual and what steps can
            change, is less.
        show, name: as for `adam`.
        flat: done too where a step lowers the loss by a smaller share.
        trial: theta (k,) -> r (m,), where that is much cheaper: steps are judged by it first.

    Returns:
        Descent; its residual is not finite if the start cannot be evaluated.
    """
    theta = np.asarray(theta)
    value, jacobian = _attempt_arrays(evaluate, theta, np.full(1, np.nan))
    damping, rejected, converged, count = 1e-3, 0, False, 0
    for count in range(1, steps + 1):
        slope = value @ jacobian
        if converged or not np.isfinite(slope).all():
            break
        move = _damped(jacobian, slope, damping)
        converged = np.abs(move).max() < tolerance or _orthogonal(value, jacobian, tolerance)
        if converged:
            break
        there = _lower(evaluate, trial, theta + move, value)
        if there:
            converged = there[0] @ there[0] > (1 - flat) * (value @ value)
            theta, (value, jacobian), damping = theta + move, there, damping / 10
        else:
            damping, rejected = 10 * damping, rejected + 1
        if show:
            loss, size = value @ value / 2, np.linalg.norm(slope)
            show(_line(f"Gauss-Newton {count}", loss, size, name(theta)))
    return Descent(theta, value, jacobian, count, rejected, bool(converged))


def _lower(evaluate, trial, theta, value):
    """(r, its Jacobian) at theta, None where they are not finite or r is larger than `value`."""
    if trial is not None and not _no_larger(_attempt_value(trial, theta, value), value):
        return None
    there = _attempt_arrays(evaluate, theta, value)
    return there if _no_larger(there[0], value) and np.isfinite(there[1]).all() else None


def _no_larger(residual, value):
    return residual @ residual <= value @ value  # not so if not finite


def _attempt_value(trial, theta, like):
    return np.asarray(_attempt(lambda x: (trial(x), None), jnp.asarray(theta), like)[0])


def _attempt_arrays(evaluate, theta, like):
    return tuple(np.asarray(part) for part in _attempt(evaluate, jnp.asarray(theta), like))


def _damped(jacobian, slope, damping):
    """Step (k,) of the damped normal equations, at most 2 in any direction."""
    square = jacobian.T @ jacobian
    diagonal = np.maximum(np.diag(square), 1e-12 * np.trace(square) + 1e-300)
    move = -np.linalg.lstsq(square + damping * np.diag(diagonal), slope)[0]
    return move * min(1.0, 2.0 / max(np.abs(move).max(), 1e-300))


def _orthogonal(value, jacobian, tolerance):
    """Whether no small step can change the residual by more than a share of it."""
    size = np.linalg.norm(value) * np.linalg.norm(jacobian, axis=0)
    return (np.abs(value @ jacobian) <= tolerance * size).all()


def lbfgs(loss, theta, steps=100, tolerance=1e-13):
    """L-BFGS of optax on a cheap, compiled loss: theta (k,), and the norm of its gradient."""
    optimiser = optax.lbfgs(
        memory_size=4, linesearch=optax.scale_by_backtracking_linesearch(20, store_grad=True)
    )
    evaluate = optax.value_and_grad_from_state(loss)

    def going(carry):
        _, slope, _, count = carry
        return (jnp.linalg.norm(slope) > tolerance) & (count < steps)

    def closer(carry):
        theta, _, state, count = carry
        value, slope = evaluate(theta, state=state)
        update, state = optimiser.update(
            slope, state, theta, value=value, grad=slope, value_fn=loss
        )
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
