"""Factors of a tangent stiffness of which little changes: only a zone about the cells that do is factorised anew.

Behind the peak some bands soften and all others are at rest, which answer by a secant: thousands of cracked cells may be
no part of what changes from step to step. All that lies further from the zone than a margin is eliminated once, with the tangents
of its bands as they are then (`substructure.py`), until too many of them become others: where a few do, the factors precondition GMRES
(Y. Saad, M. Schultz, SIAM J. Sci. Stat. Comput. 7, 1986).
"""

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from jaxmpm.factors import Factors
from jaxmpm.stiffness import MODES, weights_of
from jaxmpm.substructure import Substructure

MARGIN = 3  # cells about those that change, which are in the zone
SAME = 1e-9  # of the elastic stiffness, by which a tangent may differ and be the same
FORCING = 1e-4  # of a right side, that a solution may miss: Newton's next step makes it good
STEPS = 12  # of GMRES, after which a new zone is quicker
FEW = 3  # cells outside the zone that may have another tangent before the zone is chosen anew
LATELY = 8  # tangents back that a cell which does not soften may have changed to be in the zone
SMALLER = 30, 0.6  # tangents after which the zone is chosen anew where so small a share of its cells would do


class ZonedFactors:
    """Solves systems of the tangent stiffness of a structure: that of the tangents taken last."""

    def __init__(self, structure):
        self.structure = structure
        self.stiffness = (structure.moves.T @ structure.stiffness @ structure.moves).tocsr()  # of the uncracked structure
        self.tangent, self.hourglass = structure.elastic.copy(), structure.hourglass.copy()  # of all cells outside the zone
        self.before = np.full_like(structure.elastic, np.nan)  # tangents taken last, of all cells
        self.since = np.full(len(structure.elastic), LATELY + 1)  # tangents since a cell's changed
        self.near = np.zeros(len(structure.elastic), bool)  # cells in the zone
        self.part = self.factors = self.factored = None  # factors of the zone, and of which matrix
        self.cells, self.rows = None, None  # the cracked ones, and theirs of the strain operator by the unknowns
        self.eliminated = np.zeros(0, int)  # cracked cells outside the zone as it was chosen
        self.taken, self.lively = 0, 0  # tangents since the zone was chosen, and cells about which it was

    def take(self, cells, tangent, hourglass):
        """The tangents (k, 3, 3), MPa, and hourglass stiffness (k,), N/mm, of the cracked cells (flat indices)."""
        if not np.array_equal(cells, self.cells):
            self.cells = cells
            self.rows = (self.structure.rows(cells) @ self.structure.moves).tocsr()
        self.asked = cells, tangent, hourglass
        self.blocks = self._blocks(slice(None))
        self.since[cells] = np.where(self._differs(self.before), 0, self.since[cells] + 1)
        self.before[cells] = tangent
        live = self._live()
        outside = (self._differs(self.tangent) | (hourglass != self.hourglass[cells])) & ~self.near[cells]
        whole_again = np.setdiff1d(self.eliminated, cells)
        if self.part is None or outside.sum() > FEW or len(whole_again) or self._shrinks(live.sum()):
            self._eliminate(live)
            outside[:] = False
        self.alike = not outside.any()  # outside the zone
        self._assemble()

    def solve(self, right):
        """Solution for right sides (m,) or (m, many), as exact as Newton's method needs; raises RuntimeError where singular."""
        self._factorise()
        near = lambda b: self.part.solve(b, self.factors.solve)  # noqa: E731
        found = None if self.alike else _iterated(self._times, right, near)
        if found is None:
            self.sharpen()
            found = near(right)
        return found

    def _times(self, unknowns):
        """The tangent stiffness times unknowns (m,)."""
        return self.stiffness @ unknowns + self.rows.T @ (self.blocks @ (self.rows @ unknowns))

    def sharpen(self):
        """Make the factors exact; raises RuntimeError where the matrix is singular."""
        if not self.alike:
            self._eliminate(self._live())
            self.alike = True
            self._assemble()
        self._factorise()

    def solve_transposed(self, right):
        """Solution of the transposed system: outside the zone the stiffness is symmetric."""
        self.sharpen()
        return self.part.solve(right, self.factors.solve_transposed)

    @property
    def positive(self):
        """Whether the determinant is positive; raises RuntimeError where the matrix is singular."""
        self.sharpen()
        return self.factors.positive == self.part.positive

    def _differs(self, tangent):
        """Which of the cracked cells have another tangent than those of all cells say, (k,)."""
        cells, now, _ = self.asked
        return np.abs(now - tangent[cells]).max((1, 2)) > SAME * np.abs(self.structure.elastic[cells]).max((1, 2))

    def _live(self):
        """Which of the cracked cells are likely to change: those that soften, and those that did lately, (k,)."""
        cells, tangent, _ = self.asked
        return (self.since[cells] <= LATELY) | (np.linalg.eigvalsh((tangent + tangent.swapaxes(1, 2)) / 2)[:, 0] < 0)

    def _shrinks(self, live):
        self.taken += 1
        return self.taken > SMALLER[0] and live < SMALLER[1] * self.lively

    def _eliminate(self, which):
        """Choose the zone anew, about some of the cracked cells (k,)."""
        structure, (cells, tangent, hourglass) = self.structure, self.asked
        self.taken, self.lively = 0, which.sum()
        live = np.zeros(len(self.near))
        live[cells[which]] = 1.0
        live[cells[-1]] = 1.0  # so that there is a zone
        strain = abs(structure.strain)
        for _ in range(MARGIN):
            live = (strain @ (strain.T @ np.repeat(live > 0, MODES))).reshape(-1, MODES).sum(1)
        self.near = live > 0
        self.tangent, self.hourglass = structure.elastic.copy(), structure.hourglass.copy()
        far = ~self.near[cells]
        self.eliminated = cells[far]
        self.tangent[cells[far]], self.hourglass[cells[far]] = tangent[far], hourglass[far]
        stays = np.asarray(abs(structure.rows(np.flatnonzero(self.near)) @ structure.moves).sum(0)).reshape(-1) > 0
        rows, blocks = self.rows[np.repeat(far, MODES)], self._blocks(far)
        stiffness = self.stiffness + rows.T @ (blocks @ rows)
        self.part = Substructure(stiffness, stays, structure.order)

    def _blocks(self, which):
        """Stiffness of some of the cracked cells (k,) over that when they were whole, a sparse matrix."""
        structure, (cells, tangent, hourglass) = self.structure, self.asked
        own = cells[which]
        return weights_of(structure.volume * (tangent[which] - structure.elastic[own]), hourglass[which] - structure.hourglass[own])

    def _assemble(self):
        """The matrix of the zone."""
        inside = self.near[self.asked[0]]
        rows = self.rows[np.repeat(inside, MODES)][:, self.part.own]
        self.matrix = (self.part.matrix + rows.T @ (self._blocks(inside) @ rows)).tocsr()

    def _factorise(self):
        if self.factored is not self.matrix:
            self.factors, self.factored = Factors(self.matrix, np.arange(len(self.part.own))), self.matrix


def _iterated(times, right, near):
    """Solution for right sides by GMRES, `near` the solution of a system near by; None where it takes too many steps."""
    shape = (len(right),) * 2
    stiffness, inverse = (LinearOperator(shape, function, dtype=float) for function in (times, near))
    found = []
    for column in right.reshape(len(right), -1).T:
        one, failed = gmres(stiffness, column, rtol=FORCING, atol=0.0, restart=STEPS, maxiter=1, M=inverse)
        if failed:
            return None
        found.append(one)
    return np.stack(found, axis=1).reshape(right.shape)
