"""From diffuse cracking to one crack: what goes on in the cells at some stages of a response.

At each stage stand the damage D of all cells and what was added since the frame before. D of a band is
within a thousandth of 1 soon after onset, though the band still bears most of its strength, so ΔD shows
where cells crack; where cracks go on opening the increment of the opening, Δw, shows. The share of an
increment in the cells of the final crack says how localised it is.
"""

import csv
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxmpm.results import ResultError, read_history, read_summary
from jaxmpm.vtkhdf import read_frame, read_frames

RISING, FALLING = (0.8, 0.95), (0.75, 0.35)  # loads over the peak at which one looks
OPEN = 0.1  # of the largest opening at the end: what belongs to the final crack
COLUMNS = ("stage", "displacement", "load", "cracked", "active", "share_of_damage", "share_of_opening")


@dataclass(frozen=True)
class Stage:
    """A moment of a run; arrays are (cells,).

    `number` from 1; `frame` of result.vtkhdf; `displacement` and `load` of the response; `damage`
    there; `more_damage` and `more_opening` (mm) since the frame before; `share_of_damage` and
    `share_of_opening`, of these in the cells of the final crack (NaN where nothing was added);
    `active`, how many cells take part in the opening, (Σ Δw)²/Σ Δw².
    """

    number: int
    frame: int
    displacement: float
    load: float
    damage: np.ndarray
    more_damage: np.ndarray
    more_opening: np.ndarray
    share_of_damage: float
    share_of_opening: float

    @property
    def cracked(self) -> int:
        """Number of cells with damage."""
        return int((self.damage > 0).sum())

    @property
    def active(self) -> float:
        """Number of cells that take part in the opening."""
        square = (self.more_opening**2).sum()
        return float(self.more_opening.sum() ** 2 / square) if square > 0 else 0.0


def find_stages(directory: str | os.PathLike) -> list[Stage]:
    """The stages of a run in the total frame: on the way up, the peak, on the way down, the end.

    Raises ResultError where the results are missing, have no response or points that move.
    """
    directory = Path(directory)
    path, summary = directory / "result.vtkhdf", read_summary(directory)
    names = summary.get("response")
    if not names:
        raise ResultError(f"{directory}: the scene has no [response], which stages are stages of")
    count, times = read_frames(path)
    frames = [read_frame(path, k) for k in range(count)]
    if any("side" in frame for frame in frames):
        raise ResultError(f"{directory}: points that move have no cells of their own; stages are for the total frame")
    history = read_history(directory / "history.csv")
    load, displacement = (np.interp(times, history["time"], history[names[key]]) for key in ("load", "displacement"))
    final = final_crack(frames[-1]["opening"])
    found = []
    for k in chosen(load):
        more = [np.maximum(frames[k][name] - frames[k - 1][name], 0.0) for name in ("damage", "opening")]
        shares = [float(each[final].sum() / each.sum()) if each.sum() > 0 else np.nan for each in more]
        found.append(
            Stage(len(found) + 1, k, float(displacement[k]), float(load[k]), frames[k]["damage"], *more, *shares)
        )
    return found


def final_crack(opening: np.ndarray) -> np.ndarray:
    """Which cells are of the crack that the openings (cells,) at the end show."""
    return opening > OPEN * max(opening.max(initial=0.0), 0.0)


def chosen(load: np.ndarray) -> list[int]:
    """Frames of the stages, by the load (frames,) at each; the first is never one, it has none before."""
    size = np.abs(load)
    peak = max(int(size.argmax()), 1)
    rise = [1 + int(np.argmax(size[1 : peak + 1] >= share * size[peak])) for share in RISING]
    fall = [peak + int(np.argmax(size[peak:] <= share * size[peak])) for share in FALLING if (size[peak:] <= share * size[peak]).any()]
    return sorted({*rise, peak, *fall, len(load) - 1} - {0})


def write_stages(stages: list[Stage], path: Path) -> None:
    """The stages as a table, a CSV file."""
    with open(path, "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for stage in stages:
            row = (stage.number, stage.displacement, stage.load, stage.cracked, round(stage.active, 1))
            table.writerow([*row, f"{stage.share_of_damage:.4f}", f"{stage.share_of_opening:.4f}"])
