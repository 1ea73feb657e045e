"""A scene in the total frame made ready to run: its model, its state, the compiled step."""

import time as clock
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import compilation, explicit, model as models, observe, walls
from jaxmpm.elastic_rise import ElasticRise
from jaxmpm.errors import RunError, SceneError, written
from jaxmpm.layout import lay_out
from jaxmpm.layout_crop import cropped, padded
from jaxmpm.scene import Scene

MOST_STEPS = 2**31 - 2  # steps are counted in 32 bits
ERROR_LIMIT = 0.05  # of the energy: what an error may be where the scene says nothing
LOST_LIMIT = 0.2  # what points that move may lose to the grid where the scene says nothing
OPEN = 0.9  # of a cell: opening of a crack at which a run goes on with points that move
FRAME_FIELDS = {
    "displacement": 3, "stress": 3, "damage": 1, "opening": 1, "normal": 3, "material": 1,
}  # fmt: skip


@dataclass
class Simulation:
    """A scene made ready: its model, its state and the compiled functions that advance it.

    Build one with `Simulation.of(scene)`, then `advance(sample)` through `samples + 1` samples
    and `read()` or `frame()` between them.
    """

    scene: Scene
    layout: object
    model: models.Model
    state: models.State
    dt: float  # s
    stable_dt: float  # s
    steps: int  # in the whole run
    whole: object = None  # the layout of the grid as the scene has it, where `layout` leaves out what no body fills
    compile_seconds: float = 0.0
    run_seconds: float = 0.0
    rise: ElasticRise | None = None  # to be passed in equilibrium
    _compiled: dict = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene, crop: bool = True) -> "Simulation":
        """Lay out a scene and build its model and first state; raises SceneError.

        `crop`: whether to leave out rows and columns of the grid that lie beyond all bodies.
        """
        whole = lay_out(scene)
        layout = cropped(whole) if crop else whole
        model = models.from_layout(scene, layout)
        stable = float(models.stable_time_step(model))
        duration = scene.solver.duration
        steps = np.ceil(duration / (stable * scene.solver.time_step_factor))
        if not steps < MOST_STEPS:
            raise SceneError(
                f"solver.duration = {written(duration)}: expected less than "
                f"{stable * scene.solver.time_step_factor * MOST_STEPS:.3g} s, {MOST_STEPS} steps "
                f"(the stable time step is {stable:.3g} s: load faster, or use larger cells)"
            )
        steps = int(steps)
        state = models.first_state(model, layout.velocity)
        dt = duration / steps
        sim = cls(scene, layout, model, state, dt, stable, steps + 1, whole)
        if scene.solver.elastic_rise == "equilibrium":
            sim.rise = sim._rise()
        return sim

    def _rise(self) -> ElasticRise:
        began = clock.perf_counter()
        samples = self.scene.output.samples
        marks = [self.step_at(sample, samples) for sample in range(samples + 1)]
        rise = ElasticRise.of(self.model, self.state, self.dt, marks)
        self.run_seconds += clock.perf_counter() - began
        return rise

    def on_whole_grid(self) -> "Simulation":
        """The same with all of the grid, for points that may go anywhere on it."""
        if self.whole is None or self.whole is self.layout:
            return self
        state = padded(self.state, self.layout, self.whole)
        return replace(self, layout=self.whole, model=models.from_layout(self.scene, self.whole), state=state, _compiled={})

    def compiled(self, function):
        """`function(model, state, dt, …)` compiled for the present capacity, timed once."""
        capacity = self.state.pool.cell.shape[0]
        if (function, capacity) not in self._compiled:
            began = clock.perf_counter()
            extra = (jnp.int32(0),) if function is explicit.advance else ()
            program = compilation.program(function, self.model, self.state, self._dt(), *extra)
            self._compiled[function, capacity] = program
            self.compile_seconds += clock.perf_counter() - began
        return self._compiled[function, capacity]

    def _dt(self):
        return jnp.asarray(self.dt, self.model.free.dtype)

    def step_at(self, sample: int, samples: int) -> int:
        """Number of the step of a sample; a state is read one step behind."""
        return 1 + round(sample * (self.steps - 1) / samples)

    def advance(self, until: int) -> None:
        """Advance to step `until`; raises RunError where a band cannot be solved."""
        if self.rise is not None and int(self.state.step) < self.rise.last:
            began = clock.perf_counter()
            self.state = self.rise.state(self.state, min(until, self.rise.last))
            self.run_seconds += clock.perf_counter() - began
        while int(self.state.step) < until:
            if bool(explicit.needs_room(self.state)):
                self.state = models.with_room(self.model, self.state)
            function = self.compiled(explicit.advance)
            began = clock.perf_counter()
            self.state = function(self.model, self.state, self._dt(), jnp.int32(until))
            jax.block_until_ready(self.state.step)
            self.run_seconds += clock.perf_counter() - began
            if int(self.state.failed) >= 0:
                cell = int(self.state.pool.cell[int(self.state.failed)])
                raise RunError(
                    f"the band of the cell at {self.place(cell)} did not converge in step "
                    f"{int(self.state.step)} (t = {int(self.state.step) * self.dt:.6g} s): try a "
                    "smaller solver.time_step_factor, a slower load or smaller cells"
                )

    def cracked(self) -> int:
        """Number of cells with a band."""
        return int(self.state.pool.count)

    def read(self) -> observe.Reading:
        """Gauges and energies now, as NumPy numbers."""
        reading = self.compiled(observe.read)(self.model, self.state, self._dt())
        return jax.tree.map(np.asarray, reading)

    def at_rest(self) -> observe.Reading:
        """The reading before the first step."""
        back = self.state._replace(
            step=jnp.ones_like(self.state.step),
            displacement=self.state.displacement + self._dt() * self.state.velocity,
        )
        reading = self.compiled(observe.read)(self.model, back, self._dt())
        return jax.tree.map(np.asarray, reading)

    def step_of(self, time) -> int:
        """Number of the step at a time (s)."""
        return round(time / self.dt)

    def _fields(self):
        """What `frame` shows, over the grid."""
        return self.compiled(observe.frame)(self.model, self.state, self._dt())

    def frame(self) -> tuple[np.ndarray, dict]:
        """Centres of the filled cells (N, 3), mm, and their fields; of a half those of its image too."""
        values = jax.tree.map(np.asarray, self._fields())
        filled = self.layout.material >= 0
        i, j = np.nonzero(filled)
        x, y = self.layout.origin
        cell = self.layout.cell
        points = np.stack([x + (i + 0.5) * cell, y + (j + 0.5) * cell, 0.0 * i], axis=1)
        data = {"material": self.layout.material[filled].astype(float)}
        for name, value in values.items():
            column = value[..., filled].T
            if FRAME_FIELDS[name] == 3 and column.shape[1] == 2:
                column = np.pad(column, ((0, 0), (0, 1)))
            data[name] = column
        return self.layout.half.with_images(points, data, cell) if self.layout.half else (points, data)

    def little_energy(self) -> float:
        """Too little energy to judge a balance by, N·mm."""
        return little_energy(self.scene, self.layout)

    def asks_for_points(self, reading) -> str:
        """Why the motion is too large to go on in the total frame, "" where it is not."""
        solver, cell = self.scene.solver, self.layout.cell
        if self.scene.macro:
            return ""
        limit = solver.hand_over_displacement or cell
        if reading.displacement > limit:
            return f"a node has moved by {float(reading.displacement):.3g} mm, more than {limit:g} mm"
        if reading.gradient > solver.hand_over_gradient:
            return (
                f"the displacement gradient at {self.place(reading.gradient_cell)} is "
                f"{float(reading.gradient):.3g}, more than {solver.hand_over_gradient:g}"
            )
        by_next = reading.opening_rate * solver.duration / self.scene.output.samples
        if reading.opening + min(by_next, reading.opening) > OPEN * cell:
            return (
                f"a crack has opened by {float(reading.opening):.3g} mm and goes on at "
                f"{float(reading.opening_rate):.3g} mm/s, nearly a cell by the next sample"
            )
        return ""

    def place(self, cell: int) -> str:
        """Where a cell is, for a message."""
        i, j = divmod(int(cell), self.layout.shape[1])
        x, y = (o + (k + 0.5) * self.layout.cell for o, k in zip(self.layout.origin, (i, j)))
        return f"({x:g}, {y:g}) mm"

    def check(self, reading: observe.Reading, energy_error: float) -> None:
        """Raise RunError where a result can no longer be trusted."""
        solver = self.scene.solver
        when = f"at t = {float(reading.time):.6g} s"
        check_finite(solver, [*reading.gauges.values(), *reading.energies(), reading.gradient], when)
        if reading.gradient > solver.gradient_limit:
            raise RunError(
                f"displacement gradient {float(reading.gradient):.3g} {when} in the uncracked cell "
                f"at {self.place(reading.gradient_cell)}, more than solver.gradient_limit = "
                f"{solver.gradient_limit:g}: too large a motion for the total frame; stop earlier, "
                'use solver.frame = "updated" or, where the small-strain error is acceptable, raise the limit'
            )
        far = reading.displacement > self.layout.cell  # from inside, to beyond an edge
        if far and (passed := walls.crossed(self.scene, self.layout, np.asarray(self.state.displacement))):
            raise RunError(
                f'{passed} {when}: in the total frame walls hold only what lies on them; use solver.frame = "auto" '
                'or "updated"'
            )
        if reading.opening > self.layout.cell:
            raise RunError(
                f"crack opening {float(reading.opening):.3g} mm {when} in the cell at "
                f"{self.place(reading.opening_cell)}, more than a cell of {self.layout.cell:g} mm: "
                "too large a motion for the total frame; stop earlier or use larger cells"
            )
        check_energy(solver, energy_error, when)


