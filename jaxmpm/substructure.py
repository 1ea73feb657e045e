"""The part of a structure that stays as it is, eliminated once: what is left are the unknowns of a zone that changes.

Where I are the unknowns that go, and B those that stay,

    S = K_BB − K_BI K_II⁻¹ K_IB,      u_I = K_II⁻¹ (f_I − K_IB u_B)

Only on the edge b of B, which K couples to I, is S another than K. Sparse factors of I and b, b last, hold all that is needed: the product
of their last blocks is S_bb. (J. Przemieniecki, Matrix structural analysis of substructures, AIAA J. 1, 1963, for the method.)
"""

import numpy as np
from scipy.sparse.linalg import splu

from jaxmpm.factors import OPTIONS


class Substructure:
    """Some unknowns of a structure, all others eliminated."""

    def __init__(self, matrix, stays, order):
        """
        Args:
            matrix: K, symmetric and positive, (m, m).
            stays: which unknowns stay (m,), boolean.
            order: of elimination (m,).
        """
        matrix, gone, own = matrix.tocsr(), order[~stays[order]], order[stays[order]]
        edge = np.zeros(len(own), bool)
        edge[np.unique(matrix[gone][:, own].indices)] = True
        self.own = np.concatenate([own[~edge], own[edge]])  # numbers of those that stay, in order of elimination
        self.gone, self.edge = gone, np.arange(len(own) - edge.sum(), len(own))  # places of the edge among `own`
        self.matrix = matrix[self.own][:, self.own].tocsr()  # S
        self.positive = True
        if len(gone):
            self._eliminate(matrix)

    def _eliminate(self, matrix):
        self.part = np.concatenate([self.gone, self.own[self.edge]])
        diagonal = dict(permc_spec="NATURAL", diag_pivot_thresh=0.0, options=dict(OPTIONS))
        self.lu = splu(matrix[self.part][:, self.part].tocsc(), **diagonal)
        last = self.lu.perm_c[len(self.gone) :]
        low, high = (triangle.tocsr()[last][:, last].toarray() for triangle in (self.lu.L, self.lu.U))
        self.stiffness = low @ high  # S_bb
        pivots = self.lu.U.diagonal()[self.lu.perm_c[: len(self.gone)]]
        self.positive = bool(np.count_nonzero(pivots < 0) % 2 == 0)  # whether the determinant of K_II is
        corner = self.matrix.tolil()
        corner[np.ix_(self.edge, self.edge)] = self.stiffness
        self.matrix = corner.tocsr()

    def solve(self, right, solve_own):
        """All unknowns (m,) or (m, many) under forces, where `solve_own` answers for those that stay."""
        forces, alone = right[self.own], np.zeros((len(self.edge), *right.shape[1:]))
        if not len(self.gone):
            found = np.empty_like(forces)
            found[self.own] = solve_own(forces)
            return found
        # what the edge would do under f_I, were all else held
        alone = self.lu.solve(np.concatenate([right[self.gone], alone]))[len(self.gone) :]
        forces[self.edge] += self.stiffness @ alone
        own = solve_own(forces)
        there = self.stiffness @ (own[self.edge] - alone)
        found = np.empty_like(right)
        found[self.own] = own
        found[self.gone] = self.lu.solve(np.concatenate([right[self.gone], there]))[: len(self.gone)]
        return found
