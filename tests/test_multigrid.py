"""Multigrid on the structured grid: against a sparse direct solver, and how its iterations grow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg

from jaxmpm import grid
from jaxmpm.errors import RunError
from jaxmpm.multigrid import Multigrid, applied, halvable, prolonged, restricted

HASTY = True
jax.config.update("jax_enable_x64", True)  # as `jaxmpm.tensor` does for the whole package

E, NU, CELL, THICKNESS = 32000.0, 0.2, 2.5, 50.0
C = np.array([[1, NU, 0], [NU, 1, 0], [0, 0, (1 - NU) / 2]]) * E / (1 - NU**2)


def plate(nx, ny, crack=None):
    """Tangents, hourglass stiffness and free dofs of a notched plate, clamped below; a wavy crack bears `crack` of it."""
    filled = np.ones((nx, ny))
    filled[: nx // 5, ny // 2] = 0
    share = filled.copy()
    if crack is not None:
        i = np.arange(nx // 5, nx)
        share[i, ny // 2 + np.round(0.1 * ny * np.sin(i / 5)).astype(int)] = crack
    free = np.ones((2, nx + 1, ny + 1))
    free[:, :, 0] = 0
    return C[:, :, None, None] * share, share * float(grid.hourglass_stiffness(C[0, 0], C[2, 2])), free


def pulled(free):
    """Forces on the upper edge."""
    b = np.zeros(free.shape)
    b[0, :, -1], b[1, :, -1] = 300.0, 1000.0
    return b


def sparse(tangent, hourglass, free):
    """The stiffness as a sparse matrix, cell by cell from unit displacements of its corners."""
    unit = np.eye(8).reshape(8, 2, 2, 2)
    strain = [grid.strain(jnp.asarray(u), CELL) for u in unit]
    b = np.array([[float(m[0, 0]) for m in s.mean] for s in strain]).T
    q = np.array([[float(h[0, 0]) for h in s.hourglass] for s in strain]).T
    nx, ny = hourglass.shape
    node = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
    corners = np.stack([node[i : nx + i, j : ny + j] for i in (0, 1) for j in (0, 1)], axis=-1).reshape(-1, 4)
    dofs = np.concatenate([corners, node.size + corners], axis=1)
    blocks = CELL**2 * np.einsum("am,abc,bn->cmn", b, tangent.reshape(3, 3, -1), b) + np.einsum("am,c,an->cmn", q, hourglass.reshape(-1), q)
    rows, columns = np.repeat(dofs, 8, axis=1), np.tile(dofs, (1, 8))
    full = scipy.sparse.coo_array((THICKNESS * blocks.reshape(-1), (rows.reshape(-1), columns.reshape(-1)))).tocsc()
    keep = np.flatnonzero((free.reshape(-1) > 0) & (full.diagonal() > 0))
    return full, keep


@pytest.fixture(scope="module")
def coarse():
    return plate(18, 21, crack=1e-6)  # padded to 20 and 22


def test_what_it_solves_is_what_the_cells_do(coarse):
    solver = Multigrid(*coarse, CELL, THICKNESS)
    full, keep = sparse(*coarse)
    b = pulled(coarse[2])
    wanted = np.zeros(b.size)
    wanted[keep] = scipy.sparse.linalg.spsolve(full[keep][:, keep], b.reshape(-1)[keep])
    found = solver.solve(b)
    np.testing.assert_allclose(found.x.reshape(-1), wanted, atol=1e-6 * np.abs(wanted).max())
    assert found.residual < 1e-8 and found.iterations < 40
    x = np.random.default_rng(0).normal(size=b.shape) * coarse[2]
    padded = np.pad(x, ((0, 0), *((0, wide - n) for n, wide in zip((18, 21), halvable((18, 21))[0], strict=True))))
    images = np.asarray(applied(solver.levels.levels[0].stencil, jnp.asarray(padded)))[:, :19, :22]
    np.testing.assert_allclose(images.reshape(-1)[keep], (full @ x.reshape(-1))[keep], rtol=1e-9, atol=1e-6)


def test_a_coarse_level_is_galerkins(coarse):
    solver = Multigrid(*coarse, CELL, THICKNESS)
    fine, below = (level.stencil for level in solver.levels.levels[:2])
    x = jnp.asarray(np.random.default_rng(1).normal(size=(2, *below.shape[-2:])))
    wanted = restricted(applied(fine, prolonged(x)))
    np.testing.assert_allclose(applied(below, x), wanted, rtol=1e-9, atol=1e-6 * np.abs(wanted).max())


def test_interpolation_is_exact_for_linear_fields_and_restriction_its_transpose():
    i, j = np.indices((5, 4)).astype(float)
    coarse = jnp.asarray(np.stack([3 * i - j, i + 2 * j + 1]))
    i, j = np.indices((9, 7)) / 2
    np.testing.assert_allclose(prolonged(coarse), np.stack([3 * i - j, i + 2 * j + 1]), atol=1e-12)
    fine = jnp.asarray(np.random.default_rng(2).normal(size=(2, 9, 7)))
    assert float(jnp.vdot(prolonged(coarse), fine)) == pytest.approx(float(jnp.vdot(coarse, restricted(fine))))


def test_iterations_hardly_grow_with_the_grid_or_with_a_crack():
    counts = {}
    for n in (16, 32):
        for crack in (None, 1e-6):
            laid = plate(n, n, crack)
            counts[n, crack] = int(Multigrid(*laid, CELL, THICKNESS).solve(pulled(laid[2])).iterations)
    assert counts[32, None] <= 1.5 * counts[16, None]
    assert counts[32, 1e-6] <= 4 * counts[32, None]


def test_a_body_that_nothing_holds_has_no_solution():
    tangent, hourglass, free = plate(16, 16)
    with pytest.raises(RunError, match="held by nothing"):
        Multigrid(tangent, hourglass, jnp.ones_like(free), CELL, THICKNESS).solve(pulled(free))


def test_grids_are_padded_so_that_they_can_be_halved():
    assert halvable((18, 21)) == ((18, 22), 2)
    assert halvable((100, 100)) == ((104, 104), 4)
    assert halvable((7, 400)) == ((7, 400), 1)
    assert jax.eval_shape(prolonged, jax.ShapeDtypeStruct((2, 10, 12), float)).shape == (2, 19, 23)
