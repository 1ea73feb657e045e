"""A scene in equilibrium whose points move: large slow deformation in increments, each on a fresh grid.

An increment takes the loads further along their histories, finds the equilibrium of the points on the grid as it lies
under them, and moves them there; then the grid is reset. Where that brings cells beyond onset the most critical get a
band, and equilibrium is found anew at the same loads, until none is left. Loads that act at once, gravity and forces
that begin with a value, grow from nothing first, in the time from −duration to 0.
"""

import time as clock
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import explicit, observe, observe_moving
from jaxmpm import model as models
from jaxmpm.errors import RunError
from jaxmpm.layout import lay_out
from jaxmpm.moving_path import Path, amplitudes
from jaxmpm.moving_simulation import MovingSimulation
from jaxmpm.one_thread import on_one_thread
from jaxmpm.simulation import Simulation, check_finite
from jaxmpm.stepping import CUT, critical, next_size, share_to_onset

MISSING = (0.005, 1e-6)  # energy that an increment may miss, over its work, and over the most so far: else it was a leap
DONE = 1e-9  # of the duration
ENERGY_LIMIT = 0.05  # of the energy: what an error may be where the scene says nothing


@dataclass
class MovingStatic(MovingSimulation):
    """The counterpart of `QuasiStatic` for points that move; build one with `MovingStatic.of(scene)`."""

    path: Path | None = None
    now: float = 0.0  # time that the histories have come to, s
    size: float = 0.0  # of the next increment, s
    amplitude: np.ndarray | None = None  # of the loads at the last equilibrium
    energy: float = 0.0  # stored and dissipated there, N·mm
    most: float = 0.0  # the most so far
    ratio: np.ndarray | None = None  # r̂ of the cells of the window there
    reactions: dict = field(default_factory=dict)  # gauges there, N
    move: tuple | None = None  # displacement of the nodes (2 N,), mm, in the last increment, and its size, s
    leaps: list = field(default_factory=list)  # time (s) and energy (N·mm) of each
    messages: list = field(default_factory=list)  # not yet told

    open_ended = False  # all samples are at given times

    @classmethod
    def of(cls, scene) -> "MovingStatic":
        """Lay out a scene and fill it with points; raises SceneError."""
        layout = lay_out(scene)
        model = models.from_layout(scene, layout)
        state = models.first_state(model, layout.velocity)
        solver, samples = scene.solver, scene.output.samples
        stable = float(models.stable_time_step(model))
        total = Simulation(scene, layout, model, state, solver.duration / samples, stable, samples, layout)
        sim = super().of(total)
        sim.dt, sim.steps, sim.stable_dt = solver.duration / samples, samples, stable
        sim.path = Path(sim.model, scene.grid.thickness, solver.tolerance)
        sim.size = solver.first_increment * solver.duration
        sim.now = -solver.duration
        sim.amplitude = amplitudes(sim.model, sim.now, solver.duration)
        asked, _ = sim.path.increment(sim.state, sim.amplitude, sim.amplitude)
        asked.nodes.check_held(asked.known)
        sim.ratio = sim.path.ratio(sim.state.points)
        sim.reactions = dict.fromkeys(sim.sets[1], 0.0)
        return sim

    def step_at(self, sample: int, samples: int) -> int:
        """Number of a sample."""
        return sample

    def step_of(self, time) -> int:
        """Number of increments so far."""
        return int(self.state.step)

    def time(self) -> float:
        """Time that the histories have come to, s."""
        return self.now

    @on_one_thread
    def at_rest(self):
        """The reading at the start of the histories, with the loads that act there."""
        if amplitudes(self.model, 0.0, self.scene.solver.duration).any():
            self._follow(0.0)
        self.now, self.size = 0.0, self.scene.solver.first_increment * self.scene.solver.duration
        self.amplitude = amplitudes(self.model, 0.0, self.scene.solver.duration)
        return self.read()

    @on_one_thread
    def advance(self, until: int) -> None:
        """Advance to the time of a sample; raises RunError where no equilibrium is found."""
        self._follow(until * self.dt)

    def _follow(self, target):
        began, compiled = clock.perf_counter(), self.path.compile_seconds
        try:
            while self.now < target - DONE * self.scene.solver.duration:
                self._increment(target)
                self._crack()
        finally:
            spent = self.path.compile_seconds - compiled
            self.compile_seconds += spent
            self.run_seconds += clock.perf_counter() - began - spent

    # -- increments ------------------------------------------------------------------------------

    def _increment(self, target):
        """One increment towards a time (s); raises RunError where there is none."""
        solver = self.scene.solver
        smallest, largest = (share * solver.duration for share in (solver.smallest_increment, solver.largest_increment))
        size = min(self.size, target - self.now)
        if size > 0.7 * (target - self.now):
            size = target - self.now
        while True:
            amplitude = amplitudes(self.model, self.now + size, solver.duration)
            if np.array_equal(amplitude, self.amplitude):  # a fresh grid alone moves points a little: not to be done for nothing
                self.now += size
                return
            guess = None  # without cracks nothing is gained by one
            if self.move is not None and self.cracked():
                guess = self.move[0] * size / self.move[1]
            attempt, last = self.path.attempt(self.state, self.amplitude, amplitude, guess), size <= smallest
            if attempt is None or (self._leaps(attempt) and not last):
                if last:
                    raise RunError(self._no_way(size))
                self.size = size = max(CUT * size, smallest)
                continue
            share = share_to_onset(self.ratio, attempt.ratio)
            if share == 1 or last:
                break
            size = max(share * size, smallest)
        self.size = next_size(self.size, size, len(attempt.found.history), smallest, largest)
        self._accept(attempt, self.now + size)
        self.move = attempt.found.displacement, size

    def _leaps(self, attempt):
        """Whether an equilibrium is no neighbour of the last: energy is missing on the way."""
        return attempt.missing(self.energy) > MISSING[0] * abs(attempt.found.work) + MISSING[1] * self.most

    def _crack(self):
        """Bands in cells beyond onset, the most critical first, each time with the equilibrium that they come to."""
        while len(cells := critical(self.ratio, explicit.ROOM)):
            if explicit.needs_room(self.state):
                self.state = models.with_room(self.total, self.state)
            before = self.state
            for chosen in (cells, cells[:1]):
                self.state = self.path.opened(before, chosen)
                self._make_room()
                attempt = self.path.attempt(self.state, self.amplitude, self.amplitude)
                if attempt is not None:
                    break
                self.state = before
            else:
                raise RunError(
                    f"no equilibrium at t = {self.now:.6g} s once the cell with the largest stress has cracked, at "
                    f"{self._cell(cells[0])}: what is left may bear the loads in motion only; all is on disk up to the last equilibrium"
                )
            self._accept(attempt, self.now, released=attempt.lost(self.energy))

    def _accept(self, attempt, time, released=None):
        """Take an equilibrium at a time (s) over; `released`, N·mm, is what cells have let go of that have cracked on the way."""
        found, work, fall = attempt.found, self.state.work, 0.0
        if released is None and self._leaps(attempt):
            fall = attempt.missing(self.energy)
            self.leaps.append((time, fall))
            self.messages.append(f"t = {time:.6g} s: a leap to an equilibrium further off, which damping took {fall:.3g} N mm for")
        self.reactions = attempt.gauges(self.model, self.sets[1])
        work = work._replace(
            external=work.external + found.work, damping=work.damping + found.ghosts + fall, released=work.released + (released or 0.0)
        )
        self.state = self.path.reached(self.state, attempt)._replace(work=work)
        self.now, self.amplitude = time, attempt.amplitude
        self.energy = float(found.answer.energy)
        self.most = max(self.most, self.energy)
        self._make_room()
        self.ratio = self.path.ratio(self.state.points)

    def _let_go(self, position, lists, leaves):
        super()._let_go(position, lists, leaves)
        self.energy = self._energy()

    def _no_way(self, size):
        return (
            f"no equilibrium found after t = {self.now:.6g} s, not even {size:.3g} s further on: the loads may be more than what "
            "is left can bear, or a part has come loose; all is on disk up to the last equilibrium"
        )

    def _cell(self, number):
        """Where a cell of the window is, for a message."""
        n, shape = self.model.numerics, self.ratio.shape
        first = np.asarray(self.state.points.window) - n.shape.centred
        x, y = (np.array(np.unravel_index(number, shape)) + first + 0.5) * n.cell + np.asarray(self.layout.origin)
        return f"({x:.6g}, {y:.6g}) mm"

    # -- what it says ----------------------------------------------------------------------------

    def read(self) -> observe.Reading:
        """Gauges and energies at the last equilibrium, as NumPy numbers."""
        model = replace(self.model, begin=jnp.asarray(max(self.now, 0.0)))
        found = self.path.call(observe_moving.read, model, self.state, jnp.zeros(()), (self.sets[0], {}))
        found = found._replace(gauges=found.gauges | self.reactions)
        return jax.tree.map(np.asarray, found)

    def check(self, reading, energy_error: float) -> None:
        """Raise RunError where a result can no longer be trusted."""
        when = f"at t = {float(reading.time):.6g} s"
        check_finite(self.scene.solver, [*reading.gauges.values(), *reading.energies()], when)
        limit = self.scene.solver.energy_error_limit or ENERGY_LIMIT
        if abs(energy_error) > limit:
            raise RunError(
                f"relative energy error {energy_error:.3g} {when}, more than {limit:g}: lower solver.largest_increment (now "
                f"{self.scene.solver.largest_increment:g}), or use smaller cells, more points per cell or points.shape = \"cubic\""
            )

    def meta(self) -> dict:
        """What a restart file must know besides the state."""
        path = self.path
        return super().meta() | {
            "now": self.now, "size": self.size, "amplitude": self.amplitude.tolist(), "most": self.most, "energy": self.energy,
            "reactions": self.reactions, "leaps": self.leaps, "iterations": list(path.iterations),
            "attempts": path.attempts, "cut_backs": path.cut_backs,
        }  # fmt: skip

    def resume(self, meta) -> None:
        """Go on with the state of a restart file and what `meta` told it."""
        super().resume(meta)
        self.now, self.size, self.most, self.reactions = (meta[key] for key in ("now", "size", "most", "reactions"))
        self.energy = meta["energy"]
        self.amplitude, self.leaps = np.array(meta["amplitude"]), [tuple(leap) for leap in meta["leaps"]]
        path = self.path
        path.iterations, path.attempts, path.cut_backs = (meta[key] for key in ("iterations", "attempts", "cut_backs"))
        self.ratio = path.ratio(self.state.points)

    def report(self) -> dict:
        """What it took: the entry of summary.json."""
        path = self.path
        return {
            "control": "time", "increments": int(self.state.step), "iterations": int(sum(path.iterations)),
            "median_iterations": float(np.median(path.iterations)) if path.iterations else 0.0,
            "attempts": path.attempts, "cut_backs": path.cut_backs,
            "leaps": len(self.leaps), "leap_energy": float(sum(energy for _, energy in self.leaps)),
        }  # fmt: skip
