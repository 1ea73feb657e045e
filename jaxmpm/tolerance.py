"""The cheapest setting that is good enough: `jaxmpm run SCENE --tolerance 2%`.

Within a tolerance means: peak and work differ by no more from those on the finest cells considered, loaded
as the scene says. Two quick runs of the scene, on its own cells and on the finest, loaded faster and in float32,
tell what the cells do; charts of scenes of its kind tell what loading faster and float32 do. The cheapest setting
whose errors add up to less is run, and held against what was expected.
"""

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from jaxmpm import results
from jaxmpm.chart.classes import WORDS, Experience, kind_of
from jaxmpm.chart.estimate import Estimate
from jaxmpm.chart.front import percent, seconds
from jaxmpm.chart.measure import run_seconds, run_setting
from jaxmpm.chart.outcome import fallen, outcome_of
from jaxmpm.chart.reference import numbers_of
from jaxmpm.chart.settings import Setting, Source, apply, cells, label
from jaxmpm.errors import RunError, SceneError
from jaxmpm.run import Recorder

HALF = 0.5  # of the scene's cells: the finest considered where nothing else is said
QUICK = ({"speed": 4.0, "precision": "float32"}, {"speed": 2.0, "precision": "float32"}, {})
NAME = "tolerance.json"


@dataclass(frozen=True)
class Asked:
    """What is asked for: relative `tolerance` of `names` ("peak", "work"); `finest` cells, mm, and displacement of the work, None for the usual."""

    tolerance: float
    names: tuple[str, ...] = ("peak", "work")
    finest: float | None = None
    until: float | None = None


def run_within(source: Source, asked: Asked, directory, progress: bool = True) -> dict:
    """Choose the cheapest setting of a scene within a tolerance and run it; returns the summary.

    The directory gets the run's files and tolerance.json; the summary has what was chosen, and why, under `tolerance`.
    Raises SceneError before anything runs, RunError where the chosen run stops.
    """
    return _Choice(source, asked, Path(directory), progress).run()


