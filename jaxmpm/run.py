"""Drives a scene: chunks of steps, samples, frames, restart files, and what must not go unseen."""

import json
import signal
import time as clock
from dataclasses import dataclass, field
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import bands, compilation, explicit, model as models, observe, results
from jaxmpm.errors import RunError, SceneError, written
from jaxmpm.layout import lay_out
from jaxmpm.progress import Progress
from jaxmpm.scene import Scene
from jaxmpm.vtkhdf import PointCloudWriter

MOST_STEPS = 2**31 - 2  # steps are counted in 32 bits
CHECKPOINT_SECONDS = 10.0  # wall time between restart files
FRAME_FIELDS = {
    "displacement": 3, "stress": 3, "damage": 1, "opening": 1, "normal": 3, "material": 1,
}  # fmt: skip
ENERGIES = ("external_work", "stored_energy", "kinetic_energy", "dissipated_energy", "damping_work")


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
    compile_seconds: float = 0.0
    run_seconds: float = 0.0
    _compiled: dict = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene) -> "Simulation":
        """Lay out a scene and build its model and first state; raises SceneError."""
        layout = lay_out(scene)
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
        return cls(scene, layout, model, state, dt, stable, steps + 1)

    def compiled(self, function):
        """`function(model, state, dt, …)` compiled for the present capacity, timed once."""
        capacity = self.state.pool.cell.shape[0]
        if (function, capacity) not in self._compiled:
            began = clock.perf_counter()
            extra = (jnp.int32(0),) if function is explicit.advance else ()
            lowered = function.lower(self.model, self.state, self._dt(), *extra)
            self._compiled[function, capacity] = compilation.compiled(lowered)
            self.compile_seconds += clock.perf_counter() - began
        return self._compiled[function, capacity]

    def _dt(self):
        return jnp.asarray(self.dt, self.model.free.dtype)

    def advance(self, until: int) -> None:
        """Advance to step `until`; raises RunError where a band cannot be solved."""
        while int(self.state.step) < until:
            if bool(explicit.needs_room(self.state)):
                spare = models.empty_pool(self.model, self.state.pool.cell.shape[0])
                self.state = self.state._replace(pool=bands.joined(self.state.pool, spare))
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

    def read(self) -> observe.Reading:
        """Gauges and energies now, as NumPy numbers."""
        reading = self.compiled(observe.read)(self.model, self.state, self._dt())
        return jax.tree.map(np.asarray, reading)

    def frame(self) -> tuple[np.ndarray, dict]:
        """Centres of the filled cells (N, 3), mm, and their fields."""
        values = jax.tree.map(
            np.asarray, self.compiled(observe.frame)(self.model, self.state, self._dt())
        )
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
        return points, data

    def little_energy(self) -> float:
        """A thousandth of the energy (N·mm) that the bodies hold at onset: too little to judge by."""
        volume = self.layout.cell**2 * self.scene.grid.thickness
        total = 0.0
        for index, name in enumerate(self.layout.materials):
            material = self.scene.materials[name]
            if material.band:
                cells = (self.layout.material == index).sum()
                total += cells * volume * material.band.ft**2 / (2 * material.bulk.E)
        return 1e-3 * float(total)

    def place(self, cell: int) -> str:
        """Where a cell is, for a message."""
        i, j = divmod(int(cell), self.layout.shape[1])
        x, y = (o + (k + 0.5) * self.layout.cell for o, k in zip(self.layout.origin, (i, j)))
        return f"({x:g}, {y:g}) mm"

    def check(self, reading: observe.Reading, energy_error: float) -> None:
        """Raise RunError where a result can no longer be trusted."""
        solver = self.scene.solver
        when = f"at t = {float(reading.time):.6g} s"
        numbers = [*reading.gauges.values(), *reading[2:7], reading.gradient]
        if not np.isfinite(numbers).all():
            raise RunError(
                f"not finite {when}: the run has become unstable; lower solver.time_step_factor "
                f"(now {solver.time_step_factor:g})"
            )
        if reading.gradient > solver.gradient_limit:
            raise RunError(
                f"displacement gradient {float(reading.gradient):.3g} {when} in the uncracked cell "
                f"at {self.place(reading.gradient_cell)}, more than solver.gradient_limit = "
                f"{solver.gradient_limit:g}: too large a motion for the total frame; stop earlier "
                "or, where the small-strain error is acceptable, raise the limit"
            )
        if reading.opening > self.layout.cell:
            raise RunError(
                f"crack opening {float(reading.opening):.3g} mm {when} in the cell at "
                f"{self.place(reading.opening_cell)}, more than a cell of {self.layout.cell:g} mm: "
                "too large a motion for the total frame; stop earlier or use larger cells"
            )
        if abs(energy_error) > solver.energy_error_limit:
            raise RunError(
                f"relative energy error {energy_error:.3g} {when}, more than "
                f"solver.energy_error_limit = {solver.energy_error_limit:g}: lower "
                f"solver.time_step_factor (now {solver.time_step_factor:g}) or load more slowly"
            )


