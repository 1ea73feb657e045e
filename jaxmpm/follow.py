"""Which increment comes next: its control and size, cut back and grown, from peak to separation without supervision.

The loads follow their histories as long as an equilibrium is found a little further on. Where none is, energy takes over as
control: the path is followed by the energy that the bands dissipate, which grows whatever loads and displacements do,
until the loads can go on. Where that fails too, the structure moves (`bridge.py`) to its next equilibrium.
"""

from dataclasses import dataclass, field

import jax
import numpy as np

from jaxmpm import bridge
from jaxmpm.equilibria import Equilibria
from jaxmpm.errors import RunError
from jaxmpm.newton import Control
from jaxmpm.stepping import CUT, next_size
from jaxmpm.stiffness import amplitudes, loads_of

ENERGY = (0.02, 1e-5, 0.1)  # first, smallest and largest energy of an increment, over that of breaking a cell
GAUGE = (0.1, 1e-4, 1.0)  # the same of the gauge's reading, over what it would change without cracks in the largest increment of time
MISSING = (0.005, 0.002)  # energy that an increment may miss, over its work, and over that of breaking a cell
LEAP = 4  # largest increments of time that an increment of energy may take the loads
CANDIDATES = 4  # bands that are tried one by one for control
SAME = 1e-9  # of the duration: times that differ by less are one
NOTHING = 1e-4  # of the loads at which energy took control: a structure that bears no more has broken
STAY = 3  # increments at least under control of energy, once it has taken over
BRIDGES = 400  # at most in a run
KEPT = "time", "by_energy", "began", "span", "sense", "begun"  # of a follower, over a restart


@dataclass
class Line:
    """A segment of the histories on which the load factor is free: amplitudes start + factor · direction."""

    start: np.ndarray
    direction: np.ndarray
    times: np.ndarray  # s, of a table
    factors: np.ndarray  # of the load that changes most, increasing
    factor: float = 0.0  # where the structure is
    increments: int = 0
    bound: float = np.inf  # on the change of the factor in an increment
    kind: str = "dissipation"  # what is under control
    only: int | None = None  # the band whose energy is under control, else that of all

    def time(self, factor):
        """Time (s) at which the histories have come as far."""
        return float(np.interp(factor, self.factors, self.times))

    def factor_at(self, time):
        """How far the histories have come at a time (s)."""
        return float(np.interp(time, self.times, self.factors))


