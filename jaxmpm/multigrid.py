"""Geometric multigrid on the structured grid, robust to cells that are broken: it preconditions Krylov methods (`krylov.py`).

A level keeps its operator as a stencil, the 2 × 2 blocks that couple a node with its eight neighbours and itself, so
that applying it is nine shifted products. Coarse operators are Galerkin's, Pᵀ A P. What makes them good for cracks:

- P takes a node's displacement from the coarse nodes beside it by the stiffness towards each, so that nothing is
  interpolated across a broken cell or a notch (R. Alcouffe et al., SIAM J. Sci. Stat. Comput. 2, 1981);
- cracked cells have no hourglass stiffness, so that where they are many, as in a process zone, displacements that
  alternate from node to node have next to no energy however smooth their amplitude is. No smoother takes these out:
  below the finest level a second hierarchy, of the amplitudes, runs beside that of displacements.

Smoothing is Chebyshev's, on the diagonal blocks: symmetric, and the same on any device. The coarsest level is solved
directly. (U. Trottenberg, C. Oosterlee, A. Schüller, Multigrid, Academic Press, 2001.) float32 is enough for a preconditioner.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import grid

SHIFTS = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1))
MIDDLE = SHIFTS.index((0, 0))
COARSEST = 8  # cells along the shorter side of the coarsest level, at least
DEGREE = 2  # of the smoother's polynomial
BAND = 6.0  # the smoother damps the upper part of the spectrum, from the largest value over this
POWER = 10  # steps of the power iteration for the largest
SAFETY = 1.1  # over the largest value that it finds


class Level(NamedTuple):
    """One level; nodes (nx+1, ny+1)."""

    stencil: jax.Array  # (9, 2, 2, nx+1, ny+1), N/mm
    inverse: jax.Array  # of the diagonal blocks, (2, 2, nx+1, ny+1)
    largest: jax.Array  # eigenvalue of inverse · stencil


class Shares(NamedTuple):
    """What nodes between coarse ones take from their neighbours; coarse cells (n, m)."""

    x: jax.Array  # of the lower neighbour along x, (2, n, m+1); the upper one has the rest
    y: jax.Array  # of the lower one along y, (2, n+1, m)
    middle: jax.Array  # of the neighbours above and below along x, then along y, (4, 2, n, m)


class Coarse(NamedTuple):
    """Levels, the finest of them first, shares between them, and the inverse of the last, (dofs, dofs)."""

    levels: tuple
    shares: tuple
    last: jax.Array


class Hierarchy(NamedTuple):
    """The finest level; below it two of everything, for displacements and for alternating ones."""

    fine: Level
    shares: Shares
    below: Coarse


# -- operators -----------------------------------------------------------------------------------


def internal_force(tangent, hourglass, displacement, cell, thickness):
    """Nodal forces (2, nx+1, ny+1), N, of cells with dσ/dε (3, 3, nx, ny) and a hourglass stiffness (nx, ny), MPa."""
    strain = grid.strain(displacement, cell)
    mean = [sum(tangent[a, b] * strain.mean[b] for b in range(3)) for a in range(3)]
    stress = grid.CellStress(tuple(mean), tuple(hourglass * q for q in strain.hourglass))
    return grid.internal_force(stress, cell, thickness)


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
    found = _probed(lambda u: free * internal_force(tangent, hourglass, free * u, cell, thickness), free.shape[1:], free.dtype)
    unit = jnp.eye(2, dtype=free.dtype)[:, :, None, None]
    diagonal = found[MIDDLE, 0, 0] + found[MIDDLE, 1, 1]
    loose = (diagonal <= diagonal.max() * jnp.finfo(free.dtype).eps).astype(free.dtype)  # no cell holds it
    return found.at[MIDDLE].add(unit * (1 - free)[None] + loose * unit * (free.min(0) > 0))


def _numbers(shape):
    return (lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (0, 1))


def _probed(apply, shape, dtype):
    """Stencil of a linear map of nodal fields that couples neighbours only, by unit fields that do not overlap."""
    i, j = _numbers(shape)
    colour = 3 * (i % 3) + j % 3

    def answer(k):
        component = (jnp.arange(2) == k % 2).astype(dtype)
        return apply((colour == k // 2).astype(dtype) * component[:, None, None])

    answers = lax.map(answer, jnp.arange(18, dtype=jnp.int32)).reshape(9, 2, 2, *shape)  # (colour, b, a, …)
    di, dj = (jnp.asarray(s, jnp.int32)[:, None, None] for s in zip(*SHIFTS, strict=True))
    near = 3 * ((i + di) % 3) + (j + dj) % 3
    inside = (i + di >= 0) & (i + di < shape[0]) & (j + dj >= 0) & (j + dj < shape[1])
    found = jnp.take_along_axis(answers, near[:, None, None], axis=0).swapaxes(1, 2)
    return jnp.where(inside[:, None, None], found, 0)


def applied(stencil, x):
    """The stencil times a nodal field (2, nx+1, ny+1)."""
    padded = _padded(x, (1, 1), (1, 1))
    nx, ny = x.shape[1:]
    total = 0.0
    for k, (i, j) in enumerate(SHIFTS):
        near = padded[:, 1 + i : 1 + i + nx, 1 + j : 1 + j + ny]
        total += jnp.stack([stencil[k, a, 0] * near[0] + stencil[k, a, 1] * near[1] for a in range(2)])
    return total


def _padded(a, along_x, along_y):
    return jnp.pad(a, ((0, 0),) * (a.ndim - 2) + (along_x, along_y))


# -- between levels ------------------------------------------------------------------------------


def shares_of(stencil) -> Shares:
    """Shares by the stiffness of each component towards either side; halves where nothing differs.

    That towards a side is what a displacement there takes that does not vary across: the sum of three blocks.
    """
    own = -stencil[:, (0, 1), (0, 1)]
    least = -jnp.finfo(stencil.dtype).eps * own[MIDDLE].sum(0)
    sides = slice(6, 9), slice(0, 3), slice(2, 9, 3), slice(0, 9, 3)  # of SHIFTS: i = 1, i = −1, j = 1, j = −1
    above, below, right, left = (jnp.maximum(own[side].sum(0), 0) + least for side in sides)
    all_of_them = jnp.stack([above, below, right, left])
    return Shares(
        (below / (below + above))[:, 1::2, ::2], (left / (left + right))[:, ::2, 1::2],
        (all_of_them / all_of_them.sum(0))[..., 1::2, 1::2],
    )  # fmt: skip


def bilinear(cells, dtype) -> Shares:
    """Shares of bilinear interpolation to a grid of twice as many cells."""
    n, m = cells
    return Shares(*(jnp.full(*of, dtype) for of in (((2, n, m + 1), 0.5), ((2, n + 1, m), 0.5), ((4, 2, n, m), 0.25))))


def prolonged(shares, coarse):
    """Interpolation of a nodal field to a grid of cells half as large."""
    x = shares.x * coarse[:, :-1] + (1 - shares.x) * coarse[:, 1:]
    y = shares.y * coarse[:, :, :-1] + (1 - shares.y) * coarse[:, :, 1:]
    above, below, right, left = shares.middle
    middle = above * y[:, 1:] + below * y[:, :-1] + right * x[:, :, 1:] + left * x[:, :, :-1]
    return _spaced(coarse, 0, 0) + _spaced(x, 1, 0) + _spaced(y, 0, 1) + _spaced(middle, 1, 1)


def _spaced(a, along_x, along_y):
    """Interleaved with zeros, and one more all around where it lies between coarse nodes."""
    return lax.pad(a, jnp.zeros((), a.dtype), ((0, 0, 0), (along_x, along_x, 1), (along_y, along_y, 1)))


def restricted(shares, fine):
    """The transpose of `prolonged`."""
    middle = fine[:, 1::2, 1::2]
    above, below, right, left = shares.middle
    x = fine[:, 1::2, ::2] + _padded(right * middle, (0, 0), (1, 0)) + _padded(left * middle, (0, 0), (0, 1))
    y = fine[:, ::2, 1::2] + _padded(above * middle, (1, 0), (0, 0)) + _padded(below * middle, (0, 1), (0, 0))
    by_x = _padded(shares.x * x, (0, 1), (0, 0)) + _padded((1 - shares.x) * x, (1, 0), (0, 0))
    return fine[:, ::2, ::2] + by_x + _padded(shares.y * y, (0, 0), (0, 1)) + _padded((1 - shares.y) * y, (0, 0), (1, 0))


def halvable(shape):
    """Cells (nx, ny), a few more if need be, that can be halved down to the coarsest level, and how many levels that makes."""
    halvings = max(int(np.floor(np.log2(max(min(shape) / COARSEST, 1)))), 1)
    return tuple(-(-n // 2**halvings) * 2**halvings for n in shape), halvings + 1


def coarsest_unknowns(shape):
    """Unknowns of the coarsest level of a grid of cells (nx, ny)."""
    cells, levels = halvable(shape)
    return 2 * int(np.prod([n // 2 ** (levels - 1) + 1 for n in cells]))


# -- hierarchy -----------------------------------------------------------------------------------


def hierarchy(stencil) -> Hierarchy:
    """All levels of a symmetric stencil on a grid that can be halved (`halvable`)."""
    cells = [n - 1 for n in stencil.shape[-2:]]
    sign = np.array([(-1) ** (i + j) for i, j in SHIFTS]).reshape(9, 1, 1, 1, 1)
    both = jnp.stack([stencil, stencil * sign.astype(stencil.dtype)])  # alternating fields have the signs in their operator
    bare = bilinear([n // 2 for n in cells], stencil.dtype)
    shares = jax.tree.map(lambda *each: jnp.stack(each), shares_of(stencil), bare)
    coarse = lax.map(lambda each: _coarser(*each), (both, shares))
    return Hierarchy(_level(stencil), shares, jax.vmap(partial(_coarse, halvable(cells)[1] - 1))(coarse))


def _coarse(count, stencil) -> Coarse:
    levels, shares = [_level(stencil)], []
    for _ in range(count - 1):
        shares.append(shares_of(levels[-1].stencil))
        levels.append(_level(_coarser(levels[-1].stencil, shares[-1])))
    last = levels[-1].stencil.astype(float)
    unit = jnp.eye(2 * last.shape[-2] * last.shape[-1], dtype=last.dtype).reshape(-1, 2, *last.shape[-2:])
    matrix = lax.map(partial(applied, last), unit).reshape(len(unit), -1)
    return Coarse(tuple(levels), tuple(shares), jnp.linalg.inv((matrix + matrix.T) / 2).astype(stencil.dtype))


def _coarser(stencil, shares):
    """Galerkin's operator of the next level."""
    shape = tuple((n + 1) // 2 for n in stencil.shape[-2:])
    return _probed(lambda x: restricted(shares, applied(stencil, prolonged(shares, x))), shape, stencil.dtype)


def _level(stencil) -> Level:
    (a, b), (c, d) = stencil[MIDDLE]
    inverse = jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / (a * d - b * c)
    k = jnp.arange(2 * a.size, dtype=jnp.int32) % 1009
    start = ((k * k % 1009) / 1009 - 0.5).astype(a.dtype).reshape(2, *a.shape)  # like noise, the same each time

    def power(_, carry):
        x = _blocks(inverse, applied(stencil, carry[0]))
        size = jnp.linalg.norm(x)
        return x / size, size

    return Level(stencil, inverse, SAFETY * lax.fori_loop(0, POWER, power, (start, start[0, 0, 0]))[1])


def _blocks(inverse, x):
    return jnp.stack([inverse[a, 0] * x[0] + inverse[a, 1] * x[1] for a in range(2)])


# -- cycle ---------------------------------------------------------------------------------------


def _smoothed(level, x, b):
    """Chebyshev's iteration on the upper part of the spectrum, from x, or from zero if that is None."""
    high = level.largest
    low = high / BAND
    middle, half = (high + low) / 2, (high - low) / 2

    def more(_, carry):
        x, step, rho, momentum, weight = carry
        step = momentum * step + weight * _blocks(level.inverse, b - applied(level.stencil, x))
        return x + step, step, *following(rho)

    def following(rho):
        after = 1 / (2 * middle / half - rho)
        return after, after * rho, 2 * after / half

    first = half / middle
    if x is None:
        step = _blocks(level.inverse, b) / middle
        return lax.fori_loop(0, DEGREE - 1, more, (step, step, *following(first)))[0]
    return lax.fori_loop(0, DEGREE, more, (x, jnp.zeros_like(x), first, jnp.zeros_like(first), 1 / middle))[0]


def cycle(levels: Hierarchy, b):
    """One V-cycle from zero: about the displacement (2, nx+1, ny+1) under nodal forces b."""
    fine = levels.fine
    x = _smoothed(fine, None, b)
    rest = b - applied(fine.stencil, x)
    i, j = _numbers(b.shape[1:])
    sign = (1 - 2 * ((i + j) % 2)).astype(b.dtype)
    both = jax.vmap(restricted)(levels.shares, jnp.stack([rest, sign * rest]))
    smooth, alternating = jax.vmap(prolonged)(levels.shares, jax.vmap(_below)(levels.below, both))
    return _smoothed(fine, x + smooth + sign * alternating, b)


def _below(levels: Coarse, b, k=0):
    if k == len(levels.shares):
        return jnp.dot(levels.last, b.reshape(-1), precision=lax.Precision.HIGHEST).reshape(b.shape)
    level, shares = levels.levels[k], levels.shares[k]
    x = _smoothed(level, None, b)
    x = x + prolonged(shares, _below(levels, restricted(shares, b - applied(level.stencil, x)), k + 1))
    return _smoothed(level, x, b)
