"""How far a setting is likely to be from the finest cells, from two quick runs of the scene and what charts of its kind say."""

import math
from dataclasses import dataclass, field

from jaxmpm.chart.classes import Experience

SPEEDS = (1.0, 2.0, 2**1.5, 4.0)  # of loading that are considered, over that of the scene
MARGIN = 1.25  # by which what was seen is enlarged
ORDERS = (0.5, 2.0)  # of convergence that are believed
ORDER = 1.0  # where it is not observed


@dataclass
class Estimate:
    """Errors of settings, each number's apart.

    `own`, `finest`: cells of the scene and those that errors are relative to, mm; `names`: of the numbers; `quick`: the choices
    of the quick runs; `runs`: their numbers by cell; `times`: their seconds by cell; `rates`: what was seen of the loading rate on
    the scene itself, over what its kind would have let expect.
    """

    experience: Experience
    own: float
    finest: float
    names: list[str]
    quick: dict
    runs: dict[float, dict[str, float]] = field(default_factory=dict)
    times: dict[float, float] = field(default_factory=dict)
    rates: dict[str, float] = field(default_factory=dict)

    def at(self, name: str, cell: float) -> float:
        """A number of quick runs on cells of a size: as run, or by Richardson's extrapolation from the two finest that were."""
        if cell in self.runs:
            return self.runs[cell][name]
        fine, coarse, *more = sorted(self.runs)
        order = self.order(name) if more else ORDER
        change = self.runs[fine][name] - self.runs[coarse][name]
        return self.runs[fine][name] + change * (fine**order - cell**order) / (coarse**order - fine**order)

    def order(self, name: str) -> float:
        """The order of convergence that the three finest quick runs show, within what is believed."""
        fine, middle, coarse = sorted(self.runs)[:3]
        change, before = (self.runs[a][name] - self.runs[b][name] for a, b in ((fine, middle), (middle, coarse)))
        shown = math.log(before / change) / math.log(coarse / middle) if change and before / change > 0 else ORDERS[0]
        return min(max(shown, ORDERS[0]), ORDERS[1])

    def of_cell(self, name: str, cell: float) -> float | None:
        """Error that comes of the cells; between sizes that were run straight in the logarithm of the size, None beyond them."""
        limit = self.at(name, self.finest)
        if self.finest < cell < min(self.runs):
            return abs(self.at(name, cell) / limit - 1) * MARGIN
        if cell == self.finest:
            return 0.0
        blur = self.experience.blur(name, **self.quick) if self.quick else 0.0
        known = {size: abs(run[name] / limit - 1) * MARGIN + blur for size, run in self.runs.items()} | {self.finest: blur}
        if cell in known:
            return known[cell]
        larger, smaller = ([size for size in known if test(size)] for test in (lambda s: s > cell, lambda s: s < cell))
        if not larger or not smaller:
            return None
        a, b = min(larger), max(smaller)
        share = math.log(cell / b) / math.log(a / b)
        return max(known[b], known[b] + share * (known[a] - known[b]))

    def of(self, setting: dict) -> dict[str, float] | None:
        """Errors of a setting; None where nothing is known of it.

        Loading rate and precision may both let other cells crack first, but that happens once: the larger counts.
        """
        cell, speed = setting.get("cell", self.own), setting.get("speed", 1.0)
        found = {}
        for name in self.names:
            parts = [self.of_cell(name, cell), self.of_rate(name, speed, cell > self.own), self.of_precision(name, setting)]
            if None in parts:
                return None
            found[name] = parts[0] + max(parts[1:])
        return found

    def of_rate(self, name: str, speed: float, coarse: bool) -> float | None:
        """Error that comes of loading faster."""
        shift = self.experience.rate(name, speed, coarse)
        return shift if shift is None else MARGIN * shift * max(self.rates.get(name, 1.0), 1.0)

    def of_precision(self, name: str, setting: dict) -> float | None:
        """Error that comes of fewer digits."""
        if "precision" not in setting:
            return 0.0
        shift = self.experience.shift(name, False, precision=setting["precision"])
        return shift if shift is None else MARGIN * shift

    def seconds(self, setting: dict) -> float:
        """What a run is likely to take, s."""
        cell, speed = setting.get("cell", self.own), setting.get("speed", 1.0)
        sizes = sorted(self.times)
        near = min(sizes, key=lambda size: abs(math.log(size / cell)))
        power = 3.0
        if len(sizes) > 1:
            a, b = sizes[:2] if cell < sizes[1] else sizes[-2:]
            power = math.log(self.times[a] / self.times[b]) / math.log(b / a)
        took = self.times[near] * (near / cell) ** power * self.quick.get("speed", 1.0) / speed
        return took * (self.experience.quicker(precision="float32") if "precision" in self.quick and "precision" not in setting else 1.0)

    def settings(self, sizes: list[float], precision: list[str]) -> list[dict]:
        """The settings whose errors are known, quickest first; `precision`: other ones that the scene allows."""
        speeds = SPEEDS if "speed" in self.quick else (1.0,)
        found = []
        for cell in sizes:
            for speed in speeds:
                for other in (None, *precision):
                    setting = {"cell": cell} if cell != self.own else {}
                    setting |= {"speed": speed} if speed != 1.0 else {}
                    setting |= {"precision": other} if other else {}
                    if self.of(setting) is not None:
                        found.append(setting)
        return sorted(found, key=self.seconds)

    def cheapest(self, settings: list[dict], tolerance: float) -> dict | None:
        """The quickest of settings that is likely to be within a tolerance."""
        return next((setting for setting in settings if max(self.of(setting).values()) <= tolerance), None)

    def afterwards(self, setting: dict, numbers: dict[str, float]) -> dict[str, float]:
        """Errors of a setting anew with what its run has come to.

        What the loading rate shifted between the quick run on these cells and this one tells, in proportion to the rate,
        what it shifts between this one and the scene's own.
        """
        cell, speed = setting.get("cell", self.own), setting.get("speed", 1.0)
        before, fast = self.of(setting), self.quick.get("speed", 1.0)
        if cell not in self.runs or not 1.0 < speed < fast:
            return before
        found = {}
        for name in self.names:
            seen = abs(self.runs[cell][name] / numbers[name] - 1) * (speed - 1) / (fast - speed)
            digits = self.of_precision(name, setting)
            found[name] = before[name] - max(self.of_rate(name, speed, cell > self.own), digits) + max(seen, digits)
        return found

    def learn(self, setting: dict, expected: dict[str, float], after: dict[str, float]) -> None:
        """Expect more of the loading rate from now on, as it was seen `afterwards`."""
        for name in self.names:
            before = self.of_rate(name, setting.get("speed", 1.0), setting.get("cell", self.own) > self.own)
            if before and after[name] > expected[name]:
                self.rates[name] = max(self.rates.get(name, 1.0), 1.0) * (before + after[name] - expected[name]) / before