@dataclass
class Follower:
    """Follows the equilibria of a model along its histories."""

    equilibria: Equilibria
    duration: float  # s
    control: str  # "time", "dissipation" or "gauge"
    first: float  # increment of time, s
    smallest: float
    largest: float
    time: float = 0.0
    size: dict = field(default_factory=dict)  # of the next increment in each measure
    line: Line | None = None
    switches: list = field(default_factory=list)  # time (s) at which an equilibrium was unstable, whether one beside it was not
    by_energy: int = 0  # increments under control of energy or gauge
    began: float = 0.0  # time at which energy took control, s
    bridges: list = field(default_factory=list)  # time (s), energy (N·mm) of each
    span: float = np.inf  # time of the last increment, s
    sense: float = 1.0  # which way the gauge goes
    begun: float = np.inf  # energy of the increment with which it took control last, N·mm

    def __post_init__(self):
        self.size = {"load": self.first}
        self.limits = {"load": (self.smallest, self.largest)}
        self.turns = _turns(loads_of(self.equilibria.model))

    def begin(self):
        """The equilibrium at the start of the histories, without cracks; raises RunError where that is not enough."""
        eq = self.equilibria
        trial = eq.attempt(amplitudes(eq.model, 0.0) - eq.now.amplitude, Control("load", 1.0))
        if eq.share_to_onset(trial) < 1:
            raise RunError(
                f"the loads at t = 0 stress a cell to {trial.ratio.max():.3g} times what it bears: expected histories that "
                "begin with less, so that cracks can be followed"
            )
        eq.accept(trial)

    @property
    def farthest(self):
        """Time (s) that the loads have come to at the furthest."""
        return max(self.time, self.began)

    def meta(self) -> dict:
        """What a restart needs: where the path has come to, and by which control it goes on."""
        kept = {name: getattr(self, name) for name in KEPT}
        line = self.line and {key: v.tolist() if isinstance(v, np.ndarray) else v for key, v in vars(self.line).items()}
        return kept | {"size": dict(self.size), "limits": {kind: list(both) for kind, both in self.limits.items()}, "line": line}

    def resume(self, meta: dict) -> None:
        """Go on from there."""
        for name in KEPT:
            setattr(self, name, meta[name])
        self.size, self.limits = dict(meta["size"]), dict(meta["limits"])
        arrays = lambda line: {key: np.array(v) if isinstance(v, list) else v for key, v in line.items()}  # noqa: E731
        self.line = Line(**arrays(meta["line"])) if meta["line"] else None

    def increment(self, until):
        """One increment towards a time (s); raises RunError where there is no way on."""
        if self.line is None and (self.control == "time" or not self._cracks()):
            if self._towards(until):
                return
        if self.line is None:
            self._take_over()
        line, leads = self.line, self.control == "time" or self.line.increments > 0
        if self._by_energy(until, back=leads):
            return
        if self.control != "time":  # nothing is spent as the loads go back and forth: they go on
            self.line = None
            if self._towards(until):
                return
        if not leads:  # neither do the loads: the structure snaps back
            self.line = line
            if self._by_energy(until):
                return
        self._bridge(until)

    def _cracks(self):
        eq = self.equilibria
        return len(eq.system.cells) > 0 or eq.now.ratio.max() >= 1

    # -- along the histories -------------------------------------------------------------------

    def _towards(self, until):
        """An increment of time; whether there is one."""
        eq = self.equilibria
        ahead = self.turns[self.turns > self.time + SAME * self.duration]
        until = min([until, *ahead[:1]])  # the farthest that a load goes is not passed over
        opened = eq.open_critical()
        size = min(self.size["load"], until - self.time)
        size = max(min(size, self.span * eq.reach_to_onset()), self.smallest)
        size = until - self.time if size > 0.7 * (until - self.time) else size
        while True:
            size = min(size, until - self.time)
            target = amplitudes(eq.model, self.time + size)
            trial = self._stable(self._try(target - eq.now.amplitude, Control("load", 1.0)))
            if trial is None:
                if size == 0 or size <= self.smallest:
                    return size > 0 and opened and self._at_rest()
                size = max(CUT * size, self.smallest)
                self.size["load"] = size
                continue
            share = eq.share_to_onset(trial)
            if share < 1 and size > self.smallest:
                size = max(share * size, self.smallest)
                continue
            self._accept(trial, "load", size)
            self.time, self.span = self.time + size, size
            return True

    def _stable(self, trial):
        """The trial where it is stable, else a stable one beside it; None where there is none."""
        if trial is None or trial.found.stable:
            return trial
        other = self.equilibria.switched(trial)
        self.switches.append((self.time, other is not None))
        return other

    def _at_rest(self):
        """Equilibrium of cells that have just cracked, under the same loads."""
        eq = self.equilibria
        trial = self._stable(self._try(np.zeros_like(eq.now.amplitude), Control("load", 1.0)))
        if trial is None:
            return False
        self._accept(trial, "load", 0.0)
        return True

    def _try(self, direction, control):
        """An attempt; None where it came to nothing, or to an equilibrium that is no neighbour: energy is missing on the way."""
        eq = self.equilibria
        trial = eq.attempt(direction, control)
        if trial is not None and eq.missing(trial) > MISSING[0] * abs(trial.work) + MISSING[1] * eq.energy_of_a_cell:
            trial = None
        if trial is None:
            eq.counts.cut_backs += 1
        return trial

    def _accept(self, trial, kind, size):
        self.equilibria.accept(trial)
        iterations = self.equilibria.counts.iterations[-1]
        self.size[kind] = next_size(self.size[kind], size, iterations, *self.limits[kind])

    # -- by energy -----------------------------------------------------------------------------

    def _take_over(self):
        """Energy takes control of the segment of the histories that the structure is on."""
        eq, model = self.equilibria, self.equilibria.model
        knots = np.unique(np.concatenate([[self.duration], *(np.asarray(load.time) for load in loads_of(model))]))
        knots = knots[knots <= self.duration]
        ahead = knots[knots > self.time + SAME * self.duration]
        behind = knots[knots <= self.time + SAME * self.duration]
        end, begin = (ahead[0] if len(ahead) else knots[-1]), behind[-1]
        start = eq.now.amplitude
        direction = amplitudes(model, end) - start
        times = np.linspace(begin, end, 401)
        most = np.argmax(np.abs(direction / eq.scale))
        along = np.asarray(jax.vmap(loads_of(model)[most].amplitude)(times))
        unit = direction[most] if direction[most] != 0 else 1.0  # where all loads stay
        factors = np.maximum.accumulate((along - start[most]) / unit)
        bound = LEAP * self.largest / (end - begin) * (factors[-1] - factors[0])
        self.began = self.time
        self.line = Line(start, direction, times, factors, bound=bound)
        first, *limits = (share * eq.energy_of_a_cell for share in ENERGY)
        self.size["dissipation"], self.limits["dissipation"] = min(first, next_size(self.begun, self.begun, 0, *limits)), limits
        if self.control == "gauge" and "gauge" not in self.limits:
            elastic = eq.gauge @ (eq.structure.response @ direction)
            unit = max(abs(elastic) * min(self.largest / (end - begin), 1.0), 1e-12)
            self.size["gauge"], self.limits["gauge"] = GAUGE[0] * unit, (GAUGE[1] * unit, GAUGE[2] * unit)
            self.sense = 1.0 if elastic >= 0 else -1.0

    def _by_energy(self, until, back=True):
        """An increment of the gauge or of dissipated energy, of all bands or of the one that would run away; whether there is one.

        `back`: whether the loads may go back with it.
        """
        self.equilibria.open_critical()
        line = self.line  # which may end here
        if line.increments and self._with(line.kind, line.only, until):
            return True
        first = [("gauge", None)] if self.control == "gauge" else [("dissipation", None)] * (self.control == "dissipation")
        for kind, only in (*first, *(("dissipation", k) for k in self._runaways()), ("dissipation", None)):
            if self._with(kind, only, until, back):
                line.kind, line.only = kind, only
                self.begun = self.size[kind] if kind == "dissipation" else self.begun
                return True
        return False

    def _runaways(self):
        """Bands that kept changing between rest and loading as the last attempt failed: neither is an equilibrium.

        Those first whose stress changed most with it: others only follow.
        """
        failed = self.equilibria.failed
        if failed is None or failed.flips is None:
            return []
        order = np.argsort(-failed.torn, kind="stable")[:CANDIDATES]
        return [int(k) for k in order if failed.flips[k] > 1]

    def _with(self, kind, only, until, back=True):
        """An increment by the gauge, or by the energy of one band or of all; whether there is one."""
        eq, line = self.equilibria, self.line
        small, _ = self.limits[kind]
        size = self.size[kind]
        last = eq.last.size(Control(kind, only=only)) if eq.last else 0.0
        if last > 0:
            size = max(min(size, last * eq.reach_to_onset()), small)
        most = line.factor_at(until) - line.factor
        while True:
            reached = eq.spent(only) if kind == "dissipation" else eq.reading
            trial = self._try(line.direction, Control(kind, reached + self._sense_of(kind) * size, size, only))
            if trial is not None and trial.found.factor < 0 and not back:
                return False
            if trial is not None and trial.found.factor > most:
                trial = self._try(line.direction, Control("load", most))
            if trial is None or abs(trial.found.factor) > line.bound:
                if size <= small:
                    return False
                size = max(CUT * size, small)
                self.size[kind] = size
                continue
            share = eq.share_to_onset(trial)
            if share < 1 and size > small:
                size = max(share * size, small)
                continue
            self._accept(trial, kind, size)
            self._moved_on(trial.found.factor)
            return True

    def _moved_on(self, change):
        """Where on the line the structure has come to; back to the histories if they can go on."""
        line = self.line
        line.factor += change
        line.increments += 1
        self.by_energy += 1
        self.time = max(line.time(line.factor), 0.0)
        eq = self.equilibria
        left, were = (np.abs(a / eq.scale)[:-1].max(initial=0.0) for a in (eq.now.amplitude, line.start))  # gravity aside
        if left < NOTHING * were:
            raise RunError(
                f"the loads have come back to nothing from what they were at t = {self.farthest:.6g} s: the structure has broken, and no "
                "equilibrium bears more of their histories; all is on disk up to there"
            )
        if line.factor >= 1 - 1e-9:
            self.line, self.time = None, line.times[-1]
        elif self.control == "time" and line.factor > 0 and change > 0 and line.increments >= STAY:
            self.line = None
            self.span, self.size["load"] = np.inf, self.first

    def _sense_of(self, kind):
        """Which way what is under control goes: energy only grows."""
        return self.sense if kind == "gauge" else 1.0

    # -- where there is no way -----------------------------------------------------------------

    def _bridge(self, until):
        if len(self.bridges) >= BRIDGES:
            raise RunError(f"no equilibrium after t = {self.time:.6g} s, and {BRIDGES} dynamic bridges so far: something is wrong")
        energy, time = bridge.cross(self, until)
        self.bridges.append((self.time, energy))
        self.time, self.line = time, None
        self.span, self.size["load"] = np.inf, self.first


def _turns(loads):
    """Times (s) at which any history turns back, in order; where it stays in between, that at which it goes on."""
    found = [np.zeros(0)]
    for load in loads:
        way = np.sign(np.diff(np.asarray(load.value)))
        ahead = np.flatnonzero(way)
        found.append(np.asarray(load.time)[ahead[1:][np.diff(way[ahead]) != 0]])
    return np.unique(np.concatenate(found))
