"""Load histories: their value at and between the knots, and how smoothly they get there."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm.loads import Load

jax.config.update("jax_enable_x64", True)  # as `jaxmpm.tensor` does for the whole package

TIME = np.array([0.5, 1.0, 3.0, 3.5, 7.0])
VALUE = np.array([0.2, -1.0, 2.0, 2.0, 5.0])


def load(start=(0, 0, 0, 0), smooth=False):
    return Load(
        dofs=jnp.array([3, 7, 8]),
        weights=jnp.array([1.0, -2.0, 0.5]),
        time=jnp.asarray(TIME),
        value=jnp.asarray(VALUE),
        start=jnp.asarray(start, dtype=float),
        smooth=smooth,
    )


EVERY = pytest.mark.parametrize(
    "history", [load(), load((0.25, 0, 0.5, 1)), load((0, 1, 0, 0.1)), load(smooth=True)]
)


@EVERY
def test_value_at_the_knots_and_constant_outside(history):
    at = jax.vmap(history.amplitude)
    np.testing.assert_allclose(at(jnp.asarray(TIME)), VALUE, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(at(jnp.array([-9.0, 0.0, 0.499])), VALUE[0], rtol=1e-14)
    np.testing.assert_allclose(at(jnp.array([7.001, 1e6])), VALUE[-1], rtol=1e-14)


def test_linear_between_the_knots_and_weighted_at_each_degree_of_freedom():
    history, times = load(), np.linspace(0, 8, 401)
    expected = np.interp(times, TIME, VALUE)
    found = jax.vmap(history.at)(jnp.asarray(times))
    np.testing.assert_allclose(found, expected[:, None] * [1.0, -2.0, 0.5], rtol=0, atol=1e-13)


def test_parabolic_start_is_continuously_differentiable_and_then_straight():
    """Over the start the rate grows in proportion to time, from zero to that of the rest."""
    history = load((0.25, 0, 0, 0))
    t0, t1, share = 0.5, 1.0, 0.25
    rate = jax.vmap(jax.grad(history.amplitude))
    x = np.linspace(1e-6, 1 - 1e-6, 1001)
    steady = (VALUE[1] - VALUE[0]) / (t1 - t0) / (1 - share / 2)
    expected = steady * np.minimum(x / share, 1)
    np.testing.assert_allclose(rate(jnp.asarray(t0 + x * (t1 - t0))), expected, atol=1e-10)
    # elsewhere it stays as it was
    times = jnp.linspace(1.0, 7.0, 100)
    np.testing.assert_allclose(
        jax.vmap(history.amplitude)(times), np.interp(times, TIME, VALUE), atol=1e-13
    )


def test_a_start_over_the_whole_segment_is_a_parabola():
    history, x = load((0, 1, 0, 0)), np.linspace(0, 1, 11)
    found = jax.vmap(history.amplitude)(jnp.asarray(1.0 + 2.0 * x))
    np.testing.assert_allclose(found, -1.0 + 3.0 * x**2, atol=1e-13)


def test_smooth_history_is_the_quintic_at_rest_at_every_knot():
    history = load(smooth=True)
    first, second = jax.grad(history.amplitude), jax.grad(jax.grad(history.amplitude))
    for knot in TIME:
        sides = jnp.array([knot - 1e-9, knot, knot + 1e-9])
        np.testing.assert_allclose(jax.vmap(first)(sides), 0, atol=1e-12)
        np.testing.assert_allclose(jax.vmap(second)(sides), 0, atol=1e-4)
    x = np.linspace(0, 1, 21)
    # the polynomial of least degree with those six conditions
    powers = np.arange(6)
    rows = [0.0**powers, 1.0**powers]
    rows += [powers * np.r_[0, x0 ** powers[:-1]] for x0 in (0.0, 1.0)]
    rows += [powers * (powers - 1) * np.r_[0, 0, x0 ** powers[:-2]] for x0 in (0.0, 1.0)]
    shape = np.linalg.solve(np.array(rows), [0, 1, 0, 0, 0, 0])
    found = jax.vmap(history.amplitude)(jnp.asarray(3.5 + 3.5 * x))
    np.testing.assert_allclose(found, 2 + 3 * (x[:, None] ** powers @ shape), atol=1e-12)


def test_derivative_by_the_values_is_that_of_differences():
    history = load((0.3, 0, 0, 0.2))

    def value(values, time):
        moved = Load(history.dofs, history.weights, history.time, values, history.start)
        return moved.amplitude(time)

    for time in (0.55, 0.9, 2.0, 3.7, 9.0):
        exact = jax.grad(value)(history.value, time)
        quotient = [
            (value(history.value + d, time) - value(history.value - d, time)) / 2e-3
            for d in 1e-3 * np.eye(5)
        ]
        np.testing.assert_allclose(exact, quotient, atol=1e-10)
