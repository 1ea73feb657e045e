"""Drives a scene: chunks of steps, samples, frames, restart files, and what must not go unseen."""

import json
import signal
import time as clock
from pathlib import Path

import numpy as np

from jaxmpm import layout_half, restart, results, walls
from jaxmpm.errors import OutOfTime, RunError, SceneError, written
from jaxmpm.moving_static import MovingStatic
from jaxmpm.moving_simulation import MOVING_FIELDS, MovingSimulation
from jaxmpm.progress import Progress
from jaxmpm.quasistatic import QuasiStatic
from jaxmpm.run_result import DRAWN, Result, drawn, suffix_of
from jaxmpm.scene import Scene
from jaxmpm.simulation import ERROR_LIMIT, FRAME_FIELDS, Simulation
from jaxmpm.summary import ENERGIES, summarise
from jaxmpm.vtkhdf import PointCloudWriter, read_frame, read_frames

CHECKPOINT_SECONDS = 10.0  # wall time between restart files


def energy_error(reading, floor: float = 0.0) -> float:
    """Relative error of the balance: work = stored + kinetic + dissipated + damping + contact.

    Positive where energy is lost, negative where it is made. Relative to the work, or to `floor`
    (N·mm) where that is more: the most that a run has met so far, as a body that bounces gives back
    to gravity what it has taken.
    """
    external, *parts = (float(value) for value in reading.energies())
    scale = max(energy_met(reading), floor)
    return (external - sum(parts)) / scale if scale > 0 else 0.0


def energy_met(reading) -> float:
    """The energy (N·mm) that an error of the balance is relative to, as far as one state tells."""
    external, *parts = (float(value) for value in reading.energies())
    return max(abs(external), sum(parts))


