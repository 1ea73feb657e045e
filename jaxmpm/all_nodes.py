"""The equations of all nodes: what is the same however they are solved, by factors (`full_system.py`) or without (`multigrid_system.py`)."""

from functools import cached_property

import numpy as np

from jaxmpm.condensed import GRIP
from jaxmpm.factors import Factors
from jaxmpm.stiffness import MEAN, MODES, Structure


class AllNodes:
    """The equations of all unknowns of the structure (m,); residuals are forces, N."""

    def __init__(self, structure: Structure, cells, gauge=None):
        """Cracked cells are flat indices, a gauge a vector of weights (dofs,) of the displacement."""
        self.structure, self.cells = structure, np.zeros(0, int)
        self.gauge = gauge if gauge is not None else np.zeros(structure.strain.shape[1])
        self.add(cells)

    def add(self, cells):
        """Take more cells (flat indices) among the cracked ones."""
        self.cells = np.concatenate([self.cells, np.asarray(cells, int)])
        self.rows = self.structure.rows(self.cells)
        mean = self.rows[np.arange(self.rows.shape[0]) % MODES < MEAN]
        self.by_unknowns, self.by_prescribed = (mean @ self.structure.moves).tocsr(), mean @ self.structure.prescribed
        self.across = self.by_unknowns.T.tocsr()

    def keep(self, count):
        """Forget all but the first cells: those that cracked last are whole again."""
        if count < len(self.cells):
            self.cells = self.cells[:count]
            self.add(())

    def unknowns(self, displacement, amplitude):
        """Unknowns (m,) of a displacement (dofs,)."""
        own = self.structure.moves.T @ (displacement - self.structure.prescribed @ amplitude)
        return own if self._ties is None else self._ties.solve(own)

    @cached_property
    def _ties(self):
        """Factors of TᵀT where an unknown moves more than one dof, else None."""
        square = self.structure.moves.T @ self.structure.moves
        return Factors(square, self.structure.order) if square.diagonal().max(initial=1.0) > 1 else None

    def displacement(self, unknowns, stress, amplitude):
        """Displacement (dofs,) of the whole structure."""
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
        force = structure.force_of(self.displacement(unknowns, stress, amplitude), self.cells, stress, GRIP, self.rows)
        return structure.moves.T @ (force - structure.force @ amplitude)

    def driven(self, tangent, direction):
        """How that changes along a direction of the loads, with tangents (k, 3, 3) of the bands, the unknowns held."""
        structure = self.structure
        strain = (self.by_prescribed @ direction).reshape(-1, MEAN)
        stress = np.einsum("kij,kj->ki", tangent, strain).reshape(-1)
        force = structure.force_of(structure.prescribed @ direction, self.cells, stress, GRIP, self.rows)
        return structure.moves.T @ (force - structure.force @ direction)

    def size(self, residual, strength, stiffness):
        """Largest residual as a share of the force that a cell bears at onset."""
        return np.abs(residual).max(initial=0.0) / (strength * self.structure.edge)

    def reading(self, unknowns, stress, amplitude):
        """The gauge's reading, mm."""
        return self.gauge @ self.displacement(unknowns, stress, amplitude)

    def reading_slopes(self, tangent, direction):
        """How the reading changes with the unknowns (m,) and along a direction of the loads."""
        return self.structure.moves.T @ self.gauge, self.gauge @ (self.structure.prescribed @ direction)
