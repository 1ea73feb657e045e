"""Newton–Raphson with the consistent tangents of the bands, a line search, and one quantity under control.

Written for either system of equations, `condensed.Condensed` or `full_system.Full`.
"""

from dataclasses import dataclass, field

import numpy as np

from jaxmpm.laws.balance import FAILS

MOST = 14  # iterations
BACK = (1.0, 0.5, 0.25, 0.1)  # shares of a step that the line search tries
WILD = 1e3  # times the best residual, after which it is given up too
PUSH = 1e-3  # of its strain by which a band is taken further to see it load
PATIENCE = 4  # iterations without a better residual after which it is given up


@dataclass
class Control:
    """What fixes the load factor: a reading that is to reach a target."""

    kind: str  # "load", "dissipation" or "gauge"
    target: float = 0.0  # the load factor, N·mm or mm
    scale: float = 1.0  # an error in the target of this size counts as one of 1 in the residual
    only: int | None = None  # the one band whose dissipation is meant, else that of all

    def among(self, each):
        """`each` (k, …) of the bands where it is meant, zero elsewhere."""
        if self.only is None:
            return each
        meant = np.zeros_like(each)
        meant[self.only] = each[self.only]
        return meant


@dataclass
class Found:
    """An equilibrium, or the attempt at one."""

    unknowns: np.ndarray
    factor: float  # load factor: amplitudes are start + factor · direction
    amplitude: np.ndarray  # (loads,)
    strain: np.ndarray  # of the cracked cells (3k,)
    answers: object = None  # of the bands there
    stress: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (3k,), MPa
    residual: np.ndarray = field(default_factory=lambda: np.zeros(0))
    short: float = 0.0  # what is controlled still lacks
    error: float = np.inf  # residual and shortage, relative
    history: list = field(default_factory=list)  # error of every iteration
    converged: bool = False
    flips: np.ndarray | None = None  # how often each band changed between rest and loading (k,),
    torn: np.ndarray | None = None  # and by how much, all in all, its stress with that, MPa (k,)
    stable: bool = True  # under its loads: the structure would come back if it were disturbed
    control: Control | None = None  # what was under control
    direction: np.ndarray | None = None  # of the loads (loads,)


class Newton:
    """Solves one set of equations after the other."""

    def __init__(self, system, respond, strength, stiffness, tolerance):
        """`respond(strain (3k,))` gives the bands' `Answers` as NumPy arrays."""
        self.system, self.respond = system, respond
        self.strength, self.stiffness, self.tolerance = strength, stiffness, tolerance

    def solve(self, unknowns, start, direction, control, factor=0.0) -> Found:
        """Equilibrium near `unknowns` where amplitudes are start + factor · direction and control has its target.

        Does not raise: `Found.converged` says whether it is one.
        """
        if control.kind == "load":
            factor = control.target
        now = self._at(unknowns, factor, start, direction, control)
        history, best, since = [now.error], now.error, 0
        flips, torn = np.zeros((2, len(self.system.cells)))
        self._make_load(now, control)
        while np.isfinite(now.error) and len(history) <= MOST:
            if now.error <= self.tolerance and len(history) > 1:
                now.converged = True
                break
            change = self._change(now, direction, control)
            if not np.isfinite(change[0]).all() or not np.isfinite(change[1]):
                break
            before = now
            now = self._along(now, change, start, direction, control)
            flipped = (before.answers.status != now.answers.status)[: len(flips)]
            flips += flipped
            torn += flipped * np.abs(now.stress - before.stress).reshape(-1, 3).max(1)
            history.append(now.error)
            best, since = (now.error, 0) if now.error < 0.7 * best else (best, since + 1)
            if since >= PATIENCE or now.error > WILD * best:
                break
        now.history, now.flips, now.torn = history, flips, torn
        now.control, now.direction = control, direction
        if now.converged and control.kind == "load" and self.system.stable is False:
            # said of the last iteration but one: look again
            now.stable = self.system.softest(now.answers.tangent[: len(self.system.cells)])[1]
        return now

    def _make_load(self, now, control):
        """Where energy is to be spent and no band loads, take those at their limit for loading in the first step."""
        count = len(self.system.cells)
        if control.kind == "dissipation" and not control.among(now.answers.spends[:count]).any():
            further = PUSH * control.among(now.strain.reshape(-1, 3)).reshape(-1)  # what drives softening grows with the strain
            pushed = self.respond(now.strain + further)
            now.answers = now.answers._replace(tangent=pushed.tangent, spends=pushed.spends)

    def _change(self, now, direction, control):
        """Newton's step from here."""
        system, count = self.system, len(self.system.cells)
        tangent = now.answers.tangent[:count]
        if control.kind == "load":
            return system.step(tangent, now.residual)
        if control.kind == "dissipation":
            slopes = system.slopes(control.among(now.answers.spends[:count]).reshape(-1), direction)
        else:
            slopes = system.reading_slopes(tangent, direction)
        return system.step(tangent, now.residual, direction, slopes, now.short)

    def _along(self, now, change, start, direction, control):
        """The first of ever shorter steps with a smaller error, or the best of them."""
        best = None
        for share in BACK:
            tried = self._at(now.unknowns + share * change[0], now.factor + share * change[1], start, direction, control)
            if best is None or tried.error < best.error or not np.isfinite(best.error):
                best = tried
            if tried.error < now.error:
                break
        return best

    def _at(self, unknowns, factor, start, direction, control):
        """Everything at a trial."""
        system = self.system
        amplitude = start + factor * direction
        strain = system.strain(unknowns, amplitude)
        answers, count = self.respond(strain), len(system.cells)
        stress = answers.stress[:count].reshape(-1)
        residual = system.residual(unknowns, stress, amplitude)
        error = system.size(residual, self.strength, self.stiffness)
        short = 0.0
        if control.kind == "dissipation":
            short = control.target - control.among(answers.spent[:count]).sum()
        elif control.kind == "gauge":
            short = control.target - system.reading(unknowns, stress, amplitude)
        error = max(error, abs(short) / control.scale)
        if (answers.status[:count] == FAILS).any() or not np.isfinite(stress).all():
            error = np.inf
        return Found(unknowns, factor, amplitude, strain, answers, stress, residual, short, error)
