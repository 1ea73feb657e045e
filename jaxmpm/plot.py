"""Pictures of a run: its response curve and its cracks."""

from __future__ import annotations

import contextlib
import os
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmpm.results import ResultError, read_history, read_summary, read_units
from jaxmpm.vtkhdf import read_frame, read_frames

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 180
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.linewidth": 0.7,
    "axes.edgecolor": "#444444",
    "xtick.color": "#444444",
    "ytick.color": "#444444",
}
INK, ACCENT, FAINT = "#1f3b5c", "#c2410c", "#8d96a0"
PHASES = ("#eceef1", "#d5dae0", "#e9e2d2", "#d8e5dc", "#e4dbe6", "#cfdfe8")
NEARLY_CLOSED = 0.01
# Inches: the longest sides of the picture's frame, and the shortest that still holds a scale.
WIDEST, TALLEST, SHORTEST = 6.2, 6.4, 1.3


@dataclass(frozen=True)
class Body:
    """The filled cells of a plane grid, cropped to them, with what moves them.

    `size` and `origin` (lower left corner) in mm; `index` (N, 2) of each cell; `filled` (nx, ny);
    `nodes` (nx + 1, ny + 1, 2), the drawn position of each node in mm.
    """

    size: float
    origin: np.ndarray
    index: np.ndarray
    filled: np.ndarray
    nodes: np.ndarray

    def place(self, cells: np.ndarray, local: np.ndarray) -> np.ndarray:
        """Drawn positions, in mm, of the `local` (M, 2) points, -1 to 1, in `cells` (M,)."""
        i, j = self.index[cells].T
        (s, t), nodes = (0.5 * (1 + local.T))[..., None], self.nodes
        low = (1 - s) * nodes[i, j] + s * nodes[i + 1, j]
        high = (1 - s) * nodes[i, j + 1] + s * nodes[i + 1, j + 1]
        return (1 - t) * low + t * high


def plot_response(directory: str | os.PathLike, path: str | os.PathLike | None = None) -> Path:
    """Draw load against displacement, with the peak marked, and return the picture's path.

    `directory`: of a run; `path`: of the picture (.png, .pdf, .svg), response.png in the directory
    if None. Raises ResultError where the results are missing or lack the response's gauges.
    """
    directory = Path(directory)
    summary, units = read_summary(directory), read_units(directory / "history.csv")
    load, displacement = response(directory, summary)
    names = summary["response"]
    factor, load_unit = _load_scale(load, units[names["load"]] or summary.get("load_unit") or "")
    displacement_unit = units[names["displacement"]]

    with _styled_figure() as figure:
        figure.set_size_inches(6.4, 4.4)
        axes = figure.add_axes((0.11, 0.12, 0.86, 0.78))
        single = len(load) == 1
        axes.plot(displacement, load * factor, color=INK, lw=1.4, marker="." if single else None)
        axes.set_xlabel(_label(names["displacement"], displacement_unit))
        axes.set_ylabel(_label(names["load"], load_unit))
        axes.grid(color="#dddddd", lw=0.6)
        axes.set_axisbelow(True)
        axes.margins(x=0.04, y=0.13)
        axes.spines[["top", "right"]].set_visible(False)
        peak = peak_row(load, summary.get("peak_load"))
        if peak is not None:
            x, y = displacement[peak], load[peak] * factor
            _mark_peak(axes, x, y, f"{y:.4g} {load_unit} at {x:.3g} {displacement_unit}")
        if early := stopped_early(summary):
            axes.plot(displacement[-1:], load[-1:] * factor, "x", color=ACCENT, ms=7, mew=1.6)
        _title(axes, summary, [], early)
        return _save(figure, Path(path or directory / "response.png"))


