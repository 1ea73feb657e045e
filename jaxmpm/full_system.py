"""Equilibrium of all nodes at once, by sparse matrices: for so many cracked cells that a dense system is slower.

The same equations as in `condensed.py`, with the same methods; unknowns are those of the structure, residuals forces. From
step to step little of the matrix changes (`zoned_factors.py`).
"""

import numpy as np

from jaxmpm.condensed import GRIP, INVERSE
from jaxmpm.factors import Factors
from jaxmpm.stiffness import MEAN, Structure, block_diagonal
from jaxmpm.zoned_factors import ZonedFactors


class Full:
    """The equations of all unknowns of the structure (m,); residuals are forces, N."""

    def __init__(self, structure: Structure, cells, gauge=None):
        """Cracked cells are flat indices, a gauge a vector of weights (dofs,) of the displacement."""
        self.structure, self.cells = structure, np.zeros(0, int)
        self.factors = ZonedFactors(structure)
        self.by_load = False  # whether the loads were as they were at the last step
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
        return Factors(moves.T @ moves, self.structure.order).solve(moves.T @ own)

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
        structure = self.structure
        self.by_load = direction is None
        self._take(tangent)
        try:
            if direction is None:
                return self.factors.solve(-residual), 0.0
            prescribed = structure.prescribed @ direction
            column = structure.moves.T @ (self.elastic @ prescribed - structure.force @ direction)
            column += self.across @ (self.blocks @ (self.by_prescribed @ direction))
            row, own = slopes
            there, along = self.factors.solve(-np.stack([residual, column], 1)).T
            slope = own + row @ along
            factor = (short - row @ there) / slope if slope != 0 else np.nan  # where it has no say in what is controlled
            return there + factor * along, factor
        except RuntimeError:  # singular
            return np.full_like(residual, np.nan), np.nan

    def _take(self, tangent):
        """Take tangents (k, 3, 3) of the bands for those of the tangent stiffness."""
        self.blocks = block_diagonal(self.structure.volume * tangent)
        self.factors.take(self.cells, tangent, GRIP * self.structure.hourglass[self.cells])

    @property
    def stable(self):
        """Whether the structure was at the last step, under the loads as they were; None where nothing is said of it."""
        if not self.by_load:
            return None
        try:
            return self.factors.positive
        except RuntimeError:  # singular
            return False

    def softest(self, tangent):
        """The change of the unknowns (m,) against which the structure is softest, and whether it is stable."""
        self._take(tangent)
        mode = self.across @ np.ones(self.across.shape[1])
        try:
            stable = self.factors.positive
        except RuntimeError:  # singular
            return np.ones(len(mode)), False
        for _ in range(INVERSE):
            mode = self.factors.solve(mode / np.abs(mode).max())
        return mode / np.abs(self.by_unknowns @ mode).max(), stable

    def keep(self, count):
        """Forget all but the first cells: those that cracked last are whole again."""
        if count < len(self.cells):
            self.cells = self.cells[:count]
            self.add(())

    def adjoint(self, tangent, right):
        """λ with Kᵀ λ = right, both of the unknowns, (m,) or (m, many); arguments as in `Condensed.adjoint`."""
        if not len(self.cells):
            return self.structure.factors.solve(right)
        self._take(tangent)
        return self.factors.solve_transposed(right)

    def displacement(self, unknowns, stress, amplitude):
        """Displacement (dofs,) of the whole structure."""
        return self._whole(unknowns, amplitude)

