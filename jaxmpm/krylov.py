"""GMRES, preconditioned by multigrid: linear systems on the grid, and those with one unknown and one equation more.

The operator is applied cell by cell in float64, nothing of it is stored but what cells have; the preconditioner is a V-cycle of a
symmetric operator near it, in float32. GMRES (Y. Saad, M. Schultz, SIAM J. Sci. Stat. Comput. 7, 1986) in its flexible form
(Y. Saad, SIAM J. Sci. Comput. 14, 1993) takes both, whether the operator is symmetric and positive or not.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import multigrid
from jaxmpm.compilation import program

RESTART = 30  # steps after which GMRES begins again from the residual it has left


class Operator(NamedTuple):
    """The stiffness of a grid that can be halved (`multigrid.halvable`), cell by cell."""

    tangent: jax.Array  # dσ/dε in plane, MPa, (3, 3, nx, ny)
    hourglass: jax.Array  # stiffness of either hourglass amplitude per thickness, MPa, (nx, ny)
    free: jax.Array  # 1 where a degree of freedom may move, (2, nx+1, ny+1)
    cell: jax.Array  # mm
    thickness: jax.Array  # mm


class Border(NamedTuple):
    """One unknown and one equation more: column · factor is added to the forces, row · x + own · factor is what is controlled."""

    column: jax.Array  # (2, nx+1, ny+1)
    row: jax.Array  # (2, nx+1, ny+1)
    own: jax.Array
    ahead: jax.Array  # about K⁻¹ column, (2, nx+1, ny+1)
    pivot: jax.Array  # own − row · ahead


class Krylov(NamedTuple):
    """What GMRES has built: the operator times `ahead` is `basis` times `hessenberg`."""

    ahead: list  # preconditioned basis vectors, float32
    hessenberg: np.ndarray  # (steps + 1, steps)
    left: float  # residual over the right side that the best combination leaves


class Solved(NamedTuple):
    """A solution, how many steps it took, and its true residual over the right side."""

    x: jax.Array
    steps: int
    residual: float


def no_border(shape, dtype=float) -> Border:
    """That of a system without one, nodal fields (2, *shape)."""
    none, one = jnp.zeros((2, *shape), dtype), jnp.ones((), dtype)
    return Border(none, none, one, none, one)


@jax.jit
def prepared(operator: Operator) -> multigrid.Hierarchy:
    """The preconditioner of a symmetric positive operator, in the precision of its fields."""
    return multigrid.hierarchy(multigrid.stencil_of(*operator))


@jax.jit
def image(operator, border, x):
    """The operator, and the border's equation, on a vector (dofs + 1,): a nodal field and the factor."""
    field, factor = x[:-1].reshape(operator.free.shape), x[-1]
    tangent, hourglass, free, cell, thickness = operator
    force = free * multigrid.internal_force(tangent, hourglass, free * field, cell, thickness) + (1 - free) * field
    last = jnp.vdot(border.row, field) + border.own * factor
    return jnp.append((force + border.column * factor).reshape(-1), last)


@jax.jit
def ahead(levels, operator, border, x):
    """A vector preconditioned, float32, and its image."""
    low = levels.fine.stencil.dtype
    field = x[:-1].reshape(operator.free.shape)
    found = multigrid.cycle(levels, field.astype(low)).astype(x.dtype)
    factor = (x[-1] - jnp.vdot(border.row, found)) / border.pivot
    there = jnp.append((found - factor * border.ahead).reshape(-1), factor).astype(low)
    return there, image(operator, border, there.astype(x.dtype))


@jax.jit
def _begun(start):
    """A basis with room for `RESTART` vectors more than the first, and that."""
    unit = start / jnp.linalg.norm(start)
    return jnp.zeros((RESTART + 1, len(start)), start.dtype).at[0].set(unit), unit


@partial(jax.jit, donate_argnums=0)
def _orthogonalised(basis, k, x):
    """The basis with one vector more, of what is left of x besides the first k + 1; that vector, and the components of x."""

    def one(i, carry):
        x, components = carry
        share = jnp.vdot(basis[i], x)
        return x - share * basis[i], components.at[i].set(share)

    rest, components = lax.fori_loop(0, k + 1, one, (x, jnp.zeros(basis.shape[0], basis.dtype)))
    size = jnp.linalg.norm(rest)
    unit = rest / jnp.where(size > 0, size, 1.0)
    return lax.dynamic_update_index_in_dim(basis, unit, k + 1, 0), unit, components.at[k + 1].set(size)


