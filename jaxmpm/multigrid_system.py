"""Equilibrium of all nodes at once without factors: for grids on which those take longer, and more memory.

The same equations as in `full_system.py`, with the same methods. Newton's systems are solved by GMRES with one multigrid V-cycle as
preconditioner (`krylov.py`), only as far as it helps (S. Eisenstat, H. Walker, SIAM J. Sci. Comput. 17, 1996). The tangent stiffness
of softening bands is not positive and need not be symmetric, which GMRES does not mind; the cycle is that of an operator near it that
is: tangents of bands symmetric, without negative eigenvalues. That of an earlier step is tried first: a new one costs as much as
ten steps, but takes a third of those that an old one does once other bands load. What is controlled, and the load factor, are one
equation and one unknown more: the bordered system is regular at a limit point, where the tangent stiffness is not.

There is no inertia here to tell whether the structure is stable: see `stable` and `softest` for what is said instead.
"""

import jax.numpy as jnp
import numpy as np

from jaxmpm.all_nodes import AllNodes
from jaxmpm.condensed import GRIP
from jaxmpm.errors import RunError
from jaxmpm.krylov import arnoldi, bordered, combined, gmres, image, no_border

FORCING = (1e-3, 1e-5)  # of a right side that its solution may miss, at most and at least
SHARE = 0.5  # of the square by which the residual fell in the last step, that the next solution may miss
MOST = 90  # steps of GMRES
USELESS = 0.5  # of a right side left, from which on there is no step
LAGGED = 10  # of these with an earlier preconditioner: they take as long as to make a new one
FLOOR = 1e-6  # of the elastic stiffness, that the preconditioner has in a broken cell
EXHAUSTED = 1e-9  # of a start vector left: beyond that a Krylov basis loses its independence
SEEN = 0.1  # of the share that one mode has in noise: with so much of it left, none has been missed
PRECISION, ADJOINT = 1e-10, 1e-6  # of the way back: what is aimed at, and what is enough


