"""The cheapest setting that is good enough: `jaxmpm run SCENE --tolerance 2%`.

Within a tolerance means: peak and work differ by no more from those on the finest cells considered, loaded
as the scene says. Two quick runs of the scene, on its own cells and on the finest, loaded faster and in float32,
tell what the cells do; charts of scenes of its kind tell what loading faster and float32 do. The cheapest setting
whose errors add up to less is run, and held against what was expected.
"""

import json
import math
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

from jaxmpm import results
from jaxmpm.chart.classes import WORDS, Experience, kind_of
from jaxmpm.chart.estimate import Estimate
from jaxmpm.chart.front import percent, seconds
from jaxmpm.chart.measure import run_seconds, run_setting
from jaxmpm.chart.outcome import fallen, outcome_of
from jaxmpm.chart.reference import numbers_of
from jaxmpm.chart.settings import AXES, Source, apply, cells, label
from jaxmpm.errors import RunError, SceneError
from jaxmpm.restart import difference
from jaxmpm.run import Recorder, terminate_as_interrupt

HALF = 0.5  # of the scene's cells: the finest considered where nothing else is said
QUICK = ({"speed": 4.0, "precision": "float32"}, {"speed": 2.0, "precision": "float32"}, {})
COARSER = 1.9  # times the scene's own cells from which on they count as coarser
NAME = "tolerance.json"


@dataclass(frozen=True)
class Asked:
    """What is asked for.

    `tolerance`: relative; `names`: of the numbers that it holds for; `finest`: cells that errors are relative to, mm, half the
    scene's if None; `until`: displacement up to which the work is counted, where the load has fallen to half its peak if None.
    """

    tolerance: float
    names: tuple[str, ...] = ("peak", "work")
    finest: float | None = None
    until: float | None = None


def run_within(source: Source, asked: Asked, directory, resume: bool = False, progress: bool = True) -> dict:
    """Choose the cheapest setting of a scene within a tolerance and run it; returns the summary.

    The directory gets the run's files and tolerance.json; the summary has what was chosen, and why, under `tolerance`.
    Raises SceneError before anything runs, ResultError where `resume` finds another scene or tolerance, RunError where
    the chosen run stops.
    """
    choice = _Choice(source, asked, Path(directory), progress)
    with terminate_as_interrupt():
        return choice.run(resume)


