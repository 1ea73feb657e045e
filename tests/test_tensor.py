"""Vector operations against the full tensors they stand for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import tensor

PLANE = pytest.mark.parametrize("size", [3, 4])
SIZES = pytest.mark.parametrize("size", [1, 3, 4, 6])
RNG = np.random.default_rng(3)
PLACES = {
    1: ["xx"], 3: ["xx", "yy", "xy"], 4: ["xx", "yy", "zz", "xy"],
    6: ["xx", "yy", "zz", "yz", "xz", "xy"],
}  # fmt: skip


def full(vector, shear=1.0):
    """Full tensors (k, 3, 3) of vectors (k, size); shear 0.5 for strain."""
    vector = np.asarray(vector)
    matrix = np.zeros((len(vector), 3, 3))
    for value, (a, b) in zip(vector.T, PLACES[vector.shape[1]], strict=True):
        i, j = "xyz".index(a), "xyz".index(b)
        matrix[:, i, j] = matrix[:, j, i] = value if a == b else shear * value
    return matrix


def units(count, size):
    """Random unit vectors of the dimension of a stress state."""
    vectors = RNG.normal(size=(count, tensor.DIMENSION[size]))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def padded(vectors):
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))


@SIZES
def test_symmetric_product_is_the_symmetric_dyad(size):
    n = units(50, size)
    w = RNG.normal(size=n.shape)
    found = full(jax.vmap(lambda a, b: tensor.symmetric_product(a, b, size))(n, w), 0.5)
    dyad = np.einsum("ki,kj->kij", padded(n), padded(w))
    np.testing.assert_allclose(found, (dyad + dyad.transpose(0, 2, 1)) / 2, atol=1e-15)


@SIZES
def test_traction_and_direct_stress_are_those_of_the_tensor(size):
    stress, n = RNG.normal(size=(50, size)), units(50, size)
    expected = np.einsum("kij,kj->ki", full(stress), padded(n))[:, : n.shape[1]]
    np.testing.assert_allclose(jax.vmap(tensor.traction)(stress, n), expected, atol=1e-14)
    along = jax.vmap(lambda d, s: tensor.dot(tensor.along(d, size), s))(n, stress)
    np.testing.assert_allclose(along, (expected * n).sum(1), atol=1e-14)


@SIZES
def test_a_stress_takes_on_a_traction_and_keeps_the_rest(size):
    """The change is the smallest that does: it has nothing in the plane of the normal."""
    stress, n = RNG.normal(size=(50, size)), units(50, size)
    asked = RNG.normal(size=n.shape)
    found = jax.vmap(tensor.with_traction)(stress, n, asked)
    np.testing.assert_allclose(jax.vmap(tensor.traction)(found, n), asked, atol=1e-14)
    change = full(found) - full(stress)
    across = np.eye(3) - np.einsum("ki,kj->kij", padded(n), padded(n))
    np.testing.assert_allclose(across @ change @ across, 0, atol=1e-14)


@SIZES
def test_directions_in_the_plane_complete_the_normal(size):
    for normal in [*units(20, size), -np.eye(tensor.DIMENSION[size])[-1]]:
        basis = np.stack([normal, *tensor.in_the_plane_of(jnp.asarray(normal))])
        np.testing.assert_allclose(basis @ basis.T, np.eye(tensor.DIMENSION[size]), atol=1e-15)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_solve_is_the_inverse(count):
    matrix, vector = RNG.normal(size=(40, count, count)), RNG.normal(size=(40, count))
    found = jax.vmap(tensor.solve)(matrix, vector)
    np.testing.assert_allclose(found, np.linalg.solve(matrix, vector[..., None])[..., 0], rtol=1e-9)


@SIZES
def test_points_along_a_trailing_axis_are_as_points_mapped_over(size):
    stress, n = RNG.normal(size=(9, size)), units(9, size)
    for function in (tensor.traction, lambda s, n: tensor.along(n, size)):
        many = function(jnp.asarray(stress.T), jnp.asarray(n.T))
        np.testing.assert_allclose(many.T, jax.vmap(function)(stress, n), atol=1e-15)
    values = tensor.principal_values(jnp.asarray(stress.T))
    one = jax.vmap(tensor.principal_values)(stress)
    np.testing.assert_allclose(values.T, one, atol=1e-14)
    slope = lambda s: jax.jvp(tensor.principal_values, (s,), (jnp.ones_like(s),))[1]  # noqa: E731
    np.testing.assert_allclose(slope(jnp.asarray(stress.T)).T, jax.vmap(slope)(stress), atol=1e-12)


@PLANE
def test_plane_components_go_in_and_out(size):
    plane = jnp.array([1.0, 2.0, 3.0])
    vector = tensor.from_plane(plane, size)
    np.testing.assert_array_equal(vector, [1, 2, 3] if size == 3 else [1, 2, 0, 3])
    np.testing.assert_array_equal(tensor.to_plane(vector), plane)


@SIZES
def test_dot_is_the_inner_product_along_the_first_axis(size):
    a, b = RNG.normal(size=(2, size, 6))
    np.testing.assert_allclose(tensor.dot(a, b), (a * b).sum(0), atol=1e-15)


@PLANE
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


@PLANE
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


def awkward_solids():
    """Solid stresses: random, diagonal, nearly diagonal, spherical, with two equal values, zero."""
    stress = RNG.normal(size=(3000, 6)) * 10 ** RNG.uniform(-3, 3, (3000, 1))
    stress[:300, 3:] = 0
    stress[300:600, 3:] *= 1e-9
    stress[600:900] = np.outer(RNG.normal(size=300), [1, 1, 1, 0, 0, 0])
    turn, _ = np.linalg.qr(RNG.normal(size=(300, 3, 3)))
    pair = np.einsum("kia,a,kja->kij", turn, [1.0, 1.0, -0.5], turn)
    stress[900:1200] = np.stack([pair[:, "xyz".index(a), "xyz".index(b)] for a, b in PLACES[6]], 1)
    stress[1200] = 0
    return stress


def test_principal_values_of_a_solid_are_those_of_the_eigenproblem():
    stress = awkward_solids()
    scale = np.abs(stress).max(1, keepdims=True) + 1e-300
    found = np.asarray(jax.vmap(tensor.principal_values)(stress))
    exact = np.linalg.eigvalsh(full(stress))[:, ::-1]
    np.testing.assert_allclose(found / scale, exact / scale, atol=1e-14)
    first = np.asarray(jax.vmap(tensor.first_principal_direction)(stress))
    image = np.einsum("kij,kj->ki", full(stress), first)
    np.testing.assert_allclose(image / scale, exact[:, :1] * first / scale, atol=1e-13)


def test_derivative_of_principal_values_of_a_solid():
    """By central differences of a smooth function symmetric in them, coinciding values too."""
    stress = awkward_solids()
    stress /= np.abs(stress).max(1, keepdims=True) + 1e-300
    squares = jax.vmap(lambda s: (jnp.maximum(tensor.principal_values(s), 0) ** 2).sum())
    gradient = jax.jit(jax.vmap(jax.grad(lambda s: squares(s[None])[0])))(stress)
    step = 1e-6
    for k, unit in enumerate(np.eye(6)):
        quotient = (squares(stress + step * unit) - squares(stress - step * unit)) / (2 * step)
        np.testing.assert_allclose(gradient[:, k], quotient, atol=3e-6)


def test_strain_sizes_name_every_stress_state():
    assert set(tensor.STRAIN_SIZE.values()) == {1, 3, 4, 6} == set(tensor.PAIRS)
    assert jnp.zeros(1).dtype == jnp.float64
