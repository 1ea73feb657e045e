"""The elastic structure of a scene as sparse matrices: what its cells would do if none ever cracked.

The strain of a cell is three mean components and two hourglass amplitudes, as in `grid.py`; `strain_operator`
S takes nodal displacements to those of all cells, W holds what a unit of stress weighs (cell volume for the mean,
thickness for the hourglass) and C the elastic stiffness, so that K₀ = Sᵀ W C S. What may move is u = T x + Σ aᵢ pᵢ:
x the unknowns, aᵢ the amplitude of each load and pᵢ the displacement that it prescribes, if it is one.
"""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
import scipy.sparse as sparse

from jaxmpm import elastic_grid, layout_macro
from jaxmpm.elastic_grid import Answers, Multigrid, OnGrid
from jaxmpm.errors import SceneError
from jaxmpm.factors import Factors, dissection
from jaxmpm.loads import Load, amplitudes_at
from jaxmpm.model import fields

MEAN, MODES = 3, 5  # mean strain components of a cell, and those with its hourglass amplitudes
SINGULAR = 1e-13  # least pivot over the largest of a structure that holds
STATIC = 'solver.kind = "quasistatic"'
LOOSE = (
    ": expected supports that hold every body, but one can move without strain: "
    "add supports, or displacements with an angle as direction, until it cannot slide or turn"
)


def strain_operator(shape, cell):
    """S (5 cells, dofs): xx, yy, xy and the hourglass amplitudes q_x, q_y (mm) of every cell, cell after cell."""
    nx, ny = shape
    i, j = (k.reshape(-1) for k in np.indices(shape))
    corners = np.stack([(i + p) * (ny + 1) + j + q for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))])
    by_x, by_y = (np.array(s) / (2 * cell) for s in ((-1, 1, 1, -1), (-1, -1, 1, 1)))
    mode, along_y = np.array([1, -1, 1, -1]) / 4, (nx + 1) * (ny + 1)
    table = ((0, 0, by_x), (1, along_y, by_y), (2, 0, by_y), (2, along_y, by_x), (3, 0, mode), (4, along_y, mode))
    number = np.arange(nx * ny)
    rows, columns, values = [], [], []
    for row, offset, weights in table:
        for corner, weight in zip(corners, weights, strict=True):
            rows.append(MODES * number + row)
            columns.append(offset + corner)
            values.append(np.full(nx * ny, weight))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_matrix(entries, shape=(MODES * nx * ny, 2 * along_y))