class MatrixFree(AllNodes):
    """The equations of all nodes, solved without factors."""

    def __init__(self, structure, cells=(), gauge=None):
        """Arguments as those of `AllNodes`."""
        self.asked = None  # tangents at the last step, if the loads stayed as they were
        self.grid = structure.grid
        self.levels = None  # of a preconditioner
        self.before = None  # size of the residual at the last step
        self.counts = {"solves": 0, "steps": 0, "preconditioners": 0, "looks": 0}
        super().__init__(structure, cells, gauge)

    def add(self, cells):
        """Take more cells (flat indices) among the cracked ones."""
        super().add(cells)
        self.hourglass = self.structure.hourglass / self.grid.thickness
        self.hourglass[self.cells] *= GRIP
        self.hourglass = self.hourglass.reshape([n - 1 for n in self.grid.nodes])

    # -- Newton's steps --------------------------------------------------------------------------

    def step(self, tangent, residual, direction=None, slopes=None, short=0.0):
        """Newton's change of the unknowns (m,) and of the load factor; arguments as in `Condensed.step`."""
        border = None if direction is None else self._border(tangent, direction, slopes)
        self.asked = tangent if direction is None else None
        found = self._solved(tangent, -residual, border, short, self._forcing(residual))
        if not found.residual <= USELESS:
            return np.full_like(residual, np.nan), np.nan
        field, factor = self.grid.field(found.x)
        return self.structure.moves.T @ field.reshape(-1), 0.0 if direction is None else factor

    def _forcing(self, residual):
        """How much of the right side the next solution may miss: little more than Newton's method leaves anyway."""
        size, before = np.linalg.norm(residual), self.before
        self.before = size
        fallen = min(size / before, 1.0) if before else 1.0
        return float(np.clip(SHARE * fallen**2, FORCING[1], FORCING[0]))

    def _border(self, tangent, direction, slopes):
        """Column, row and own of the equation of what is controlled, both fields by nodes."""
        return self._field(self.driven(tangent, direction)), self._field(slopes[0]), slopes[1]

    def _field(self, unknowns):
        return (self.structure.moves @ unknowns).reshape(2, *self.grid.nodes)

    def _fields(self, tangent):
        """dσ/dε of all cells (3, 3, nx, ny) with tangents (k, 3, 3) in the cracked ones."""
        field = np.moveaxis(self.structure.elastic, 0, -1).copy()
        field[:, :, self.cells] = np.moveaxis(tangent, 0, -1)
        return field.reshape(3, 3, *self.hourglass.shape)

    def _solved(self, tangent, right, border, short, tolerance):
        """Solution of a system for a right side (m,), with the last preconditioner if it soon does, else on with a new one."""
        operator, start = self.grid.operator(self._fields(tangent), self.hourglass), None
        if self.levels is not None:
            found = self._attempt(operator, right, border, short, tolerance, LAGGED)
            if found.residual <= tolerance:
                return found
            start = found.x
        self._precondition(tangent)
        return self._attempt(operator, right, border, short, tolerance, MOST, start)

    def _precondition(self, tangent):
        """Make the preconditioner of tangents (k, 3, 3)."""
        self.levels = self.grid.preconditioner(self._fields(positive(tangent, self.structure.elastic[self.cells])), self.hourglass)
        self.counts["preconditioners"] += 1

    def _attempt(self, operator, right, border, short, tolerance, most, start=None):
        """What GMRES makes of a system in some steps."""
        edge, scale = no_border(self.grid.free.shape[1:]), 1.0
        if border is not None:
            edge, scale = bordered(self.levels, operator, *(self.grid.pad(field) for field in border[:2]), border[2])
        found = gmres(self.levels, operator, edge, self.grid.vector(self._field(right), scale * short), tolerance, most, start)
        self.counts["solves"] += 1
        self.counts["steps"] += found.steps
        return found

    def adjoint(self, tangent, right):
        """λ with Kᵀ λ = right, both of the unknowns, (m,) or (m, many); arguments as in `Condensed.adjoint`.

        Raises RunError without a solution.
        """
        solutions = []
        for column in right.reshape(len(right), -1).T:
            found = self._solved(tangent.swapaxes(1, 2), column, None, 0.0, PRECISION)
            if not found.residual <= ADJOINT:
                raise RunError(f"a system of the way back kept a residual of {found.residual:.1e}: its equilibrium is at a limit of the loads")
            solutions.append(self.structure.moves.T @ self.grid.field(found.x)[0].reshape(-1))
        return np.stack(solutions, axis=1).reshape(right.shape)

    @property
    def stable(self):
        """Whether the structure seems so at the last step, under the loads as they were; None where nothing is said of it.

        A look that ends as soon as noise is so well resolved that no single mode can have been missed but by bad luck.
        """
        enough = SEEN / np.sqrt(self.structure.moves.shape[1])
        return None if self.asked is None else self.softest(self.asked, enough)[1]

    def softest(self, tangent, enough=EXHAUSTED):
        """The change of the unknowns (m,) against which the structure is softest, and whether it is stable.

        Softness is over the stiffness of the preconditioner, whose lowest Ritz vector is sought from noise, which holds all modes. The
        structure is unstable if a motion along it gives energy (Ritz values alone do not tell: the preconditioned operator is not
        normal, and they can be negative where no eigenvalue is), and stable if not, unless one round of `krylov` does not get near.
        """
        structure = self.structure
        operator, plain = self.grid.operator(self._fields(tangent), self.hourglass), no_border(self.grid.free.shape[1:])
        if self.levels is None:
            self._precondition(tangent)
        start = np.random.default_rng(len(self.cells)).normal(size=structure.moves.shape[1])
        space = arnoldi(self.levels, operator, plain, self.grid.vector(self._field(start)), enough)
        self.counts["looks"] += len(space.ahead)
        found = combined(space, lowest(space.hessenberg[:-1]))
        energy = float(jnp.vdot(found, image(operator, plain, found)))
        mode = structure.moves.T @ self.grid.field(found)[0].reshape(-1)
        return mode / np.abs(self.by_unknowns @ mode).max(), energy > 0


def positive(tangent, elastic):
    """Tangents (k, 3, 3) made symmetric, with hardly any stiffness where theirs is negative or none."""
    values, vectors = np.linalg.eigh((tangent + tangent.swapaxes(1, 2)) / 2)
    least = FLOOR * np.abs(elastic).max((1, 2), initial=0.0)[:, None]
    return np.einsum("kij,kj,klj->kil", vectors, np.maximum(values, least), vectors)


def lowest(hessenberg):
    """The real part of the Ritz vector whose value has the least one, of a square Hessenberg matrix."""
    values, vectors = np.linalg.eig(hessenberg)
    return vectors[:, values.real.argmin()].real