def run_scene(scene: Scene, directory, resume: bool = False, progress: bool = True, pictures: str = "png") -> Result:
    """Run a scene and write its results to a directory; returns its summary with what lies beside it.

    `resume`: go on with a run that was interrupted there; `progress`: say how far it is, on stderr or
    below a notebook's cell; `pictures`: png, pdf or svg. Raises SceneError before anything runs; RunError where the run had to stop, after all that
    was computed is on disk with the reason in summary.json.
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene = {written(scene)}: expected a Scene (jaxmpm.load_scene makes one)")
    recorder = Recorder(scene, Path(directory), resume, progress, suffix_of(pictures))
    return recorder.run()


class Recorder:
    """One run and the files it writes; `seconds`: of wall time after which it stops with OutOfTime, None for never."""

    def __init__(self, scene, directory, resume, progress, suffix, seconds=None):
        self.scene, self.directory, self.suffix, self.seconds = scene, directory, suffix, seconds
        self.static = scene.solver.kind == "quasistatic"
        self.kind_of_frame = "total" if scene.grid.half else scene.solver.frame  # a half cannot hand over
        self.sim = self._prepared()
        self.can_crack = any(scene.materials[name].band for name in self.sim.layout.materials)
        self.handed_over = None  # time, s
        self.messages: list[str] = []
        self.rise = None if self.static else self.sim.rise  # passed in equilibrium, if it is
        if self.rise is not None and self.rise.why:
            self.messages.append(self.rise.why)
        if not self.static and self._begins_as_points():
            self.sim = MovingSimulation.of(self.sim)
        self.offer = "" if self.moves else layout_half.offer(scene, self.sim.whole)
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
        self.most = self.sim.little_energy()  # energy met so far, N·mm
        self.progress = Progress(progress)
        directory.mkdir(parents=True, exist_ok=True)
        self._open_files(resume)

    def _prepared(self):
        """The scene made ready to run."""
        if not self.static:
            return Simulation.of(self.scene)
        return (MovingStatic if self.scene.solver.frame == "updated" else QuasiStatic).of(self.scene)

    def _begins_as_points(self) -> bool:
        """Bodies that meet, part or come to a wall are no matter for the total frame."""
        frame = self.kind_of_frame
        if frame == "updated":
            return True
        met = walls.heading(self.scene, self.sim.whole)
        if met and frame == "total":
            raise SceneError(f'solver.frame = "total": expected "auto" or "updated", as {met}')
        if met:
            self.messages.append(f"t = 0 s: {met}: the run begins as points that move")
        return bool(met) or (frame == "auto" and len({body.velocity for body in self.scene.bodies}) > 1)

    def run(self, pictures: bool = True) -> Result:
        """All samples, then the summary and, if they are wanted, pictures."""
        status, error = "completed", None
        try:
            with terminate_as_interrupt():
                self._samples()
        except RunError as stop:
            status, error = f"stopped: {stop}", stop
            if self.static:
                self._last_equilibrium()
        except KeyboardInterrupt:
            status, error = "interrupted", KeyboardInterrupt()
            self.save()
        except Exception as failure:  # disk, memory, …: it goes on to the caller after this
            status, error = f"failed: {failure!r}", failure
        self.progress.close()
        self.history.close()
        self.cloud.close()
        summary = summarise(self, status)
        results.write_summary(self.directory, summary)
        if pictures:
            self.draw()
        if error is not None:
            raise error
        return Result(self.directory, summary)

    def _samples(self):
        scene, sim = self.scene, self.sim
        samples = scene.output.samples
        saved = clock.perf_counter()
        self.progress.start(self)
        for sample in self._numbers():
            if sample > 0:
                sim.advance(sim.step_at(sample, samples))
            reading = sim.read() if sample > 0 or (self.moves and not self.static) else sim.at_rest()
            self._told()
            error = self._error(reading)
            self._record(reading, error)
            if self._framed(sample):
                self._frame(reading)
            self.done = sample
            self.keep()
            self.progress.show(self)
            if self._hand_over(reading, error):
                sim = self.sim
            else:
                sim.check(reading, error)
                self._mention_loss(reading, error)
            if clock.perf_counter() - saved > CHECKPOINT_SECONDS or self.complete:
                self.save()
                saved = clock.perf_counter()
            if self.seconds is not None and self.wall_seconds() > self.seconds and not self.complete:
                raise OutOfTime(f"it takes longer than the {self.seconds:.3g} s that it was given")

    def _numbers(self):
        """Numbers of the samples to come."""
        while self.done < 0 or not self.complete:
            yield self.done + 1

    @property
    def complete(self) -> bool:
        """Whether all samples have been recorded."""
        if self.static and self.sim.open_ended:
            return self.sim.finished
        return self.done >= self.scene.output.samples

    def _framed(self, sample) -> bool:
        """Whether a frame is written at a sample."""
        samples, frames = self.scene.output.samples, self.scene.output.frames
        if self.static and self.sim.open_ended:
            return sample % max(samples // (frames - 1), 1) == 0 or self.sim.finished
        return sample in {round(k * samples / (frames - 1)) for k in range(frames)}

    def _told(self):
        """Say what an equilibrium's way has to say."""
        if self.static:
            for message in self.sim.messages:
                self.messages.append(message)
                self.progress.say(message)
            self.sim.messages.clear()

    def _last_equilibrium(self):
        """Record the last equilibrium of a run that stops between two samples."""
        self._told()
        reading = self.sim.read()
        if self.rows and self.sim.step_of(reading.time) > self.rows[-1][0]:
            self._record(reading, self._error(reading))
            self._frame(reading)

    @property
    def moves(self) -> bool:
        """Whether points move by now."""
        return isinstance(self.sim, MovingSimulation)

    def _error(self, reading) -> float:
        """Relative energy error; the most energy met so far is what it is relative to."""
        self.most = max(self.most, energy_met(reading), self.sim.left["energy"] if self.moves else 0.0)
        return energy_error(reading, self.most)

    def _mention_loss(self, reading, error):
        """Say once that points that move have lost energy to the grid; see `simulation.check_energy`."""
        if self.moves and not self.static and error > ERROR_LIMIT and not any("lost" in message for message in self.messages):
            self.messages.append(
                f"t = {float(reading.time):.6g} s: {error:.1%} of the energy is lost between points and grid: "
                "smaller cells and a smaller solver.time_step_factor lose less"
            )
            self.progress.say(self.messages[-1])

    def _hand_over(self, reading, error) -> bool:
        """Go on with points that move where the motion asks for it; says when and why."""
        if self.moves or self.kind_of_frame != "auto" or self.done == self.scene.output.samples:
            return False
        reason = self.sim.asks_for_points(reading)
        if not reason:
            return False
        self.sim.check(reading, error)  # it may have gone too far, all at once
        self.sim = MovingSimulation.of(self.sim)
        self.handed_over = self.sim.begin
        now = energy_error(self.sim.read(), self.most)
        self.messages.append(
            f"t = {self.sim.begin:.6g} s: {reason}: on with {self.sim.count()} points that move, "
            f"{int(reading.cracked)} with a band (relative energy error {error:.1e} before, {now:.1e} after)"
        )
        self.progress.say(self.messages[-1])
        self.cloud = _with_fields(self.cloud, self.directory / "result.vtkhdf", self.scene.grid.cell)
        self.keep()
        self.save()
        return True

    def keep(self):
        """What a restart file would hold now: things that belong together."""
        meta = json.loads(json.dumps(self.sim.meta())) if self.moves or self.static else None
        self.safe = (self.sim.state, self.done, self.frames, self.most, meta)

    def _record(self, reading, error):
        sim = self.sim
        time = float(reading.time)
        row = [sim.step_of(time), time]
        row += [float(reading.gauges[gauge.name]) for gauge in self.sim.layout.gauges]
        row += [float(value) for value in reading.energies()]
        row += [error, int(reading.cracked)]
        self.history.append(row)
        self.rows.append(row)

    def _frame(self, reading):
        points, data = self.sim.frame()
        self.cloud.write(float(reading.time), points, data)
        self.frames += 1

    # -- files ---------------------------------------------------------------------------------

    def _open_files(self, resume):
        kept = self.directory / restart.NAME
        history, cloud = self.directory / "history.csv", self.directory / "result.vtkhdf"
        if resume and kept.exists():
            restart.restore(self)
            self.history = results.History.reopen(history, self.columns, self.done + 1)
            known = results.read_history(history)
            self.rows = np.stack([known[name] for name, _ in self.columns], axis=1).tolist()
            self.cloud = PointCloudWriter.reopen(cloud, self.frames)
            return
        kept.unlink(missing_ok=True)
        (self.directory / "summary.json").unlink(missing_ok=True)
        (self.directory / "scene.json").write_text(json.dumps(self.scene.to_dict(), indent=1))
        self.history = results.History.create(history, self.columns)
        self.cloud = PointCloudWriter.create(cloud, MOVING_FIELDS if self.moves else FRAME_FIELDS)

    def save(self):
        """Write the restart file, as of the last complete sample."""
        if self.safe is not None:
            restart.save(self)

    def draw(self):
        """The pictures of what has been computed."""
        from jaxmpm import plot

        for before in drawn(self.directory):  # of another format maybe
            before.unlink()
        at = {name: self.directory / f"{name}{self.suffix}" for name in DRAWN}
        if self.scene.response and len(self.rows) > 1:
            plot.plot_response(self.directory, at["response"])
        if self.frames:
            plot.plot_cracks(self.directory, at["cracks"])
        if self.shows_stages():
            from jaxmpm.plot_stages import plot_stages

            plot_stages(self.directory, at["stages"])

    def shows_stages(self) -> bool:
        """Whether cracking is likely to be diffuse first and localised later, in cells that stay."""
        return bool(self.scene.mesostructure and self.scene.response and self.can_crack and self.frames > 2) and not self.moves

    def wall_seconds(self) -> float:
        """Seconds spent on this run so far, those before an interruption included."""
        return self.wall_before + clock.perf_counter() - self.began

    def table(self) -> dict[str, np.ndarray]:
        """The history so far: every column's values, (samples,), by its name."""
        rows = np.asarray(self.rows).reshape(-1, len(self.columns))
        return {name: rows[:, k] for k, (name, _) in enumerate(self.columns)}

    def units(self) -> tuple[str, str]:
        """Units of the response's load and displacement."""
        units = dict(self.columns)
        return units[self.scene.response.load], units[self.scene.response.displacement]


def _with_fields(cloud, path, cell):
    """The frames so far written anew as those of points that move: where they are, with their side."""
    cloud.close()
    count, _ = read_frames(path)
    aside = path.with_name("." + path.name)
    with PointCloudWriter.create(aside, MOVING_FIELDS) as new:
        for k in range(count):
            frame = read_frame(path, k)
            time, points = frame.pop("time"), frame.pop("points")
            frame |= {"side": np.full(len(points), cell), "velocity": np.zeros((len(points), 3))}
            new.write(time, points + frame["displacement"], frame)
    aside.replace(path)
    return PointCloudWriter.reopen(path, count)


class terminate_as_interrupt:
    """Inside, SIGTERM ends a run as Ctrl-C does: with everything on disk."""

    def __enter__(self):
        try:
            self.before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        except ValueError:  # not the main thread: signals are somebody else's business
            self.before = None

    def __exit__(self, *_):
        if self.before is not None:
            signal.signal(signal.SIGTERM, self.before)