@dataclass(eq=False)
class Structure:
    """A model's elastic structure; build one with `Structure.of(model)`."""

    strain: sparse.csr_matrix  # S, (5 cells, dofs)
    elastic: np.ndarray  # C of every cell, MPa, (cells, 3, 3)
    hourglass: np.ndarray  # stiffness of a hourglass amplitude, N/mm, (cells,)
    volume: float  # of a cell, mm³
    edge: float  # area of an edge of a cell, mm²
    stiffness: sparse.csr_matrix  # K₀, N/mm, (dofs, dofs)
    moves: sparse.csr_matrix  # T, (dofs, unknowns)
    prescribed: np.ndarray  # pᵢ, mm per unit of the load's history, (dofs, loads)
    force: np.ndarray  # fᵢ, N per unit, (dofs, loads)
    free: np.ndarray  # where the force is what a load says and not a reaction, (dofs,)
    order: np.ndarray  # of elimination of the unknowns, if they are eliminated
    factors: Factors | Answers  # of their stiffness, or what solves without
    response: np.ndarray  # uᵢ of the uncracked structure to a unit of each load, mm, (dofs, loads)
    grid: OnGrid | None  # for multigrid, if it is for this structure

    @classmethod
    def of(cls, model, asked=STATIC):
        """Assemble, and factorise what is not too large; raises SceneError where the supports leave a body free to move.

        `asked`: what asks for it, for that message.
        """
        n, prepared = model.numerics, fields(model)
        shape = model.material.shape
        strain = strain_operator(shape, n.cell)
        direct, cross, shear = (np.asarray(c).reshape(-1) for c in (prepared.direct, prepared.cross, prepared.shear))
        none = 0 * direct
        elastic = np.stack([direct, cross, none, cross, direct, none, none, none, shear], axis=1).reshape(-1, 3, 3)
        volume = n.cell**2 * n.thickness
        hourglass = np.asarray(prepared.hourglass).reshape(-1) * n.thickness
        weighted = weights_of(volume * elastic, hourglass)
        stiffness = (strain.T @ (weighted @ strain)).tocsr()
        moves, free = _unknowns(model, np.asarray(prepared.mass))
        prescribed, force = _loads(model, np.asarray(prepared.mass))
        grid = OnGrid(_by_nodes(model, moves), n.cell, n.thickness) if elastic_grid.suits(shape, moves) else None
        if grid is not None and moves.shape[1] >= elastic_grid.LARGE:
            order, factors = np.zeros(0, int), _on_grid_or_says_why(model, elastic, hourglass, moves, asked)
        else:
            order = dissection(shape, moves)
            factors = _factorised_or_says_why((moves.T @ stiffness @ moves).tocsc(), order, asked)
        unknowns = factors.solve(moves.T @ (force - stiffness @ prescribed))
        response = moves @ unknowns + prescribed
        edge = n.cell * n.thickness
        return cls(
            strain, elastic, hourglass, volume, edge, stiffness, moves, prescribed, force, free, order, factors, response, grid
        )

    @property
    def large(self) -> bool:
        """Whether there are no factors, but multigrid."""
        return isinstance(self.factors, Answers)

    def answer(self, force):
        """Displacement (dofs, k) of the uncracked structure under nodal forces (dofs, k), N, its loads at zero."""
        return self.moves @ self.factors.solve(self.moves.T @ force)

    def rows(self, cells, count=MODES):
        """Rows of S for the first `count` components of some cells, cell after cell, (count · k, dofs)."""
        return self.strain[(MODES * np.asarray(cells, int)[:, None] + np.arange(count)).reshape(-1)]

    def force_of(self, displacement, cells, stress, keep, rows=None):
        """Nodal forces (dofs,), N, of the structure where some cells bear the mean stress (3k,), MPa, of their bands.

        `keep`: the share of their hourglass stiffness that these have; `rows`: theirs of S, where they are at hand.
        """
        rows = self.rows(cells) if rows is None else rows
        own = (rows @ displacement).reshape(-1, MODES)
        lacks = np.empty_like(own)
        mean = np.einsum("kij,kj->ki", self.elastic[cells], own[:, :MEAN]) - stress.reshape(-1, MEAN)
        lacks[:, :MEAN] = self.volume * mean
        lacks[:, MEAN:] = (1 - keep) * self.hourglass[cells][:, None] * own[:, MEAN:]
        return self.stiffness @ displacement - rows.T @ lacks.reshape(-1)


def weights_of(mean, hourglass):
    """W C (5k, 5k) of k cells from their mean stiffness (k, 3, 3) and hourglass stiffness (k,)."""
    blocks = np.zeros((len(hourglass), MODES, MODES))
    blocks[:, :MEAN, :MEAN] = mean
    blocks[:, 3, 3] = blocks[:, 4, 4] = hourglass
    return block_diagonal(blocks)


def block_diagonal(blocks):
    """Sparse matrix of square blocks (k, m, m) along its diagonal."""
    count, size, _ = blocks.shape
    return sparse.bsr_matrix((blocks, np.arange(count), np.arange(count + 1)), shape=(count * size, count * size)).tocsr()