@jax.jit
def _sum(x, factor, y):
    return x + factor * y.astype(x.dtype)


def arnoldi(levels, operator, border, start, tolerance, most=RESTART) -> Krylov:
    """The Krylov space of a start vector (dofs + 1,), of `RESTART` steps at most, until it holds a solution to a tolerance."""
    advance = program(ahead, levels, operator, border, start, optimised=False)
    basis, unit = _begun(start)
    found, hessenberg = [], np.zeros((RESTART + 1, RESTART))
    null = np.zeros(RESTART + 1)  # a vector that the Hessenberg matrix takes to zero from the left: it gives the residual
    null[0] = left = 1.0
    while len(found) < most and left > tolerance:
        k = len(found)
        there, x = advance(levels, operator, border, unit)
        basis, unit, components = _orthogonalised(basis, k, x)
        found.append(there)
        hessenberg[:, k] = components
        if not np.isfinite(hessenberg[k + 1, k]) or hessenberg[k + 1, k] <= 0:
            break
        null[k + 1] = -(null[: k + 1] @ hessenberg[: k + 1, k]) / hessenberg[k + 1, k]
        left = 1 / np.linalg.norm(null[: k + 2])
    steps = len(found)
    return Krylov(found, hessenberg[: steps + 1, :steps], left)


def bordered(levels, operator, column, row, own) -> tuple[Border, float]:
    """The border of a column and a row, fields (2, nx+1, ny+1), and what its equation has been multiplied by.

    That makes errors in it count as much as the forces that they would take.
    """
    plain, column, row = no_border(operator.free.shape[1:]), jnp.asarray(column), jnp.asarray(row)
    asked = levels, operator, plain, jnp.append(column.reshape(-1), 0.0)
    there = program(ahead, *asked, optimised=False)(*asked)[0][:-1].reshape(column.shape).astype(column.dtype)
    pivot = own - jnp.vdot(row, there)
    scale = (jnp.linalg.norm(column) or 1.0) / jnp.abs(pivot)
    return Border(column, scale * row, scale * own, there, scale * pivot), float(scale)


def combined(space: Krylov, weights):
    """A combination of the preconditioned vectors."""
    total = jnp.zeros(space.ahead[0].shape, float)
    for weight, vector in zip(weights, space.ahead, strict=True):
        total = _sum(total, weight, vector)
    return total


def gmres(levels, operator, border, right, tolerance, most=RESTART, start=None) -> Solved:
    """Solution of a system for a right side (dofs + 1,), to a residual of `tolerance` times the right side.

    Begins at zero, or at `start` where that is better. Stops after about `most` steps, or where another round does not help: its
    residual, worked out anew, says how good it is.
    """
    apply = program(image, operator, border, right)
    size, x, rest, steps, left = float(jnp.linalg.norm(right)), jnp.zeros_like(right), right, 0, 1.0
    if not size > 0:
        return Solved(x, 0, 0.0)
    if start is not None:
        after = right - apply(operator, border, start)
        now = float(jnp.linalg.norm(after)) / size
        if now < 1:
            x, rest, left = start, after, now
    while left > tolerance and steps < most:
        space = arnoldi(levels, operator, border, rest, tolerance / left, min(RESTART, most - steps))
        first = np.zeros(len(space.hessenberg))
        first[0] = left * size
        if not np.isfinite(space.hessenberg).all():
            return Solved(jnp.full_like(x, jnp.nan), steps, np.inf)
        better = x + combined(space, np.linalg.lstsq(space.hessenberg, first)[0])
        steps += len(space.ahead)
        after = right - apply(operator, border, better)
        now = float(jnp.linalg.norm(after)) / size
        if not now < left:
            break
        x, rest, stalled, left = better, after, now > 0.5 * left, now
        if stalled:
            break
    return Solved(x, steps, left)
