"""Equilibrium of all nodes at once, by sparse matrices: for so many cracked cells that a dense system is slower.

The same equations as in `condensed.py`, with the same methods; unknowns are those of the structure, residuals forces. From
step to step little of the matrix changes (`zoned_factors.py`).
"""

import numpy as np

from jaxmpm.all_nodes import AllNodes
from jaxmpm.condensed import GRIP, INVERSE
from jaxmpm.zoned_factors import ZonedFactors


class Full(AllNodes):
    """The equations of all nodes, solved by factors."""

    def __init__(self, structure, cells, gauge=None):
        """Arguments as those of `AllNodes`."""
        self.factors = ZonedFactors(structure)
        self.by_load = False  # whether the loads were as they were at the last step
        super().__init__(structure, cells, gauge)

    def step(self, tangent, residual, direction=None, slopes=None, short=0.0):
        """Newton's change of the unknowns (m,) and of the load factor; arguments as in `Condensed.step`."""
        self.by_load = direction is None
        self._take(tangent)
        try:
            if direction is None:
                return self.factors.solve(-residual), 0.0
            row, own = slopes
            there, along = self.factors.solve(-np.stack([residual, self.driven(tangent, direction)], 1)).T
            slope = own + row @ along
            factor = (short - row @ there) / slope if slope != 0 else np.nan  # where it has no say in what is controlled
            return there + factor * along, factor
        except RuntimeError:  # singular
            return np.full_like(residual, np.nan), np.nan

    def _take(self, tangent):
        """Take tangents (k, 3, 3) of the bands for those of the tangent stiffness."""
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

    def adjoint(self, tangent, right):
        """λ with Kᵀ λ = right, both of the unknowns, (m,) or (m, many); arguments as in `Condensed.adjoint`."""
        if not len(self.cells):
            return self.structure.factors.solve(right)
        self._take(tangent)
        return self.factors.solve_transposed(right)
