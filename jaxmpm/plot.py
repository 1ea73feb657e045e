"""Pictures of a run: its response curve and its cracks."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmpm import plot_style
from jaxmpm.plot_body import directions
from jaxmpm.plot_fields import find_field
from jaxmpm.plot_frame import draw_bar, draw_frame, load_frame, scale_of
from jaxmpm.plot_style import ACCENT, BAND, DPI, FAINT, INK, STYLE, frame_axes, stopped_early, styled_figure, title
from jaxmpm.results import ResultError, read_history, read_reference, read_summary, read_units
from jaxmpm.vtkhdf import read_frames

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jaxmpm.reference import Reference

__all__ = ["DPI", "STYLE", "picture_name", "plot_cracks", "plot_response", "plot_run", "read_summary"]


def plot_response(directory: str | os.PathLike, path: str | os.PathLike | None = None) -> Path:
    """Draw load against displacement, with the peak marked and what was measured behind it.

    Returns the picture's path.

    `directory`: of a run; `path`: of the picture (.png, .pdf, .svg), response.png in the directory
    if None. Raises ResultError where the results are missing or lack the response's gauges.
    """
    directory = Path(directory)
    summary, units = read_summary(directory), read_units(directory / "history.csv")
    load, displacement = response(directory, summary)
    names = summary["response"]
    factor, load_unit = load_scale(load, units[names["load"]] or summary.get("load_unit") or "")
    displacement_unit = units[names["displacement"]]

    with styled_figure() as figure:
        figure.set_size_inches(6.4, 4.4)
        axes = figure.add_axes((0.11, 0.12, 0.86, 0.78))
        if summary.get("reference"):
            _draw_reference(axes, read_reference(directory), factor)
        single = len(load) == 1
        axes.plot(displacement, load * factor, color=INK, lw=1.4, marker="." if single else None)
        axes.ticklabel_format(axis="x", scilimits=(-3, 5))  # a strain is a small number
        axes.set_xlabel(label(names["displacement"], displacement_unit))
        axes.set_ylabel(label(names["load"], load_unit))
        axes.grid(color="#dddddd", lw=0.6)
        axes.set_axisbelow(True)
        axes.margins(x=0.04, y=0.13)
        axes.spines[["top", "right"]].set_visible(False)
        peak = peak_row(load, summary.get("peak_load"))
        if peak is not None:
            x, y = displacement[peak], load[peak] * factor
            _mark_peak(axes, x, y, f"{y:.4g} {load_unit} at {x:.3g} {displacement_unit}")
        if stopped_early(summary):
            axes.plot(displacement[-1:], load[-1:] * factor, "x", color=ACCENT, ms=7, mew=1.6)
        title(axes, summary, [])
        return plot_style.save(figure, Path(path or directory / "response.png"))


def plot_cracks(
    directory: str | os.PathLike,
    path: str | os.PathLike | None = None,
    frame: int = -1,
    deformed: float | None = None,
    field: str = "material",
) -> Path:
    """Draw the body, or its moving points, and its cracks; returns the picture's path.

    `directory`: of a run; `path`: of the picture (.png, .pdf, .svg), None for cracks.png or its
    like in the directory; `frame`: which, negative from the end; `deformed`: factor on the
    displacements, None for the reference shape, or for moving points where they are; `field`: what
    colours the body (one of `plot_fields.FIELDS`), "material" for cracks coloured by their opening.
    Raises ResultError where the results are missing, not plane or without that field.
    """
    directory = Path(directory)
    summary = read_summary(directory)
    count, times = read_frames(directory / "result.vtkhdf")
    drawn = load_frame(directory, frame, summary, deformed)
    colouring = find_field(field, drawn.data, directory / "result.vtkhdf")
    scale = scale_of(drawn, colouring)
    notes = [] if deformed is None else [f"displacements × {deformed:g}"]
    if frame % count != count - 1:
        notes.append(f"t = {times[frame]:.4g} s")
    if summary.get("can_crack", True) and not len(directions(drawn.data["normal"])[0]):
        notes.append("no cracks")

    with styled_figure() as figure:
        axes = frame_axes(figure, scale.low, scale.high)
        draw_frame(axes, drawn, colouring, scale)
        draw_bar(axes, colouring, scale)
        title(axes, summary, notes)
        path = Path(path or directory / f"{picture_name(field, deformed)}.png")
        return plot_style.save(figure, path)


def plot_run(
    directory: str | os.PathLike,
    suffix: str = ".png",
    frame: int = -1,
    deformed: float | None = None,
    field: str = "material",
) -> list[Path]:
    """Draw the body as `plot_cracks` does and, of a run that has one, the response; returns the pictures' paths.

    `suffix`: .png, .pdf or .svg. Raises ResultError as those do.
    """
    directory = Path(directory)
    target = directory / f"{picture_name(field, deformed)}{suffix}"
    drawn = [plot_cracks(directory, target, frame, deformed, field)]
    if "response" in read_summary(directory):
        drawn.insert(0, plot_response(directory, directory / f"response{suffix}"))
    return drawn


def picture_name(field: str, deformed: float | None) -> str:
    """The name, without its end, of a picture of a body: one for each way to draw it."""
    if field == "material":
        return "cracks" if deformed is None else "deformed"
    return field if deformed is None else f"{field}_deformed"


def response(directory: Path, summary: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Load and displacement, each (rows,), of the gauges that the summary names as the response.

    Raises ResultError where the history lacks one of them or has no row.
    """
    history = read_history(directory / "history.csv")
    names = summary.get("response") or {}
    for role in ("load", "displacement"):
        if names.get(role) not in history:
            raise ResultError(
                f"{directory}: response.{role} = {names.get(role)!r} in summary.json is no column "
                f"of history.csv ({', '.join(history)})"
            )
    load, displacement = history[names["load"]], history[names["displacement"]]
    if not len(load):
        raise ResultError(f"{directory}: history.csv has no row; nothing to draw")
    return load, displacement