def _difference(before, now, path=""):
    """The first key in which two scenes differ, and both its values, for a message."""
    if type(before) is type(now) and isinstance(now, dict | list) and before != now:
        keys = [*before, *now] if isinstance(now, dict) else range(max(len(before), len(now)))
        absent = "absent"
        for key in keys:
            pair = [_item(tree, key, absent) for tree in (before, now)]
            if pair[0] != pair[1]:
                return _difference(*pair, f"{path}.{key}" if path else str(key))
    return f"{path} was {written(before)} and is {written(now)}"


def _item(tree, key, absent):
    try:
        return tree[key]
    except (KeyError, IndexError):
        return absent


def energy_error(reading, floor: float = 0.0) -> float:
    """Relative error of the balance: work = stored + kinetic + dissipated + damping.

    Relative to the work, or to `floor` (N·mm) where there is hardly any yet.
    """
    external, *parts = (float(value) for value in reading[2:7])
    scale = max(abs(external), sum(parts), floor)
    return (external - sum(parts)) / scale if scale > 0 else 0.0


def run_scene(scene: Scene, directory, resume: bool = False, progress: bool = True) -> dict:
    """Run a scene and write its results to a directory; returns the summary.

    Raises SceneError before anything runs; RunError where the run had to stop, after all that
    was computed is on disk with the reason in summary.json.
    """
    recorder = Recorder(scene, Path(directory), resume, progress)
    return recorder.run()


