"""What a setting will cost, from what others have taken.

A run in motion takes cells × steps, which grows with 1/cell³ in the plane, less where small grids do not keep
the cores busy; so sizes that have been timed are joined in logarithms, and every other choice is a factor.
"""

import math
from statistics import median

from jaxmpm.chart.settings import rest

EXPONENTS = (2.2, 3.3)  # of the cell, in what a finer one will take, that are believed
STEEPER = 1.2  # by how much equilibrium grows faster with 1/cell than motion
FIRST_OVERHEAD = 12.0  # s: compiling, setting up and writing, where nothing is known yet
GUESSES = {"solver": 12.0, "frame": 10.0, "precision": 0.9, "half": 0.6}  # factors before anything is timed


class Costs:
    """Predictions from timed settings."""

    def __init__(self, timed: list[tuple[dict, float, float]], cell: float, step: float):
        """`timed`: (setting, seconds of the run, wall seconds besides) each; `cell`, `step`: of the scene as given."""
        self.cell, self.step = cell, step
        self.timed = [({"cell": cell} | dict(setting), seconds) for setting, seconds, _ in timed]
        self.others = [besides for *_, besides in timed]

    def seconds(self, setting) -> float:
        """Of the run alone, s."""
        setting = {"cell": self.cell} | dict(setting)
        cell, others = setting["cell"], rest(setting)
        if (known := self._along(others)) and (len(known) > 1 or cell in known):
            return _joined(known, cell, others)
        return _joined(self._along({}), cell, {}) * self._factor(others, cell)

    def overhead(self) -> float:
        """Of everything else that a new setting takes: compilation, setting up, files, s."""
        return max(median(self.others), self.others[-1]) if self.others else FIRST_OVERHEAD

    def _along(self, others: dict) -> dict[float, float]:
        """Seconds by cell of the settings that have all else in common."""
        return {setting["cell"]: seconds for setting, seconds in self.timed if rest(setting) == others}

    def _factor(self, others: dict, cell: float) -> float:
        """Time of a setting over that of the scene as given on cells of that size."""
        for together in (others, *({name: value} for name, value in others.items())):
            if known := self._along(together):
                near = min(known, key=lambda size: abs(math.log(size / cell)))
                factor = known[near] / _joined(self._along({}), near, {})
                if "solver" in together:
                    factor *= max(near / cell, 1.0) ** STEEPER
                left = {name: value for name, value in others.items() if name not in together}
                return factor * (self._factor(left, cell) if left else 1.0)
        return math.prod(self._guess(name, value) for name, value in others.items())

    def _guess(self, name: str, value) -> float:
        if name == "speed":
            return 1 / value
        if name == "step":
            return self.step / value
        return (value / 2) ** 2 if name == "per_side" else GUESSES.get(name, 1.0)


def _joined(known: dict[float, float], cell: float, others: dict) -> float:
    """Seconds on a cell size: between known ones straight in logarithms, beyond them on a slope that is believed."""
    sizes = sorted(known)
    if cell in known:
        return known[cell]
    if len(sizes) == 1:
        ends, slope = sizes * 2, 3.0
    else:
        at = next((i for i in range(len(sizes) - 1) if cell < sizes[i + 1]), len(sizes) - 2)
        ends = sizes[at : at + 2]
        slope = math.log(known[ends[0]] / known[ends[1]]) / math.log(ends[1] / ends[0])
        if not ends[0] < cell < ends[1]:
            slope = min(max(slope, EXPONENTS[0]), EXPONENTS[1] + STEEPER * ("solver" in others))
    slope += STEEPER * ("solver" in others and len(sizes) == 1)
    near = min(ends, key=lambda size: abs(math.log(size / cell)))
    return known[near] * (near / cell) ** slope
