"""Factors of a tangent stiffness of which little changes: only a zone about the cells that do is factorised anew.

Behind the peak some bands soften and all others are at rest, which answer by a secant: thousands of cracked cells may be
no part of what changes from step to step. All that lies further from the zone than a margin is eliminated once, with the tangents
of its bands as they are then (`substructure.py`), until too many of them become others.
"""

import numpy as np

from jaxmpm.factors import Factors
from jaxmpm.stiffness import MODES, weights_of
from jaxmpm.substructure import Substructure

MARGIN = 3  # cells about those that change, which are in the zone
SAME = 1e-9  # of the elastic stiffness, by which a tangent may differ and be the same
FEW = 3  # cells outside the zone that may have another tangent before the zone is chosen anew
LATELY = 8  # tangents back that a cell which does not soften may have changed to be in the zone
SMALLER = 30, 0.6  # tangents after which the zone is chosen anew where so small a share of its cells would do


class ZonedFactors:
    """Factors of the tangent stiffness of a structure; what is asked for is that of the tangents taken last."""

    def __init__(self, structure):
        self.structure = structure
        self.stiffness = (structure.moves.T @ structure.stiffness @ structure.moves).tocsr()  # of the uncracked structure
        self.tangent, self.hourglass = structure.elastic.copy(), structure.hourglass.copy()  # of all cells outside the zone
        self.before = np.full_like(structure.elastic, np.nan)  # tangents taken last, of all cells
        self.since = np.full(len(structure.elastic), LATELY + 1)  # tangents since a cell's changed
        self.near = np.zeros(len(structure.elastic), bool)  # cells in the zone
        self.part = None
        self.taken, self.lively = 0, 0  # tangents since the zone was chosen, and cells about which it was

    def take(self, cells, tangent, hourglass):
        """The tangents (k, 3, 3), MPa, and hourglass stiffness (k,), N/mm, of the cracked cells (flat indices).

        Raises RuntimeError where what is left of the zone is singular.
        """
        self.asked = cells, tangent, hourglass
        self.since[cells] = np.where(self._differs(self.before), 0, self.since[cells] + 1)
        self.before[cells] = tangent
        live = self._live()
        outside = (self._differs(self.tangent) | (hourglass != self.hourglass[cells])) & ~self.near[cells]
        if self.part is None or outside.sum() > FEW or self._shrinks(live.sum()):
            self._eliminate(live)
            outside[:] = False
        self.exact = not outside.any()  # else the factors are those of a matrix near by
        self._factorise()

    def sharpen(self):
        """Make the factors exact."""
        if not self.exact:
            self._eliminate(self._live())
            self.exact = True
            self._factorise()

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
        self.tangent[cells[far]], self.hourglass[cells[far]] = tangent[far], hourglass[far]
        stays = np.asarray(abs(structure.rows(np.flatnonzero(self.near)) @ structure.moves).sum(0)).reshape(-1) > 0
        self.part = Substructure(self.stiffness + self._change(cells[far], tangent[far], hourglass[far]), stays, structure.order)

    def _change(self, cells, tangent, hourglass, columns=slice(None)):
        """How the stiffness of the unknowns in `columns` differs from that of the uncracked structure, by cells as they are."""
        structure = self.structure
        rows = (structure.rows(cells) @ structure.moves)[:, columns].tocsr()
        mean, modes = structure.volume * (tangent - structure.elastic[cells]), hourglass - structure.hourglass[cells]
        return rows.T @ (weights_of(mean, modes) @ rows)

    def _factorise(self):
        """Factors of the zone."""
        cells, tangent, hourglass = self.asked
        inside, own = self.near[cells], self.part.own
        self.factors = Factors(self.part.matrix + self._change(cells[inside], tangent[inside], hourglass[inside], own), np.arange(len(own)))

    def solve(self, right):
        """Solution for right sides (m,) or (m, many)."""
        return self.part.solve(right, self.factors.solve)

    def solve_transposed(self, right):
        """Solution of the transposed system: outside the zone the stiffness is symmetric."""
        return self.part.solve(right, self.factors.solve_transposed)

    @property
    def positive(self):
        """Whether the determinant is positive."""
        return self.factors.positive == self.part.positive
