"""Cohesive laws: published curves, their energy, and mixed mode; the smeared crack beside them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm.laws.cohesive import CURVES, Cohesive, alone
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.smeared import Smeared

BULK = Elastic(32000.0, 0.2)
FT, GF = 3.0, 0.11
OPENING = np.linspace(0, 6 * GF / FT, 40001)


def published(curve, w):
    """σ(w)/f_t as the sources print it."""
    x = w * FT / GF
    if curve == "linear":
        return np.clip(1 - x / 2, 0, None)
    if curve == "bilinear":  # Petersson (1981)
        return np.interp(x, [0, 0.8, 3.6], [1, 1 / 3, 0])
    if curve == "exponential":
        return np.exp(-x)
    x = np.minimum(x / 5.136, 1)  # Hordijk (1991), w_c = 5.136 G_F/f_t
    return (1 + (3 * x) ** 3) * np.exp(-6.93 * x) - x * 28 * np.exp(-6.93)


@pytest.mark.parametrize("curve", CURVES)
def test_curve_is_the_published_one_and_holds_the_fracture_energy(curve):
    p = jnp.asarray(OPENING * FT / GF)
    value = np.asarray(CURVES[curve].value(p))
    np.testing.assert_allclose(value, published(curve, OPENING), atol=1e-4)
    area = np.asarray(CURVES[curve].area(p))
    sums = np.r_[0, np.cumsum((value[1:] + value[:-1]) / 2 * np.diff(np.asarray(p)))]
    np.testing.assert_allclose(area, sums, atol=1e-6)
    assert float(CURVES[curve].area(jnp.asarray(50.0))) == pytest.approx(1, abs=1e-12)
    slopes = -np.diff(value) / np.diff(np.asarray(p))
    assert CURVES[curve].steepest == pytest.approx(slopes.max(), rel=2e-3)


@pytest.mark.parametrize("curve", CURVES)
def test_alone_it_follows_its_curve_and_unloads_along_the_secant(curve):
    law = Cohesive(FT, GF, 0.8, 0.05, curve)
    normal = jnp.array([0.6, 0.8])
    stress = published(curve, OPENING[50:30000:3000])
    faces = OPENING[50:30000:3000] + stress * FT * 0.05 / 32000  # elastic part included
    pull = jax.jit(lambda delta, p: alone(law, delta * normal, p, BULK, normal))
    softening = jnp.zeros(())
    for delta, expected in zip(faces, stress, strict=True):
        traction, softening = pull(delta, softening)
        np.testing.assert_allclose(traction, expected * FT * normal, atol=1e-4 * FT)
    half, same = pull(faces[-1] / 2, softening)
    assert float(same) == float(softening)
    np.testing.assert_allclose(half, traction / 2, atol=1e-12)
    # pressed together it has the stiffness of the material
    pressed, _ = pull(-1e-4, softening)
    np.testing.assert_allclose(pressed, -1e-4 * 32000 / 0.05 * normal, rtol=1e-12)


def test_in_shear_it_is_as_strong_as_the_ratio_says_and_gives_up_the_same_energy():
    law = Cohesive(FT, GF, 0.8, 0.05, "exponential")
    normal, slide = jnp.array([1.0, 0.0]), jnp.array([0.0, 1.0])
    first = 0.8 * FT / (0.8**2 * 32000 / 0.05)  # where β f_t is reached
    steps = np.r_[first, first + np.geomspace(1e-6, 1.5, 3000)]

    def step(p, delta):
        traction, p = alone(law, delta * slide, p, BULK, normal)
        return p, traction[1]

    last, shear = jax.jit(lambda d: jax.lax.scan(step, jnp.zeros(()), d))(jnp.asarray(steps))
    assert float(shear.max()) == pytest.approx(0.8 * FT, rel=1e-6)
    work = np.trapezoid(np.r_[0, shear], np.r_[0, steps])
    assert work == pytest.approx(GF, rel=2e-3)
    assert float(law.given_up(last, BULK)) == pytest.approx(GF, rel=1e-6)


@pytest.mark.parametrize("direction", ["isotropic", "fixed", "rotating"])
def test_smeared_crack_dissipates_the_fracture_energy_until_it_is_brittle(direction):
    """Work of a cell pulled apart in uniaxial stress, over sizes; f_t²/2E H beyond 2 E G_F/f_t²."""
    damage = Damage(FT, 8.184, 0.128, 0.05)
    H = jnp.array([0.5, 20.0, 190.0, 700.0, 1500.0])
    law = Smeared.of(damage, BULK, H, direction)
    onset = FT / 32000
    strains = onset * np.r_[np.linspace(0.05, 1, 20), 1 + np.geomspace(1e-6, 1e8, 4000)]

    def step(carry, strain):
        history, last, before, work = carry
        vector = strain * jnp.array([1.0, -0.2, 0.0])[:, None] + 0 * H
        stress, history = law.respond(vector, history)
        work += (stress[0] + last) / 2 * (strain - before)
        return (history, stress[0], strain, work), None

    start = (law.initial(3), 0 * H, 0.0, 0 * H)
    work = jax.jit(lambda s: jax.lax.scan(step, start, s)[0][3])(jnp.asarray(strains)) * H
    expected = np.maximum(0.110036, FT**2 / 64000 * np.asarray(H))
    np.testing.assert_allclose(work, expected, rtol=2e-3)
