"""Equilibrium on the cracked cells alone: the bulk, which is elastic, is condensed out once and for all.

With K₀ the stiffness of the uncracked structure (`stiffness.py`) and e the mean strain of the cracked cells,

    e = Σ aᵢ eᵢ − G w (σ(e) − C e)

aᵢ the amplitudes of the loads, eᵢ the strain that each causes without cracks, σ(e) the stress of the bands, w the cell's
volume and G = S K⁻¹ Sᵀ the strain in cracked cells due to stress in others (Betti: symmetric). K is K₀ without the hourglass
stiffness of the cracked cells, which a band does not have: that is taken out by Woodbury's formula as cells crack, so that three
unknowns are left for each. A cell more costs five solves with K₀ and a matrix product.
"""

import numpy as np
from scipy.linalg import lapack

from jaxmpm.stiffness import MEAN, MODES, Structure

INVERSE = 6  # steps of inverse iteration for the softest mode
GRIP = 1e-6  # share of its hourglass stiffness that a cracked cell keeps, so that nothing flutters


class Condensed:
    """The equations of the cracked cells; unknowns are their mean strains (3k,), residuals are strains too."""

    def __init__(self, structure: Structure, gauge=None):
        """A gauge is a vector of weights (dofs,) of the displacement; its reading can be asked for."""
        self.structure, self.cells = structure, np.zeros(0, int)
        self.stable = None  # whether the structure was at the last step, under the loads as they were
        self.gauge = gauge if gauge is not None else np.zeros(structure.strain.shape[1])
        # the gauge comes first among the rows, then five for each cell
        self.flexibility = np.zeros((1, 1))
        self.bare = (self.gauge @ structure.response)[None]  # response to the loads of the uncracked structure
        self._index()

    def _index(self):
        k = np.arange(len(self.cells))
        self.mean = (1 + MODES * k[:, None] + np.arange(MEAN)).reshape(-1)
        self.loose = (1 + MODES * k[:, None] + np.arange(MEAN, MODES)).reshape(-1)
        taken = (1 - GRIP) * np.repeat(self.structure.hourglass[self.cells], 2)
        by_loads = self.bare + self.flexibility[:, self.loose] @ (taken[:, None] * self.bare[self.loose])
        self.taken, self.by_loads = taken, by_loads
        self.inner = np.ascontiguousarray(self.flexibility[np.ix_(self.mean, self.mean)])
        self.weighted = self.structure.volume * self.structure.elastic[self.cells]  # w C, (k, 3, 3)

    def add(self, cells):
        """Take more cells (flat indices) among the cracked ones."""
        structure, new = self.structure, np.asarray(cells, int)
        rows = structure.rows(new)
        caused = structure.answer(rows.T.toarray())
        old = structure.rows(self.cells) @ caused
        column = np.concatenate([(self.gauge @ caused)[None], old])  # as in the uncracked structure
        before, count = len(column), len(rows.indptr) - 1
        through = self.taken[:, None] * column[self.loose]
        column = column + self.flexibility[:, self.loose] @ through
        corner = rows @ caused + column[self.loose].T @ through
        grown = np.empty((before + count, before + count))
        grown[:before, :before] = self.flexibility
        grown[:before, before:], grown[before:, :before] = column, column.T
        grown[before:, before:] = (corner + corner.T) / 2
        loose = before + np.flatnonzero(np.arange(count) % MODES >= MEAN)
        taken = (1 - GRIP) * np.repeat(structure.hourglass[new], 2)
        across = grown[:, loose]
        grown += across @ np.linalg.solve(np.diag(1 / taken) - across[loose], across.T)
        self.flexibility = grown
        self.bare = np.concatenate([self.bare, rows @ structure.response])
        self.cells = np.concatenate([self.cells, new])
        self._index()

    def unknowns(self, displacement, amplitude):
        """Unknowns of a displacement (dofs,)."""
        return self.structure.rows(self.cells, MEAN) @ displacement

    def strain(self, unknowns, amplitude):
        """Mean strain (3k,) of the cracked cells."""
        return unknowns

    def slopes(self, by_strain, direction):
        """Slopes by the unknowns and along a direction of the loads, from those by strain (3k,)."""
        return by_strain, 0.0

    def _missing(self, strain, stress):
        """w (σ − C e), N·mm, (3k,): what the cracked cells bear less than they would uncracked."""
        elastic = np.einsum("kij,kj->ki", self.weighted, strain.reshape(-1, MEAN)).reshape(-1)
        return self.structure.volume * stress - elastic

    def residual(self, unknowns, stress, amplitude):
        """Strain (3k,) that is out of balance, for bands' stress (3k,), MPa."""
        missing = self._missing(unknowns, stress)
        return unknowns + self.inner @ missing - self.by_loads[self.mean] @ amplitude

    def size(self, residual, strength, stiffness):
        """Largest residual as a share of the strain at onset."""
        return np.abs(residual).max(initial=0.0) * stiffness / strength

    def reading(self, unknowns, stress, amplitude):
        """The gauge's reading, mm."""
        return self.by_loads[0] @ amplitude - self.flexibility[0, self.mean] @ self._missing(unknowns, stress)

    def reading_slopes(self, tangent, direction):
        """How the reading changes with the strain (3k,) and along a direction of the loads."""
        softer = self.structure.volume * tangent - self.weighted
        row = self.flexibility[0, self.mean].reshape(-1, MEAN)
        return -np.einsum("ki,kij->kj", row, softer).reshape(-1), self.by_loads[0] @ direction

    def step(self, tangent, residual, direction=None, slopes=None, short=0.0):
        """Newton's change of the unknowns (3k,) and of the load factor.

        Args:
            tangent: of the bands, MPa, (k, 3, 3).
            residual: (3k,).
            direction: change of the amplitudes with the load factor (loads,); None: it is given.
            slopes: how what is controlled changes with strain (3k,) and load factor.
            short: what is controlled still lacks.
        """
        matrix = self._matrix(tangent)
        if direction is None:
            change, self.stable = _solved(matrix, -residual)
            return change, 0.0
        row, own = slopes
        scale = np.abs(row).max(initial=abs(own)) or 1.0  # of the last row: pivots are chosen by size
        column = -self.by_loads[self.mean] @ direction
        matrix = np.block([[matrix, column[:, None]], [row[None] / scale, np.array([[own / scale]])]])
        change, _ = _solved(matrix, np.append(-residual, short / scale))
        self.stable = None  # of the structure under its loads nothing is said
        return change[:-1], change[-1]

    def _matrix(self, tangent):
        """1 + G (w D − w C), (3k, 3k); its determinant is that of the tangent stiffness over the elastic one."""
        softer = self.structure.volume * tangent - self.weighted
        blocks = np.matmul(self.inner.reshape(len(self.inner), -1, 1, MEAN), softer)
        matrix = blocks.reshape(self.inner.shape)
        matrix[np.diag_indices(len(matrix))] += 1.0
        return matrix

    def softest(self, tangent):
        """The change of the unknowns (3k,) against which the structure is softest, and whether it is stable."""
        factors, stable = _factors(self._matrix(tangent))
        mode = np.ones(len(self.inner))
        if factors is None:
            return mode, False
        for _ in range(INVERSE):
            mode = _back(factors, mode / np.abs(mode).max())
        return mode / np.abs(mode).max(), stable

    def displacement(self, unknowns, stress, amplitude):
        """Displacement (dofs,) of the whole structure."""
        structure = self.structure
        if not len(self.cells):
            return structure.response @ amplitude
        missing = self._missing(unknowns, stress)
        modes = self.by_loads[self.loose] @ amplitude - self.flexibility[np.ix_(self.loose, self.mean)] @ missing
        lacks = np.empty((len(self.cells), MODES))
        lacks[:, :MEAN] = missing.reshape(-1, MEAN)
        lacks[:, MEAN:] = (-self.taken * modes).reshape(-1, 2)
        force = structure.rows(self.cells).T @ lacks.reshape(-1)
        return structure.response @ amplitude - structure.answer(force)


def _solved(matrix, right):
    """Solution of a dense system, not finite where there is none, and whether the determinant is positive."""
    factors, positive = _factors(matrix)
    if factors is None:
        return np.full_like(right, np.nan), positive
    return _back(factors, right), positive


def _factors(matrix):
    """LU factors, None where there are none, and whether the determinant is positive."""
    if not np.isfinite(matrix).all():
        return None, False
    triangles, pivots, info = lapack.dgetrf(matrix, overwrite_a=True)
    if info != 0:
        return None, False
    swaps = np.count_nonzero(pivots != np.arange(len(matrix)))
    return (triangles, pivots), bool((swaps + np.count_nonzero(triangles.diagonal() < 0)) % 2 == 0)


def _back(factors, right):
    return lapack.dgetrs(*factors, right)[0]
