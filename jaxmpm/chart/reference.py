"""What the runs of a chart are held against: the finest of them, what they tend to, or a measured curve."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from jaxmpm.chart import outcome as outcomes
from jaxmpm.errors import SceneError
from jaxmpm.reference import read_reference_file
from jaxmpm.results import ResultError, read_history, read_summary

ORDERS = (0.5, 3.0)  # of convergence that are believed
RATIO = 1.9, 2.1  # of two cell sizes of which one is half the other
KNOWN = {"balance": 0.0}  # numbers whose value is known beforehand
SHARES = ("end", "balance")  # numbers that are shares themselves, so that errors are their differences


@dataclass(frozen=True)
class Reference:
    """What errors are relative to.

    `outcome`: its curve and crack; `until`: displacement up to which work is counted; `numbers`: of
    `names`; `floor`: by how much it may be off itself, relative (crack path: mm), None where unknown; `how`:
    where each number is from, in words; `given`: whether it comes from outside.
    """

    words: str
    outcome: dict
    until: float
    numbers: dict[str, float]
    floor: dict[str, float | None]
    how: dict[str, str]
    given: bool

    @property
    def names(self) -> list[str]:
        """The numbers that are compared."""
        return list(self.numbers)

    def to_dict(self) -> dict:
        """Ready for JSON, without the curve, which is that of a run or a file."""
        return {name: value for name, value in asdict(self).items() if name != "outcome"}


def numbers_of(outcome: dict, until: float) -> dict[str, float]:
    """Peak and work up to a displacement, or of a motion the share of its kinetic energy that is left, and of all energy that is lost."""
    if outcome["motion"]:
        return {"end": outcomes.end(outcome), "balance": outcome["balance"]}
    return {"peak": outcomes.peak(outcome), "work": outcomes.work(outcome, until)}


def errors_of(outcome: dict, reference: Reference) -> dict[str, float | None]:
    """Errors of an outcome: of numbers with their sign and relative, of the curve relative, of the crack's path in mm."""
    scale = {name: 1.0 if name in SHARES else abs(value) for name, value in reference.numbers.items()}
    mine = numbers_of(outcome, reference.until)
    found = {name: (mine[name] - value) / scale[name] for name, value in reference.numbers.items()}
    found["curve"] = outcomes.curve_distance(outcome, reference.outcome)
    return found | {"path": outcomes.path_distance(outcome, reference.outcome)}


def worst(errors: dict, names) -> float:
    """The largest of the errors of some numbers."""
    return max(abs(errors[name]) for name in names)


# -- made of runs -------------------------------------------------------------------------------------


def of_runs(ladder: list[tuple[float, dict]], extrapolate: bool, until: float | None = None) -> Reference:
    """The reference that runs with ever finer cells make.

    Args:
        ladder: (cell in mm, outcome), coarse to fine, at least one.
        extrapolate: numbers that approach a limit steadily are taken there (Richardson), others from the finest.
        until: displacement up to which work is counted; None for where the finest has fallen to half its peak.
    """
    cell, finest = ladder[-1]
    until = outcomes.fallen(finest) if until is None else until
    rows = [(size, numbers_of(outcome, until)) for size, outcome in ladder]
    numbers, floor, how = {}, {}, {}
    for name, value in rows[-1][1].items():
        if name in KNOWN:
            numbers[name], floor[name], how[name] = KNOWN[name], 0.0, "known"
            continue
        history = [(size, row[name]) for size, row in rows]
        numbers[name], off, how[name] = _limit(history, extrapolate)
        floor[name] = None if off is None or not value else off / abs(value)
    before = ladder[-2][1] if len(ladder) > 1 else None
    floor["curve"] = before and outcomes.curve_distance(before, finest)
    floor["path"] = before and outcomes.path_distance(before, finest)
    return Reference(f"cells of {cell:.4g} mm", finest, until, numbers, floor, how, given=False)


