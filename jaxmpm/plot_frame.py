"""One frame of a result drawn: the body or its moving points, coloured, and the cracks on them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmpm.errors import written
from jaxmpm.plot_body import Body, directions, find_body
from jaxmpm.plot_fields import Field, opening_colours
from jaxmpm.plot_points import Squares, find_squares
from jaxmpm.plot_style import ACCENT, FAINT, PHASES, colour_bar, points_per_mm
from jaxmpm.results import ResultError
from jaxmpm.vtkhdf import read_frame

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize

NEEDED = ("displacement", "opening", "normal", "material")
NEARLY_CLOSED = 0.01


@dataclass(frozen=True)
class Frame:
    """A frame at `time` (s), as read (`data`) and as it is to be drawn (`shape`)."""

    time: float
    data: dict[str, np.ndarray]
    shape: Body | Squares


@dataclass(frozen=True)
class Scale:
    """What axes and colours span; that of an animation is the same through all its frames.

    `low`, `high` (2,): corners of what is drawn, mm; `ends` of the field's colours; `least`,
    `most` of the field's values; `widest` opening of a crack, mm; `materials`, sorted.
    """

    low: np.ndarray
    high: np.ndarray
    ends: tuple[float, float]
    least: float
    most: float
    widest: float
    materials: np.ndarray

    def joined(self, other: Scale) -> Scale:
        """What spans both."""
        return Scale(
            np.minimum(self.low, other.low),
            np.maximum(self.high, other.high),
            (min(self.ends[0], other.ends[0]), max(self.ends[1], other.ends[1])),
            min(self.least, other.least),
            max(self.most, other.most),
            max(self.widest, other.widest),
            np.union1d(self.materials, other.materials),
        )


def load_frame(
    directory: Path, k: int, summary: dict[str, Any], deformed: float | None = None
) -> Frame:
    """Frame `k` of a run (negative: from the end), its displacements times `deformed`.

    None for `deformed`: the cells of the total frame at rest, points that move where they are.
    Raises ResultError where the frame is missing, broken or not plane.
    """
    path = directory / "result.vtkhdf"
    data = read_frame(path, k)
    if missing := [name for name in NEEDED if name not in data]:
        raise ResultError(f"{path}: has no {', '.join(missing)}; run the scene again")
    if deformed is not None and not math.isfinite(deformed):
        raise ResultError(f"deformed = {deformed}: expected a finite factor on the displacements")
    for name in ("points", "displacement"):
        if not np.isfinite(data[name]).all():
            raise ResultError(f"{path}: frame {k} has {name} that are not finite; nothing to draw")
    if "side" in data:
        factor = 1.0 if deformed is None else deformed
        shape = find_squares(data["points"], data["displacement"], data["side"], factor)
        return Frame(data["time"], data, shape)
    size = summary.get("cell_size")
    if not (isinstance(size, int | float) and size > 0):
        raise ResultError(
            f"{directory / 'summary.json'}: cell_size = {written(size)}: expected more than 0 mm"
        )
    displacement = data["displacement"][:, :2] * deformed if deformed else None
    return Frame(data["time"], data, find_body(data["points"], float(size), displacement))


def scale_of(frame: Frame, field: Field) -> Scale:
    """What one frame spans."""
    values = np.asarray(field.of(frame.data), float)
    cracked, _ = directions(frame.data["normal"])
    return Scale(
        *frame.shape.extent(),
        field.ends(values),
        float(np.nanmin(values, initial=np.inf)),
        float(np.nanmax(values, initial=-np.inf)),
        float(np.nanmax(frame.data["opening"][cracked], initial=0.0)),
        np.unique(frame.data["material"]),
    )


def draw_frame(axes: Axes, frame: Frame, field: Field, scale: Scale) -> list[Artist]:
    """Draw a frame into axes; returns what was added."""
    values = np.asarray(field.of(frame.data), float)
    if field.source == "material":
        values = np.searchsorted(scale.materials, values) % len(PHASES)
    added = frame.shape.draw(axes, values, field.colours(), _norm(field, scale))
    if field.shows_cracks:
        return added
    return added + _draw_cracks(axes, frame, scale, plain=field.source != "material")


def draw_bar(axes: Axes, field: Field, scale: Scale) -> None:
    """Draw the colour bar: of the field, or of the cracks' opening where materials have colours."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    if field.source != "material":
        below, above = scale.least < scale.ends[0], scale.most > scale.ends[1]
        extend = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[below, above]
        colour_bar(axes, ScalarMappable(_norm(field, scale), field.colours()), field.label, extend)
    elif scale.widest > 0:
        norm = Normalize(0.0, scale.widest)
        colour_bar(axes, ScalarMappable(norm, opening_colours()), "opening [mm]")


def _norm(field: Field, scale: Scale) -> Normalize:
    from matplotlib.colors import Normalize

    if field.source == "material":
        return Normalize(-0.5, len(PHASES) - 0.5)
    low, high = scale.ends
    # A field that is the same everywhere still needs a bar with two ends.
    return Normalize(low, high if high > low else low + 1.0)


def _draw_cracks(axes: Axes, frame: Frame, scale: Scale, plain: bool) -> list[Artist]:
    """Cracks coloured by their opening, those nearly closed faint; `plain`: one colour, open only."""
    from matplotlib.collections import LineCollection

    cracked, segments = frame.shape.crack_segments(frame.data["normal"])
    opening = frame.data["opening"][cracked]
    open_ = opening > NEARLY_CLOSED * scale.widest
    shown = np.flatnonzero(open_)[np.argsort(opening[open_])]
    size = points_per_mm(axes) * frame.shape.sizes(cracked[shown])
    lines = LineCollection(
        segments[shown],
        linewidths=np.clip((0.2 if plain else 0.5) * size, *((0.7, 1.2) if plain else (1.2, 2.6))),
        capstyle="round",
        zorder=4,
    )
    added = [lines] if len(shown) else []
    if plain:
        lines.set_color(ACCENT)
    else:
        lines.set(array=opening[shown], cmap=opening_colours(), clim=(0.0, scale.widest))
        faint = segments[~open_]
        added.insert(0, LineCollection(faint, colors=FAINT, linewidths=0.5, zorder=3))
    for collection in added:
        axes.add_collection(collection, autolim=False)
    return added
