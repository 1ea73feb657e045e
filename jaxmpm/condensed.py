"""Equilibrium on the cracked cells alone: what answers linearly is condensed out, the bulk as well as bands at rest.

The base is a structure in which every cell answers affinely, σ = S e + t: intact ones elastically, cracked ones as they did
when the base was renewed last, by the secant of a band at rest or as if they were elastic. With e the mean strain of the
cracked cells, and m = w (σ(e) − S e − t) what they bear more than in the base,

    e = Σ aᵢ eᵢ + o − F m

aᵢ the amplitudes of the loads, eᵢ the strain in the base that each causes, o that caused by t, w the cell's volume and
F = S_op K⁻¹ S_opᵀ the strain in cracked cells due to stress in others (Betti: symmetric), K the stiffness of the base. Only
cells that load bear anything else than the base says: Newton's systems are three times as large as their number. K has no
hourglass stiffness in cracked cells, which a band does not have. F follows changes of the base, and cells that crack, by
Woodbury's formula; a cell more costs five solves with the uncracked structure.
"""

import numpy as np
from scipy.linalg import lapack

from jaxmpm.stiffness import MEAN, MODES, Structure

INVERSE = 6  # steps of inverse iteration for the softest mode
GRIP = 1e-6  # share of its hourglass stiffness that a cracked cell keeps, so that nothing flutters
NOTHING = 1e-11  # of the largest stress, and of the elastic stiffness: what differs by less does not differ
GROWTH = 1.5  # of the room for cells, when it is used up
STRIPS = 256  # rows of F that are changed together
STALE = (16, 0.3)  # cells that rest otherwise than the base says, and that over those that load, before it is renewed