def _limit(history: list[tuple[float, float]], extrapolate: bool) -> tuple[float, float | None, str]:
    """What a number tends to as cells become small, by how much that may be off, and how it was found."""
    cell, value = history[-1]
    found = halved(history)
    if len(found) < 2:
        off = abs(history[-2][1] - value) if len(history) > 1 else None
        return value, off, f"{cell:.4g} mm"
    last = found[1] - found[0]  # change from twice the finest cell to the finest
    order = steady_order(found)
    if order is None or not extrapolate:
        return value, abs(last), f"{cell:.4g} mm"
    limit, linear = (value - last / (2**p - 1) for p in (order, 1.0))
    return limit, max(abs(limit - linear), 0.1 * abs(limit - value)), f"extrapolated, order {order:.2f}"


def halved(history: list[tuple[float, float]]) -> list[float]:
    """Values on the finest cell, on twice it, four times, … as far as they are there."""
    found = [history[-1]]
    for cell, value in reversed(history[:-1]):
        if RATIO[0] <= cell / found[-1][0] <= RATIO[1]:
            found.append((cell, value))
    return [value for _, value in found]


def order_of(values: list[float]) -> float | None:
    """Order of convergence that values on a cell, on twice and on four times it show; None where they go back and forth."""
    change, before = values[1] - values[0], values[2] - values[1]
    return math.log2(before / change) if change != 0.0 and before / change > 0.0 else None


def steady_order(values: list[float]) -> float | None:
    """The order shown by the three finest of values, each on twice the cell of the one before; None unless four bear it out.

    Three are too few to know: an order of one may be seen where a number goes on growing.
    """
    orders = [order_of(values[start : start + 3]) for start in (0, 1)] if len(values) > 3 else [None]
    return orders[0] if all(order is not None and ORDERS[0] <= order <= ORDERS[1] for order in orders) else None


# -- given --------------------------------------------------------------------------------------------


def of_file(path: str | Path, scene, until: float | None = None) -> Reference:
    """A measured curve, the band of several, or the history.csv of another run.

    A measured one is a CSV file as of `response.reference`. Raises SceneError or ResultError where it is neither.
    """
    path = Path(path)
    if not scene.response:
        raise SceneError("response: absent, expected a load and a displacement to hold against a reference from a file")
    if (curve := _of_history(path, scene)) is not None:
        return _given(str(path), [curve], _crack_beside(path), until)
    table = read_reference_file(path, scene.response.displacement)
    edges = [np.asarray(line, float) for line in table["loads"]]
    return _given(path.name, [(np.asarray(table["displacement"], float), edge) for edge in edges], [], until)


def _of_history(path: Path, scene):
    """Displacement and load where the file is the history of a run, else None."""
    try:
        history = read_history(path)
    except ResultError:
        return None
    names = scene.response.displacement, scene.response.load
    return tuple(history[name] for name in names) if all(name in history for name in names) else None


def _crack_beside(path: Path) -> list:
    if not (path.parent / "summary.json").exists() or not (path.parent / "result.vtkhdf").exists():
        return []
    return outcomes.outcome_of(path.parent, read_summary(path.parent))["crack"]


def _given(words: str, edges: list, crack: list, until: float | None) -> Reference:
    """Of one curve, or of the two edges of a band: its middle, with half its width as the floor."""
    each = [{"displacement": list(x), "load": list(load), "motion": False, "crack": crack} for x, load in edges]
    middle = each[0] | {"load": list(np.mean([one["load"] for one in each], axis=0))}
    until = outcomes.fallen(middle) if until is None else until
    rows = [numbers_of(one, until) for one in each]
    numbers = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    floor = {name: float(np.ptp([row[name] for row in rows]) / 2 / abs(value)) for name, value in numbers.items()}
    floor |= {"curve": outcomes.curve_distance(each[0], middle), "path": 0.0 if crack else None}
    return Reference(words, middle, until, numbers, floor, dict.fromkeys(numbers, words), given=True)
