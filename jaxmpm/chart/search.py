"""Which setting a chart tries next: cells coarse to fine, then one choice at a time, then what the front suggests."""

from collections.abc import Iterator

from jaxmpm.chart.costs import Costs
from jaxmpm.chart.reference import Reference
from jaxmpm.chart.settings import MODEL, key, rest

FINEST = 0.5  # of the budget that the finest run may take
ONE = 0.2  # of what is left that a choice by itself may take
HALF = 0.5  # and what `tolerance` builds on
COARSE = 2.1  # times the scene's cells: coarser ones may be another problem
LONGER = 1.5  # times what the finest run took: what takes longer is of no use


class Search:
    """Proposes settings; what is worth a run depends on what is known by then."""

    def __init__(self, sizes: list[float], cell: float, choices: dict[str, list], given: bool):
        """`sizes`: of cells, coarse to fine; `cell`: of the scene as given; `given`: whether the reference comes from outside."""
        self.sizes, self.cell, self.choices, self.given = sizes, cell, choices, given
        self.doubled = [size for size in sizes if _power_of_two(size / cell)]

    def ladder(self, records: list[dict], costs: Costs, budget: float, left: float) -> dict | None:
        """The next finer cell of the scene as given, None where there is none or it takes too long."""
        known = {record["key"] for record in records}
        for size in self.doubled:
            setting = self.of_cell(size)
            if key(setting) not in known:
                cost = costs.seconds(setting) + costs.overhead() if costs.timed else 0.0
                return setting if cost < min(FINEST * budget, left) else None
        return None

    def of_cell(self, size: float) -> dict:
        """The setting of a size of cells, all else as given."""
        return {} if size == self.cell else {"cell": size}

    def further(self, records: list[dict], costs: Costs, left: float, reference: Reference) -> dict | None:
        """The next setting worth a run besides those of the ladder, None where nothing is."""
        known = {record["key"] for record in records}
        refused = [record["setting"].items() for record in records if record["status"].startswith("refused")]
        longest = LONGER * max(record["seconds"] for record in ladder(records))
        stages = (ONE, self._alone(records)), (HALF, self._quick(records)), (1.0, self._together(records, costs, reference))
        for share, settings in stages:
            found = []
            for setting in settings:
                seconds = costs.seconds(setting)
                if any(less <= setting.items() for less in refused):
                    continue
                if key(setting) not in known and seconds < longest and seconds + costs.overhead() < share * left:
                    found.append((seconds, setting))
            if found:
                return min(found, key=lambda pair: pair[0])[1]
        return None

    def _alone(self, records: list[dict]) -> Iterator[dict]:
        """Each choice by itself, on the coarsest cells that came to an end, but not much coarser ones than the scene's."""
        cells = ladder(records)
        base = next((record for record in cells if record["cell_size"] <= COARSE * self.cell), cells[-1])["setting"]
        for name, values in self.choices.items():
            yield from (base | {name: value} for value in values)

    def _quick(self, records: list[dict]) -> Iterator[dict]:
        """Faster loading in float32 on all cells of the ladder, which `jaxmpm run --tolerance` chooses from."""
        if "float32" in self.choices.get("precision", ()):
            for record in ladder(records):
                yield record["setting"] | {"precision": "float32"}
                for speed in (speed for speed in self.choices.get("speed", ()) if speed > 1.0):
                    yield record["setting"] | {"speed": speed, "precision": "float32"}

    def _together(self, records: list[dict], costs: Costs, reference: Reference) -> Iterator[dict]:
        """Other cells for what is good, and choices that were tried alone put together, unless it will be beaten."""
        done = [record for record in records if "error" in record]
        starts = [record for record in done if record["front"]] + ladder(records)
        for record in starts:
            for size in self.sizes:
                yield from self._unbeaten(self.of_cell(size) | rest(record["setting"]), done, costs, reference)
            for name, values in self.choices.items():
                for value in values if name not in record["setting"] and (self.given or name not in MODEL) else ():
                    yield from self._unbeaten(record["setting"] | {name: value}, done, costs, reference)

    def _unbeaten(self, setting: dict, done: list[dict], costs: Costs, reference: Reference) -> Iterator[dict]:
        seconds, error = costs.seconds(setting), self.foreseen(setting, done, reference)
        if not any(record["seconds"] <= seconds and record["error"] <= error for record in done):
            yield setting

    def foreseen(self, setting: dict, done: list[dict], reference: Reference) -> float:
        """The error that a setting is likely to have: that of its cells, and what each choice shifted where it was tried."""
        cell = setting.get("cell", self.cell)
        cells = ladder(done)
        worst = 0.0
        for name in reference.names:
            error = _between([(record["cell_size"], record["errors"][name]) for record in cells], cell)
            error += sum(self._shift(choice, cells, done, name, cell) for choice in rest(setting).items())
            worst = max(worst, abs(error))
        return worst

    def _shift(self, choice, cells: list[dict], done: list[dict], name: str, cell: float) -> float:
        """By how much a choice alone shifted the error of a number, on the cells nearest to a size; 0 where it was not tried."""
        tried = [record for record in done if dict([choice]) == rest(record["setting"])]
        if not tried:
            return 0.0
        near = min(tried, key=lambda record: abs(record["cell_size"] - cell))
        base = _between([(record["cell_size"], record["errors"][name]) for record in cells], near["cell_size"])
        return near["errors"][name] - base


def ladder(records: list[dict]) -> list[dict]:
    """Records of cells alone that came to their end, coarse to fine."""
    done = [record for record in records if "seconds" in record and not rest(record["setting"])]
    return sorted(done, key=lambda record: -record["cell_size"])


def _power_of_two(ratio: float) -> bool:
    import math

    return math.isclose(math.log2(ratio), round(math.log2(ratio)), abs_tol=1e-6)


def _between(known: list[tuple[float, float]], cell: float) -> float:
    """A number on a size of cells, straight between known ones (cell, number), coarse to fine, and level beyond."""
    import numpy as np

    sizes, values = zip(*reversed(known), strict=True)
    return float(np.interp(cell, sizes, values))