def peak_row(load: np.ndarray, known: float | None = None) -> int | None:
    """The row of the largest load in magnitude, or nearest to a `known` peak; None without one."""
    distance = -np.abs(load) if known is None else np.abs(load - known)
    return int(np.nanargmin(distance)) if np.isfinite(distance).any() else None


def load_scale(load: np.ndarray, unit: str) -> tuple[float, str]:
    """The factor and the unit in which loads are drawn: kN where they are large."""
    large = np.nanmax(np.abs(load), initial=0) > 1000
    return (1e-3, "kN") if unit == "N" and large else (1.0, unit)


def label(name: str, unit: str) -> str:
    """What is written at an axis for a gauge."""
    # A dollar sign in a name would start Matplotlib's mathematics.
    return f"{name.replace('_', ' ')} [{unit}]".replace(" []", "").replace("$", r"\$")


def _draw_reference(axes: Axes, reference: Reference | None, factor: float) -> None:
    """What was measured, grey and behind all else: a band, or one curve."""
    if reference is None:
        return
    label = reference.file.replace("$", r"\$") or "reference"
    edges = [np.array(line) * factor for line in reference.loads]
    if reference.is_band:
        axes.fill_between(reference.displacement, *edges, color=BAND, lw=0, zorder=1, label=label)
    else:
        axes.plot(reference.displacement, *edges, color=FAINT, lw=1.4, ls="--", zorder=1, label=label)
    axes.legend(loc="upper right", frameon=False)


def _mark_peak(axes: Axes, x: float, y: float, text: str) -> None:
    axes.plot([x], [y], "o", color=ACCENT, ms=5, zorder=3)
    low, high = axes.get_xlim()
    place = (x - low) / (high - low)
    # On the far side of the peak there is no curve for the words to hide.
    axes.annotate(
        text.replace("-", "\N{MINUS SIGN}"),
        (x, y),
        xytext=(0, 7 if y >= 0 else -7),
        textcoords="offset points",
        ha="left" if place < 0.25 else "right" if place > 0.75 else "center",
        va="bottom" if y >= 0 else "top",
        color=ACCENT,
        parse_math=False,
    )
