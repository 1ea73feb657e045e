"""Moving points: exact solutions, order of convergence, what is conserved."""


import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm.laws.finite import Corotated, NeoHookean
from jaxmpm.moving import Model, Numerics, Transfer, advance, energies, first_state
from jaxmpm.points import in_bins, listed
from jaxmpm.shape_functions import Cubic, Gimp, Linear, Quadratic

HASTY = True  # see conftest.py

SHAPES = [Linear(), Gimp(0.25), Quadratic(), Cubic()]
TRANSFERS = [Transfer("flip", flip=0.95), Transfer("taylor"), Transfer("apic"), Transfer("xpic", order=3)]


def body(shape, cells, cell, low, high, velocity, density=1.0, each=2, transfer=Transfer(), keep=None, room=3):
    """Points of a box, `each` to a cell along every axis, with a velocity field of the positions."""
    d = len(low)
    lines = [np.arange(a + cell / each / 2, b, cell / each) for a, b in zip(low, high, strict=True)]
    x = np.stack(np.meshgrid(*lines, indexing="ij")).reshape(d, -1)
    x = x if keep is None else x[:, keep(x)]
    n = x.shape[1]
    volume = np.full(n, (cell / each) ** d)
    fields = {
        "velocity": np.asarray(velocity(x), float), "stress": np.zeros((d * (d + 1) // 2, n)),
        "gradient": np.zeros((d, d, n)), "mass": density * volume,
        "volume": volume, "material": np.zeros(n, int), "home": x,
        "affine": np.zeros((d, d, n) if transfer.kind in ("apic", "taylor") else (0, 0, n)),
    }  # fmt: skip
    bins = tuple(c + shape.centred for c in cells)
    return in_bins(x, fields, np.zeros(d), cell, shape.centred, slots=room * each**d, bins=bins, window=(0,) * d)


def run(model, points, dt, steps):
    state = advance(model, first_state(points), jnp.asarray(dt), steps)
    assert int(state.step) == steps, state.room
    n = model.numerics
    return state, *listed(state.points, np.zeros(n.dimension), n.cell, n.shape.centred)


@pytest.mark.parametrize(
    "shape, transfer", [(s, TRANSFERS[1]) for s in SHAPES] + [(Quadratic(), t) for t in TRANSFERS[::2]] + [(Gimp(0.25), TRANSFERS[3])], ids=str
)
def test_free_fall_through_many_cells_strains_nothing(shape, transfer):
    points = body(shape, (12, 30), 1.0, (4, 22), (7, 26), lambda x: 0 * x + [[0.4], [0.0]], transfer=transfer)
    law = Corotated(jnp.array([100.0]), jnp.array([0.3]))
    model = Model(law, jnp.array([0.0, -1.0]), Numerics(1.0, (12, 30), shape, transfer))
    dt, steps = 0.02, 250
    _, x, fields = run(model, points, dt, steps)
    fallen = -dt * dt * steps * (steps + 1) / 2  # the sum that the scheme makes
    np.testing.assert_allclose(x[1] - fields["home"][1], fallen, rtol=0, atol=1e-9)
    np.testing.assert_allclose(x[0] - fields["home"][0], 0.4 * dt * steps, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fields["gradient"], 0, atol=1e-9)


@pytest.mark.parametrize("order", ["usf", "usl", "musl"])
def test_axially_vibrating_bar(order):
    """E = 100, ρ = 1, L = 25, first mode: the centre of mass moves with 0.063662 cos(ωt), ω = 0.628319."""
    shape = Quadratic()
    mode = lambda x: 0.1 * np.sin(np.pi * x / 50)  # noqa: E731
    points = body(shape, (30,), 1.0, (0,), (25,), mode)
    law = Corotated(jnp.array([100.0]), jnp.array([0.0]))
    model = Model(law, jnp.zeros(1), Numerics(1.0, (30,), shape, order=order, walls=(("stick", "open"),)))
    dt, state, times, speeds = 0.01, first_state(points), [], []
    for k in range(1, 21):
        state = advance(model, state, jnp.asarray(dt), 50 * k)
        mass = np.asarray(state.points.mass)
        speeds.append((mass * np.asarray(state.points.velocity[0])).sum() / mass.sum())
        times.append((50 * k - 0.5) * dt)
    np.testing.assert_allclose(speeds, 0.063662 * np.cos(0.628319 * np.array(times)), atol=1e-3)


def free_bar(shape, speed, transfer=Transfer()):
    """Displacement in its first mode after half a period of a bar that also flies."""
    law = NeoHookean(jnp.array([1.0]), jnp.array([0.0]))
    start = lambda x: 1e-4 * np.cos(np.pi * (x - 16) / 32) + speed  # noqa: E731
    points = body(shape, (100,), 1.0, (16,), (48,), start, each=4, transfer=transfer)
    model = Model(law, jnp.zeros(1), Numerics(1.0, (100,), shape, transfer))
    steps = 160
    _, x, fields = run(model, points, 32.0 / steps, steps)
    return (x - fields["home"] - speed * 32.0)[0] / 1e-4, fields["home"][0]


@pytest.mark.parametrize("shape", [Gimp(0.125), Quadratic(), Cubic()], ids=str)
def test_a_body_that_flies_vibrates_as_one_that_does_not(shape):
    """Points that cross cells leave nothing behind and take everything along."""
    still, flying = free_bar(shape, 0.0), free_bar(shape, 0.5)
    np.testing.assert_allclose(np.sort(flying[0]), np.sort(still[0]), atol=0.02)
    assert np.abs(still[0]).max() < 0.12  # it is back where it was, but for the error of the mesh


def manufactured(shape, cells, amplitude, transfer=Transfer(), each=2):
    """Largest error (rms over points, in time) of u = G sin(πX) sin(πt); E = ρ = 1, ν = 0.

    The neo-Hookean bar with fixed ends needs a body force π² u (F⁻² − 1)/2.
    """
    cell = 1 / cells

    def pull(points, time):
        wave, swing = jnp.sin(jnp.pi * points.home), jnp.sin(jnp.pi * time)
        stretch = 1 + amplitude * jnp.pi * jnp.cos(jnp.pi * points.home) * swing
        return jnp.pi**2 * amplitude * wave * swing * (stretch**-2 - 1) / 2

    start = lambda x: np.pi * amplitude * np.sin(np.pi * x)  # noqa: E731
    points = body(shape, (cells,), cell, (0,), (1,), start, each=each, transfer=transfer)
    law = NeoHookean(jnp.array([1.0]), jnp.array([0.0]))
    numerics = Numerics(cell, (cells,), shape, transfer, walls=(("stick", "stick"),))
    model = Model(law, jnp.zeros(1), numerics, pull)
    steps = 20 * cells
    dt, state, errors = 2 / steps, first_state(points), []
    for k in range(1, 11):
        state = advance(model, state, jnp.asarray(dt), k * steps // 10)
        assert int(state.step) == k * steps // 10
        x, fields = listed(state.points, np.zeros(1), cell, shape.centred)
        exact = amplitude * np.sin(np.pi * fields["home"]) * np.sin(np.pi * k * steps // 10 * dt)
        errors.append(np.sqrt(np.mean((x - fields["home"] - exact) ** 2)))
    return max(errors)


def orders(errors):
    return np.log2(np.array(errors[:-1]) / errors[1:])


@pytest.mark.parametrize("shape", [Linear(), Quadratic()], ids=str)
def test_without_crossing_all_functions_are_of_second_order(shape):
    assert (orders([manufactured(shape, n, 1e-4) for n in (8, 16, 32)]) > 1.9).all()


@pytest.mark.parametrize("shape, least", [(Quadratic(), 1.88), (Cubic(), 1.85)], ids=str)
def test_splines_keep_their_order_when_points_cross_cells(shape, least):
    assert (orders([manufactured(shape, n, 0.05) for n in (8, 16, 32)]) > least).all()


def test_linear_functions_lose_theirs():
    """The known failure of the method's first form: finer grids do not help."""
    errors = [manufactured(Linear(), n, 0.05) for n in (8, 16, 32)]
    assert errors[2] > errors[1] and errors[2] > 10 * manufactured(Quadratic(), 32, 0.05)


@pytest.mark.parametrize(
    "transfer, share", [(Transfer("flip"), 0.75), (Transfer("taylor"), 0.75), (Transfer("apic"), 0.3)], ids=str
)
def test_two_discs_collide(transfer, share):
    """Sulsky et al. (1994): momentum is kept to round-off, and most of the kinetic energy comes back."""
    shape, cell = Quadratic(), 1 / 16
    centres = np.array([[0.4, 0.4], [0.8, 0.8]])
    to = lambda x, k: np.hypot(x[0] - centres[k, 0], x[1] - centres[k, 1])  # noqa: E731
    keep = lambda x: (to(x, 0) < 0.2) | (to(x, 1) < 0.2)  # noqa: E731
    points = body(
        shape, (20, 20), cell, (0.1, 0.1), (1.1, 1.1),
        lambda x: np.where(to(x, 0) < 0.2, 0.1, -0.1) * np.ones((2, 1)), density=1000.0, keep=keep, transfer=transfer,
    )  # fmt: skip
    law = Corotated(jnp.array([1000.0]), jnp.array([0.3]))
    model = Model(law, jnp.zeros(2), Numerics(cell, (20, 20), shape, transfer))
    momentum = lambda p: np.asarray((p.mass * p.velocity).sum((1, 2, 3)))  # noqa: E731
    before, (start, *_) = momentum(points), map(float, energies(model, points))
    state, dt = first_state(points), 4e-3
    least = start
    for k in range(1, 13):
        state = advance(model, state, jnp.asarray(dt), 75 * k)
        assert int(state.step) == 75 * k
        now, stored, _ = map(float, energies(model, state.points))
        least = min(least, now)
        assert now + stored < 1.02 * start
    np.testing.assert_allclose(momentum(state.points), before, atol=1e-12 * start)
    assert least < 0.6 * start  # they have met
    assert now > share * start  # APIC filters the waves in the discs at every step
    _, fields = listed(state.points, np.zeros(2), cell, True)
    first = np.hypot(fields["home"][0] - 0.4, fields["home"][1] - 0.4) < 0.2
    assert (fields["velocity"][:, first].mean(1) < -0.05).all()  # and fly apart


def test_a_spinning_block_keeps_its_shape_energy_and_angular_momentum():
    shape, transfer, spin = Quadratic(), Transfer("taylor"), 1.0
    points = body(
        shape, (20, 20), 1.0, (6, 6), (14, 14), lambda x: spin * np.stack([10 - x[1], x[0] - 10]), transfer=transfer
    )
    turning = jnp.array([[0.0, -spin], [spin, 0.0]]).reshape(2, 2, 1, 1, 1)
    points = points._replace(affine=jnp.where(points.mass > 0, turning, 0.0))
    law = Corotated(jnp.array([1e4]), jnp.array([0.3]))
    model = Model(law, jnp.zeros(2), Numerics(1.0, (20, 20), shape, transfer))
    dt = 2e-3
    steps = round(np.pi / 2 / dt)
    first = sum(map(float, energies(model, points)))
    state, x, fields = run(model, points, dt, steps)
    whole = sum(map(float, energies(model, state.points)))
    angular = (fields["mass"] * ((x[0] - 10) * fields["velocity"][1] - (x[1] - 10) * fields["velocity"][0])).sum()
    home = fields["home"]
    begin = (fields["mass"] * ((home[0] - 10) ** 2 + (home[1] - 10) ** 2)).sum() * spin
    assert angular == pytest.approx(begin, rel=1e-3)
    assert whole == pytest.approx(first, rel=2e-3)
    assert whole == pytest.approx(begin * spin / 2, rel=0.05)  # masses at nodes spin with more energy
    # a quarter turn: (x, y) has become (−y, x)
    np.testing.assert_allclose(x[0] - 10, -(home[1] - 10), atol=0.05)
    np.testing.assert_allclose(x[1] - 10, home[0] - 10, atol=0.05)


@pytest.mark.parametrize("walls, inside", [("slip", True), ("stick", True), ("open", False)])
def test_edges_of_the_grid_hold_points_or_ask_for_room(walls, inside):
    shape = Quadratic()
    points = body(shape, (12, 12), 1.0, (2, 1), (6, 4), lambda x: 0 * x + [[0.3], [-1.0]])
    law = Corotated(jnp.array([50.0]), jnp.array([0.2]))
    model = Model(law, jnp.array([0.0, -0.5]), Numerics(1.0, (12, 12), shape, walls=((walls,) * 2,) * 2))
    state = advance(model, first_state(points), jnp.asarray(0.02), 400)
    _, fields = listed(state.points, np.zeros(2), 1.0, True)
    assert len(fields["mass"]) == 4 * 3 * 4  # none is lost
    assert (int(state.step) == 400 and not bool(state.room.window)) is inside
    if walls == "slip":
        assert fields["velocity"][0].mean() == pytest.approx(0.3, rel=1e-6)




@pytest.mark.parametrize("shape", [Linear(), Quadratic()], ids=str)
def test_a_bar_in_three_dimensions_moves_as_in_one(shape):
    """Without Poisson's effect; it flies through cells as well."""
    law = Corotated(jnp.array([1.0]), jnp.array([0.0]))
    found = []
    for d in (1, 3):
        start = lambda x: np.stack([*[0 * x[0]] * (d - 1), 0.1 + 1e-2 * np.cos(np.pi * (x[-1] - 2) / 8)])  # noqa: B023
        low, high = (*[2] * (d - 1), 2), (*[4] * (d - 1), 10)
        points = body(shape, (*[6] * (d - 1), 16), 1.0, low, high, start)
        model = Model(law, jnp.zeros(d), Numerics(1.0, (*[6] * (d - 1), 16), shape))
        _, x, fields = run(model, points, 0.1, 40)
        line = np.isclose(fields["home"][0], 2.25) if d == 3 else x[0] > 0
        line &= np.isclose(fields["home"][-2], 2.25) if d == 3 else line
        found.append((x[-1] - fields["home"][-1])[line][np.argsort(fields["home"][-1][line])])
        assert np.abs(x[:-1] - fields["home"][:-1]).max(initial=0.0) < 1e-12
    np.testing.assert_allclose(found[1], found[0], atol=1e-12)
    assert np.ptp(found[0]) > 5e-3
