"""What an increment starts from, goes by and comes to: the records that `equilibria.py` keeps."""

from dataclasses import dataclass, field

import numpy as np

from jaxmpm.newton import Found


@dataclass
class Point:
    """An equilibrium that has been accepted."""

    amplitude: np.ndarray  # of the loads (loads,)
    displacement: np.ndarray  # (dofs,), mm
    strain: np.ndarray  # mean strain of the cracked cells (3k,)
    stress: np.ndarray  # (3k,), MPa
    force: np.ndarray  # of the cells on the nodes (dofs,), N
    ratio: np.ndarray  # r̂ of the intact cells (nx, ny)
    spent: np.ndarray  # energy that the softening of each band has taken, N·mm, (k,)
    energy: float  # stored and dissipated, N·mm


@dataclass
class Move:
    """How the last increment went, to extrapolate from."""

    displacement: np.ndarray
    ratio: np.ndarray
    amplitude: np.ndarray  # their change
    load: float  # size of the increment by the loads,
    gauge: float  # by the gauge's reading, mm,
    spent: np.ndarray  # and by the energy that each band has spent, N·mm, (k,)

    def size(self, control):
        """Size of the increment in the measure of a control."""
        if control.kind == "dissipation":
            return self.spent[control.only] if control.only is not None else self.spent.sum()
        return self.load if control.kind == "load" else self.gauge


@dataclass
class Trial:
    """An equilibrium that may be accepted."""

    found: Found
    displacement: np.ndarray
    ratio: np.ndarray
    energy: float  # stored and dissipated, N·mm
    work: float  # of the loads on the way, by the trapezoidal rule
    force: np.ndarray  # of the cells on the nodes, N
    unbalanced: float  # largest force at a node that is left over, over that which a cell bears at onset
    aside: bool = False  # reached by a fall: energy that is missing was taken by damping

    def missing(self, before: float) -> float:
        """Energy (N·mm) that the way here has lost: more than next to nothing where it was no way but a leap."""
        return self.work - (self.energy - before)


@dataclass
class Pending:
    """Cells that have cracked since the last equilibrium."""

    place: np.ndarray  # among the cracked cells
    modes: np.ndarray  # hourglass amplitudes then, mm, (k, 2)
    fall: np.ndarray  # of the stress as the bands answer the overshoot (k, 3), MPa


@dataclass
class Counts:
    """What it took."""

    increments: int = 0
    iterations: list = field(default_factory=list)  # of every increment that was accepted
    attempts: int = 0
    cut_backs: int = 0
    residual: float = 0.0  # largest of `Trial.unbalanced` in any that was accepted
