"""Checks of points that move, in closed form: a bar, free fall, patches, two discs."""

from collections.abc import Iterator
from itertools import pairwise

import jax.numpy as jnp
import numpy as np

from jaxmpm.laws.finite import Corotated, NeoHookean
from jaxmpm.moving import Model, Numerics, Transfer, energies, first_state
from jaxmpm.shape_functions import Cubic, Gimp, Linear, Quadratic
from jaxmpm.verify_points import body, forward, lattice, points_of, row

SHAPES = (("linear", Linear()), ("GIMP", Gimp(0.25)), ("quadratic", Quadratic()), ("cubic", Cubic()))
ROUND_OFF = 1e-10


def _corotated(young, poisson):
    return Corotated(jnp.array([young]), jnp.array([poisson]))


def vibrating_bar() -> Iterator[dict]:
    """First mode of a bar held at one end, E = 100, ρ = 1, L = 25, v₀ = 0.1 (mpmat)."""
    numerics = Numerics(1.0, (30,), Quadratic(), walls=(("stick", "open"),))
    model = Model(_corotated(100.0, 0.0), jnp.zeros(1), numerics)
    points = body(numerics, lattice((0,), (25,), 0.5), lambda x: 0.1 * jnp.sin(jnp.pi * x / 50), 0.5)
    dt, state, times, speeds = 0.01, first_state(points), [], []
    for k in range(1, 41):  # two periods
        state = forward(model, state, dt, 50 * k)
        mass = np.asarray(state.points.mass)
        speeds.append((mass * np.asarray(state.points.velocity[0])).sum() / mass.sum())
        times.append((50 * k - 0.5) * dt)
    times, speeds = np.array(times), np.array(speeds)
    miss = np.abs(speeds - 0.063662 * np.cos(0.628319 * times)).max() / 0.063662
    yield row("vibrating bar, velocity", miss, 0.0, 0.02)
    # the first and the last zero are whole half periods apart
    zeros = [t - v * (u - t) / (w - v) for (t, v), (u, w) in pairwise(zip(times, speeds, strict=True)) if v * w < 0]
    yield row("vibrating bar, period", 2 * (zeros[-1] - zeros[0]) / (len(zeros) - 1), 10.0, 2e-3)


def free_fall() -> Iterator[dict]:
    """A block that falls through many cells is nowhere strained and is where it should be."""
    dt, steps = 0.02, 250
    for name, shape in SHAPES:
        numerics = Numerics(1.0, (12, 30), shape)
        model = Model(_corotated(100.0, 0.3), jnp.array([0.0, -1.0]), numerics)
        start = lambda x: jnp.array([0.4, 0.0])
        points = body(numerics, lattice((4, 22), (7, 26), 0.5), start, 0.25, margin=15)
        x, fields = points_of(model, forward(model, first_state(points), dt, steps))
        # the sum that the scheme makes of g t²/2
        moved = np.array([[0.4 * dt * steps], [-dt * dt * steps * (steps + 1) / 2]])
        yield row(f"free fall, {name}, position", np.abs(x - fields["home"] - moved).max(), 0.0, ROUND_OFF)
        strain = fields["gradient"]
        yield row(f"free fall, {name}, strain", np.abs(strain).max(), 0.0, ROUND_OFF)


def patch() -> Iterator[dict]:
    """Affine velocities of points anywhere give a constant F; a uniform stress stays in equilibrium."""
    slope = np.array([[0.3, -0.5], [0.2, -0.1]])
    scatter = np.random.default_rng(0).uniform(3.0, 7.0, (2, 200))
    dt = 0.1
    for name, shape in SHAPES:
        numerics = Numerics(1.0, (10, 10), shape, Transfer("taylor"))
        model = Model(_corotated(0.0, 0.0), jnp.zeros(2), numerics)
        points = body(numerics, scatter, lambda x: jnp.asarray(slope) @ x, 0.1, slots=40)
        _, fields = points_of(model, forward(model, first_state(points), dt, 1))
        miss = fields["gradient"] - dt * slope[..., None]
        yield row(f"affine velocity, {name}, F", np.abs(miss).max(), 0.0, ROUND_OFF)
    for name, shape in SHAPES:
        yield row(f"uniform stress, {name}, displacement", _drift(shape), 0.0, ROUND_OFF)


def _drift(shape, walls="slip", steps=200):
    """How far points of a box full of uniformly stressed material move in a few periods."""
    law = NeoHookean(jnp.array([100.0]), jnp.array([0.3]))
    numerics = Numerics(1.0, (8, 8), shape, walls=((walls,) * 2,) * 2)
    points = body(numerics, lattice((0, 0), (8, 8), 0.5), jnp.zeros_like, 0.25, density=1.0)
    used = points.mass > 0
    stretch = jnp.array([[0.1, 0.0], [0.0, -0.2]]).reshape(2, 2, 1, 1, 1)
    gradient = jnp.where(used, stretch, points.gradient)
    stress = jnp.where(used, jnp.stack(law.kirchhoff(stretch)), 0.0)
    model = Model(law, jnp.zeros(2), numerics)
    points = points._replace(gradient=gradient, stress=stress)
    x, fields = points_of(model, forward(model, first_state(points), 0.02, steps))
    return np.abs(x - fields["home"]).max()


def discs() -> Iterator[dict]:
    """Two elastic discs meet and bounce, E = 1000, ν = 0.3, ρ = 1000, v = ±0.1 (Sulsky, Chen, Schreyer 1994)."""
    cell = 1 / 16
    numerics = Numerics(cell, (20, 20), Quadratic())
    model = Model(_corotated(1000.0, 0.3), jnp.zeros(2), numerics)
    x = lattice((0.1, 0.1), (1.1, 1.1), cell / 2)
    inside = [np.hypot(*(x - c)) < 0.2 for c in (0.4, 0.8)]
    start = lambda place: jnp.where(place.sum() < 1.2, 0.1, -0.1) * jnp.ones(2)
    points = body(numerics, x[:, inside[0] | inside[1]], start, (cell / 2) ** 2, density=1000.0, margin=4)
    state, dt = first_state(points), 4e-3
    begin, kinetic, whole = _sums(model, state)[0], [], []
    for k in range(1, 37):
        state = forward(model, state, dt, 25 * k)
        momentum, moving, total = _sums(model, state)
        kinetic.append(moving)
        whole.append(total)
    first = _sums(model, first_state(points))[1]
    scale = np.sqrt(2 * first * float(points.mass.sum()))
    yield row("discs, momentum", np.abs(momentum - begin).max() / scale, 0.0, 1e-12)
    yield row("discs, largest energy", max(whole) / first, 1.0, 0.02)
    yield row("discs, least kinetic energy", min(kinetic) / first, 0.4, 0.2, side="≤")
    share = kinetic[-1] / first
    yield row("discs, kinetic energy afterwards", share, 1.0, 0.25, side="≥")


def _sums(model, state):
    """Momentum (d,), kinetic and whole energy."""
    points = state.points
    momentum = np.asarray((points.mass * points.velocity).sum((1, 2, 3)))
    kinetic, stored, _ = map(float, energies(model, points))
    return momentum, kinetic, kinetic + stored