class _Choice:
    """A setting being chosen."""

    def __init__(self, source: Source, asked: Asked, directory: Path, progress: bool):
        self.source, self.asked, self.directory, self.progress = source, asked, directory, progress
        self.scene = source.scene()
        self.own = self.scene.grid.cell
        self.sizes, self.finest = self._sizes()
        self.kind = kind_of(self.scene)
        self.experience = Experience(self.kind)
        self.names = list(asked.names) if self.scene.response else ["end"]
        self.until, self.spent, self.tried = asked.until, 0.0, []
        self.estimate: Estimate | None = None

    def _sizes(self) -> tuple[list[float], float]:
        """Sizes of cells that are considered, coarse to fine, and the finest of them."""
        wanted = self.asked.finest
        if wanted is not None and not 0.0 < wanted <= self.own:
            raise SceneError(f"--finest = {wanted:g}: expected a size of cells up to the scene's own, {self.own:g} mm")
        sizes, refused = cells(self.source, HALF * self.own if wanted is None else wanted)
        if wanted is not None and not any(math.isclose(size, wanted) for size in sizes):
            try:
                apply(self.source, {"cell": wanted})
            except SceneError as error:
                raise SceneError(f"--finest = {wanted:g}: {error}") from None
            sizes = [*sizes, wanted]
        if not sizes:
            raise SceneError(next(iter(refused.values())))
        return sizes, sizes[-1]

    def of_cell(self, cell: float) -> dict:
        """The setting of a size of cells, all else as the scene says."""
        return {} if cell == self.own else {"cell": cell}

    def run(self, resume: bool) -> dict:
        """Quick runs, the choice, its run, and whether it turned out as expected."""
        began = perf_counter()
        what = f"{100 * self.asked.tolerance:g} % of {' and '.join(self.names)}"
        self.say(f"{self.scene.name}: {what} asked, against cells of {self.finest:.4g} mm; quick runs:")
        if not (resume and self._take_up()):
            self._quick_runs()
        last = self.of_cell(self.finest)
        while True:
            chosen = self._chosen()
            chosen = last if chosen is None else chosen
            expected = dict.fromkeys(self.names, 0.0) if chosen == last else self.estimate.of(chosen)
            self._save({})
            self._tell(chosen, expected)
            summary = Recorder(apply(self.source, chosen), self.directory, resume, self.progress, ".png").run()
            numbers = numbers_of(outcome_of(self.directory, summary), self.until)
            self.spent += run_seconds(summary)
            after = expected if chosen == last else self.estimate.afterwards(chosen, numbers)
            if max(after.values()) <= self.asked.tolerance:
                break
            self.say(f"{label(chosen, self.own)}: not as expected, {listed(after)}: on with a better setting")
            self.tried.append(chosen)
            self.estimate.learn(chosen, expected, after)
        reference = run_seconds(summary) if chosen == last else self.estimate.seconds(last)
        found = {
            "asked": self.asked.tolerance, "of": self.names, "against_cells": self.finest, "work_until": self.until,
            "setting": label(chosen, self.own), "choices": dict(chosen), "expected_errors": expected, "errors_afterwards": after,
            "numbers": {name: numbers[name] for name in self.names}, "quick_runs": len(self.estimate.runs),
            "tried_before": [label(one, self.own) for one in self.tried], "seconds_in_all": self.spent,
            "seconds_of_finest": reference, "wall_seconds": perf_counter() - began, "kind": WORDS[self.kind],
            "charts": self.experience.scenes,
        }  # fmt: skip
        self._save(found)
        results.write_summary(self.directory, summary | {"tolerance": found})
        return summary | {"tolerance": found}

    def _chosen(self) -> dict | None:
        """The cheapest setting that is likely to be good enough; its cells have had a quick run, if there are any."""
        while len(self.estimate.runs) > 1:
            settings = [one for one in self.estimate.settings(self.sizes, self._precisions()) if one not in self.tried]
            chosen = self.estimate.cheapest(settings, self.asked.tolerance)
            cell = (chosen or {}).get("cell", self.own)
            if chosen is None or not self.estimate.quick or cell in self.estimate.runs:
                return chosen
            if not self._quick(cell):  # cells between two sizes need not behave like either
                self.sizes.remove(cell)
        return None

    # -- quick runs ------------------------------------------------------------------------------

    def _quick_runs(self) -> None:
        """The runs that tell what the cells do; coarser ones as long as they may be good enough."""
        coarser = [size for size in self.sizes if size >= COARSER * self.own]
        for quick in QUICK:
            if not self._known(quick):
                continue
            self.estimate = Estimate(self.experience, self.own, self.finest, self.names, quick)
            # Cells much finer than half the scene's are extrapolated to; and where no choice is quick, from two coarser ones.
            finer = min(size for size in self.sizes if size > 0.99 * HALF * self.own)
            pair = [finer, self.own] if quick else (coarser if len(coarser) > 1 else [*coarser, self.own])[-2:]
            if all(self._quick(cell) for cell in dict.fromkeys(sorted(pair))):
                break
        else:
            raise RunError("no quick run of the scene came to its end: run it without --tolerance to see why")
        for cell in reversed([size for size in coarser if size not in self.estimate.runs]):
            errors = [self.estimate.of_cell(name, max(self.estimate.runs)) for name in self.names]
            if max(errors) > self.asked.tolerance or not self._quick(cell):
                break

    def _known(self, quick: dict) -> bool:
        """Whether charts tell what the choices of quick runs do, and the scene allows them."""
        speed = quick.get("speed", 1.0)
        if any(self.experience.rate(name, speed, True) is None for name in self.names):
            return False
        if speed != 1.0 and not list(AXES["speed"].others(self.scene)):
            return False
        try:
            apply(self.source, quick)
        except SceneError:
            return False
        return True

    def _quick(self, cell: float) -> bool:
        """One quick run, into the estimate; whether it came to its end. The first is the one on the finest."""
        setting = self.of_cell(cell) | self.estimate.quick
        try:
            summary, outcome = run_setting(self.source, setting, math.inf)
        except RunError as error:
            self.say(f"  {label(setting, self.own)}: stopped: {error}")
            return False
        self.until = fallen(outcome) if self.until is None else self.until
        took, numbers = run_seconds(summary), numbers_of(outcome, self.until)
        self.estimate.times[cell], self.estimate.runs[cell] = took, numbers
        self.spent += took
        self.say(f"  {label(setting, self.own)}: {seconds(took)}, " + ", ".join(f"{name} {value:.5g}" for name, value in numbers.items()))
        return True

    def _precisions(self) -> list[str]:
        """Other precisions that charts of the kind know and the scene allows."""
        known = self.experience.shift(self.names[0], False, precision="float32") is not None
        return ["float32"] if known and self.scene.solver.precision == "float64" and self.scene.solver.kind == "explicit" else []

    # -- what is kept and said -------------------------------------------------------------------

    def _basis(self) -> dict:
        """What a choice rests on besides its quick runs."""
        return json.loads(json.dumps({"scene": self.scene.to_dict(), "asked": asdict(self.asked)}))

    def _save(self, found: dict) -> None:
        """tolerance.json: what was found, and what it takes to go on."""
        one = self.estimate
        runs = [{"cell": cell, "seconds": one.times[cell], "numbers": run} for cell, run in sorted(one.runs.items(), reverse=True)]
        kept = {"quick": {"choices": one.quick, "runs": runs, "rates": one.rates}, "until": self.until, "tried": self.tried}
        self.directory.mkdir(parents=True, exist_ok=True)
        results.write_object(self.directory / NAME, found | {"cells_considered": self.sizes} | kept | {"basis": self._basis()})

    def _take_up(self) -> bool:
        """Take over the quick runs of a choice that was interrupted; False where there is none."""
        path = self.directory / NAME
        if not path.exists():
            return False
        kept = results.read_object(path)
        if kept["basis"] != self._basis():
            changed = difference(kept["basis"], self._basis())
            raise results.ResultError(f"{path}: something else was asked ({changed}); go on with the same, or without --resume to start anew")
        quick = kept["quick"]
        self.estimate = Estimate(self.experience, self.own, self.finest, self.names, quick["choices"], rates=quick["rates"])
        self.estimate.runs = {run["cell"]: run["numbers"] for run in quick["runs"]}
        self.estimate.times = {run["cell"]: run["seconds"] for run in quick["runs"]}
        self.sizes, self.until, self.tried = kept["cells_considered"], kept["until"], kept["tried"]
        self.spent = sum(self.estimate.times.values())
        self.say("  taken over from before")
        return True

    def say(self, text: str) -> None:
        """A line of progress."""
        if self.progress:
            print(text, file=sys.stderr, flush=True)

    def _tell(self, chosen: dict, expected: dict) -> None:
        why = f"expected to be off by {listed(expected)}" if any(expected.values()) else "the finest cells as given, as nothing else is good enough"
        self.say(f"chosen: {label(chosen, self.own)}, {why}; {seconds(self.estimate.seconds(chosen))} foreseen")