class Recorder:
    """One run and the files it writes."""

    def __init__(self, scene, directory, resume, progress):
        self.scene, self.directory = scene, directory
        self.sim = Simulation.of(scene)
        self.columns = [("step", ""), ("time", "s")]
        self.columns += [(gauge.name, gauge.unit) for gauge in self.sim.layout.gauges]
        self.columns += [(name, "N mm") for name in ENERGIES]
        self.columns += [("energy_error", ""), ("cracked", "")]
        self.done = -1  # samples recorded, less one
        self.frames = 0
        self.safe = None  # state, samples and frames that belong together
        self.rows: list[list[float]] = []
        self.wall_before = 0.0
        self.began = clock.perf_counter()
        self.little = self.sim.little_energy()
        self.progress = Progress(progress)
        directory.mkdir(parents=True, exist_ok=True)
        self._open_files(resume)

    def run(self) -> dict:
        """All samples, then pictures and summary."""
        status, error = "completed", None
        try:
            with _terminate_as_interrupt():
                self._samples()
        except RunError as stop:
            status, error = f"stopped: {stop}", stop
        except KeyboardInterrupt:
            status, error = "interrupted", KeyboardInterrupt()
            self.save()
        except Exception as failure:  # disk, memory, …: it goes on to the caller after this
            status, error = f"failed: {failure!r}", failure
        self.progress.close()
        self.history.close()
        self.cloud.close()
        summary = self.summary(status)
        results.write_summary(self.directory, summary)
        self._pictures()
        if error is not None:
            raise error
        return summary

    def _samples(self):
        scene, sim = self.scene, self.sim
        samples, frames = scene.output.samples, scene.output.frames
        framed = {round(k * samples / (frames - 1)) for k in range(frames)}
        saved = clock.perf_counter()
        self.progress.start(self)
        for sample in range(self.done + 1, samples + 1):
            if sample > 0:
                sim.advance(1 + round(sample * (sim.steps - 1) / samples))
            reading = sim.read() if sample > 0 else self._at_rest()
            error = energy_error(reading, self.little)
            self._record(reading, error)
            if sample in framed:
                self._frame(reading)
            self.done = sample
            self.safe = (sim.state, self.done, self.frames)
            self.progress.show(self)
            sim.check(reading, error)
            if clock.perf_counter() - saved > CHECKPOINT_SECONDS or sample == samples:
                self.save()
                saved = clock.perf_counter()

    def _at_rest(self):
        """The reading before the first step."""
        sim = self.sim
        back = sim.state._replace(
            step=jnp.ones_like(sim.state.step),
            displacement=sim.state.displacement + sim._dt() * sim.state.velocity,
        )
        reading = sim.compiled(observe.read)(sim.model, back, sim._dt())
        return jax.tree.map(np.asarray, reading)

    def _record(self, reading, error):
        row = [int(round(float(reading.time) / self.sim.dt)), float(reading.time)]
        row += [float(reading.gauges[gauge.name]) for gauge in self.sim.layout.gauges]
        row += [float(value) for value in reading[2:7]]
        row += [error, int(reading.cracked)]
        self.history.append(row)
        self.rows.append(row)

    def _frame(self, reading):
        points, data = self.sim.frame()
        self.cloud.write(float(reading.time), points, data)
        self.frames += 1

    # -- files ---------------------------------------------------------------------------------

    def _open_files(self, resume):
        restart = self.directory / "restart.h5"
        history, cloud = self.directory / "history.csv", self.directory / "result.vtkhdf"
        if resume and restart.exists():
            self._restore(restart)
            self.history = results.History.reopen(history, self.columns, self.done + 1)
            known = results.read_history(history)
            self.rows = np.stack([known[name] for name, _ in self.columns], axis=1).tolist()
            self.cloud = PointCloudWriter.reopen(cloud, self.frames)
            return
        restart.unlink(missing_ok=True)
        (self.directory / "summary.json").unlink(missing_ok=True)
        (self.directory / "scene.json").write_text(json.dumps(self.scene.to_dict(), indent=1))
        self.history = results.History.create(history, self.columns)
        self.cloud = PointCloudWriter.create(cloud, FRAME_FIELDS)

    def save(self):
        """Write the restart file, as of the last complete sample."""
        if self.safe is None:
            return
        state, done, frames = self.safe
        leaves, _ = jax.tree_util.tree_flatten_with_path(state)
        arrays = {_name(path): np.asarray(leaf) for path, leaf in leaves}
        meta = {
            "scene": self.scene.to_dict(),
            "done": done,
            "frames": frames,
            "wall_seconds": self.wall_seconds(),
            "run_seconds": self.sim.run_seconds,
        }
        results.save_restart(self.directory / "restart.h5", arrays, meta)

    def _restore(self, path):
        arrays, meta = results.load_restart(path)
        now = json.loads(json.dumps(self.scene.to_dict()))
        if meta["scene"] != now:
            raise results.ResultError(
                f"{path}: the scene differs from the one that was interrupted "
                f"({_difference(meta['scene'], now)}); run it with the same scene and --set, or "
                "without --resume to start anew"
            )
        leaves, tree = jax.tree_util.tree_flatten_with_path(self.sim.state)
        names = [_name(path) for path, _ in leaves]
        self.sim.state = jax.tree.unflatten(tree, [jnp.asarray(arrays[name]) for name in names])
        self.done, self.frames = meta["done"], meta["frames"]
        self.safe = (self.sim.state, self.done, self.frames)
        self.wall_before, self.sim.run_seconds = meta["wall_seconds"], meta["run_seconds"]

    def _pictures(self):
        from jaxmpm import plot

        if self.scene.response and len(self.rows) > 1:
            plot.plot_response(self.directory)
        if self.frames:
            plot.plot_cracks(self.directory)

    def wall_seconds(self) -> float:
        """Seconds spent on this run so far, those before an interruption included."""
        return self.wall_before + clock.perf_counter() - self.began

    def response(self) -> tuple[np.ndarray, np.ndarray]:
        """Load and displacement of every sample, as the scene names them."""
        names = [name for name, _ in self.columns]
        rows = np.asarray(self.rows).reshape(-1, len(names))
        pick = lambda name: rows[:, names.index(name)]  # noqa: E731
        response = self.scene.response
        return pick(response.load), pick(response.displacement)

    def summary(self, status: str) -> dict:
        """The run in numbers: N, mm, N·mm, s."""
        sim, scene = self.sim, self.scene
        last = dict(zip((name for name, _ in self.columns), self.rows[-1])) if self.rows else {}
        steps = int(sim.state.step)
        cells = int((sim.layout.material >= 0).sum())
        out = {
            "scene": scene.name, "title": scene.title, "status": status,
            "cell_size": scene.grid.cell, "thickness": scene.grid.thickness,
            "cells": cells, "cracked": int(sim.state.pool.count), "steps": steps,
        }  # fmt: skip
        if scene.response and self.rows:
            load, displacement = self.response()
            peak = int(np.nanargmax(np.abs(load))) if np.isfinite(load).any() else 0
            out["response"] = scene.response.model_dump()
            out["load_unit"] = "N"
            out |= {"peak_load": load[peak], "displacement_at_peak": displacement[peak]}
            out |= {"final_load": load[-1], "final_displacement": displacement[-1]}
        out |= {name: last.get(name) for name in (*ENERGIES, "energy_error", "time")}
        worst = max((abs(row[-2]) for row in self.rows), default=None)
        return out | {
            "largest_energy_error": worst,
            "time_step": sim.dt, "stable_time_step": sim.stable_dt,
            "time_step_factor": scene.solver.time_step_factor,
            "wall_seconds": self.wall_seconds(), "run_seconds": sim.run_seconds,
            "compile_seconds": sim.compile_seconds,
            "ms_per_step": 1e3 * sim.run_seconds / max(steps, 1),
            "cell_steps_per_second": cells * steps / sim.run_seconds if sim.run_seconds else None,
            "precision": scene.solver.precision, "device": jax.devices()[0].device_kind,
        }  # fmt: skip


def _name(path) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".")


class _terminate_as_interrupt:
    """Inside, SIGTERM ends a run as Ctrl-C does: with everything on disk."""

    def __enter__(self):
        try:
            self.before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        except ValueError:  # not the main thread: signals are somebody else's business
            self.before = None

    def __exit__(self, *_):
        if self.before is not None:
            signal.signal(signal.SIGTERM, self.before)
