"""Vector operations against the full tensors they stand for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import tensor

SIZES = pytest.mark.parametrize("size", [3, 4])
RNG = np.random.default_rng(3)


def full(vector, shear=1.0):
    """Full tensors (k, 3, 3) of vectors (k, size); shear 0.5 for strain."""
    vector = np.asarray(vector)
    matrix = np.zeros((len(vector), 3, 3))
    matrix[:, 0, 0], matrix[:, 1, 1] = vector[:, 0], vector[:, 1]
    matrix[:, 0, 1] = matrix[:, 1, 0] = shear * vector[:, -1]
    if vector.shape[1] == 4:
        matrix[:, 2, 2] = vector[:, 2]
    return matrix


def units(count):
    angle = RNG.uniform(-np.pi, np.pi, count)
    return np.stack([np.cos(angle), np.sin(angle)], 1)


@SIZES
def test_symmetric_product_is_the_symmetric_dyad(size):
    n, w = units(50), RNG.normal(size=(50, 2))
    found = full(jax.vmap(lambda a, b: tensor.symmetric_product(a, b, size))(n, w), 0.5)
    dyad = np.einsum("ki,kj->kij", n, w)
    np.testing.assert_allclose(found[:, :2, :2], (dyad + dyad.transpose(0, 2, 1)) / 2, atol=1e-15)
    assert np.all(found[:, 2] == 0)


@SIZES
def test_traction_and_direct_stress_are_those_of_the_tensor(size):
    stress, n = RNG.normal(size=(50, size)), units(50)
    matrix = full(stress)[:, :2, :2]
    expected = np.einsum("kij,kj->ki", matrix, n)
    np.testing.assert_allclose(jax.vmap(tensor.traction)(stress, n), expected, atol=1e-14)
    along = jax.vmap(lambda d, s: tensor.dot(tensor.along(d, size), s))(n, stress)
    np.testing.assert_allclose(along, (expected * n).sum(1), atol=1e-14)


@SIZES
def test_plane_components_go_in_and_out(size):
    plane = jnp.array([1.0, 2.0, 3.0])
    vector = tensor.from_plane(plane, size)
    np.testing.assert_array_equal(vector, [1, 2, 3] if size == 3 else [1, 2, 0, 3])
    np.testing.assert_array_equal(tensor.to_plane(vector), plane)


@SIZES
def test_dot_is_the_inner_product_along_the_first_axis(size):
    a, b = RNG.normal(size=(2, size, 6))
    np.testing.assert_allclose(tensor.dot(a, b), (a * b).sum(0), atol=1e-15)


@SIZES
def test_principal_values_and_direction_are_those_of_the_eigenproblem(size):
    stress = RNG.normal(size=(400, size)) * 10 ** RNG.uniform(-3, 3, (400, 1))
    stress[0, -1] = 0.0
    found = np.asarray(jax.vmap(tensor.principal_values)(stress))
    plane = np.linalg.eigvalsh(full(stress)[:, :2, :2])[:, ::-1]
    scale = np.abs(stress).max(1, keepdims=True)
    np.testing.assert_allclose(found[:, :2] / scale, plane / scale, atol=1e-14)
    np.testing.assert_array_equal(found[:, 2], stress[:, 2] if size == 4 else 0 * found[:, 2])
    direction = np.asarray(jax.vmap(tensor.first_principal_direction)(stress))
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, rtol=1e-14)
    image = np.einsum("kij,kj->ki", full(stress)[:, :2, :2], direction)
    np.testing.assert_allclose(image / scale, plane[:, :1] * direction / scale, atol=1e-14)


@SIZES
def test_coinciding_principal_values_have_a_finite_derivative(size):
    """Of functions symmetric in the pair it is the right one: here of its sum and of squares."""
    for level in (0.0, 2.5, -1.0):
        stress = jnp.full(size, level).at[-1].set(0.0)
        values = tensor.principal_values(stress)
        slopes = jax.jacfwd(tensor.principal_values)(stress)
        np.testing.assert_array_equal(values[:2], level)
        sum_of_squares = jax.grad(lambda s: (tensor.principal_values(s)[:2] ** 2).sum())(stress)
        total = slopes[0] + slopes[1]
        unit = np.eye(size)
        np.testing.assert_allclose(total, unit[0] + unit[1], atol=1e-15)
        np.testing.assert_allclose(sum_of_squares, 2 * level * (unit[0] + unit[1]), atol=1e-15)


def test_strain_sizes_name_both_stress_states():
    assert tensor.STRAIN_SIZE == {"plane_stress": 3, "plane_strain": 4}
    assert jnp.zeros(1).dtype == jnp.float64
