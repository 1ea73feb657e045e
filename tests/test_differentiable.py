"""Derivatives of whole runs: against differences, in both modes, across cracks."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm.differentiable import NO_ROOM, Run, about_displacement, at_displacement, check, smooth_peak
from jaxmpm.errors import RunError, SceneError
from jaxmpm.scene import Scene

NAMES = ("concrete.ft", "concrete.E", "concrete.Ep", "concrete.n")


def scene(**solver):
    """A notched strip of 40×20 mm, pulled until its ligament has cracked."""
    rectangle = lambda low, high: {"kind": "rectangle", "min": low, "max": high}  # noqa: E731
    edge = lambda x: {"inside": [rectangle([x, 0.0], [x, 20.0])]}  # noqa: E731
    return Scene.from_dict({
        "title": "strip", "name": "strip",
        "grid": {"size": [40.0, 20.0], "cell": 5.0, "stress_state": "plane_stress", "thickness": 1.0},
        "materials": {"concrete": {
            "density": 2.4e-9, "bulk": {"law": "elastic", "E": 32000.0, "nu": 0.2},
            "band": {"law": "damage", "ft": 3.0, "Ep": 8.184, "n": 0.128, "h": 0.05},
        }},
        "bodies": [{
            "name": "strip", "material": "concrete", "shapes": [rectangle([0.0, 0.0], [40.0, 20.0])],
            "minus": [rectangle([15.0, 15.0], [20.0, 20.0])],
        }],
        "sets": {"left": edge(0.0), "right": edge(40.0)},
        "supports": [{"set": "left", "fix": ["x", "y"]}],
        "displacements": [{
            "set": "right", "direction": "x",
            "history": {"time": [0.0, 4e-4], "value": [0.0, 0.02], "smooth_start": 1e-4},
        }],
        "gauges": {
            "load": {"kind": "reaction", "set": "right", "direction": "x"},
            "pull": {"kind": "displacement", "set": "right", "direction": "x"},
        },
        "response": {"load": "load", "displacement": "pull"},
        "solver": {"duration": 4e-4, "damping": 0.0, "viscosity": 0.1, "frame": "total"} | solver,
    })  # fmt: skip


def answers(run, values, reverse=False):
    return answers_of(run(run.with_values(values), reverse))


def answers_of(history):
    """Work, smooth peak and the load at a displacement."""
    load = history.gauges["load"]
    there = at_displacement(load, history.gauges["pull"], 0.012)
    return jnp.stack([history.work[-1], smooth_peak(load, 0.2), there])


def compiled(function, *args, level=1):
    """Compiled in little time; that it runs in more is no matter here."""
    options = {"xla_backend_optimization_level": level}
    return jax.jit(function).lower(*args).compile(compiler_options=options)


@pytest.fixture(scope="module")
def run():
    return Run.of(scene(), samples=24)


@pytest.fixture(scope="module")
def both(run):
    """Answers for relative changes of the parameters from a state, their derivatives one way, and the history."""
    start = run.values(NAMES)

    def of(changes, state):
        values = {name: start[name] * (1 + x) for name, x in zip(NAMES, changes, strict=True)}
        history = replace(run, state=state)(run.with_values(values))
        return answers_of(history), history

    none = jnp.zeros(len(NAMES))
    program = lambda x, d, state: jax.jvp(lambda x: of(x, state), (x,), (d,), has_aux=True)  # noqa: E731
    return compiled(program, none, none, run.state)


@pytest.fixture(scope="module")
def value_and_slopes(run, both):
    """Answers for relative changes of the parameters, and their derivatives (parameters, answers)."""
    none, units = jnp.zeros(len(NAMES)), jnp.eye(len(NAMES))
    slopes = np.stack([both(none, d, run.state)[1] for d in units])
    return lambda x: np.asarray(both(none + x, units[0], run.state)[0]), slopes


def test_forward_mode_agrees_with_central_differences(value_and_slopes):
    """Where no crack opens in another step: to 0.1 %."""
    value, slopes = value_and_slopes
    for unit, got in zip(np.eye(len(NAMES)), slopes, strict=True):
        wanted = (value(1e-6 * unit) - value(-1e-6 * unit)) / 2e-6
        np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-4 * np.abs(slopes).max())


def test_reverse_mode_agrees_with_forward_mode(run, value_and_slopes):
    _, slopes = value_and_slopes
    start = run.values(NAMES)
    weights = jnp.asarray([0.3, 1.0, -0.7])
    # hardly optimised: should that ever make it wrong (see conftest.py), the other mode, which is, says so
    back = compiled(jax.grad(lambda values: weights @ answers(run, values, reverse=True)), start, level=0)(start)
    got = np.array([back[name] * start[name] for name in NAMES])
    np.testing.assert_allclose(got, slopes @ weights, rtol=1e-7, atol=1e-9 * np.abs(slopes).max())


def test_a_derivative_is_the_slope_over_a_range_in_which_cracks_change_steps(value_and_slopes):
    """Over ±2 % of the strength each crack opens up to six steps earlier or later, without a leap."""
    value, slopes = value_and_slopes
    x = np.linspace(-0.02, 0.02, 21)
    answers = np.array([value(each * np.eye(len(NAMES))[0]) for each in x])
    for k, limit in enumerate((1e-4, 5e-4, 5e-4)):
        left = answers[:, k] - np.polyval(np.polyfit(x, answers[:, k], 3), x)
        assert np.abs(left).max() < limit * answers[:, k].mean()
        assert abs(slopes[0, k] / np.polyfit(x, answers[:, k], 1)[0] - 1) < 0.03


def test_single_precision_has_the_derivatives_of_double(value_and_slopes):
    run = Run.of(scene(precision="float32"), samples=24)
    one = jnp.float32(1)
    program = lambda ft: jax.jvp(lambda v: answers(run, {"concrete.ft": v}), (ft,), (one,))  # noqa: E731
    value, slope = compiled(program, 3 * one, level=0)(3 * one)
    assert value.dtype == jnp.float32
    np.testing.assert_allclose(3 * slope, value_and_slopes[1][0], rtol=1e-3)


def test_a_pool_without_room_leaves_no_number_to_trust(run, both):
    short = run.state._replace(pool=run.state.pool._replace(count=jnp.int32(10**6)))
    *_, history = both(jnp.zeros(len(NAMES)), jnp.zeros(len(NAMES)), short)
    assert (history.status == NO_ROOM).all()
    assert np.isnan(history.gauges["load"]).all()
    with pytest.raises(RunError, match="capacity"):
        check(history)


def test_what_has_no_derivative_is_refused():
    with pytest.raises(SceneError, match="solver.damping = 0.02"):
        Run.of(scene(damping=0.02))
    with pytest.raises(SceneError, match='"updated"'):
        Run.of(scene(frame="updated"))
    run = Run.of(scene())
    with pytest.raises(SceneError, match="did you mean concrete.ft"):
        run.with_values({"concrete.ftt": 3.0})


def test_smooth_peak_is_the_peak_of_a_flat_curve():
    assert smooth_peak(jnp.full(5, 3.0), 0.1) == pytest.approx(3.0)


def test_the_load_about_a_displacement_keeps_a_straight_line_and_loses_vibration():
    displacement = jnp.linspace(0.0, 0.06, 241)  # even: the middle of the triangle is a sample
    straight = 20.0 - 100.0 * displacement
    vibrates = straight + jnp.cos(2 * jnp.pi * displacement / 0.002)
    found = [about_displacement(load, displacement, 0.03, 0.004) for load in (straight, vibrates)]
    np.testing.assert_allclose(found, 17.0, rtol=1e-12)
