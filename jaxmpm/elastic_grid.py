"""Structures for multigrid: their stiffness without factors, ready to be solved for many right sides.

Which structures these are is a matter of what multigrid can do: degrees of freedom that move by themselves or not at all. Periodic
volumes, whose nodes are tied, and grids so long that their coarsest level is large stay with factors. And it is one of
measurement. Factors of an elastic structure serve for many solutions: with 203 000 unknowns they take 3.2 s and 1.3 GB, multigrid 1.5 s and
0.7 GB but seven seconds more to compile the first time, so that only larger ones do without (`LARGE`). A cracked one has another
stiffness in every step of Newton's method. There multigrid is as quick as factors of the zone that changes at 51 000 unknowns
(30 increments of the scene den behind its peak: 25.6 and 25.7 s), and quicker beyond (`MANY`).
"""

import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from jaxmpm import krylov
from jaxmpm.compilation import program
from jaxmpm.errors import RunError
from jaxmpm.krylov import Operator, gmres, no_border
from jaxmpm.multigrid import coarsest_unknowns, halvable

MANY = 60_000  # unknowns from which multigrid is quicker in Newton's systems
LARGE = 300_000  # unknowns from which it takes the place of the factors of the elastic structure, too
COARSEST = 2_500  # unknowns of the coarsest level, at most
PRECISION = 1e-10  # of the residual over the forces
MOST = 300  # steps of GMRES
LOST = 1e-12  # of the largest eigenvalue: that of a motion that nothing resists


def suits(shape, moves) -> bool:
    """Whether a structure on cells (nx, ny) whose unknowns move dofs by `moves` (dofs, unknowns) is one for multigrid."""
    alone = moves.nnz == moves.shape[1] and np.all(moves.data == 1)
    return bool(alone and moves.shape[1] >= MANY and coarsest_unknowns(shape) <= COARSEST)


class OnGrid:
    """Fields of a grid, laid out so that it can be halved."""

    def __init__(self, free, cell, thickness):
        """`free`: 1 where a degree of freedom may move, (2, nx+1, ny+1); cell size and thickness in mm."""
        self.nodes = np.shape(free)[1:]
        shape = tuple(n - 1 for n in self.nodes)
        self.more = [(0, wide - n) for n, wide in zip(shape, halvable(shape)[0], strict=True)]
        self.free, self.cell, self.thickness = self.pad(np.asarray(free, float)), float(cell), float(thickness)

    def pad(self, field):
        """A field with empty cells, or nodes that no cell holds, beyond the upper edges."""
        return np.pad(np.asarray(field), [(0, 0)] * (np.ndim(field) - 2) + self.more)

    def operator(self, tangent, hourglass, dtype=float) -> Operator:
        """The operator of cells (3, 3, nx, ny), (nx, ny), MPa."""
        cells = self.pad(tangent), self.pad(hourglass), self.free, self.cell, self.thickness
        return Operator(*(jnp.asarray(field, dtype) for field in cells))

    def preconditioner(self, tangent, hourglass):
        """Its preconditioner; cells as in `operator`, symmetric and positive."""
        low = self.operator(tangent, hourglass, jnp.float32)
        return program(krylov.prepared, low, optimised=False)(low)

    def vector(self, field, factor=0.0):
        """A vector of `krylov` of a nodal field (2, nx+1, ny+1), zero where nothing may move, and a factor."""
        return jnp.append(jnp.asarray((self.pad(field) * self.free).reshape(-1)), factor)

    def field(self, vector):
        """The nodal field (2, nx+1, ny+1) and the factor of a vector."""
        padded = np.asarray(vector[:-1]).reshape(self.free.shape)
        return padded[:, : self.nodes[0], : self.nodes[1]] * self.free[:, : self.nodes[0], : self.nodes[1]], float(vector[-1])


class Multigrid:
    """The stiffness of a grid, ready to be solved for many right sides.

    Args:
        tangent: dσ/dε of each cell in plane, MPa, (3, 3, nx, ny); zero where empty, symmetric.
        hourglass: stiffness of either hourglass amplitude per thickness, MPa, (nx, ny).
        free: 1 where a degree of freedom may move, (2, nx+1, ny+1).
        cell, thickness: mm.
    """

    def __init__(self, tangent, hourglass, free, cell, thickness):
        self.grid = OnGrid(free, cell, thickness)
        self.operator = self.grid.operator(tangent, hourglass)
        self.levels = self.grid.preconditioner(tangent, hourglass)

    def solve(self, b, tolerance=PRECISION):
        """Displacements (mm, zero where nothing is free) under forces b, N, both (2, nx+1, ny+1), and the `Solved` they come from.

        Raises RunError where the residual does not come down to `tolerance` times the forces.
        """
        right = self.grid.vector(b)
        found = gmres(self.levels, self.operator, no_border(self.grid.free.shape[1:]), right, tolerance, MOST)
        if not found.residual <= tolerance:
            raise RunError(
                f"the linear system kept a residual of {found.residual:.1e} after {found.steps} steps: a part of the body is "
                "held by nothing, or its stiffness is not positive"
            )
        return self.grid.field(found.x)[0], found


class Answers:
    """Displacements of an elastic structure under forces, in its unknowns: what `factors.Factors` is to smaller ones."""

    def __init__(self, multigrid, moves):
        """`moves` (dofs, unknowns) takes unknowns to dofs of the grid."""
        self.multigrid, self.moves = multigrid, moves

    def solve(self, right):
        """Solution for right sides (m,) or (m, many)."""
        shape = 2, *self.multigrid.grid.nodes
        columns = np.asarray(right, float).reshape(len(right), -1)
        found = [self.moves.T @ self.multigrid.solve((self.moves @ b).reshape(shape))[0].reshape(-1) for b in columns.T]
        return np.stack(found, axis=1).reshape(np.shape(right))


def is_held(filled, free) -> bool:
    """Whether supports leave no body, or part that hangs on a single node, free to move without strain.

    Cells that share an edge are rigid together; each such part has two displacements and a rotation, which vanish where nothing is
    free and agree at nodes that parts share.

    Args:
        filled: where there is material, (nx, ny).
        free: 1 where a degree of freedom may move, (2, nx+1, ny+1).
    """
    label, count = ndimage.label(filled)
    shape = tuple(n + 1 for n in label.shape)
    parts = [np.pad(label, ((i, 1 - i), (j, 1 - j))) for i in (0, 1) for j in (0, 1)]  # of the cells around a node
    x, y = (2 * k / (n - 1) - 1 for k, n in zip(np.indices(shape), shape, strict=True))
    one, none = np.ones(shape), np.zeros(shape)
    resisted = np.zeros((count, 3, count, 3))  # sum of squares of motions that are to vanish
    for motion, held in zip(((one, none, -y), (none, one, x)), np.asarray(free) == 0, strict=True):
        motion = np.stack(motion)
        for part in range(count):
            at = np.any([each == part + 1 for each in parts], axis=0) & held
            resisted[part, :, part] += motion[:, at] @ motion[:, at].T
        for k, first in enumerate(parts):
            for second in parts[:k]:
                for node in zip(*np.nonzero((first != second) & (first > 0) & (second > 0)), strict=True):
                    a, b, square = first[node] - 1, second[node] - 1, np.outer(motion[:, *node], motion[:, *node])
                    for into, of, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
                        resisted[into, :, of] += sign * square
    values = np.linalg.eigvalsh(resisted.reshape(3 * count, -1))
    return bool(values[0] > LOST * values[-1])