def _unknowns(model, mass):
    """T (dofs, unknowns) and where the force is given (dofs,)."""
    there = np.broadcast_to(mass > 0, model.free.shape)
    free = (np.asarray(model.free) > 0) & there
    size = free.size
    if model.macro is None:
        picked = np.flatnonzero(free)
        return sparse.csr_matrix((np.ones(len(picked)), (picked, np.arange(len(picked)))), shape=(size, len(picked))), free.reshape(-1)
    # a periodic cell: each node once but for one that stays, then the components of mean strain that are free
    nx, ny = model.material.shape
    node = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
    tied = node[np.ix_(np.arange(nx + 1) % nx, np.arange(ny + 1) % ny)].reshape(-1)
    tied = np.concatenate([tied, tied + node.size])
    own = np.flatnonzero(free)
    own = own[(own % node.size) != 0]
    column = np.full(size, -1)
    column[own] = np.arange(len(own))
    dofs = np.flatnonzero(column[tied] >= 0)
    ties = sparse.csr_matrix((np.ones(len(dofs)), (dofs, column[tied[dofs]])), shape=(size, len(own)))
    modes = layout_macro.modes((nx, ny), model.numerics.cell).reshape(3, -1)
    return sparse.hstack([ties, sparse.csr_matrix(modes[np.asarray(model.macro.driven) == 0].T)]).tocsr(), np.zeros(size, bool)


def _loads(model, mass):
    """Prescribed displacement and force (dofs, loads) per unit of each load, in the order of `amplitudes`."""
    size = model.free.size
    every = loads_of(model)
    prescribed, force = np.zeros((size, len(every) + 1)), np.zeros((size, len(every) + 1))
    for k, load in enumerate(every):
        field = prescribed if k < len(model.displacements) else force
        np.add.at(field[:, k], np.asarray(load.dofs), np.asarray(load.weights))
    if model.macro is not None:
        modes = layout_macro.modes(model.material.shape, model.numerics.cell).reshape(3, -1)
        prescribed[:, len(every) - 1] = np.asarray(model.macro.strain * model.macro.driven) @ modes
    force[:, -1] = (mass * np.asarray(model.gravity).reshape(2, 1, 1)).reshape(-1)
    return prescribed, force


def loads_of(model) -> tuple[Load, ...]:
    """Displacements, forces and what drives the mean strain."""
    return (*model.displacements, *model.forces, *(() if model.macro is None else (model.macro.load,)))


def amplitudes(model, time):
    """Amplitude of every load at a time (s), gravity last, (loads,)."""
    return np.append(amplitudes_at(loads_of(model), time), 1.0)


def held_at(model, amplitude):
    """The model with its loads held at amplitudes (loads,): all histories constant."""
    held = [replace(load, value=jnp.full_like(load.value, a)) for load, a in zip(loads_of(model), amplitude, strict=False)]
    first, second = len(model.displacements), len(model.displacements) + len(model.forces)
    macro = None if model.macro is None else replace(model.macro, load=held[-1])
    return replace(model, displacements=tuple(held[:first]), forces=tuple(held[first:second]), macro=macro)


def _factorised_or_says_why(reduced, order, asked):
    """Factors of K; SceneError where it is singular."""
    try:
        factors = Factors(reduced, order)
        pivots = np.abs(factors.pivots)
    except RuntimeError:
        pivots = np.zeros(1)
    if not pivots.min() > SINGULAR * pivots.max():
        raise SceneError(asked + LOOSE)
    return factors


def _by_nodes(model, moves):
    """1 where a degree of freedom is an unknown, (2, nx+1, ny+1)."""
    return np.asarray(moves.sum(1)).reshape(model.free.shape)


def _on_grid_or_says_why(model, elastic, hourglass, moves, asked):
    """K by multigrid; SceneError where it is singular."""
    n, shape, free = model.numerics, model.material.shape, _by_nodes(model, moves)
    if not elastic_grid.is_held(np.asarray(model.material) >= 0, free):
        raise SceneError(asked + LOOSE)
    tangent = np.moveaxis(elastic, 0, -1).reshape(MEAN, MEAN, *shape)
    return Answers(Multigrid(tangent, hourglass.reshape(shape) / n.thickness, free, n.cell, n.thickness), moves)
