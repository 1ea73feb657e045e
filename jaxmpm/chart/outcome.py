"""What a chart keeps of a run, and how far it is from a reference: peak, work, curve, path of the crack.

An outcome is plain numbers, ready for JSON. Of a scene with a response the curve is load over
displacement, of another its kinetic energy over time; of that one how much energy the balance lacks is kept
too, as the answer is known: none. (Momentum, known as well, is kept to round-off by any setting and tells nothing.)
"""

import os
from pathlib import Path

import numpy as np

from jaxmpm.ensemble_statistics import onward
from jaxmpm.results import read_history
from jaxmpm.stages import final_crack
from jaxmpm.vtkhdf import read_frame, read_frames

FALLEN = 0.5  # of the peak: the work is counted up to where the load has fallen to it
MOST_CELLS = 400  # of the crack that are kept, those that have opened furthest
AXIS = 2000  # places at which curves are compared
WORDS = {
    "peak": "peak load", "work": "work", "curve": "whole curve", "path": "path of the crack", "end": "kinetic energy kept",
    "balance": "energy lost",
}  # fmt: skip


def outcome_of(directory: str | os.PathLike, summary: dict) -> dict:
    """What a run has come to: `displacement` and `load` (rows,), `crack` (cells, 3) of x, y and opening, mm.

    Without a response `displacement` is the time, s, `load` the kinetic energy, N·mm, `motion` is true, and `balance` is the energy
    that the run has lost, over the most that it has met.
    """
    directory = Path(directory)
    history = read_history(directory / "history.csv")
    names = summary.get("response")
    columns = (names["displacement"], names["load"]) if names else ("time", "kinetic_energy")
    found = {name: _short(history[column]) for name, column in zip(("displacement", "load"), columns, strict=True)}
    found |= {} if names else {"balance": summary["energy_error"]}
    return found | {"motion": not names, "crack": _crack(directory / "result.vtkhdf")}


def _crack(path: Path) -> list[list[float]]:
    """The cells of the final crack: where they are, and how far they have opened, mm."""
    count, _ = read_frames(path)
    frame = read_frame(path, count - 1)
    opening = frame["opening"]
    cells = np.flatnonzero(final_crack(opening))
    cells = cells[np.argsort(-opening[cells])][:MOST_CELLS]
    return [_short(row) for row in np.column_stack([frame["points"][cells, :2], opening[cells]])]


def _short(values) -> list[float]:
    return [float(f"{value:.7g}") for value in values]


# -- numbers of one outcome ---------------------------------------------------------------------------


def curve(outcome: dict) -> tuple[np.ndarray, np.ndarray]:
    """Displacements that increase, along the way that they go, and the loads there, positive at the peak."""
    load = np.asarray(outcome["load"], float)
    sign = np.sign(load[np.abs(load).argmax()]) or 1.0
    return onward(np.asarray(outcome["displacement"], float), sign * load)


def peak(outcome: dict) -> float:
    """The largest load, in magnitude."""
    return float(np.abs(outcome["load"]).max())


def end(outcome: dict) -> float:
    """The last value of the curve over the largest."""
    return float(outcome["load"][-1]) / peak(outcome)


def work(outcome: dict, until: float) -> float:
    """Area under the curve up to a displacement."""
    x, load = curve(outcome)
    places = np.union1d(x[x < until], [until])
    return float(np.trapezoid(np.interp(places, x, load), places))


def fallen(outcome: dict) -> float:
    """The displacement at which the load has fallen to half the peak, or the last one."""
    x, load = curve(outcome)
    top = int(load.argmax())
    below = np.flatnonzero(load[top:] <= FALLEN * load[top])
    return float(x[top + below[0]] if len(below) else x[-1])


# -- distance of two outcomes -------------------------------------------------------------------------


def curve_distance(outcome: dict, other: dict) -> float:
    """L2 distance of two curves over that of the second from zero, as far as both reach."""
    (x, load), (x2, load2) = curve(outcome), curve(other)
    places = np.linspace(max(x[0], x2[0]), min(x[-1], x2[-1]), AXIS)
    mine, theirs = np.interp(places, x, load), np.interp(places, x2, load2)
    return float(np.sqrt(((mine - theirs) ** 2).sum() / (theirs**2).sum()))


def path_distance(outcome: dict, other: dict) -> float | None:
    """How far two cracks are apart, mm; None where one has none.

    The mean distance of the cells of one to the nearest of the other, weighed by their opening, the
    larger of both ways: a modified Hausdorff distance (Dubuisson, Jain 1994) that ignores what has hardly opened.
    """
    if not outcome["crack"] or not other["crack"]:
        return None
    one, two = np.asarray(outcome["crack"], float), np.asarray(other["crack"], float)
    apart = np.hypot(one[:, None, 0] - two[None, :, 0], one[:, None, 1] - two[None, :, 1])
    there = (one[:, 2] * apart.min(axis=1)).sum() / one[:, 2].sum()
    back = (two[:, 2] * apart.min(axis=0)).sum() / two[:, 2].sum()
    return float(max(there, back))
