"""What all pictures share: colours, the figure's frame, its title, its colour bar."""

from __future__ import annotations

import contextlib
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

DPI = 180
TIE = "\N{NO-BREAK SPACE}"
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#444444",
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "pdf.fonttype": 42,  # text stays text, in the font's own outlines
    "svg.fonttype": "none",
}
INK, ACCENT, FAINT, EDGE = "#1f3b5c", "#c2410c", "#8d96a0", "#3c434b"
BAND = "#d9dde2"
# Pale, as cracks lie on them; blues and yellows of different lightness, which any kind of colour vision tells apart.
PHASES = ("#eceef1", "#ccd6e3", "#efe2bf", "#b3bfcf", "#d6c493", "#9bb7d2")
# Inches: the longest sides of the picture's frame, and the shortest that still holds a scale.
WIDEST, TALLEST, SHORTEST = 6.2, 6.4, 1.3


def styled() -> contextlib.AbstractContextManager:
    """A block in which all that is made looks as pictures here do."""
    from matplotlib import rc_context

    return rc_context(STYLE)


@contextlib.contextmanager
def styled_figure() -> Iterator[Figure]:
    """An empty figure, and the style while it is drawn; pyplot stays out of it."""
    from matplotlib.figure import Figure

    with styled():
        yield Figure()


def save(figure: Figure, path: Path) -> Path:
    """Save a figure, cropped to what is in it."""
    figure.savefig(path, dpi=DPI, bbox_inches="tight", pad_inches=0.08)
    return path


def frame_axes(figure: Figure, low: np.ndarray, high: np.ndarray) -> Axes:
    """Axes of equal scale that show the plane from `low` to `high`, (2,) in mm, and a margin."""
    span = high - low
    margin = 0.04 * span.max()
    span = span + 2 * margin
    scale = min(WIDEST / span[0], TALLEST / span[1])
    inches = np.maximum(scale * span, SHORTEST)
    half, middle = 0.5 * inches / scale, 0.5 * (low + high)
    figure.set_size_inches(inches + (1.8, 1.4))
    left, bottom = np.array([0.7, 0.6]) / figure.get_size_inches()
    axes = figure.add_axes((left, bottom, *(inches / figure.get_size_inches())))
    (left, right), (bottom, top) = zip(middle - half, middle + half, strict=True)
    axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x [mm]", ylabel="y [mm]")
    axes.locator_params(nbins="auto", steps=[1, 2, 5, 10])
    return axes


def points_per_mm(axes: Axes) -> float:
    """How many typographic points a millimetre of the body takes in the picture."""
    return _width(axes) / np.ptp(axes.get_xlim())


def title(axes: Axes, summary: dict[str, Any], notes: list[str]) -> list[Artist]:
    """Write the run's title, the notes and why it stopped above the axes; returns what was added."""
    inches = axes.get_window_extent().width / axes.figure.dpi
    text = str(summary.get("title") or summary.get("scene") or "")
    height, added = 6.0, []
    # Stacked upwards from the frame, so that a long status takes the room it needs.
    for line, size, style in (
        (stopped_early(summary), 9, {"color": ACCENT}),
        (", ".join(notes), 9, {"color": "#555555"}),
        (text, 10.5, {"fontweight": "bold"}),
    ):
        line = re.sub(r"(?<=\d) (?=[a-zA-Z%])", TIE, line)  # a number stays with its unit
        lines = textwrap.wrap(line, max(30, int(114 * inches / size)))[:4]
        if lines:
            added.append(
                axes.annotate(
                    "\n".join(lines).replace(TIE, " "),
                    (0, 1),
                    xytext=(0, height),
                    xycoords="axes fraction",
                    textcoords="offset points",
                    va="bottom",
                    fontsize=size,
                    parse_math=False,
                    **style,
                )
            )
            height += 1.25 * size * len(lines) + 3
    return added


def stopped_early(summary: dict[str, Any]) -> str:
    """What to say of a run that was not completed, "" of one that was."""
    status = str(summary.get("status", "completed"))
    return "" if status == "completed" else f"stopped early: {status.removeprefix('stopped: ')}"


def shades(name: str, low: float, high: float, start: str | None = None) -> Colormap:
    """Part `low` to `high` of a map of Matplotlib's, after the colour `start` if there is one."""
    from matplotlib import colormaps
    from matplotlib.colors import LinearSegmentedColormap

    colours = colormaps[name](np.linspace(low, high, 32)).tolist()
    return LinearSegmentedColormap.from_list(name, [start, *colours] if start else colours)


def colour_bar(axes: Axes, colours: ScalarMappable, label: str, extend: str = "neither") -> None:
    """Put a colour bar right of the axes, as high as they are."""
    width = 0.14 * 72 / _width(axes)
    bar = axes.figure.colorbar(
        colours, cax=axes.inset_axes((1 + width, 0, width, 1)), extend=extend, extendfrac=0.02
    )
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)


def _width(axes: Axes) -> float:
    """Of the axes, in typographic points."""
    return 72 * axes.figure.get_figwidth() * axes.get_position().width
