"""The explicit step: motion, energy, opening of bands, growth of the pool."""


import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import bands, explicit, observe
from jaxmpm import model as models
from jaxmpm.run import Simulation, energy_error
from jaxmpm.scene import Scene, load_scene

HASTY = True  # see conftest.py


def scene(**changes):
    """A 20×20 mm block, free or loaded, elastic unless it is given a band."""
    tree = {
        "title": "block",
        "name": "block",
        "grid": {"size": [20.0, 20.0], "cell": 2.5, "stress_state": "plane_stress", "thickness": 1.0},
        "materials": {
            "rock": {"density": 2.4e-9, "bulk": {"law": "elastic", "E": 32000.0, "nu": 0.2}}
        },
        "bodies": [
            {
                "name": "block",
                "material": "rock",
                "shapes": [{"kind": "rectangle", "min": [0.0, 0.0], "max": [20.0, 20.0]}],
                "velocity": [3.0, -2.0],
            }
        ],
        "solver": {"duration": 1e-4, "damping": 0.0},
    }
    return Scene.from_dict(tree | changes)


def test_free_flight_keeps_momentum_and_shape():
    sim = Simulation.of(scene())
    sim.advance(sim.steps)
    momentum = (models.fields(sim.model).mass * sim.state.velocity).sum((1, 2))
    mass = 2.4e-9 * 400
    np.testing.assert_allclose(momentum, [3 * mass, -2 * mass], rtol=1e-12)
    moved = np.asarray(sim.state.displacement)
    time = sim.steps * sim.dt
    np.testing.assert_allclose(moved[0], 3.0 * time, rtol=1e-9)
    np.testing.assert_allclose(moved[1], -2.0 * time, rtol=1e-9)


def test_axial_wave_keeps_its_energy_and_its_period():
    """A bar with free ends in its first axial mode, v = cos(πx/L): period 2L/c, energy kept."""
    tree = scene().to_dict()
    tree["grid"]["size"] = [100.0, 2.5]
    tree["bodies"][0]["shapes"] = [{"kind": "rectangle", "min": [0.0, 0.0], "max": [100.0, 2.5]}]
    tree["materials"]["rock"]["bulk"]["nu"] = 0.0
    sim = Simulation.of(Scene.from_dict(tree))
    x = np.arange(41) * 2.5
    velocity = np.zeros((2, 41, 2))
    velocity[0] = np.cos(np.pi * x / 100.0)[:, None]
    start = models.first_state(sim.model, velocity)
    period = 2 * 100.0 / np.sqrt(32000.0 / 2.4e-9)
    steps = int(round(period / sim.dt))
    dt = period / steps
    end = explicit.advance(sim.model, start, jnp.asarray(dt), steps + 1)
    # lumped masses slow a mode of 40 cells by 2.6e-4: a phase of 1.6e-3 after one period
    np.testing.assert_allclose(end.velocity[0], velocity[0], atol=5e-3)
    assert abs(energy_error(jax.tree.map(np.asarray, observe.read(sim.model, end, dt)))) < 1e-3


def test_stable_time_step_is_where_the_scheme_goes_unstable():
    """Noise stays bounded at 0.999 of the estimate and blows up at 1.05 of it."""
    sim = Simulation.of(scene())
    noise = np.random.default_rng(0).normal(size=sim.model.free.shape)
    start = models.first_state(sim.model, noise)

    def largest(factor):
        end = explicit.advance(sim.model, start, jnp.asarray(factor * sim.stable_dt), 4000)
        return float(jnp.abs(end.velocity).max())

    assert largest(0.999) < 100 * np.abs(noise).max()
    # the estimate is a bound by one cell alone: the mesh may stand a little more, not much
    assert not largest(1.3) < 1e6


def test_small_step_of_a_pytree_is_what_advance_repeats():
    sim = Simulation.of(load_scene("bar", ["parameters.cell=5", "output.samples=4"]))
    dt = jnp.asarray(sim.dt)
    state = sim.state
    one = jax.jit(explicit.step)
    for _ in range(3):
        state = one(sim.model, state, dt)
    together = explicit.advance(sim.model, sim.state, dt, 3)
    for a, b in zip(jax.tree.leaves(state), jax.tree.leaves(together), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-20)


@pytest.fixture(scope="module")
def cracked_bar():
    sim = Simulation.of(load_scene("bar", ["parameters.cell=5", "output.samples=4"]))
    sim.advance(sim.steps)
    return sim


def test_bar_breaks_in_the_weak_column_only(cracked_bar):
    cells = np.asarray(cracked_bar.state.pool.cell)[: int(cracked_bar.state.pool.count)]
    weak = np.flatnonzero(cracked_bar.layout.material.reshape(-1) == 1)
    band = bands.bands_of(cracked_bar.state.pool, 3)
    broken = np.asarray(band.softening)[: len(cells)] > 10
    assert set(cells[broken]) == set(weak)
    normals = np.asarray(band.normal)[:, : len(cells)][:, broken]
    np.testing.assert_allclose(np.abs(normals[0]), 1.0, atol=1e-3)


def test_bar_dissipates_the_fracture_energy_of_its_section(cracked_bar):
    reading = cracked_bar.read()
    exact = 0.110036 * 0.95**2 * 10.0 * 10.0  # the weak column has 0.95 f_t
    assert float(reading.dissipated) == pytest.approx(exact, rel=0.01)
    assert abs(energy_error(reading)) < 1e-3


def test_growing_the_pool_changes_nothing(monkeypatch):
    """A run that starts with the smallest pool goes as one that has from the start the room that the first comes to.

    Not bit for bit: each capacity is a program of its own, which may round otherwise.
    """
    monkeypatch.setattr(bands, "BLOCK", 128)
    sim = Simulation.of(load_scene("den", ["grid.cell=5"]))
    steps = round(0.4 * sim.steps)
    small = models.first_state(sim.model, sim.layout.velocity, capacity=bands.BLOCK)
    sim.state = small
    sim.advance(steps)
    grown = sim.state
    first, last = (state.pool.cell.shape[0] for state in (small, grown))
    assert first < last
    sim.state = models.first_state(sim.model, sim.layout.velocity, capacity=last)
    sim.advance(steps)
    roomy = sim.state
    assert roomy.pool.cell.shape[0] == last
    count = int(roomy.pool.count)
    assert int(grown.pool.count) == count > bands.BLOCK - explicit.ROOM
    np.testing.assert_array_equal(grown.pool.cell[:count], roomy.pool.cell[:count])
    np.testing.assert_allclose(grown.displacement, roomy.displacement, atol=1e-6)
    for name in ("normal", "jump"):
        a, b = (getattr(bands.bands_of(state.pool, 3), name)[:, :count] for state in (grown, roomy))
        np.testing.assert_allclose(a, b, atol=1e-3)
