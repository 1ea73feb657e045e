"""Large elastic systems on the structured grid: conjugate gradients, preconditioned by geometric multigrid.

A level keeps its operator as a stencil, the 2 × 2 blocks that couple a node with its eight neighbours and
itself, so that applying it is nine shifted products. Coarse operators are Galerkin's, Pᵀ A P with
bilinear P, which know of holes, supports and cracked cells whatever their shape. Smoothing is
Chebyshev's, on the diagonal blocks: symmetric, and the same on any device. The coarsest level is solved
directly. (U. Trottenberg, C. Oosterlee, A. Schüller, Multigrid, Academic Press, 2001.)
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import grid
from jaxmpm.compilation import program
from jaxmpm.errors import RunError

SHIFTS = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1))
COARSEST = 8  # cells along the shorter side below which a level is solved directly
DEGREE = 3  # of the smoother's polynomial
BAND = 6.0  # the smoother damps the upper part of the spectrum, from the largest value over this
TOLERANCE, MOST = 1e-8, 500  # of the residual over that of zero; iterations


class Level(NamedTuple):
    """One level; nodes (nx+1, ny+1)."""

    stencil: jax.Array  # (9, 2, 2, nx+1, ny+1), N/mm
    inverse: jax.Array  # of the diagonal blocks, (2, 2, nx+1, ny+1)
    largest: jax.Array  # eigenvalue of inverse · stencil


class Hierarchy(NamedTuple):
    """Levels, fine first, and the inverse of the last one, (dofs, dofs)."""

    levels: tuple
    last: jax.Array


class Multigrid:
    """The stiffness of a grid, ready to be solved for many right sides.

    Args:
        tangent: dσ/dε of each cell in plane, MPa, (3, 3, nx, ny); zero where empty, symmetric.
        hourglass: stiffness of either hourglass amplitude per thickness, MPa, (nx, ny).
        free: 1 where a degree of freedom may move, (2, nx+1, ny+1).
        cell, thickness: mm.
    """

    def __init__(self, tangent, hourglass, free, cell, thickness):
        shape = np.shape(hourglass)
        more = [(0, wide - n) for n, wide in zip(shape, halvable(shape)[0], strict=True)]
        pad = lambda a: jnp.pad(jnp.asarray(a), [(0, 0)] * (np.ndim(a) - 2) + more)  # noqa: E731
        self.nodes = tuple(n + 1 for n in shape)
        self.free = pad(free)
        laid = (pad(tangent), pad(hourglass), self.free, jnp.asarray(cell, self.free.dtype), jnp.asarray(thickness, self.free.dtype))
        stencil = program(_stencil_of, *laid)(*laid)
        self.levels = program(hierarchy, stencil)(stencil)
        self._pad = pad

    def solve(self, b) -> "Solved":
        """Displacements (mm) under forces b (2, nx+1, ny+1), N; zero where nothing is free.

        Raises RunError where the residual does not come down to `TOLERANCE` times the forces in `MOST` iterations.
        """
        b = self._pad(b) * self.free
        found = program(conjugate_gradients, self.levels, b)(self.levels, b)
        if not float(found.residual) <= 2 * TOLERANCE:
            raise RunError(
                f"the linear system kept a residual of {float(found.residual):.1e} after {int(found.iterations)} "
                "iterations: a part of the body is held by nothing, or its stiffness is not positive"
            )
        return found._replace(x=found.x[:, : self.nodes[0], : self.nodes[1]])


class Solved(NamedTuple):
    """A solution, (2, nx+1, ny+1), how many iterations it took, and its true residual over the right side."""

    x: jax.Array
    iterations: jax.Array
    residual: jax.Array


def stencil_of(tangent, hourglass, free, cell, thickness):
    """The stiffness of a grid as a stencil.

    Args:
        tangent: dσ/dε of each cell in plane, MPa, (3, 3, nx, ny); zero where empty.
        hourglass: stiffness of either hourglass amplitude per thickness, MPa, (nx, ny).
        free: 1 where a degree of freedom may move, (2, nx+1, ny+1); the others stand alone.
        cell, thickness: mm.

    Returns:
        (9, 2, 2, nx+1, ny+1), N/mm: of the shift (i, j) in `SHIFTS`, what a node's force has of the
        displacement of the node i, j further on.
    """

    def apply(u):
        u = u * free
        strain = grid.strain(u, cell)
        mean = [sum(tangent[a, b] * strain.mean[b] for b in range(3)) for a in range(3)]
        stress = grid.CellStress(tuple(mean), tuple(hourglass * q for q in strain.hourglass))
        return grid.internal_force(stress, cell, thickness) * free

    found = _probed(apply, free.shape[1:], free.dtype)
    alone = jnp.eye(2, dtype=free.dtype)[:, :, None, None] * (1 - free)[None]
    middle = SHIFTS.index((0, 0))
    weak = jnp.abs(found[middle]).max() * jnp.finfo(free.dtype).eps
    loose = (found[middle][0, 0] + found[middle][1, 1] <= weak).astype(free.dtype)  # no cell holds it
    return found.at[middle].add(alone + loose * jnp.eye(2, dtype=free.dtype)[:, :, None, None] * (free.min(0) > 0))


_stencil_of = jax.jit(stencil_of)


def _probed(apply, shape, dtype):
    """Stencil of a linear map of nodal fields that couples neighbours only, by unit fields that do not overlap."""
    i, j = np.indices(shape)
    colour = 3 * (i % 3) + j % 3
    unit = (colour == np.arange(9)[:, None, None]).astype(dtype)
    fields = np.zeros((2, 9, 2, *shape), dtype)
    fields[0, :, 0] = fields[1, :, 1] = unit
    answers = lax.map(lambda each: lax.map(apply, each), jnp.asarray(fields))  # (b, colour, a, …)
    rows = []
    for di, dj in SHIFTS:
        near = jnp.asarray((3 * ((i + di) % 3) + (j + dj) % 3)[None, None, None])
        rows.append(jnp.take_along_axis(answers, near, axis=1)[:, 0].swapaxes(0, 1))
    inside = np.stack([(0 <= i + di) & (i + di < shape[0]) & (0 <= j + dj) & (j + dj < shape[1]) for di, dj in SHIFTS])
    return jnp.where(inside[:, None, None], jnp.stack(rows), 0.0)


def applied(stencil, x):
    """The stencil times a nodal field (2, nx+1, ny+1)."""
    padded = jnp.pad(x, ((0, 0), (1, 1), (1, 1)))
    nx, ny = x.shape[1:]
    total = 0.0
    for k, (i, j) in enumerate(SHIFTS):
        near = padded[:, 1 + i : 1 + i + nx, 1 + j : 1 + j + ny]
        total += jnp.stack([stencil[k, a, 0] * near[0] + stencil[k, a, 1] * near[1] for a in range(2)])
    return total


def prolonged(coarse):
    """Bilinear interpolation to a grid of cells half as large."""
    for axis in (1, 2):
        low, high = (lax.slice_in_dim(coarse, k, coarse.shape[axis] - 1 + k, axis=axis) for k in (0, 1))
        both = jnp.stack([low, 0.5 * (low + high)], axis=axis + 1)
        both = both.reshape(*coarse.shape[:axis], -1, *coarse.shape[axis + 1 :])
        coarse = jnp.concatenate([both, lax.slice_in_dim(coarse, coarse.shape[axis] - 1, coarse.shape[axis], axis=axis)], axis)
    return coarse


def restricted(fine):
    """The transpose of `prolonged`."""
    coarse = jax.ShapeDtypeStruct((2, *((n + 1) // 2 for n in fine.shape[1:])), fine.dtype)
    return jax.linear_transpose(prolonged, coarse)(fine)[0]


def halvable(shape):
    """Cells (nx, ny), a few more if need be, that can be halved down to the coarsest level, and how many levels that makes."""
    levels = max(int(np.floor(np.log2(max(min(shape) / COARSEST, 1)))), 0)
    return tuple(-(-n // 2**levels) * 2**levels for n in shape), levels + 1


@jax.jit
def hierarchy(stencil) -> Hierarchy:
    """All levels of a stencil on a grid that can be halved (`halvable`)."""
    found = [_level(stencil)]
    for _ in range(halvable([n - 1 for n in stencil.shape[-2:]])[1] - 1):
        fine = found[-1].stencil
        shape = tuple((n + 1) // 2 for n in fine.shape[-2:])
        coarse = _probed(lambda x: restricted(applied(fine, prolonged(x))), shape, fine.dtype)  # noqa: B023
        found.append(_level(coarse))
    last = found[-1].stencil
    unit = jnp.eye(2 * last.shape[-2] * last.shape[-1], dtype=last.dtype).reshape(-1, 2, *last.shape[-2:])
    matrix = jax.vmap(partial(applied, last))(unit).reshape(len(unit), -1)
    return Hierarchy(tuple(found), jnp.linalg.inv(0.5 * (matrix + matrix.T)))


def _level(stencil):
    (a, b), (c, d) = stencil[SHIFTS.index((0, 0))]
    inverse = jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / (a * d - b * c)
    start = jnp.sin(jnp.arange(2 * a.size, dtype=a.dtype) ** 2).reshape(2, *a.shape)

    def power(_, x):
        x = _blocks(inverse, applied(stencil, x))
        return x / jnp.linalg.norm(x)

    x = lax.fori_loop(0, 12, power, start)
    return Level(stencil, inverse, 1.1 * jnp.linalg.norm(_blocks(inverse, applied(stencil, x))))


def _blocks(inverse, x):
    return jnp.stack([inverse[a, 0] * x[0] + inverse[a, 1] * x[1] for a in range(2)])


def _smoothed(level, x, b):
    """Chebyshev's iteration on the upper part of the spectrum."""
    high = level.largest
    low = high / BAND
    middle, half = (high + low) / 2, (high - low) / 2
    rest = b if x is None else b - applied(level.stencil, x)
    step = _blocks(level.inverse, rest) / middle
    x = step if x is None else x + step

    def more(_, carry):
        x, step, rho = carry
        after = 1 / (2 * middle / half - rho)
        rest = _blocks(level.inverse, b - applied(level.stencil, x))
        step = after * rho * step + 2 * after / half * rest
        return x + step, step, after

    return lax.fori_loop(0, DEGREE - 1, more, (x, step, half / middle))[0]


