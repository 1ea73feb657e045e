"""The fields that can colour a body: what they are called, their values and their colours."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxmpm.errors import did_you_mean, written
from jaxmpm.plot_style import PHASES, shades
from jaxmpm.results import ResultError

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

Frame = dict[str, np.ndarray]


@dataclass(frozen=True)
class Field:
    """A field: `of(data)` gives its values (N,) from a frame's `source` and its like.

    `low`, `high`: fixed ends of its colours, None for those of the data, less the share `outliers`
    of the values beyond either; `shows_cracks`: it says itself where they are.
    """

    label: str
    source: str
    of: Callable[[Frame], np.ndarray]
    low: float | None = 0.0
    high: float | None = None
    outliers: float = 0.0
    shows_cracks: bool = False

    def ends(self, values: np.ndarray) -> tuple[float, float]:
        """Between which values the colours are to run."""
        values = values[np.isfinite(values)]
        if not len(values):
            return self.low or 0.0, self.high or 0.0
        low, high = np.quantile(values, (self.outliers, 1 - self.outliers))
        return (
            float(low) if self.low is None else self.low,
            float(high) if self.high is None else self.high,
        )

    def colours(self) -> Colormap:
        """The map of its values: the palest is that of a body at rest."""
        if self.source == "material":
            from matplotlib.colors import ListedColormap

            return ListedColormap(PHASES)
        return opening_colours(PHASES[0]) if self.shows_cracks else shades("GnBu", 0.15, 1.0, PHASES[0])


def first_principal(stress: np.ndarray) -> np.ndarray:
    """The larger principal stress (N,) of the plane, of `stress` (N, 3): xx, yy, xy."""
    xx, yy, xy = np.asarray(stress, float).T
    return 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.asarray(vectors, float), axis=1)


FIELDS = {
    "material": Field("material", "material", lambda data: data["material"]),
    "stress": Field(
        "first principal stress [MPa]", "stress", lambda data: first_principal(data["stress"]),
        low=None, outliers=0.001,
    ),
    "speed": Field("speed [mm/s]", "velocity", lambda data: _length(data["velocity"]), outliers=0.001),
    "displacement": Field("displacement [mm]", "displacement", lambda data: _length(data["displacement"])),
    "opening": Field("opening [mm]", "opening", lambda data: data["opening"], shows_cracks=True),
    "damage": Field("damage", "damage", lambda data: data["damage"], high=1.0, shows_cracks=True),
}  # fmt: skip


def find_field(name: str, present: Iterable[str], path: str | os.PathLike) -> Field:
    """The field called `name`, of a result at `path` in which the fields `present` are.

    Raises ResultError for another name, or where the result lacks what the field comes from.
    """
    present = set(present)
    usable = ", ".join(one for one, field in FIELDS.items() if field.source in present)
    if name not in FIELDS:
        near = did_you_mean(name, FIELDS)
        hint = f' (did you mean "{near}"?)' if near else ""
        raise ResultError(f"field = {written(name)}: expected one of {usable}{hint}")
    if FIELDS[name].source not in present:
        raise ResultError(
            f"field = {written(name)}: expected one of {usable} ({path} has no {FIELDS[name].source})"
        )
    return FIELDS[name]


def opening_colours(start: str | None = None) -> Colormap:
    """Of cracks: the map's palest fifth would be lost on the body, its black end in the outline."""
    return shades("magma_r", 0.22, 0.94, start)