def plot_cracks(
    directory: str | os.PathLike,
    path: str | os.PathLike | None = None,
    frame: int = -1,
    deformed: float | None = None,
) -> Path:
    """Draw the body and its cracks, coloured by their opening, and return the picture's path.

    `directory`: of a run; `path`: of the picture (.png, .pdf, .svg), cracks.png in the directory
    if None; `frame`: which, negative from the end; `deformed`: factor on the displacements, None
    for the reference shape. Raises ResultError where the results are missing or not plane.
    """
    directory = Path(directory)
    summary = read_summary(directory)
    count, times = read_frames(directory / "result.vtkhdf")
    data = read_frame(directory / "result.vtkhdf", frame)
    displacement = data["displacement"][:, :2] * deformed if deformed else None
    body = find_body(data["points"], float(summary["cell_size"]), displacement)
    cracked, segments = crack_segments(body, data["normal"])
    notes = [f"displacements × {deformed:g}"] if deformed else []
    if frame % count != count - 1:
        notes.append(f"t = {times[frame]:.4g} s")
    if not len(cracked):
        notes.append("no cracks")

    with _styled_figure() as figure:
        axes = _frame_axes(figure, body)
        _draw_body(axes, body, data["material"])
        _draw_cracks(axes, body, segments, data["opening"][cracked])
        _title(axes, summary, notes, stopped_early(summary))
        return _save(figure, Path(path or directory / "cracks.png"))


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


def stopped_early(summary: dict[str, Any]) -> str:
    """What to say of a run that was not completed, "" of one that was."""
    status = str(summary.get("status", "completed"))
    return "" if status == "completed" else f"stopped early: {status}"


def find_body(centres: np.ndarray, size: float, displacement: np.ndarray | None = None) -> Body:
    """The body whose filled cells have these centres.

    `centres` (N, 2 or 3) in mm; `size` of a cell in mm; `displacement` (N, 2) in mm as drawn; a
    node moves by the mean of its filled cells. Raises ResultError for cells off a plane grid.
    """
    centres = np.asarray(centres, float)
    if not len(centres) or np.ptp(centres[:, 2:], axis=0).any():
        raise ResultError("the picture of cracks needs the cells of a plane body")
    low = centres[:, :2].min(axis=0)
    place = (centres[:, :2] - low) / size
    index = np.rint(place).astype(int)
    if np.abs(place - index).max() > 0.1:
        raise ResultError(f"the points are not the cell centres of a grid of {size:g} mm")
    filled = np.zeros(index.max(axis=0) + 1, bool)
    filled[tuple(index.T)] = True
    origin = low - 0.5 * size
    nodes = origin + size * np.stack(np.indices(np.add(filled.shape, 1)), axis=-1)
    if displacement is not None:
        nodes = nodes + _nodal_mean(index, filled.shape, np.asarray(displacement, float))
    return Body(size, origin, index, filled, nodes)


def outline(body: Body) -> np.ndarray:
    """The cell edges between filled and empty, as drawn: (E, 2, 2), in mm."""
    padded = np.pad(body.filled, 1)
    i, j = np.nonzero(padded[:-1, 1:-1] != padded[1:, 1:-1])
    upright = np.stack([body.nodes[i, j], body.nodes[i, j + 1]], axis=1)
    i, j = np.nonzero(padded[1:-1, :-1] != padded[1:-1, 1:])
    return np.concatenate([upright, np.stack([body.nodes[i, j], body.nodes[i + 1, j]], axis=1)])