class Condensed:
    """The equations of the cracked cells; unknowns are their mean strains (3k,), residuals are strains too."""

    def __init__(self, structure: Structure, gauge=None):
        """A gauge is a vector of weights (dofs,) of the displacement; its reading can be asked for."""
        self.structure, self.cells = structure, np.zeros(0, int)
        self.stable = None  # whether the structure was at the last step, under the loads as they were
        self.gauge = gauge if gauge is not None else np.zeros(structure.strain.shape[1])
        # the gauge comes first among the rows of F, then five for each cell
        self._room = np.zeros((1, 1))
        self.flexibility = self._room
        self.bare = (self.gauge @ structure.response)[None]  # response to the loads of the uncracked structure
        self.answers = np.concatenate([self.bare, np.zeros((1, 1))], 1)  # that of the base, and o behind the loads
        self.secant = np.zeros((0, MEAN, MEAN))  # w S of the base, N/mm · mm
        self.constant = np.zeros(0)  # w t, (3k,)
        self._index()

    def _index(self):
        """What follows from the cells, and the active ones among them forgotten."""
        structure, k = self.structure, np.arange(len(self.cells))
        self.mean = self._mean_of(k)
        self.loose = (1 + MODES * k[:, None] + np.arange(MEAN, MODES)).reshape(-1)
        self.taken = (1 - GRIP) * np.repeat(structure.hourglass[self.cells], 2)
        self.weighted = structure.volume * structure.elastic[self.cells]  # w C, (k, 3, 3)
        self.active = np.zeros(0, int)  # places of cells that have borne something else than the base says
        self._rows = np.zeros((0, len(self.flexibility)))  # of F, theirs
        self._by_unknowns = None

    @property
    def by_loads(self):
        """Strains and hourglass amplitudes in the base by a unit of each load, (1 + 5k, loads)."""
        return self.answers[:, :-1]

    def _softened(self, rows):
        """Change of stiffness from the uncracked structure to the base, times rows (1 + 5k, many) of its answers."""
        found = np.zeros_like(rows)
        by_cell = rows[self.mean].reshape(len(self.cells), MEAN, rows.shape[1])
        found[self.mean] = np.matmul(self.secant - self.weighted, by_cell).reshape(len(self.mean), rows.shape[1])
        found[self.loose] = -self.taken[:, None] * rows[self.loose]
        return found

    def add(self, cells):
        """Take more cells (flat indices) among the cracked ones; in the base they are elastic but for the hourglass."""
        structure, new, before = self.structure, np.asarray(cells, int), len(self.flexibility)
        rows, bare = structure.rows(new), structure.rows(new) @ structure.response
        caused = structure.answer(rows.T.toarray())
        column = np.concatenate([(self.gauge @ caused)[None], structure.rows(self.cells) @ caused])  # as in the uncracked structure
        corner, softened = rows @ caused, self._softened(column)
        column -= self.flexibility @ softened
        corner -= column.T @ softened
        theirs = bare - column.T @ self._softened(self.bare), -column[self.mean].T @ self.constant[:, None]
        answers = np.concatenate([self.answers, np.concatenate(theirs, 1)])
        grown = self._grown(before + len(corner))
        grown[:before, before:], grown[before:, :before] = column, column.T
        grown[before:, before:] = (corner + corner.T) / 2
        loose = before + np.flatnonzero(np.arange(len(corner)) % MODES >= MEAN)
        taken = (1 - GRIP) * np.repeat(structure.hourglass[new], 2)
        across = grown[:, loose].copy()
        matrix = np.diag(1 / taken) - across[loose]
        _take_away(grown, across, -np.linalg.solve(matrix, across.T))
        self.answers = answers + across @ np.linalg.solve(matrix, answers[loose])
        self.bare = np.concatenate([self.bare, bare])
        self.cells = np.concatenate([self.cells, new])
        self.secant = np.concatenate([self.secant, structure.volume * structure.elastic[new]])
        self.constant = np.concatenate([self.constant, np.zeros(MEAN * len(new))])
        self._index()

    def _grown(self, size):
        """F with room for more rows and columns, what was there kept."""
        old = self.flexibility
        if size > len(self._room):
            self._room = np.empty((int(GROWTH * size),) * 2)
            self._room[: len(old), : len(old)] = old
        self.flexibility = self._room[:size, :size]
        return self.flexibility

    def renew(self, strain, stress, tangent, rests):
        """Take cells that rest into the base as they answer now, if there are enough whose answer is another there.

        Args:
            strain, stress: in the last equilibrium (3k,).
            tangent: of the bands there, MPa, (k, 3, 3).
            rests: where a band rests, (k,).
        """
        now = self.structure.volume * tangent
        differs = np.abs(now - self.secant).max((1, 2), initial=0.0) > NOTHING * np.abs(self.weighted).max(initial=0.0)
        symmetric = np.abs(now - now.swapaxes(1, 2)).max((1, 2), initial=0.0) <= NOTHING * np.abs(self.weighted).max(initial=0.0)
        stale = np.flatnonzero(differs & rests & symmetric)
        if len(stale) <= STALE[0] + STALE[1] * (differs & ~rests).sum():
            return
        own = np.einsum("kij,kj->ki", now[stale], strain.reshape(-1, MEAN)[stale])
        constant = self.structure.volume * stress.reshape(-1, MEAN)[stale] - own
        self._rebase(stale, now[stale], constant)

    def _rebase(self, places, secant, constant):
        """Let some cells answer by w S (j, 3, 3) and w t (j, 3) in the base."""
        rows, was = self.flexibility[self._mean_of(places)], self.constant.reshape(-1, MEAN)
        softer, more = secant - self.secant[places], (constant - was[places]).reshape(-1, 1)
        matrix = _by_blocks(rows[:, self._mean_of(places)], softer)
        matrix[np.diag_indices(len(matrix))] += 1.0
        answers = self.answers[self._mean_of(places)]
        answers[:, -1:] -= rows[:, self._mean_of(places)] @ more
        after = np.linalg.solve(matrix, np.concatenate([rows, answers], 1))
        after = np.matmul(softer, after.reshape(len(places), MEAN, -1)).reshape(after.shape)
        after[:, -1:] += more
        _take_away(self.flexibility, rows.T, after[:, : len(self.flexibility)])
        self.answers = self.answers - rows.T @ after[:, len(self.flexibility) :]
        self.secant[places] = secant
        was[places] = constant
        self._index()

    def keep(self, count):
        """Forget all but the first cells: those that cracked last are whole again."""
        rows, gone = 1 + MODES * count, slice(count, None)
        if count >= len(self.cells):
            return
        across, corner = self.flexibility[rows:, :rows], self.flexibility[rows:, rows:]
        stiffer = np.zeros((len(self.cells) - count, MODES, MODES))
        stiffer[:, :MEAN, :MEAN] = self.weighted[gone] - self.secant[gone]
        stiffer[:, 3, 3] = stiffer[:, 4, 4] = self.taken[2 * count :: 2]
        more = np.zeros((len(stiffer), MODES))
        more[:, :MEAN] = -self.constant[MEAN * count :].reshape(-1, MEAN)
        answers = self.answers[rows:].copy()
        answers[:, -1] -= corner @ more.reshape(-1)
        matrix = np.eye(len(corner)) + _by_blocks(corner, stiffer)
        after = np.linalg.solve(matrix, np.concatenate([across, answers], 1))
        after = np.matmul(stiffer, after.reshape(len(stiffer), MODES, -1)).reshape(after.shape)
        after[:, -1] += more.reshape(-1)
        self.flexibility, self.bare = self.flexibility[:rows, :rows], self.bare[:rows]
        _take_away(self.flexibility, across.T, after[:, :rows])
        self.answers = self.answers[:rows] - across.T @ after[:, rows:]
        self.cells, self.secant, self.constant = self.cells[:count], self.secant[:count], self.constant[: MEAN * count]
        self._index()

    # -- equations -------------------------------------------------------------------------------

    def unknowns(self, displacement, amplitude):
        """Unknowns of a displacement (dofs,)."""
        return self.structure.rows(self.cells, MEAN) @ displacement

    def strain(self, unknowns, amplitude):
        """Mean strain (3k,) of the cracked cells."""
        return unknowns

    def slopes(self, by_strain, direction):
        """Slopes by the unknowns and along a direction of the loads, from those by strain (3k,)."""
        return by_strain, 0.0

    def _mean_of(self, places):
        """Rows of F for the mean strain of the cells at some places."""
        return (1 + MODES * places[:, None] + np.arange(MEAN)).reshape(-1)

    def _activate(self, differs):
        """Take cells that differ from the base, (k,), among the active ones."""
        new = np.setdiff1d(np.flatnonzero(differs), self.active)
        if len(new):
            self.active = np.concatenate([self.active, new])
            self._rows = np.concatenate([self._rows, self.flexibility[self._mean_of(new)]])

    def _more(self, strain, stress):
        """m, N·mm, of the active cells (3a,): what they bear more than in the base; those of others is next to nothing."""
        weighed = self.structure.volume * stress.reshape(-1, MEAN)
        more = weighed - np.einsum("kij,kj->ki", self.secant, strain.reshape(-1, MEAN)) - self.constant.reshape(-1, MEAN)
        self._activate(np.abs(more).max(1, initial=0.0) > NOTHING * np.abs(weighed).max(initial=0.0))
        return more[self.active].reshape(-1)

    def _answer(self, rows, unknowns, stress, amplitude):
        """Some rows of the answer of the structure in which the cracked cells bear a stress."""
        more = self._more(unknowns, stress)
        return self.answers[rows] @ np.append(amplitude, 1.0) - (more @ self._rows)[rows]

    def residual(self, unknowns, stress, amplitude):
        """Strain (3k,) that is out of balance, for bands' stress (3k,), MPa."""
        return unknowns - self._answer(self.mean, unknowns, stress, amplitude)

    def size(self, residual, strength, stiffness):
        """Largest residual as a share of the strain at onset."""
        return np.abs(residual).max(initial=0.0) * stiffness / strength

    def reading(self, unknowns, stress, amplitude):
        """The gauge's reading, mm."""
        return self._answer(0, unknowns, stress, amplitude)

    def reading_slopes(self, tangent, direction):
        """How the reading changes with the strain (3k,) and along a direction of the loads."""
        row = self.flexibility[0, self.mean].reshape(-1, 1, MEAN)
        softer = self.structure.volume * tangent - self.secant
        return -np.matmul(row, softer).reshape(len(self.mean)), self.by_loads[0] @ direction

    def step(self, tangent, residual, direction=None, slopes=None, short=0.0):
        """Newton's change of the unknowns (3k,) and of the load factor.

        Args:
            tangent: of the bands, MPa, (k, 3, 3).
            residual: (3k,).
            direction: change of the amplitudes with the load factor (loads,); None: it is given.
            slopes: how what is controlled changes with strain (3k,) and load factor.
            short: what is controlled still lacks.
        """
        matrix, change = self._matrix(tangent)
        own = self._own
        if direction is None:
            active, self.stable = _solved(matrix, -residual[own])
            return self._all(active, change, -residual), 0.0
        (row, along), column = slopes, self.by_loads[self.mean] @ direction
        # what is controlled, by the active cells and the factor: the others follow from them
        rest = row.copy()
        rest[own] = 0.0
        through = self._rows[:, self.mean] @ rest
        active_row = row[own] - np.matmul(through.reshape(-1, 1, MEAN), change).reshape(len(own))
        along, short = along + rest @ column, short + rest @ residual
        scale = np.abs(active_row).max(initial=abs(along)) or 1.0  # of the last row: pivots are chosen by size
        matrix = np.block([[matrix, -column[own, None]], [active_row[None] / scale, np.array([[along / scale]])]])
        found, _ = _solved(matrix, np.append(-residual[own], short / scale))
        self.stable = None  # of the structure under its loads nothing is said
        return self._all(found[:-1], change, found[-1] * column - residual), found[-1]

    @property
    def _own(self):
        """Places of the active cells' unknowns."""
        return (MEAN * self.active[:, None] + np.arange(MEAN)).reshape(-1)

    def _matrix(self, tangent):
        """1 + F (w D − w S) of the active cells, (3a, 3a), and w D − w S (a, 3, 3).

        Its determinant is that of the tangent stiffness over that of the base, which is positive.
        """
        softer = self.structure.volume * tangent - self.secant
        self._activate(np.abs(softer).max((1, 2), initial=0.0) > NOTHING * np.abs(self.weighted).max(initial=0.0))
        change = softer[self.active]
        matrix = _by_blocks(self._rows[:, self._mean_of(self.active)], change)
        matrix[np.diag_indices(len(matrix))] += 1.0
        return matrix, change

    def _all(self, active, change, right):
        """Unknowns (3k,) from those of the active cells: x + F (w D − w S) x = right."""
        force = np.matmul(change, active.reshape(-1, MEAN, 1)).reshape(len(active))
        found = right - (force @ self._rows)[self.mean]
        found[self._own] = active
        return found

    def softest(self, tangent):
        """The change of the unknowns (3k,) against which the structure is softest, and whether it is stable."""
        matrix, change = self._matrix(tangent)
        mode = np.ones(len(self.mean))
        if not len(matrix):  # all rest, as in the base
            return mode, True
        factors, stable = _factors(matrix)
        if factors is None:
            return mode, False
        for _ in range(INVERSE):
            mode /= np.abs(mode).max()
            mode = self._all(_back(factors, mode[self._own]), change, mode)
        return mode / np.abs(mode).max(), stable

    def adjoint(self, tangent, right):
        """λ with Kᵀ λ = right, both of the unknowns of the structure, (m,) or (m, many); K its tangent stiffness.

        Tangents of the bands (k, 3, 3), MPa.
        """
        structure, columns = self.structure, right.reshape(len(right), -1)
        found = structure.factors.solve(columns)
        if not len(self.cells):
            return found.reshape(right.shape)
        seen = np.concatenate([np.zeros((1, columns.shape[1])), self.by_unknowns @ found])
        seen -= self.flexibility @ self._softened(seen)  # as in the base
        matrix, change = self._matrix(tangent.swapaxes(1, 2))
        active, _ = _solved(matrix, seen[self._mean_of(self.active)])
        force = np.matmul(change, active.reshape(len(change), MEAN, columns.shape[1])).reshape(active.shape)
        seen -= self._rows.T @ force
        lacks = self._softened(seen)
        lacks[self._mean_of(self.active)] += force
        return (found - structure.factors.solve(self.by_unknowns.T @ lacks[1:])).reshape(right.shape)

    @property
    def by_unknowns(self):
        """Strains and hourglass amplitudes of the cracked cells by the structure's unknowns, sparse (5k, m)."""
        if self._by_unknowns is None:
            self._by_unknowns = self.structure.rows(self.cells) @ self.structure.moves
        return self._by_unknowns

    def displacement(self, unknowns, stress, amplitude):
        """Displacement (dofs,) of the whole structure."""
        structure = self.structure
        if not len(self.cells):
            return structure.response @ amplitude
        elastic = np.einsum("kij,kj->ki", self.weighted, unknowns.reshape(-1, MEAN))
        lacks = np.empty((len(self.cells), MODES))
        lacks[:, :MEAN] = structure.volume * stress.reshape(-1, MEAN) - elastic
        modes = self._answer(self.loose, unknowns, stress, amplitude)
        lacks[:, MEAN:] = (-self.taken * modes).reshape(-1, 2)
        force = structure.rows(self.cells).T @ lacks.reshape(-1)
        return structure.response @ amplitude - structure.answer(force)


def _by_blocks(rows, blocks):
    """rows (r, ba) times a block diagonal matrix of blocks (a, b, b)."""
    return np.matmul(rows.reshape(len(rows), len(blocks), 1, blocks.shape[-1]), blocks).reshape(rows.shape)


def _take_away(matrix, left, right):
    """matrix −= left · right, in place and in strips, so that no second matrix is needed."""
    for start in range(0, len(matrix), STRIPS):
        matrix[start : start + STRIPS] -= left[start : start + STRIPS] @ right


def _solved(matrix, right):
    """Solution of a dense system, not finite where there is none, and whether the determinant is positive."""
    if not len(right):
        return right, True
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
