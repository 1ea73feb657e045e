"""Hooke's law against full tensors, and its release along a crack against the compliance."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import tensor
from jaxmpm.laws.elastic import Elastic, released_stress
from jaxmpm.laws.law import jacobian, tangent

SIZES = pytest.mark.parametrize("size", [3, 4])
E, NU = 32000.0, 0.2
BULK = Elastic(E, NU)
ANGLES = np.linspace(-np.pi / 2, np.pi / 2, 25)
NORMALS = jnp.asarray(np.stack([np.cos(ANGLES), np.sin(ANGLES)], 1))


def compliance(size, E=E, nu=NU):
    """Compliance in vector form; stresses that a vector does not hold are zero."""
    direct = tensor.NORMALS[size]
    matrix = np.diag([1.0] * direct + [2 * (1 + nu)] * (size - direct))
    matrix[:direct, :direct] += -nu + nu * np.eye(direct)
    return matrix / E


@partial(jax.jit, static_argnums=2)
def stiffness_at(normal, kept, size):
    stress = lambda strain: released_stress(BULK, strain, normal, kept)  # noqa: E731
    return jax.jacfwd(stress)(jnp.zeros(size))


@pytest.mark.parametrize("size", [1, 3, 4, 6])
def test_stiffness_is_the_inverse_of_the_compliance(size):
    for E_, nu in ((32000.0, 0.2), (45000.0, 0.0), (1.0, 0.45)):
        matrix = tangent(Elastic(E_, nu).stress, jnp.ones(size))
        np.testing.assert_allclose(matrix @ compliance(size, E_, nu), np.eye(size), atol=1e-13)
        direct, cross, shear = Elastic(E_, nu).coefficients(size)
        assert matrix[0, 0] == pytest.approx(direct, rel=1e-14)
        if size > 1:
            found = [matrix[0, 1], matrix[-1, -1]]
            np.testing.assert_allclose(found, [cross, shear], rtol=1e-14)


@SIZES
def test_tangent_is_that_of_central_differences(size):
    rng = np.random.default_rng(0)
    strain = rng.normal(size=(300, size)) * 1e-4
    exact = np.asarray(jax.vmap(lambda e: tangent(BULK.stress, e))(strain))
    reverse = np.asarray(jax.vmap(jax.jacrev(BULK.stress))(strain))
    step = 1e-5
    one, other = (
        np.stack([jax.vmap(BULK.stress)(strain + move * unit) for unit in np.eye(size)], 2)
        for move in (step, -step)
    )
    quotient = (one - other) / (2 * step)
    np.testing.assert_allclose(exact, quotient, rtol=0, atol=1e-9 * E)
    np.testing.assert_allclose(reverse, exact, rtol=1e-14, atol=1e-9)


def test_stress_out_of_plane_is_that_of_plane_strain():
    strain = jnp.array([1e-4, -3e-5, 0.0, 2e-5])
    xx, yy, zz, _ = BULK.stress(strain)
    assert float(zz) == pytest.approx(NU * float(xx + yy), rel=1e-14)


@SIZES
def test_all_kept_is_hooke(size):
    for normal in NORMALS:
        np.testing.assert_allclose(
            stiffness_at(normal, 1.0, size), tangent(BULK.stress, jnp.ones(size)), atol=1e-10
        )


@SIZES
def test_none_kept_leaves_no_stress_along_the_crack(size):
    for normal in NORMALS:
        matrix = np.asarray(stiffness_at(normal, 0.0, size))
        pick = tensor.along(jnp.stack([-normal[1], normal[0]]), size)
        np.testing.assert_allclose(np.asarray(pick) @ matrix, 0, atol=1e-10)
        across = np.asarray(tensor.along(normal, size))
        stiff = across @ matrix @ across
        # without strain out of plane that direction is still held in plane strain
        assert stiff == pytest.approx(E if size == 3 else E / (1 - NU**2), rel=1e-12)


@SIZES
@pytest.mark.parametrize("kept", [1.0, 0.5, 0.03, 1e-6, 1e-12])
def test_stiffness_is_the_inverse_of_the_degraded_compliance(size, kept):
    for normal in NORMALS:
        matrix = np.asarray(stiffness_at(normal, kept, size))
        np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=1e-10)
        pick = np.asarray(tensor.along(jnp.stack([-normal[1], normal[0]]), size))
        degraded = compliance(size) + (1 / kept - 1) / E * np.outer(pick, pick)
        np.testing.assert_allclose(
            matrix, np.linalg.inv(degraded), rtol=0, atol=E * max(1e-12, 1e-15 / kept)
        )
        assert np.linalg.eigvalsh(matrix).min() > -1e-9


def test_jacobian_is_jacfwd():
    def function(x):
        return jnp.stack([x[0] ** 2 * x[1], jnp.sin(x[0]) + x[1]]), x.sum()

    x = jnp.array([0.3, -1.2])
    found, value, aux = jacobian(function, x)
    np.testing.assert_array_equal(value, function(x)[0])
    exact, expected = jax.jacfwd(function, has_aux=True)(x)
    np.testing.assert_allclose(found, exact, rtol=1e-15)
    assert aux == expected


def test_release_in_a_solid_frees_both_directions_of_the_crack_plane():
    normal = jnp.array([0.48, -0.6, 0.64])
    matrix = np.asarray(stiffness_at(normal, 0.01, 6))
    degraded = compliance(6)
    for direction in tensor.in_the_plane_of(normal):
        pick = np.asarray(tensor.along(direction, 6))
        degraded += (1 / 0.01 - 1) / E * np.outer(pick, pick)
    np.testing.assert_allclose(matrix, np.linalg.inv(degraded), rtol=0, atol=E * 1e-11)