class _Choice:
    """A setting being chosen."""

    def __init__(self, source: Source, asked: Asked, directory: Path, progress: bool):
        self.source, self.asked, self.directory, self.progress = source, asked, directory, progress
        self.scene = source.scene()
        self.own = self.scene.grid.cell
        self.sizes, self.finest = self._sizes()
        self.kind = kind_of(self.scene)
        self.experience = Experience(self.kind)
        self.names = ["end"] if not self.scene.response else list(asked.names)
        self.began, self.spent, self.until = perf_counter(), 0.0, asked.until
        self.outcomes: dict[float, dict] = {}

    def _sizes(self) -> tuple[list[float], float]:
        """Sizes of cells that are considered, coarse to fine, and the finest of them."""
        wanted = self.asked.finest
        if wanted is not None and not 0.0 < wanted <= self.own:
            raise SceneError(f"--finest = {wanted:g}: expected a size of cells up to the scene's own, {self.own:g} mm")
        sizes, refused = cells(self.source, HALF * self.own if wanted is None else wanted)
        if wanted is not None and not any(math.isclose(size, wanted) for size in sizes):
            apply(self.source, {"cell": wanted})  # says what is wrong with it, if anything
            sizes = [*sizes, wanted]
        if not sizes:
            raise SceneError(next(iter(refused.values())))
        return sizes, sizes[-1]

    def run(self) -> dict:
        """Quick runs, the choice, its run, and whether it turned out as expected."""
        estimate = self._quick_runs()
        last, tried = ({} if self.finest == self.own else {"cell": self.finest}), []
        while True:
            settings = estimate.settings(self.sizes, self._precisions()) if len(estimate.runs) > 1 else []
            chosen = estimate.cheapest([one for one in settings if one not in tried], self.asked.tolerance)
            chosen = last if chosen is None else chosen
            exact = chosen == last
            if not exact and self._between(estimate, chosen.get("cell", self.own)):
                continue
            expected = dict.fromkeys(self.names, 0.0) if exact else estimate.of(chosen)
            self._tell_choice(estimate, chosen, expected)
            recorder = Recorder(apply(self.source, chosen), self.directory, resume=False, progress=self.progress)
            summary = recorder.run()
            numbers = numbers_of(outcome_of(self.directory, summary), self.until)
            self.spent += run_seconds(summary)
            after = expected if exact else estimate.afterwards(chosen, numbers)
            if max(after.values()) <= self.asked.tolerance:
                return self._write(estimate, summary, chosen, tried, expected, after, numbers)
            self.say(f"{label(chosen, self.own)}: not as expected, {self._listed(after)}: on with a better setting")
            tried.append(chosen)
            for name in self.names:
                rate = estimate.experience.rate(name, chosen["speed"], chosen.get("cell", self.own) > self.own)
                estimate.rates[name] = max((after[name] - expected[name]) / rate + 1 if rate else 1.0, estimate.rates.get(name, 1.0))

    # -- quick runs ------------------------------------------------------------------------------

    def _quick_runs(self) -> Estimate:
        """The runs that tell what the cells do; coarser ones as long as they may be good enough."""
        self.say(f"{self.scene.name}: {percent(self.asked.tolerance)} of {self._what()} asked, against cells of {self.finest:.4g} mm; quick runs:")
        for quick in QUICK:
            if not self._known(quick):
                continue
            pair = [self.own, self.finest] if quick else self._coarse_pair()
            estimate = Estimate(self.experience, self.own, self.finest, self.names, quick)
            try:
                for cell in dict.fromkeys(pair):
                    self._quick(estimate, cell)
            except RunError as error:
                self.say(f"  {label(quick, self.own)}: {error}")
                self.outcomes.clear()
                continue
            return self._coarser(estimate)
        raise RunError("no quick run of the scene came to its end: run it without --tolerance to see why")

    def _coarse_pair(self) -> list[float]:
        """The two next larger sizes of cells, or the scene's own and the next; for where there is no quick run on the finest."""
        larger = [size for size in self.sizes if size >= 1.9 * self.own][-2:]
        return larger if len(larger) > 1 else [*larger, self.own]

    def _known(self, quick: dict) -> bool:
        """Whether charts tell what the choices of quick runs do, and the scene allows them."""
        if any(self.experience.rate(name, quick.get("speed", 1.0), True) is None for name in self.names):
            return False
        try:
            apply(self.source, quick)
        except SceneError:
            return False
        return "speed" not in quick or bool(_driven(self.scene))

    def _between(self, estimate: Estimate, cell: float) -> bool:
        """Whether a size of cells had no quick run yet, and has now or is given up: it need not behave like larger and smaller ones."""
        if not estimate.quick or cell in estimate.runs:
            return False
        try:
            self._quick(estimate, cell)
        except RunError as error:
            self.say(f"  {cell:.4g} mm: {error}")
            self.sizes.remove(cell)
        return True

    def _coarser(self, estimate: Estimate) -> Estimate:
        """Quick runs on larger cells, as long as these are good enough by themselves."""
        for cell in reversed([size for size in self.sizes if size >= 1.9 * self.own]):
            if cell in estimate.runs:
                continue
            if max(estimate.of_cell(name, max(estimate.runs)) for name in self.names) > self.asked.tolerance:
                break
            try:
                self._quick(estimate, cell)
            except RunError as error:
                self.say(f"  {cell:.4g} mm: {error}")
                break
        return estimate

    def _quick(self, estimate: Estimate, cell: float) -> None:
        """One quick run, into an estimate."""
        setting = ({} if cell == self.own else {"cell": cell}) | estimate.quick
        summary, outcome = run_setting(self.source, setting, math.inf)
        self.outcomes[cell] = outcome
        estimate.times[cell] = run_seconds(summary)
        self.spent += estimate.times[cell]
        if self.asked.until is None:
            self.until = fallen(self.outcomes[min(self.outcomes)])
        estimate.runs.update({size: numbers_of(one, self.until) for size, one in self.outcomes.items()})
        numbers = ", ".join(f"{name} {value:.5g}" for name, value in estimate.runs[cell].items() if name in self.names)
        self.say(f"  {label(setting, self.own)}: {seconds(estimate.times[cell])}, {numbers}")

    def _precisions(self) -> list[str]:
        """Other precisions that charts of the kind know and the scene allows."""
        known = self.experience.shift(self.names[0], False, precision="float32") is not None
        return ["float32"] if known and self.scene.solver.precision == "float64" and self.scene.solver.kind == "explicit" else []

    # -- what is said ----------------------------------------------------------------------------

    def say(self, text: str) -> None:
        """A line of progress."""
        if self.progress:
            print(text, file=sys.stderr, flush=True)

    def _what(self) -> str:
        return " and ".join(self.names)

    def _listed(self, errors: dict[str, float]) -> str:
        return ", ".join(f"{name} {percent(error)}" for name, error in errors.items())

    def _tell_choice(self, estimate: Estimate, chosen: Setting, expected: dict) -> None:
        why = f"expected to be off by {self._listed(expected)}" if any(expected.values()) else "the finest cells as given, as nothing else is good enough"
        self.say(f"chosen: {label(chosen, self.own)}, {why}; {seconds(estimate.seconds(chosen))} foreseen")

    def _write(self, estimate, summary, chosen, tried, expected, after, numbers) -> dict:
        """tolerance.json, and its short form in the summary; returns the summary."""
        reference = {} if self.finest == self.own else {"cell": self.finest}
        full = run_seconds(summary) if chosen == reference else estimate.seconds(reference)
        found = {
            "asked": self.asked.tolerance, "of": self.names, "against_cells": self.finest, "work_until": self.until,
            "setting": label(chosen, self.own), "choices": dict(chosen), "expected_errors": expected, "errors_afterwards": after,
            "numbers": {name: numbers[name] for name in self.names}, "seconds_in_all": self.spent,
            "seconds_of_finest": full, "quick_runs": len(estimate.runs), "tried_before": [label(one, self.own) for one in tried], "wall_seconds": perf_counter() - self.began, "kind": WORDS[self.kind], "charts": self.experience.scenes,
        }  # fmt: skip
        runs = [{"cell": cell, "seconds": estimate.times[cell]} | run for cell, run in sorted(estimate.runs.items(), reverse=True)]
        results.write_object(self.directory / NAME, found | {"quick": {"choices": estimate.quick, "runs": runs}, "cells_considered": self.sizes})
        summary = summary | {"tolerance": found}
        results.write_summary(self.directory, summary)
        return summary


def _driven(scene) -> bool:
    from jaxmpm.chart.settings import AXES

    return bool(list(AXES["speed"].others(scene)))


def report(summary: dict) -> str:
    """What was chosen, why, what it saved and whether it turned out as expected, in a few lines."""
    found = summary["tolerance"]
    listed = lambda errors: ", ".join(f"{name} {percent(error)}" for name, error in errors.items())  # noqa: E731
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
