"""Equilibrium of all nodes at once, by sparse matrices: for so many cracked cells that a dense system is slower.

The same equations as in `condensed.py`, with the same methods; unknowns are those of the structure, residuals forces. From
step to step little of the matrix changes: the factors of an earlier one precondition GMRES (Y. Saad, M. Schultz, SIAM J. Sci. Stat.
Comput. 7, 1986), and are made anew where that is slow, or where it is to be known whether the structure is stable.
"""

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from jaxmpm.condensed import GRIP, INVERSE
from jaxmpm.factors import Factors
from jaxmpm.stiffness import MEAN, Structure, block_diagonal

FORCING = 1e-4  # of a right side, that the solution may miss: Newton's next step makes it good
MOST = 12  # steps of GMRES, after which new factors are quicker


class Full:
    """The equations of all unknowns of the structure (m,); residuals are forces, N."""

    def __init__(self, structure: Structure, cells=(), gauge=None):
        """Cracked cells are flat indices, a gauge a vector of weights (dofs,) of the displacement."""
        self.structure, self.cells = structure, np.zeros(0, int)
        self.factors = self.factored = self.matrix = None  # factors, of which matrix, and that of the last step
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
        self._take(tangent)
        self.by_load = direction is None
        try:
            if direction is None:
                return self._solved(-residual), 0.0
            prescribed = structure.prescribed @ direction
            column = structure.moves.T @ (self.elastic @ prescribed - structure.force @ direction)
            column += self.across @ (self.blocks @ (self.by_prescribed @ direction))
            row, own = slopes
            there, along = self._solved(-residual), self._solved(-column)
            factor = (short - row @ there) / (own + row @ along)
            return there + factor * along, factor
        except RuntimeError:  # singular
            return np.full_like(residual, np.nan), np.nan

    def _take(self, tangent):
        """The tangent stiffness with tangents (k, 3, 3) of the bands."""
        self.blocks = block_diagonal(self.structure.volume * tangent)
        self.matrix = (self.reduced + self.across @ (self.blocks @ self.by_unknowns)).tocsr()

    def _factorise(self):
        """Factors of this very matrix; raises RuntimeError where it is singular."""
        if self.factored is not self.matrix:
            self.factors, self.factored = Factors(self.matrix, self.structure.order), self.matrix
        return self.factors

    def _solved(self, right):
        """Solution for a right side (m,), with the factors of an earlier matrix if they do."""
        if self.factors is None or self.factored is self.matrix:
            return self._factorise().solve(right)
        inverse = LinearOperator(self.matrix.shape, self.factors.solve, dtype=float)
        found, failed = gmres(self.matrix, right, rtol=FORCING, atol=0.0, restart=MOST, maxiter=1, M=inverse)
        return self._factorise().solve(right) if failed else found

    @property
    def stable(self):
        """Whether the structure was at the last step, under the loads as they were; None where nothing is said of it."""
        if not self.by_load:
            return None
        try:
            return self._factorise().positive
        except RuntimeError:  # singular
            return False

    def softest(self, tangent):
        """The change of the unknowns (m,) against which the structure is softest, and whether it is stable."""
        self._take(tangent)
        mode = self.across @ np.ones(self.across.shape[1])
        try:
            factors = self._factorise()
        except RuntimeError:  # singular
            return np.ones(len(mode)), False
        for _ in range(INVERSE):
            mode = factors.solve(mode / np.abs(mode).max())
        return mode / np.abs(self.by_unknowns @ mode).max(), factors.positive

    def keep(self, count):
        """Forget all but the first cells: those that cracked last are whole again."""
        if count < len(self.cells):
            self.cells = self.cells[:count]
            self.add(())

    def adjoint(self, tangent, right):
        """λ with Kᵀ λ = right, both of the unknowns, (m,) or (m, many); arguments as in `Condensed.adjoint`."""
        self._take(tangent)
        return self._factorise().solve_transposed(right)

    def displacement(self, unknowns, stress, amplitude):
        """Displacement (dofs,) of the whole structure."""
        return self._whole(unknowns, amplitude)

