"""Runs a setting and times it: in this process, beside a short piece of one and the same run, more than once if it is quick."""

import contextlib
import math
import tempfile
from statistics import median
from time import perf_counter

import jax

from jaxmpm.chart.files import GIVEN_UP
from jaxmpm.chart.outcome import outcome_of
from jaxmpm.chart.settings import Setting, Source, apply, key, label
from jaxmpm.errors import OutOfTime, RunError, SceneError
from jaxmpm.run import Recorder
from jaxmpm.scene import Scene

CLOCK = 0.7  # s: how long the piece takes, about, that the machine's speed is told by
SUDDEN = 1.3  # ratio of two pieces from which on one is not trusted by itself
AGAIN = 0.3  # of what a run took besides the first time, files and compilation: what it takes besides when repeated
REPEATS = ((3.0, 3), (12.0, 2))  # runs shorter than so many seconds are timed so many times
KEPT = ("cells", "cracked", "steps", "frame", "precision", "cell_size", "energy_error", "load_unit", "displacement_unit")


def run_setting(source: Source, setting: Setting, seconds: float) -> tuple[dict, dict]:
    """Run a setting once; returns its summary and its outcome.

    Raises SceneError, or RunError where it stops or takes longer than so many seconds.
    """
    scene = _without_frames(apply(source, setting))
    with tempfile.TemporaryDirectory(prefix="jaxmpm-chart-") as directory:
        summary = _recorded(scene, directory, seconds)
        return summary, outcome_of(directory, summary)


def _recorded(scene: Scene, directory: str, seconds: float) -> dict:
    from pathlib import Path

    return Recorder(scene, Path(directory), resume=False, progress=False, suffix=".png", seconds=seconds).run(pictures=False)


def _without_frames(scene: Scene) -> Scene:
    return scene.model_copy(update={"output": scene.output.model_copy(update={"frames": 2})})


def run_seconds(summary: dict) -> float:
    """Seconds of the run alone; in equilibrium what is compiled on the way is counted with it."""
    inside = summary["compile_seconds"] if "quasistatic" in summary else 0.0
    return max(summary["run_seconds"] - inside, 1e-3)


class Clock:
    """How fast the machine is just now: seconds of a piece of one run."""

    def __init__(self, source: Source, setting: Setting, seconds: float):
        """`setting`: of a run that took so many `seconds`; of it the first part is taken."""
        tree = _without_frames(apply(source, setting)).to_dict()
        tree["solver"]["duration"] *= min(1.0, 2 * CLOCK / seconds)  # it begins elastic, with quick steps
        tree["output"]["samples"] = 10
        self.scene, self.ticks = Scene.from_dict(tree), []
        self.tick()  # compiles
        self.ticks.clear()

    def tick(self) -> float:
        """Seconds of the piece now; the middle of three where it is not as it was."""
        now = self._piece()
        if self.ticks and not 1 / SUDDEN < now / self.ticks[-1] < SUDDEN:
            now = median([now, self._piece(), self._piece()])
        self.ticks.append(now)
        return now

    def _piece(self) -> float:
        with tempfile.TemporaryDirectory(prefix="jaxmpm-chart-") as directory:
            return run_seconds(_recorded(self.scene, directory, math.inf))


class Stopwatch:
    """Measures settings of one scene, each into a record for chart.json."""

    def __init__(self, source: Source, cell: float):
        """`cell`: of the scene as given, mm."""
        self.source, self.cell, self.clock = source, cell, None

    def go_on(self, records: list[dict]) -> None:
        """Tell the machine's speed by the same piece as for records that are there."""
        if first := next((record for record in records if "timings" in record), None):
            self.clock = Clock(self.source, first["setting"], first["timings"][0][0])

    def measure(self, setting: Setting, seconds: float, again: float) -> dict:
        """The record of a setting.

        It may take `seconds`; it is repeated where it is quick and the repeats take less than `again` seconds together.
        """
        record = {"setting": dict(setting), "key": key(setting), "label": label(setting, self.cell)}
        began = perf_counter()
        before = self.clock and self.clock.tick()
        try:
            summary, outcome = run_setting(self.source, setting, seconds)
        except OutOfTime as error:
            return record | {"status": f"{GIVEN_UP}: {error}", "wall_seconds": perf_counter() - began}
        except RunError as error:
            return record | {"status": f"stopped: {error}", "wall_seconds": perf_counter() - began}
        except SceneError as error:
            return record | {"status": f"refused: {error}", "wall_seconds": perf_counter() - began}
        except jax.errors.JaxRuntimeError as error:  # as a rule the memory
            return record | {"status": f"failed: {str(error).splitlines()[0]}", "wall_seconds": perf_counter() - began}
        took = run_seconds(summary)
        if self.clock is None:
            self.clock = Clock(self.source, setting, took)
            before = self.clock.tick()
        pairs = [(took, before, self.clock.tick())]
        besides = perf_counter() - began - took
        more = next((count for limit, count in REPEATS if took < limit), 1) - 1
        for _ in range(more if more * (took + AGAIN * besides) < again else 0):
            took = run_seconds(run_setting(self.source, setting, math.inf)[0])
            pairs.append((took, pairs[-1][2], self.clock.tick()))
        return record | {
            "status": "completed", "timings": [list(pair) for pair in pairs],
            "compile_seconds": summary["compile_seconds"], "besides_seconds": besides,
            "wall_seconds": perf_counter() - began, "outcome": outcome,
        } | {name: summary.get(name) for name in KEPT}  # fmt: skip


def with_seconds(records: list[dict]) -> list[dict]:
    """Records with `seconds`, `low` and `high`, as the machine was at the middle of them all.

    A timing is (seconds, those of the piece before and after it): it counts as much as the piece took
    longer or shorter than usual. Of a single one the bar is the scatter of the piece.
    """
    pieces = [piece for record in records for _, *pair in record.get("timings", ()) for piece in pair]
    if not pieces:
        return records
    usual, found = median(pieces), []
    pairs = [pair for record in records for _, *pair in record.get("timings", ())]
    noise = median(abs(math.log(after / before)) for before, after in pairs)
    for record in records:
        with contextlib.suppress(KeyError):
            each = [took * usual / ((before + after) / 2) for took, before, after in record["timings"]]
            low, high = (min(each), max(each)) if len(each) > 1 else (each[0] * math.exp(-noise), each[0] * math.exp(noise))
            record = record | {"seconds": median(each), "low": low, "high": high}
        found.append(record)
    return found