def cycle(levels: Hierarchy, b, k=0):
    """One V-cycle from zero: about the solution of level k for the right side b."""
    if k == len(levels.levels) - 1:
        return (levels.last @ b.reshape(-1)).reshape(b.shape)
    level = levels.levels[k]
    x = _smoothed(level, None, b)
    x = x + prolonged(cycle(levels, restricted(b - applied(level.stencil, x)), k + 1))
    return _smoothed(level, x, b)


@jax.jit
def conjugate_gradients(levels: Hierarchy, b) -> Solved:
    """The first level's system solved for b (2, nx+1, ny+1); the residual is worked out anew at the end."""
    stencil = levels.levels[0].stencil
    size = jnp.linalg.norm(b)

    def on(carry):
        _, rest, *_, k = carry
        return (jnp.linalg.norm(rest) > TOLERANCE * size) & (k < MOST)

    def step(carry):
        x, rest, along, product, k = carry
        image = applied(stencil, along)
        length = product / jnp.vdot(along, image)
        x, rest = x + length * along, rest - length * image
        guess = cycle(levels, rest)
        after = jnp.vdot(rest, guess)
        return x, rest, guess + (after / product) * along, after, k + 1

    guess = cycle(levels, b)
    x, *_, k = lax.while_loop(on, step, (jnp.zeros_like(b), b, guess, jnp.vdot(b, guess), jnp.int32(0)))
    true = jnp.linalg.norm(b - applied(stencil, x)) / jnp.where(size > 0, size, 1.0)
    return Solved(x, k, true)
