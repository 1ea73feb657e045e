"""The checks of points that move, on coarse grids, and the exact solutions they rest on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import verify_bodies
from jaxmpm.laws.finite import NeoHookean
from jaxmpm.particles_per_cell import plot_particles_per_cell
from jaxmpm.shape_functions import Cubic, Linear, Quadratic
from jaxmpm.verify_moving import Bar, Vortex, fitted_order, noise, quadrature_noise
from jaxmpm.verify_points import lattice

HASTY = True  # see conftest.py


def balance(case, home, time, law, density):
    """a − ∇·P/ρ of the exact motion at one point, by automatic differentiation."""
    move = lambda x, t: x + case.displacement_of(x, t)

    def first(x):  # P = τ F⁻ᵀ
        f = jax.jacfwd(move)(x, time)
        tau = jnp.stack(law.kirchhoff(f - jnp.eye(len(x))))
        full = tau[:, None] if len(x) == 1 else jnp.array([[tau[0], tau[2]], [tau[2], tau[1]]])
        return full @ jnp.linalg.inv(f).T

    inertia = jax.jacfwd(jax.jacfwd(move, 1), 1)(home, time)
    return inertia - jnp.einsum("ijj->i", jax.jacfwd(first)(home)) / density


class _At:
    """One point as `Points` give it to a body force."""

    def __init__(self, home):
        self.home, self.mass = home[:, None], jnp.ones(1)


@pytest.mark.parametrize("time", [0.1, 0.7])
@pytest.mark.parametrize("home", [[0.8, 0.1], [-0.3, 0.9], [0.1, -1.2]])
def test_body_force_of_the_vortex_balances_its_motion(home, time):
    case = Vortex(0.4)
    exact = type("", (), {"displacement_of": staticmethod(lambda x, t: case.position(x, t) - x)})
    law = NeoHookean(jnp.array(case.young), jnp.array(case.poisson))
    expected = balance(exact, jnp.array(home), time, law, case.density)
    np.testing.assert_allclose(case(_At(jnp.array(home)), time)[:, 0], expected, rtol=1e-9, atol=1e-11)


def test_body_force_of_the_bar_balances_its_motion():
    case, home, time = Bar(0.1), jnp.array([0.3]), 0.4
    exact = type("", (), {"displacement_of": staticmethod(lambda x, t: 0.1 * jnp.sin(jnp.pi * x) * jnp.sin(jnp.pi * t))})
    expected = balance(exact, home, time, NeoHookean(jnp.array(1.0), jnp.array(0.0)), 1.0)
    np.testing.assert_allclose(case(_At(home), time)[:, 0], expected, rtol=1e-9)


def test_rings_fill_the_ring_and_nothing_turns_it():
    """Its inertia and the torque of the body force, which is the rate of its angular momentum."""
    case, time = Vortex(0.1), 0.4
    x, volume = case.rings(1 / 16, 2)
    radius = np.hypot(*x)
    assert volume.sum() == pytest.approx(np.pi * (1.25**2 - 0.75**2), rel=1e-12)
    assert (volume * radius**2).sum() == pytest.approx(np.pi / 2 * (1.25**4 - 0.75**4), rel=1e-10)
    points = type("", (), {"home": jnp.asarray(x), "mass": jnp.asarray(volume)})
    force, place = np.asarray(case(points, time)), case.position(x, time, np)
    torque = (volume * (place[0] * force[1] - place[1] * force[0])).sum()
    rate = (volume * radius**2 * case._turn(radius, time, np)[2]).sum()
    assert torque == pytest.approx(rate, rel=1e-3)


def test_noise_of_forces_is_that_of_poisson_s_sum():
    assert all(row["passed"] for row in noise())
    assert quadrature_noise(Quadratic(), 2, 1.0) < 1e-12  # whole h/s
    assert quadrature_noise(Cubic(), 2, 1.157) < 0.2 * quadrature_noise(Quadratic(), 2, 1.157)


@pytest.mark.parametrize("shape, each", [(Quadratic(), 4), (Cubic(), 2)], ids=str)
def test_splines_keep_their_order_in_the_crossing_bar(shape, each):
    assert fitted_order((8, 16), [Bar(0.05).error(n, shape, each=each) for n in (8, 16)]) > 1.88


def test_linear_functions_lose_their_order():
    assert fitted_order((8, 16), [Bar(0.05).error(n, Linear()) for n in (8, 16)]) < 0.5


def test_vortex_is_of_second_order():
    errors = [Vortex(0.1).error(n, Quadratic()) for n in (8, 16)]
    assert fitted_order((8, 16), errors) > 1.9
    assert errors[-1] < 3e-3


def test_a_uniform_stress_is_in_equilibrium_only_between_walls():
    assert verify_bodies._drift(Quadratic()) < 1e-12
    assert verify_bodies._drift(Quadratic(), "open", 2) > 1e-3


@pytest.mark.parametrize("check", [verify_bodies.vibrating_bar, verify_bodies.discs])
def test_rows_pass(check):
    rows = list(check())
    assert rows and all(row["passed"] for row in rows), rows


def test_an_order_of_what_failed_is_no_number():
    assert np.isnan(fitted_order((8, 16), [1.0, np.nan]))
    assert lattice((0,), (1,), 0.25).tolist() == [[0.125, 0.375, 0.625, 0.875]]


def test_plot_of_points_per_cell_shows_what_failed(tmp_path):
    lines = {"linear": [np.nan, 0.3], "GIMP": [0.1, 0.02], "quadratic B-spline": [0.1, 0.01], "cubic B-spline": [0.05, 0.01]}
    plot_particles_per_cell(tmp_path / "points.png", (1, 2), {16: lines})
    assert (tmp_path / "points.png").read_bytes()[:4] == b"\x89PNG"
