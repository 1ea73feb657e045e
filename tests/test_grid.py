"""Cell strains and nodal forces against an element with full Gauss integration in NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import grid
from jaxmpm.grid import CellStress
from jaxmpm.laws.elastic import Elastic

NX, NY, CELL, THICKNESS = 7, 5, 2.5, 10.0
SIZES = pytest.mark.parametrize("size", [3, 4])
DTYPES = pytest.mark.parametrize("dtype", [np.float64, np.float32])
CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
OFFSETS = (CORNERS + 1) // 2
POINTS = CORNERS / np.sqrt(3)


def gauss_matrices(cell):
    """Strain matrices B (4 points, 3, 8) of the bilinear square; dofs x1 y1 x2 y2 ..."""
    matrices = []
    for xi, eta in POINTS:
        by_x = CORNERS[:, 0] * (1 + CORNERS[:, 1] * eta) / 4 * (2 / cell)
        by_y = CORNERS[:, 1] * (1 + CORNERS[:, 0] * xi) / 4 * (2 / cell)
        B = np.zeros((3, 8))
        B[0, 0::2], B[1, 1::2] = by_x, by_y
        B[2, 0::2], B[2, 1::2] = by_y, by_x
        matrices.append(B)
    return np.array(matrices)


def element_forces(displacement, cell_forces):
    """Assemble nodal forces from `cell_forces(element displacements (8,), i, j) -> (8,)`."""
    total = np.zeros_like(displacement)
    for i in range(displacement.shape[1] - 1):
        for j in range(displacement.shape[2] - 1):
            nodes = [(i + a, j + b) for a, b in OFFSETS]
            u = np.array([displacement[:, p, q] for p, q in nodes]).ravel()
            force = cell_forces(u, i, j).reshape(4, 2)
            for (p, q), f in zip(nodes, force, strict=True):
                total[:, p, q] += f
    return total


def plane_stiffness(size, E, nu):
    """In-plane stiffness C (3, 3) and its coefficients."""
    direct, cross, shear = (np.asarray(c) for c in Elastic(E, nu).coefficients(size))
    matrix = np.array([[direct, cross, 0], [cross, direct, 0], [0, 0, shear]])
    return matrix, (direct, cross, shear)


def elastic_stress(strain, coefficients):
    direct, cross, shear = coefficients
    xx, yy, xy = strain.mean
    mean = (direct * xx + cross * yy, cross * xx + direct * yy, shear * xy)
    stiffness = grid.hourglass_stiffness(direct, shear)
    return CellStress(mean, tuple(stiffness * q for q in strain.hourglass))


def displacements(dtype=np.float64, seed=0):
    return np.random.default_rng(seed).normal(size=(2, NX + 1, NY + 1)).astype(dtype) * dtype(1e-3)


def positions():
    return np.stack(np.meshgrid(np.arange(NX + 1), np.arange(NY + 1), indexing="ij")) * CELL


def close(found, expected, dtype, factor=50):
    """Equal to round-off of the largest value."""
    atol = factor * np.finfo(dtype).eps * np.abs(expected).max()
    assert np.asarray(found).dtype == dtype
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


@jax.jit
def force_of(displacement, coefficients):
    stress = elastic_stress(grid.strain(displacement, CELL), coefficients)
    return grid.internal_force(stress, CELL, THICKNESS)


@DTYPES
@SIZES
@pytest.mark.parametrize("nu", [0.0, 0.2, 0.45])
def test_elastic_force_is_that_of_full_integration(size, nu, dtype):
    C, coefficients = plane_stiffness(size, 32000.0, nu)
    B, weight = gauss_matrices(CELL), CELL**2 / 4 * THICKNESS
    stiffness = np.einsum("gai,ab,gbj->ij", B, C, B) * weight
    u = displacements(dtype)
    expected = element_forces(u.astype(float), lambda u, i, j: stiffness @ u)
    close(force_of(u, tuple(dtype(c) for c in coefficients)), expected, dtype)


@DTYPES
def test_force_of_any_mean_stress_is_that_of_full_integration(dtype):
    rng = np.random.default_rng(1)
    mean = rng.normal(size=(3, NX, NY)).astype(dtype)
    none = np.zeros((NX, NY), dtype)

    @jax.jit
    def force(mean):
        return grid.internal_force(CellStress(tuple(mean), (none, none)), CELL, THICKNESS)

    B, weight = gauss_matrices(CELL), CELL**2 / 4 * THICKNESS
    expected = element_forces(
        np.zeros((2, NX + 1, NY + 1)),
        lambda u, i, j: np.einsum("gai,a->i", B, mean[:, i, j].astype(float)) * weight,
    )
    close(force(mean), expected, dtype)


@DTYPES
def test_strain_is_the_mean_over_the_gauss_points(dtype):
    u = displacements(dtype)
    found = grid.strain(jnp.asarray(u), CELL)
    B = gauss_matrices(CELL).mean(0)
    for i in range(NX):
        for j in range(NY):
            corners = np.array([u[:, i + a, j + b] for a, b in OFFSETS]).ravel().astype(float)
            mean = np.array([component[i, j] for component in found.mean])
            np.testing.assert_allclose(mean, B @ corners, atol=20 * np.finfo(dtype).eps * 1e-2)


@DTYPES
def test_force_is_the_gradient_of_the_energy(dtype):
    """Work conjugacy of mean and hourglass: f·v is the stress times the strain of v."""
    rng = np.random.default_rng(2)
    stress = CellStress(
        tuple(rng.normal(size=(3, NX, NY)).astype(dtype)),
        tuple(rng.normal(size=(2, NX, NY)).astype(dtype)),
    )
    v = displacements(dtype, seed=5)
    strain = grid.strain(jnp.asarray(v), CELL)
    product = lambda a, b: float((np.asarray(a, float) * np.asarray(b, float)).sum())  # noqa: E731
    power = CELL**2 * THICKNESS * product(stress.mean, strain.mean)
    power += THICKNESS * product(stress.hourglass, strain.hourglass)
    force = np.asarray(grid.internal_force(stress, CELL, THICKNESS), float)
    assert (force * v).sum() == pytest.approx(power, rel=1e-13 if dtype == np.float64 else 1e-4)


@DTYPES
@SIZES
def test_rigid_motion_costs_nothing(size, dtype):
    _, coefficients = plane_stiffness(size, 32000.0, 0.2)
    x, y = positions()
    moves = [np.stack([np.full_like(x, 0.3), np.full_like(x, -0.7)]), 1e-3 * np.stack([-y, x])]
    for move in moves:
        force = force_of(move.astype(dtype), tuple(dtype(c) for c in coefficients))
        # what a strain of round-off alone would make
        scale = 32000.0 * np.abs(move).max() * THICKNESS * np.finfo(dtype).eps
        assert np.abs(force).max() <= 50 * scale


@SIZES
def test_linear_field_leaves_the_inside_free(size):
    C, coefficients = plane_stiffness(size, 32000.0, 0.2)
    x, y = positions()
    gradient = np.array([[1e-3, -4e-4], [7e-4, 2e-3]])
    u = np.einsum("ab,bij->aij", gradient, np.stack([x, y]))
    strain = grid.strain(jnp.asarray(u), CELL)
    exact = [gradient[0, 0], gradient[1, 1], gradient[0, 1] + gradient[1, 0]]
    for component, value in zip(strain.mean, exact, strict=True):
        np.testing.assert_allclose(component, value, rtol=1e-12)
    np.testing.assert_allclose(strain.hourglass, 0, atol=1e-17)
    force = np.asarray(force_of(u, coefficients))
    np.testing.assert_allclose(force[:, 1:-1, 1:-1], 0, atol=1e-10)
    # and the edges carry the traction of the stress
    xx, yy, xy = C @ exact
    area = NY * CELL * THICKNESS
    np.testing.assert_allclose(force[:, -1].sum(1), [xx * area, xy * area], rtol=1e-12)
    area = NX * CELL * THICKNESS
    np.testing.assert_allclose(force[:, :, -1].sum(1), [xy * area, yy * area], rtol=1e-12)


@DTYPES
def test_forces_and_their_moment_add_up_to_nothing(dtype):
    rng = np.random.default_rng(3)
    stress = CellStress(
        tuple(rng.normal(size=(3, NX, NY)).astype(dtype)),
        tuple(rng.normal(size=(2, NX, NY)).astype(dtype)),
    )
    force = np.asarray(jax.jit(grid.internal_force, static_argnums=(1, 2))(stress, CELL, THICKNESS))
    x, y = positions()
    scale = np.abs(force).sum() * np.finfo(dtype).eps
    assert np.abs(force.astype(float).sum((1, 2))).max() <= scale
    moment = (x * force[1] - y * force[0]).sum()
    assert abs(moment) <= scale * x.max()


@DTYPES
def test_spread_shares_a_cell_among_its_nodes(dtype):
    field = np.random.default_rng(4).uniform(1, 2, (NX, NY)).astype(dtype)
    found = np.asarray(jax.jit(grid.spread)(field))
    expected = np.zeros((NX + 1, NY + 1))
    for i in range(NX):
        for j in range(NY):
            for a, b in OFFSETS:
                expected[i + a, j + b] += field[i, j] / 4
    close(found, expected, dtype, 4)
    assert found.astype(float).sum() == pytest.approx(field.astype(float).sum(), rel=1e-6)