def listed(errors: dict[str, float]) -> str:
    """Errors by name as they are printed."""
    return ", ".join(f"{name} {percent(error)}" for name, error in errors.items())


def report(summary: dict) -> str:
    """What was chosen, why, what it saved and whether it turned out as expected, in a few lines."""
    found = summary["tolerance"]
    asked = f"{100 * found['asked']:g} % of {' and '.join(found['of'])} asked, against cells of {found['against_cells']:.4g} mm"
    lines = [f"chosen: {found['setting']}"]
    if any(found["expected_errors"].values()):
        rest = f", loading rate and float32 by charts of {', '.join(found['charts'])}" if found["charts"] else ""
        by = f"cells by {found['quick_runs']} quick runs{rest}"
        lines.append(f"why: {asked}; the quickest of those expected to be within it: {listed(found['expected_errors'])} ({by})")
        lines.append(f"the estimate held: with what the run came to, {listed(found['errors_afterwards'])}")
    else:
        lines.append(f"why: {asked}; nothing quicker is expected to be within it, and errors are relative to this very run")
    lines += [f"{one} was run first and did not come out as expected" for one in found["tried_before"]]
    spent, full = found["seconds_in_all"], found["seconds_of_finest"]
    gain = f"{full / spent:.1f} times as fast" if spent < full else "nothing saved"
    lines.append(f"{seconds(spent)} with the quick runs, {seconds(full)} on the finest cells as given: {gain}")
    return "\n".join(lines)