def check_finite(solver, numbers, when: str) -> None:
    """Raise RunError where one of the numbers of a reading is not finite."""
    if not np.isfinite(numbers).all():
        raise RunError(
            f"not finite {when}: the run has become unstable; lower solver.time_step_factor "
            f"(now {solver.time_step_factor:g})"
        )


def check_energy(solver, energy_error: float, when: str, lost_limit: float = ERROR_LIMIT) -> None:
    """Raise RunError where the energy balance is further out than the scene allows.

    Energy that is made is a sign of instability. What is lost, error > 0, may be more by default
    where points move: vibration that the grid cannot hold, as after an impact, dies out between
    points and nodes.
    """
    limit = solver.energy_error_limit or (lost_limit if energy_error > 0 else ERROR_LIMIT)
    if abs(energy_error) > limit:
        raise RunError(
            f"relative energy error {energy_error:.3g} {when}, more than "
            f"solver.energy_error_limit = {limit:g}: lower solver.time_step_factor (now "
            f"{solver.time_step_factor:g}), use smaller cells or load more slowly"
        )


def little_energy(scene, layout) -> float:
    """Too little energy (N·mm) to judge a balance by.

    A thousandth of what the bodies hold at onset; with gravity, what they win in falling a hundredth
    of their extent, if that is more: a body at rest has little but what it was set down with.
    """
    volume = layout.cell**2 * layout.thickness
    onset = weight = 0.0
    for index, name in enumerate(layout.materials):
        material = scene.materials[name]
        cells = (layout.material == index).sum()
        weight += cells * volume * material.density * np.abs(scene.gravity)
        if material.band:
            onset += cells * volume * material.band.ft**2 / (2 * material.bulk.E)
    extent = layout.cell * np.array([np.ptp(k) + 1 for k in np.nonzero(layout.material >= 0)])
    return max(1e-3 * float(onset), 1e-2 * float((weight * extent).sum()))
