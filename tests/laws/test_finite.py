"""Laws for finite motion: stress is the derivative of the energy, and turns with the material."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.finite import Corotated, NeoHookean, rotation

DIMENSIONS = pytest.mark.parametrize("d", [1, 2, 3])
PAIRS = {1: [(0, 0)], 2: [(0, 0), (1, 1), (0, 1)], 3: [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]}


def deformations(d, size, count=200):
    """Random displacement gradients F − I (d, d, count), F near random rotations."""
    rng = np.random.default_rng(d)
    turn = np.linalg.qr(rng.normal(size=(count, d, d)))[0]
    turn[np.linalg.det(turn) < 0, :, 0] *= -1
    stretch = np.eye(d) + size * rng.normal(size=(count, d, d))
    return jnp.asarray(np.einsum("pij,pjk->ikp", turn, stretch)) - unit(d), turn


def unit(d):
    return np.eye(d)[..., None]


@DIMENSIONS
def test_rotation_is_that_of_the_polar_decomposition(d):
    deformation, _ = deformations(d, 0.15)
    found = np.moveaxis(np.asarray(rotation(deformation)), -1, 0)
    u, _, v = np.linalg.svd(np.moveaxis(np.asarray(deformation + unit(d)), -1, 0))
    np.testing.assert_allclose(found, u @ v, atol=1e-10)


@pytest.mark.parametrize("law", [Corotated(100.0, 0.3), Corotated(100.0, 0.3, True), NeoHookean(100.0, 0.3)], ids=str)
@DIMENSIONS
def test_stress_is_the_derivative_of_the_energy(law, d):
    """τ = ∂ψ/∂F Fᵀ, by automatic differentiation and by differences."""
    deformation, _ = deformations(d, 0.1)
    first = np.asarray(jax.grad(lambda f: law.energy(f).sum())(deformation))
    tau = np.einsum("ikp,jkp->ijp", first, deformation + unit(d))
    np.testing.assert_allclose(tau, tau.swapaxes(0, 1), atol=1e-9)
    found = np.asarray(law.kirchhoff(deformation))
    np.testing.assert_allclose(found, [tau[i, j] for i, j in PAIRS[d]], atol=1e-9)
    way = np.random.default_rng(0).normal(size=deformation.shape)
    change = (law.energy(deformation + 1e-5 * way) - law.energy(deformation - 1e-5 * way)) / 2e-5
    np.testing.assert_allclose(np.einsum("ijp,ijp->p", first, way), change, atol=1e-6)


@pytest.mark.parametrize("law", [Corotated(100.0, 0.3), NeoHookean(100.0, 0.3)], ids=str)
@pytest.mark.parametrize("d", [2, 3])
def test_rotation_alone_does_nothing_and_else_turns_the_stress(law, d):
    _, turn = deformations(d, 0.0)
    np.testing.assert_allclose(law.kirchhoff(jnp.asarray(np.moveaxis(turn, 0, -1) - unit(d))), 0, atol=1e-12)
    stretch, _ = deformations(d, 0.1)
    turned = jnp.einsum("pij,jkp->ikp", turn, stretch + unit(d)) - unit(d)
    before, after = np.asarray(law.kirchhoff(stretch)), np.asarray(law.kirchhoff(turned))
    full = np.zeros((2, d, d, before.shape[1]))
    for k, (i, j) in enumerate(PAIRS[d]):
        full[0, i, j] = full[0, j, i] = before[k]
        full[1, i, j] = full[1, j, i] = after[k]
    np.testing.assert_allclose(full[1], np.einsum("pij,jkp,plk->ilp", turn, full[0], turn), atol=1e-11)


@pytest.mark.parametrize("law, size", [(Corotated(100.0, 0.3, True), 3), (Corotated(100.0, 0.3), 4), (NeoHookean(100.0, 0.3), 4)])
def test_small_strains_are_those_of_the_linear_law(law, size):
    strain = 1e-7 * np.random.default_rng(0).normal(size=(3, 50))
    gradient = jnp.asarray([[strain[0], strain[2] / 2], [strain[2] / 2, strain[1]]])
    vector = strain if size == 3 else np.stack([strain[0], strain[1], 0 * strain[0], strain[2]])
    expected = np.asarray(Elastic(100.0, 0.3).stress(jnp.asarray(vector)))
    expected = expected if size == 3 else expected[[0, 1, 3]]
    np.testing.assert_allclose(law.kirchhoff(gradient), expected, atol=1e-10)


@pytest.mark.parametrize("law", [Corotated(100.0, 0.3), NeoHookean(100.0, 0.3)], ids=str)
def test_small_strains_keep_their_digits_in_single_precision(law):
    gradient = 1e-5 * np.random.default_rng(0).normal(size=(2, 2, 50))
    exact = np.asarray(law.kirchhoff(jnp.asarray(gradient)))
    found = np.asarray(law.kirchhoff(jnp.asarray(gradient, jnp.float32)))
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-6 * np.abs(exact).max())
