"""Newton's method for an increment of moving points: nodal displacements Δu at which all forces are in balance.

    Σ S(G) · ∇N_i + (K_g Δu)_i = f_i     at the nodes that are free,     Δu_i = what is prescribed elsewhere

(`moving_tangent`, `moving_nodes`). The first step starts from Δu = 0 and takes what is prescribed along.
"""

from dataclasses import dataclass

import jax
import numpy as np

from jaxmpm.factors import factorised

MOST = 16  # iterations
WILD = 1e4  # times the best error, after which it is given up
PATIENCE = 5  # iterations without a better error after which it is given up
BACK = (1.0, 0.5, 0.25, 0.1)  # shares of a step that are tried where forces are not finite
SMALL = 1e-9  # of E t c, N: a force that counts as none


@dataclass
class Increment:
    """What is asked for; vectors are (2 N,)."""

    nodes: object  # `moving_nodes.Nodes`
    respond: object  # the `Answer` to G (4, count), a function
    before: np.ndarray  # forces of the loads at the begin, N
    after: np.ndarray  # and at the end
    moved: np.ndarray  # displacement that is prescribed, mm
    known: np.ndarray  # whether it is
    scale: float  # force that errors are relative to, N; 0: the largest that a load or a support brings to a node
    small: float  # the least to be relative to, N


@dataclass
class Found:
    """An equilibrium, or the attempt at one; vectors are (2 N,)."""

    displacement: np.ndarray  # Δu, mm
    answer: object  # of the points, arrays of NumPy
    reaction: np.ndarray  # where the displacement is prescribed, N
    history: list  # error of every iteration
    converged: bool
    work: float  # of loads and supports, N·mm
    gained: float  # of the internal forces, N·mm, both by the trapezoidal rule
    ghosts: float  # energy that K_g has taken, N·mm


class Newton:
    """Solves an `Increment`."""

    def __init__(self, asked: Increment):
        self.asked, self.nodes = asked, asked.nodes
        self.free = np.flatnonzero(np.tile(self.nodes.active.reshape(-1), 2) & ~asked.known)
        self.held = np.flatnonzero(asked.known)

    def solve(self, tolerance, guess=None) -> Found:
        """The equilibrium, from Δu = 0 or near a `guess` (2 N,); `Found.converged` says whether it is one, nothing is raised."""
        u = np.zeros_like(self.asked.moved)
        answer, force = self._at(u)
        begin, errors, best, since, converged = force, [], np.inf, 0, False
        if guess is not None:
            u[self.free] = guess[self.free]
            u[self.held] = self.asked.moved[self.held]
            answer, force = self._at(u)
            if answer.wrong:
                return self._found(u, answer, begin, force, errors, converged)
        while len(errors) < MOST:
            change = self._change(answer, force, u)
            if change is None:
                break
            for share in BACK:
                answer, force = self._at(u + share * change)
                error = self._error(answer, force, u + share * change)
                if np.isfinite(error):
                    break
            u = u + share * change
            errors.append(error)
            converged = error <= tolerance and share == 1  # else what is prescribed is not reached
            best, since = (error, 0) if error < 0.7 * best else (best, since + 1)
            if converged or not np.isfinite(error) or error > WILD * best or since >= PATIENCE:
                break
        return self._found(u, answer, begin, force, errors, converged)

    def _at(self, u):
        answer = jax.tree.map(np.asarray, self.asked.respond(self.nodes.rate(u)))
        return answer, self.nodes.force(answer.pull)

    def _change(self, answer, force, u):
        """Newton's change of the displacement; None where there is none."""
        matrix = (self.nodes.stiffness(answer.slope) + self.nodes.ghosts)[self.free]
        residual = (force + self.nodes.ghosts @ u - self.asked.after)[self.free]
        change = np.zeros_like(u)
        change[self.held] = (self.asked.moved - u)[self.held]
        try:
            factors = factorised(matrix[:, self.free])
            change[self.free] = factors.solve(-residual - matrix[:, self.held] @ change[self.held])
        except RuntimeError:  # singular
            return None
        return change if np.isfinite(change).all() else None

    def _error(self, answer, force, u):
        """Largest force that is out of balance, relative."""
        if answer.wrong or not np.isfinite(force).all():
            return np.inf
        asked, total = self.asked, force + self.nodes.ghosts @ u - self.asked.after
        scale = asked.scale or max(np.abs(asked.after).max(), np.abs(total[self.held]).max(initial=0.0), asked.small)
        return float(np.abs(total[self.free]).max(initial=0.0) / scale)

    def _found(self, u, answer, begin, force, errors, converged):
        asked, soft = self.asked, self.nodes.ghosts @ u
        reaction = np.where(asked.known, force + soft - asked.after, 0.0)
        first = np.where(asked.known, begin - asked.before, 0.0)
        work = (asked.before + asked.after + first + reaction) / 2 @ u
        return Found(u, answer, reaction, errors, converged, float(work), float((begin + force) / 2 @ u), float(soft @ u) / 2)
