"""Multigrid on the structured grid: against a sparse direct solver, and how its iterations grow."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg

from jaxmpm import grid
from jaxmpm.elastic_grid import MANY, Multigrid, is_held, suits
from jaxmpm.errors import RunError
from jaxmpm.krylov import Border, gmres, image, no_border
from jaxmpm.multigrid import Shares, applied, coarsest_unknowns, cycle, halvable, hierarchy, prolonged, restricted, shares_of, stencil_of

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
    return plate(16, 15, crack=1e-6)  # padded to 16


def field_of(full, keep, x, shape):
    found = np.zeros(np.prod(shape))
    found[keep] = full[keep][:, keep] @ x.reshape(-1)[keep]
    return found.reshape(shape)


def test_what_it_solves_is_what_the_cells_do(coarse):
    solver = Multigrid(*coarse, CELL, THICKNESS)
    full, keep = sparse(*coarse)
    b = pulled(coarse[2])
    wanted = np.zeros(b.size)
    wanted[keep] = scipy.sparse.linalg.spsolve(full[keep][:, keep], b.reshape(-1)[keep])
    x, found = solver.solve(b)
    np.testing.assert_allclose(x.reshape(-1), wanted, atol=1e-8 * np.abs(wanted).max())
    assert found.residual < 1e-10 and found.steps < 40
    x = np.random.default_rng(0).normal(size=b.shape) * coarse[2]
    wanted = field_of(full, keep, x, b.shape)
    there = image(solver.operator, no_border(solver.grid.free.shape[1:]), solver.grid.vector(x))
    np.testing.assert_allclose(solver.grid.field(there)[0], wanted, rtol=1e-9, atol=1e-6)
    near = solver.levels.fine.stencil  # float32
    np.testing.assert_allclose(applied(near, solver.grid.pad(x))[:, :17, :16], wanted, atol=1e-5 * np.abs(wanted).max())


def test_an_unsymmetric_system_with_one_equation_more_against_a_dense_one():
    """Negative tangents in some cells, a border, and a preconditioner of an operator beside it."""
    tangent, hourglass, free = plate(16, 16)
    solver = Multigrid(tangent, hourglass, free, CELL, THICKNESS)
    on = solver.grid
    tangent = tangent.copy()
    tangent[:, :, 8, 3:9] = (np.diag([-300.0, 2e4, -100.0]) + np.array([[0, 50, 0], [0, 0, 0], [90, 0, 0]]))[:, :, None]
    operator, plain = on.operator(tangent, hourglass), no_border(on.free.shape[1:])
    rng = np.random.default_rng(4)
    column, row = (rng.normal(size=on.free.shape) * on.free for _ in range(2))
    size = on.free.size + 1
    border = Border(*map(jnp.asarray, (column, row, 0.3, 0 * column, 1.0)))
    matrix = np.asarray(jax.vmap(lambda x: image(operator, border, x))(jnp.eye(size))).T
    right = on.vector(pulled(free), 0.7)
    found = gmres(solver.levels, operator, border, right, 1e-9, 400)
    wanted = np.linalg.solve(matrix, np.asarray(right))
    assert found.residual < 1e-9
    np.testing.assert_allclose(found.x, wanted, atol=1e-6 * np.abs(wanted).max())
    one = np.asarray(gmres(solver.levels, operator, plain, on.vector(pulled(free)), 1e-9, 400).x)
    inner = matrix[:-1, :-1]
    np.testing.assert_allclose(one[:-1], np.linalg.solve(inner, np.asarray(right)[:-1]), atol=1e-6 * np.abs(one).max())


def test_levels_are_galerkins_and_the_cycle_is_symmetric(coarse):
    """The second hierarchy is that of alternating displacements; all in float64."""
    on = Multigrid(*coarse, CELL, THICKNESS).grid
    stencil = stencil_of(*on.operator(*coarse[:2]))
    levels = jax.jit(hierarchy)(stencil)
    rng = np.random.default_rng(1)
    x = jnp.asarray(rng.normal(size=(2, *levels.below.levels[0].stencil.shape[-2:])))
    i, j = np.indices(stencil.shape[-2:])
    for k, sign in enumerate((1, (-1.0) ** (i + j))):
        shares = jax.tree.map(lambda a: a[k], levels.shares)  # noqa: B023
        wanted = restricted(shares, sign * applied(stencil, sign * prolonged(shares, x)))
        found = applied(levels.below.levels[0].stencil[k], x)
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-6 * np.abs(wanted).max())
    a, b = (jnp.asarray(rng.normal(size=on.free.shape)) for _ in range(2))
    once = jax.jit(cycle)
    assert float(jnp.vdot(a, once(levels, b))) == pytest.approx(float(jnp.vdot(b, once(levels, a))), rel=1e-9)
    assert float(jnp.vdot(a, once(levels, a))) > 0


def test_interpolation_halves_where_nothing_differs_and_never_crosses_a_crack():
    tangent, hourglass, free = plate(16, 16)
    share = np.ones((16, 16))
    share[:, 5] = 1e-9  # a row of broken cells, above nodes that lie between coarse ones
    shares = shares_of(stencil_of(*map(jnp.asarray, (C[:, :, None, None] * share, hourglass * share, 0 * free + 1.0)), CELL, THICKNESS))
    i, j = np.indices((9, 9)).astype(float)
    coarse = jnp.asarray(np.stack([3 * i - j, i + 2 * j + 1]))
    wanted = np.stack([3 * i - j, i + 2 * j + 1])
    found = np.asarray(prolonged(shares, coarse))
    np.testing.assert_allclose(found[:, ::2, ::2], wanted, atol=1e-12)
    away = [0, 1, 2, 3, 8, 9, 10]
    p, q = np.indices((17, 17)) / 2
    np.testing.assert_allclose(found[:, 2:-2, away], np.stack([3 * p - q, p + 2 * q + 1])[:, 2:-2, away], atol=1e-8)
    np.testing.assert_allclose(found[:, ::2, 5], wanted[:, :, 2], atol=1e-6)  # from below alone, as the crack is above
    fine = jnp.asarray(np.random.default_rng(2).normal(size=(2, 17, 17)))
    assert float(jnp.vdot(prolonged(shares, coarse), fine)) == pytest.approx(float(jnp.vdot(coarse, restricted(shares, fine))))


def test_steps_hardly_grow_with_the_grid_or_with_a_crack():
    """Even with a wide zone of cells whose hourglass is free, as where many have just cracked."""
    counts = {}
    for n in (16, 48):
        for crack in (None, 1e-6):
            tangent, hourglass, free = plate(n, n, crack)
            if crack is not None:
                hourglass = hourglass.copy()
                hourglass[n // 4 : 3 * n // 4, n // 4 : 3 * n // 4] *= 1e-6
            counts[n, crack] = Multigrid(tangent, hourglass, free, CELL, THICKNESS).solve(pulled(free), 1e-8)[1].steps
    assert counts[48, None] <= 1.25 * counts[16, None]
    assert counts[48, 1e-6] <= 1.75 * counts[48, None]


def test_a_body_that_nothing_holds_has_no_solution():
    tangent, hourglass, free = plate(16, 16)
    with pytest.raises(RunError, match="held by nothing"):
        Multigrid(tangent, hourglass, np.ones_like(free), CELL, THICKNESS).solve(pulled(free))


def test_what_is_held_and_what_can_slide_or_turn():
    filled, free = np.ones((6, 4), bool), np.ones((2, 7, 5))
    assert not is_held(filled, free)
    free[:, 0, 0] = 0
    assert not is_held(filled, free)  # turns
    free[1, 6, 0] = 0
    assert is_held(filled, free)
    filled[3] = False
    assert not is_held(filled, free)  # a second body on one roller
    filled[3, 2] = True
    assert is_held(filled, free)
    filled[:, :] = False
    filled[0:3, 0:2] = filled[3:6, 2:4] = True  # two blocks hang together at a node
    assert not is_held(filled, free)
    free[:, 6, 4] = 0
    assert not is_held(filled, free)  # both held at a point in line with that node
    free[:, 6, 4], free[:, 6, 2] = 1, 0
    assert is_held(filled, free)
    free[0, 6, 2] = 1
    assert not is_held(filled, free)


def test_which_structures_suit():
    moves = scipy.sparse.identity(MANY, format="csr")
    assert suits((160, 160), moves)
    assert not suits((160, 160), scipy.sparse.identity(5_000, format="csr"))  # small
    tied = scipy.sparse.vstack([moves, moves]).tocsr()
    assert not suits((160, 160), tied)  # periodic
    assert not suits((3, 9000), moves)  # too long to be made coarse
    assert coarsest_unknowns((3, 9000)) > 20_000


def test_grids_are_padded_so_that_they_can_be_halved():
    assert halvable((18, 21)) == ((18, 22), 2)
    assert halvable((100, 100)) == ((104, 104), 4)
    assert halvable((7, 400)) == ((8, 400), 2)
    shares = Shares(*(jax.ShapeDtypeStruct(of, float) for of in ((2, 9, 12), (2, 10, 11), (4, 2, 9, 11))))
    assert jax.eval_shape(prolonged, shares, jax.ShapeDtypeStruct((2, 10, 12), float)).shape == (2, 19, 23)
