"""A scene in equilibrium made ready to run: it advances from sample to sample as `simulation.Simulation` does."""

import time as clock
from dataclasses import dataclass, field

import jax
import numpy as np

from jaxmpm import model as models
from jaxmpm import observe
from jaxmpm.equilibria import Equilibria
from jaxmpm.errors import RunError
from jaxmpm.follow import Follower
from jaxmpm.layout import lay_out
from jaxmpm.layout_crop import cropped
from jaxmpm.one_thread import on_one_thread
from jaxmpm.scene import Scene
from jaxmpm.simulation import Simulation
from jaxmpm.stiffness import held_at

PER_ROW = 2  # increments for each row of the history where their number is not known before
DONE = 1 - 1e-9  # of the duration
ENERGY_LIMIT = 0.01  # of the energy: what an error may be where the scene says nothing


@dataclass
class QuasiStatic(Simulation):
    """A scene whose histories are followed through equilibria; build one with `QuasiStatic.of(scene)`."""

    follower: Follower | None = None
    messages: list = field(default_factory=list)  # not yet told

    @classmethod
    def of(cls, scene: Scene, layout=None, model=None, tape=None) -> "QuasiStatic":
        """Lay out a scene, build and factorise its elastic structure; raises SceneError.

        Layout and model may be given; an `adjoint.Tape` keeps what is needed for derivatives.
        """
        whole = lay_out(scene) if layout is None else layout
        layout = cropped(whole) if layout is None else layout
        model = models.from_layout(scene, layout) if model is None else model
        state = models.first_state(model, layout.velocity)
        solver = scene.solver
        gauge = None
        if solver.control not in ("time", "dissipation"):
            measured = next(g for g in layout.gauges if g.name == solver.control)
            gauge = np.zeros(model.free.size)
            np.add.at(gauge, measured.dofs, measured.weights)
        equilibria = Equilibria(model, state, solver.tolerance, gauge, tape)
        shares = solver.first_increment, solver.smallest_increment, solver.largest_increment
        control = solver.control if gauge is None else "gauge"
        follower = Follower(equilibria, solver.duration, control, *(share * solver.duration for share in shares))
        samples = scene.output.samples
        stable = float(models.stable_time_step(model))
        return cls(scene, layout, model, state, solver.duration / samples, stable, samples, whole, follower=follower)

    @property
    def open_ended(self) -> bool:
        """Whether rows of the history come by increments, not at equal times."""
        return self.follower.control != "time"

    @property
    def finished(self) -> bool:
        """Whether the histories have been followed to their end."""
        return self.follower.time >= DONE * self.scene.solver.duration

    def step_at(self, sample: int, samples: int) -> int:
        """Number of a sample."""
        return sample

    @on_one_thread
    def at_rest(self) -> observe.Reading:
        """The reading at the start of the histories."""
        self.follower.begin()
        self._stamp()
        self._take_over()
        return self.read()

    @on_one_thread
    def advance(self, until: int) -> None:
        """Advance to the time of a sample, or by some increments; raises RunError where there is no way on."""
        began, follower = clock.perf_counter(), self.follower
        bridges, switches = len(follower.bridges), len(follower.switches)
        target = self.scene.solver.duration if self.open_ended else until * self.dt
        last = follower.equilibria.counts.increments + PER_ROW
        try:
            while follower.time < DONE * target and not (self.open_ended and follower.equilibria.counts.increments >= last):
                follower.increment(target)
                self._stamp()
        finally:
            self._take_over()
            self._tell(bridges, switches)
            self.run_seconds += clock.perf_counter() - began

    def _stamp(self):
        if self.follower.equilibria.tape is not None:
            self.follower.equilibria.tape.stamp(self.follower.time)

    def _take_over(self):
        self.state = self.follower.equilibria.state
        self.compile_seconds = self.follower.equilibria.compile_seconds

    def _tell(self, bridges, switches):
        for time, energy in self.follower.bridges[bridges:]:
            self.messages.append(f"t = {time:.6g} s: no equilibrium near: over a dynamic bridge to the next one, damping took {energy:.3g} N mm")
        for time, found in self.follower.switches[switches:]:
            if found:
                self.messages.append(f"t = {time:.6g} s: the equilibrium is unstable: on with a stable one beside it")

    def _at(self):
        """Arguments of `observe` at the last equilibrium: a reading is at (step − 1) dt."""
        equilibria = self.follower.equilibria
        model = held_at(self.model, equilibria.now.amplitude)
        return model, self.state._replace(step=np.int32(2)), np.asarray(self.follower.time, self.model.free.dtype)

    def read(self) -> observe.Reading:
        """Gauges and energies at the last equilibrium, as NumPy numbers."""
        return jax.tree.map(np.asarray, self.compiled(observe.read)(*self._at()))

    def _fields(self):
        return self.compiled(observe.frame)(*self._at())

    def step_of(self, time) -> int:
        """Number of increments so far."""
        return self.follower.equilibria.counts.increments

    def cracked(self) -> int:
        """Number of cells with a band."""
        return len(self.follower.equilibria.system.cells)

    def asks_for_points(self, reading) -> str:
        """Equilibrium stays in the total frame."""
        return ""

    def check(self, reading, energy_error: float) -> None:
        """Raise RunError where a result can no longer be trusted."""
        limit = self.scene.solver.energy_error_limit or ENERGY_LIMIT
        if abs(energy_error) > limit:
            raise RunError(
                f"relative energy error {energy_error:.3g} at t = {float(reading.time):.6g} s, more than {limit:g}: lower "
                "solver.largest_increment (now {:g})".format(self.scene.solver.largest_increment)
            )
        super().check(reading, energy_error)

    # -- restart and report ----------------------------------------------------------------------

    def meta(self) -> dict:
        """What a restart needs besides the state."""
        follower, counts = self.follower, self.follower.equilibria.counts
        return {
            "amplitude": follower.equilibria.now.amplitude.tolist(), "follower": follower.meta(),
            "bridges": list(follower.bridges), "switches": list(follower.switches), "iterations": list(counts.iterations),
            "increments": counts.increments, "attempts": counts.attempts, "cut_backs": counts.cut_backs, "residual": counts.residual,
        }  # fmt: skip

    def resume(self, meta: dict) -> None:
        """Go on from a state and its meta."""
        follower = self.follower
        follower.equilibria.restart(self.state, np.array(meta["amplitude"]))
        follower.resume(meta["follower"])
        follower.bridges, follower.switches = ([tuple(item) for item in meta[key]] for key in ("bridges", "switches"))
        counts = follower.equilibria.counts
        counts.iterations = meta["iterations"]
        for name in ("increments", "attempts", "cut_backs", "residual"):
            setattr(counts, name, meta[name])

    def report(self) -> dict:
        """What it took: the entry of summary.json."""
        follower, counts = self.follower, self.follower.equilibria.counts
        cracked = [k for k in counts.iterations if k > 0]
        return {
            "control": self.scene.solver.control, "increments": counts.increments,
            "iterations": int(sum(counts.iterations)), "median_iterations": float(np.median(cracked)) if cracked else 0.0,
            "attempts": counts.attempts, "cut_backs": counts.cut_backs, "residual": counts.residual, "bridges": len(follower.bridges),
            "bridge_energy": float(sum(energy for _, energy in follower.bridges)),
            "switches": sum(found for _, found in follower.switches), "by_energy": follower.by_energy,
        }  # fmt: skip
