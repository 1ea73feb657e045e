"""Makes a chart: measures settings while the budget lasts, judges them, writes what is known after each."""

import json
import math
import sys
from pathlib import Path
from time import perf_counter

from jaxmpm.chart import reference as references
from jaxmpm.chart.costs import Costs
from jaxmpm.chart.files import kept, provenance, write_chart
from jaxmpm.chart.front import judged, seconds, sentence
from jaxmpm.chart.measure import Stopwatch, with_seconds
from jaxmpm.chart.search import FINEST, Search, ladder
from jaxmpm.chart.settings import AXES, Source, cells, choices
from jaxmpm.errors import RunError, SceneError
from jaxmpm.run import terminate_as_interrupt

BUDGET = 600.0  # s
AT_THE_END = 5.0  # s, for the picture
PATIENCE, LEAST = 3.0, 40.0  # a run is given up after so many times what was foreseen, and so many seconds: it may have to be compiled
AGAIN = 0.05  # of the budget that repeats of one setting may take


def chart_scene(
    source: Source, directory, budget: float = BUDGET, resume: bool = False, reference: str = "auto",
    until: float | None = None, only: tuple[str, ...] = tuple(AXES), progress: bool = True,
) -> dict:  # fmt: skip
    """Chart speed against accuracy of a scene; returns what chart.json says.

    Args:
        source: where the scene comes from.
        directory: gets chart.json, chart.csv, chart.png and chart.pdf.
        budget: wall time, s; a run that would not fit is not begun.
        resume: keep the settings that have been measured in the directory.
        reference: "auto": what the numbers tend to where they do so steadily, else the finest run; "finest"; or a CSV
            file (as of response.reference, or history.csv of another run).
        until: displacement up to which the work is counted, None for where the load has fallen to half its peak.
        only: the choices to try besides cells, names of `settings.AXES`.
        progress: whether to say how far it is, on stderr.

    Raises SceneError and ResultError before anything runs, RunError where not one setting came to its end.
    """
    chart = Chart(source, Path(directory), budget, resume, reference, until, only, progress)
    try:
        with terminate_as_interrupt():
            chart.measure()
    finally:
        chart.write()
    if chart.reference is None:
        reasons = {record["label"]: record["status"] for record in chart.records}
        said = "; ".join(f"{name}: {why}" for name, why in reasons.items()) or f"{seconds(budget)} are too short to begin with one"
        raise RunError(f"no setting came to its end: {said}")
    from jaxmpm.chart.picture import plot_chart

    for suffix in ("png", "pdf"):
        plot_chart(chart.found, chart.directory / f"chart.{suffix}")
    return chart.found


class Chart:
    """One chart in the making."""

    def __init__(self, source, directory, budget, resume, reference, until, only, progress):
        self.began, self.only = perf_counter(), only
        self.source, self.directory, self.budget, self.progress = source, directory, budget, progress
        self.scene = source.scene()
        self.tree = json.loads(json.dumps(self.scene.to_dict()))
        self.until, self.extrapolate = until, reference == "auto"
        given = reference not in ("auto", "finest")
        self.reference = references.of_file(reference, self.scene, until) if given else None
        self.given = given
        self.cell = self.scene.grid.cell
        sizes, self.refused = cells(source)
        if not sizes:
            raise SceneError(next(iter(self.refused.values())))
        self.search = Search(sizes, self.cell, {}, given)
        self.stopwatch = Stopwatch(source, self.cell)
        self.records = kept(directory, self.tree) if resume else []
        self.stopwatch.go_on(self.records)
        self.provenance = provenance()
        directory.mkdir(parents=True, exist_ok=True)
        self.say(f"{self.scene.name}: cells of {', '.join(f'{size:.4g}' for size in sizes)} mm" + (f", {seconds(budget)} in all" if budget < math.inf else ""))

    def measure(self) -> None:
        """All that is worth a run and fits into the budget."""
        self.judge()
        while (setting := self.search.ladder(self.records, self.costs(), self.budget, self.left())) is not None:
            self.one(setting, at_least=FINEST * self.budget)
        if self.reference is None:
            return
        moved = any("updated" in (record.get("frame") or "") for record in self.records)
        allowed, refused = choices(self.source, moved)
        self.search.choices = {name: values for name, values in allowed.items() if name in self.only}
        self.refused |= refused
        while (setting := self.search.further(self.records, self.costs(), self.left(), self.reference)) is not None:
            self.one(setting)

    def one(self, setting: dict, at_least: float = LEAST) -> None:
        """Measure a setting, and judge all with it; it may take `at_least` so many seconds."""
        costs = self.costs()
        first = not costs.timed
        foreseen = None if first else costs.seconds(setting)
        limit = self.left() if first else min(self.left(), max(PATIENCE * foreseen, at_least))
        over = self.left() - (0.0 if first else foreseen + costs.overhead())
        self.records.append(self.stopwatch.measure(setting, limit, AGAIN * min(self.budget, 10 * over)))
        self.judge()
        self.write()
        self.tell(self.records[-1], foreseen)

    def judge(self) -> None:
        """Times, reference, errors and front of what has been measured."""
        self.records = with_seconds(self.records)
        pairs = [(record["cell_size"], record["outcome"]) for record in ladder(self.records)]
        if pairs and not self.given:
            self.reference = references.of_runs(pairs, self.extrapolate, self.until)
        if self.reference is not None:
            self.records = [
                record | {"errors": references.errors_of(record["outcome"], self.reference)} if "seconds" in record else record
                for record in self.records
            ]
            self.records = judged(self.records, self.reference.names, self.given)

    def costs(self) -> Costs:
        """What is known of what settings take."""
        done = [(record["setting"], record["seconds"], record["besides_seconds"]) for record in self.records if "seconds" in record]
        return Costs(done, self.cell, self.scene.solver.time_step_factor)

    def left(self) -> float:
        """Of the budget, s."""
        return self.budget - AT_THE_END - (perf_counter() - self.began)

    @property
    def found(self) -> dict:
        """What chart.json says."""
        done = self.reference is not None
        return {
            "name": self.scene.name, "title": self.scene.title,
            "says": sentence(self.records, self.reference) if done else "",
            "reference": self.reference.to_dict() if done else None,
            "budget_seconds": self.budget, "wall_seconds": perf_counter() - self.began, "made_on": self.provenance,
            "not_allowed": self.refused, "response": self.scene.response and self.scene.response.model_dump(include={"load", "displacement"}),
            "runs": self.records, "scene": self.tree,
        }  # fmt: skip

    def write(self) -> None:
        """All that is known, on disk."""
        if self.records:
            write_chart(self.directory, self.found)

    def say(self, text: str) -> None:
        """A line of progress."""
        if self.progress:
            print(text, file=sys.stderr, flush=True)

    def tell(self, record: dict, foreseen: float | None) -> None:
        """Say what a setting has come to."""
        if "seconds" not in record:
            self.say(f"  {record['label']}: {record['status']}")
            return
        wanted = "" if foreseen is None else f" ({seconds(foreseen)} foreseen)"
        left = f", {max(self.left(), 0):.0f} s left" if self.budget < math.inf else ""
        errors = [f"{name} {record['errors'][name]:+.2%}" for name in self.reference.names]
        self.say(f"  {record['label']}: {seconds(record['seconds'])}{wanted}, {', '.join(errors)}{left}")
