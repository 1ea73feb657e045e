"""Equilibrium of all nodes at once, by sparse matrices: for so many cracked cells that a dense system is slower.

The same equations as in `condensed.py`, with the same methods; unknowns are those of the structure, residuals forces.
"""

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import connected_components

from jaxmpm.condensed import GRIP, INVERSE
from jaxmpm.stiffness import MEAN, Structure, block_diagonal, factorised


class Full:
    """The equations of all unknowns of the structure (m,); residuals are forces, N."""

    def __init__(self, structure: Structure, cells=(), gauge=None):
        """Cracked cells are flat indices, a gauge a vector of weights (dofs,) of the displacement."""
        self.structure, self.cells = structure, np.zeros(0, int)
        self.stable = None  # whether the structure was at the last step, under the loads as they were
        self.gauge = gauge if gauge is not None else np.zeros(structure.strain.shape[1])
        self.add(cells)

    def add(self, cells):
        """Take more cells (flat indices) among the cracked ones."""
        structure = self.structure
        self.cells = np.concatenate([self.cells, np.asarray(cells, int)])
        self.rows = structure.rows(self.cells, MEAN)
        self.elastic = structure.without(self.cells, GRIP)
        moves = structure.moves
        self.reduced = (moves.T @ self.elastic @ moves).tocsr()
        self.by_unknowns = (self.rows @ moves).tocsr()
        self.across = self.by_unknowns.T.tocsr()
        self.by_prescribed = self.rows @ structure.prescribed

    def unknowns(self, displacement, amplitude):
        """Unknowns (m,) of a displacement (dofs,)."""
        moves = self.structure.moves
        own = displacement - self.structure.prescribed @ amplitude
        number = np.asarray(moves.multiply(moves).sum(0)).reshape(-1)
        if number.max() == 1:
            return moves.T @ own
        return factorised(moves.T @ moves).solve(moves.T @ own)

    def _whole(self, unknowns, amplitude):
        return self.structure.moves @ unknowns + self.structure.prescribed @ amplitude

    def strain(self, unknowns, amplitude):
        """Mean strain (3k,) of the cracked cells."""
        return self.by_unknowns @ unknowns + self.by_prescribed @ amplitude

    def slopes(self, by_strain, direction):
        """Slopes by the unknowns and along a direction of the loads, from those by strain (3k,)."""
        return self.across @ by_strain, by_strain @ (self.by_prescribed @ direction)

    def residual(self, unknowns, stress, amplitude):
        """Force (m,) that is out of balance, N, for bands' stress (3k,), MPa."""
        structure = self.structure
        internal = self.elastic @ self._whole(unknowns, amplitude) + structure.volume * (self.rows.T @ stress)
        return structure.moves.T @ (internal - structure.force @ amplitude)

    def size(self, residual, strength, stiffness):
        """Largest residual as a share of the force that a cell bears at onset."""
        return np.abs(residual).max(initial=0.0) / (strength * self.structure.edge)

    def reading(self, unknowns, stress, amplitude):
        """The gauge's reading, mm."""
        return self.gauge @ self._whole(unknowns, amplitude)

    def reading_slopes(self, tangent, direction):
        """How the reading changes with the unknowns (m,) and along a direction of the loads."""
        return self.structure.moves.T @ self.gauge, self.gauge @ (self.structure.prescribed @ direction)

    def step(self, tangent, residual, direction=None, slopes=None, short=0.0):
        """Newton's change of the unknowns (m,) and of the load factor; arguments as in `Condensed.step`."""
        structure, volume = self.structure, self.structure.volume
        blocks = block_diagonal(volume * tangent)
        self.stable = None
        try:
            factors = factorised(self.reduced + self.across @ (blocks @ self.by_unknowns))
            if direction is None:
                self.stable = positive(factors)
                return factors.solve(-residual), 0.0
            prescribed = structure.prescribed @ direction
            column = structure.moves.T @ (self.elastic @ prescribed - structure.force @ direction)
            column += volume * (self.across @ (blocks @ (self.by_prescribed @ direction)))
            row, own = slopes
            there, along = factors.solve(np.stack([-residual, -column], axis=1)).T
            factor = (short - row @ there) / (own + row @ along)
            return there + factor * along, factor
        except RuntimeError:  # singular
            return np.full_like(residual, np.nan), np.nan

    def softest(self, tangent):
        """The change of the unknowns (m,) against which the structure is softest, and whether it is stable."""
        blocks = block_diagonal(self.structure.volume * tangent)
        try:
            factors = factorised(self.reduced + self.across @ (blocks @ self.by_unknowns))
        except RuntimeError:  # singular
            return np.ones(len(self.reduced.indptr) - 1), False
        mode = self.across @ np.ones(self.across.shape[1])
        for _ in range(INVERSE):
            mode = factors.solve(mode / np.abs(mode).max())
        return mode / np.abs(self.by_unknowns @ mode).max(), positive(factors)

    def displacement(self, unknowns, stress, amplitude):
        """Displacement (dofs,) of the whole structure."""
        return self._whole(unknowns, amplitude)


def positive(factors):
    """Whether the determinant of a sparse matrix is positive, from its LU factors."""
    negative = np.count_nonzero(factors.U.diagonal() < 0)
    return bool((negative + sum(_odd(order) for order in (factors.perm_r, factors.perm_c))) % 2 == 0)


def _odd(order):
    """1 where a permutation is odd, else 0."""
    count, labels = connected_components(sparse.csr_matrix((np.ones(len(order)), (np.arange(len(order)), order))))
    return (len(order) - count) % 2