def crack_segments(body: Body, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cracked cells (M,), and in each the segment across its square as drawn, (M, 2, 2) in mm.

    `normal` (N, 2 or 3): of the band in each cell, zero where there is none.
    """
    along = np.asarray(normal, float)[:, 1::-1] * (-1.0, 1.0)
    cracked = np.flatnonzero(np.hypot(*along.T) > 1e-6)
    end = along[cracked] / np.abs(along[cracked]).max(axis=1, keepdims=True)
    return cracked, np.stack([body.place(cracked, -end), body.place(cracked, end)], axis=1)


def _nodal_mean(index: np.ndarray, shape: tuple[int, ...], values: np.ndarray) -> np.ndarray:
    total, count = np.zeros((*np.add(shape, 1), 2)), np.zeros((*np.add(shape, 1), 1))
    for corner in ((0, 0), (1, 0), (0, 1), (1, 1)):
        node = tuple((index + corner).T)
        np.add.at(total, node, values)
        np.add.at(count, node, 1)
    return total / np.maximum(count, 1)


def _load_scale(load: np.ndarray, unit: str) -> tuple[float, str]:
    large = np.nanmax(np.abs(load), initial=0) > 1000
    return (1e-3, "kN") if unit == "N" and large else (1.0, unit)


def _label(name: str, unit: str) -> str:
    # A dollar sign in a name would start Matplotlib's mathematics.
    return f"{name.replace('_', ' ')} [{unit}]".replace(" []", "").replace("$", r"\$")


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


def _title(axes: Axes, summary: dict[str, Any], notes: list[str], early: str) -> None:
    inches = axes.get_window_extent().width / axes.figure.dpi
    text = str(summary.get("title") or summary.get("scene") or "")
    height = 6.0
    # Stacked upwards from the frame, so that a long status takes the room it needs.
    for line, size, style in (
        (early, 9, {"color": ACCENT}),
        (", ".join(notes), 9, {"color": "#555555"}),
        (text, 10.5, {"fontweight": "bold"}),
    ):
        lines = textwrap.wrap(line, max(30, int(114 * inches / size)))[:4]
        if lines:
            axes.annotate(
                "\n".join(lines),
                (0, 1),
                xytext=(0, height),
                xycoords="axes fraction",
                textcoords="offset points",
                va="bottom",
                fontsize=size,
                parse_math=False,
                **style,
            )
            height += 1.25 * size * len(lines) + 3


def _frame_axes(figure: Figure, body: Body) -> Axes:
    corners = body.nodes.reshape(-1, 2)
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.04 * (high - low).max()
    span = high - low + 2 * margin
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


def _draw_body(axes: Axes, body: Body, material: np.ndarray) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Trace

    phase = np.ma.masked_all(body.filled.shape)
    phase[tuple(body.index.T)] = np.unique(material, return_inverse=True)[1] % len(PHASES)
    axes.pcolormesh(
        *np.moveaxis(body.nodes, -1, 0),
        phase,
        cmap=ListedColormap(PHASES),
        vmin=-0.5,
        vmax=len(PHASES) - 0.5,
        rasterized=True,
        zorder=1,
    )
    # One path, stroked at once, with ends that do not overlap: else every node shows as a dot.
    corners = outline(body).reshape(-1, 2)
    trace = Trace(corners, np.tile([Trace.MOVETO, Trace.LINETO], len(corners) // 2))
    axes.add_artist(PathPatch(trace, fill=False, ec="#3c434b", lw=0.9, capstyle="butt"))


def _draw_cracks(axes: Axes, body: Body, segments: np.ndarray, opening: np.ndarray) -> None:
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection
    from matplotlib.colors import ListedColormap

    widest = opening.max(initial=0.0)
    open_ = opening > NEARLY_CLOSED * widest
    faint = LineCollection(segments[~open_], colors=FAINT, linewidths=0.5, zorder=3)
    axes.add_collection(faint, autolim=False)
    if not open_.any():
        return
    points = 72 * axes.figure.get_figwidth() * axes.get_position().width
    cell = points * body.size / np.ptp(axes.get_xlim())
    # The map's palest fifth would be lost on the body, its black end in the outline.
    shades = ListedColormap(colormaps["magma_r"](np.linspace(0.22, 0.94, 256)))
    order = np.argsort(opening[open_])
    lines = LineCollection(
        segments[open_][order],
        cmap=shades,
        linewidths=np.clip(0.5 * cell, 1.2, 2.6),
        capstyle="round",
        zorder=4,
    )
    lines.set_array(opening[open_][order])
    lines.set_clim(0.0, widest)
    axes.add_collection(lines, autolim=False)
    width = 0.14 * 72 / points
    bar = axes.figure.colorbar(lines, cax=axes.inset_axes((1 + width, 0, width, 1)))
    bar.set_label("opening [mm]")
    bar.outline.set_linewidth(0.5)


@contextlib.contextmanager
def _styled_figure() -> Iterator[Figure]:
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        yield Figure()


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, dpi=DPI, bbox_inches="tight", pad_inches=0.08)
    return path
