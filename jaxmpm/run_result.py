"""What comes back of a run: its numbers, its history, its frames and pictures."""

from html import escape
from os import PathLike
from pathlib import Path

import numpy as np

from jaxmpm.errors import ResultError
from jaxmpm.html import Pictures, table
from jaxmpm.results import read_history, read_object, read_summary, read_units
from jaxmpm.scene import Scene
from jaxmpm.vtkhdf import read_frame

QUASI_STATIC = 1e-3  # kinetic energy over stored at the peak, below which slower loading changes little
DRAWN = ("response", "cracks", "stages")  # pictures that a run makes
FORMATS = ("png", "pdf", "svg")
ROWS = 5  # of a long history that are shown at either end


class Result(dict):
    """A run: the mapping that its summary.json holds, and what lies beside it in `directory`.

    Numbers in N, mm, N·mm, MPa, s. `history` and `frame` read files, so that they see what is there now.
    """

    def __init__(self, directory: str | PathLike, summary: dict):
        super().__init__(summary)
        self.directory = Path(directory)

    @property
    def history(self) -> "History":
        """Every sample: arrays (samples,) by column, which can be a pandas.DataFrame too."""
        path = self.directory / "history.csv"
        return History(read_history(path), read_units(path))

    @property
    def scene(self) -> Scene:
        """The scene as it was run."""
        return Scene.from_dict(read_object(self.directory / "scene.json"))

    def frame(self, k: int = -1) -> dict[str, np.ndarray]:
        """Frame `k` of result.vtkhdf, negative from the end: time (s), points (N, 3), displacement (N, 3) …"""
        return read_frame(self.directory / "result.vtkhdf", k)

    def plot(
        self, field: str = "material", deformed: float | None = None, frame: int = -1, format: str = "png"
    ) -> Pictures:
        """Draw the response and the body again, into the directory.

        Args:
            field: what colours the body: material (and cracks by their opening), stress, speed,
                displacement, opening or damage.
            deformed: factor on the displacements; the shape at rest if None.
            frame: which, negative from the end.
            format: png, pdf or svg.

        Returns:
            The pictures' paths, shown inline in a notebook.

        Raises:
            ResultError: where the results are missing or have no such field or frame.
        """
        from jaxmpm.plot import plot_run

        return Pictures(tuple(plot_run(self.directory, suffix_of(format), frame, deformed, field)))

    def pictures(self) -> Pictures:
        """Those that the run has drawn."""
        return Pictures(tuple(drawn(self.directory)))

    def __repr__(self):
        return "\n".join(report(self, self.directory))

    def _repr_html_(self):
        title = f"<p><b>{escape(str(self.get('title') or self['scene']))}</b><br>{escape(str(self['status']))}</p>"
        return title + table(numbers(self)) + self.pictures()._repr_html_()


class History(dict):
    """Columns of a history by name, arrays (samples,); `units` by name, "" without one."""

    def __init__(self, columns: dict[str, np.ndarray], units: dict[str, str]):
        super().__init__(columns)
        self.units = units

    def _heads(self) -> list[str]:
        return [f"{name} [{unit}]" if unit else name for name, unit in self.units.items()]

    def _samples(self) -> int:
        return len(next(iter(self.values())))

    def __repr__(self):
        return f"history of {self._samples()} samples: {', '.join(self._heads())}"

    def _repr_html_(self):
        count = self._samples()
        ends = [*range(min(ROWS, count)), *range(max(ROWS, count - ROWS), count)]
        rows = [[k, *(f"{column[k]:.6g}" for column in self.values())] for k in ends]
        if count > 2 * ROWS:
            rows.insert(ROWS, ["…"] * (len(self) + 1))
        return table(rows, ["", *self._heads()])


def suffix_of(format: str) -> str:
    """The end of a picture's name; raises ResultError for a format that pictures are not written in."""
    if format not in FORMATS:
        raise ResultError(f"format = {format}: expected {', '.join(FORMATS[:-1])} or {FORMATS[-1]}")
    return f".{format}"


def load_result(directory: str | PathLike) -> Result:
    """What a run left in its directory.

    Raises ResultError where there is none.
    """
    return Result(directory, read_summary(directory))


def numbers(summary: dict) -> list[tuple]:
    """The essentials of a summary as rows: what, and the number with its unit."""
    rows = []
    if "peak_load" in summary:
        names = summary["response"]
        for what, load, travel in (("peak", "peak_load", "displacement_at_peak"), ("end", "final_load", "final_displacement")):
            at = f"{load_written(summary, summary[load])} at {names['displacement']} = {travel_written(summary, summary[travel])}"
            rows.append((f"{what} of {names['load']}", at))
    if summary.get("can_crack"):
        rows.append(("cracked cells", f"{summary['cracked']} of {summary['cells']}"))
    for name in ("external_work", "stored_energy", "dissipated_energy"):
        if summary.get(name) is not None:
            rows.append((name.replace("_", " "), f"{summary[name]:.5g} N mm"))
    if summary.get("energy_error") is not None:
        rows.append(("energy error", f"{summary['energy_error']:.1e}"))
    if summary.get("run_seconds") is not None:
        rows.append(("steps", f"{summary['steps']} in {summary['run_seconds']:.1f} s"))
    return rows


def load_written(summary: dict, value: float) -> str:
    """A load of the summary with its unit: kN or MPa."""
    return f"{value / 1e3:.3f} kN" if summary["load_unit"] == "N" else f"{value:.3f} MPa"


def travel_written(summary: dict, value: float) -> str:
    """A displacement or a mean strain of the summary."""
    return f"{value:.4f} mm" if summary["displacement_unit"] else f"{value:.2e}"


def report(summary: dict, directory) -> list[str]:
    """The end of a run in a few lines."""
    lines = [] if summary["status"] == "completed" else [str(summary["status"])]
    if "peak_load" in summary:
        peak, end = (
            (load_written(summary, summary[f]), travel_written(summary, summary[u]))
            for f, u in (("peak_load", "displacement_at_peak"), ("final_load", "final_displacement"))
        )
        lines.append(f"peak {peak[0]} at {peak[1]}, {end[0]} at the end ({end[1]})")
    if (share := summary.get("kinetic_share_at_peak")) is not None:
        slow = "slow enough for a static test" if share < QUASI_STATIC else "fast for a static test: stretch the histories"
        lines.append(f"kinetic energy at the peak {share:.1e} of the stored: {slow}")
    if summary.get("reference_inside") is not None:
        lines.append(f"{summary['reference_inside']:.0%} of the curve inside {summary['reference']}")
    return lines + _cost(summary) + [f"written to {directory}: {' '.join(_files(directory))}"]


def _cost(summary: dict) -> list[str]:
    """What it cost, of a run that began."""
    if summary.get("energy_error") is None:
        return []
    cracked = f"{summary['cracked']} of {summary['cells']} cells cracked, " if summary["can_crack"] else ""
    speed = summary["cell_steps_per_second"]
    return [
        f"{cracked}energy error {summary['energy_error']:.1e}",
        f"{summary['run_seconds']:.1f} s for {summary['steps']} steps ({summary['ms_per_step']:.2f} ms a step"
        + (f", {speed / 1e6:.1f} M cell-steps/s" if speed else "")
        + f"), {summary['compile_seconds']:.1f} s compilation, {summary['wall_seconds']:.1f} s in all, "
        f"{summary['precision']}, {summary['device']}",
    ]


def _files(directory: Path) -> list[str]:
    """Names of the results that are there."""
    names = ["summary.json", "history.csv", "result.vtkhdf"]
    return [name for name in names if (Path(directory) / name).exists()] + [path.name for path in drawn(Path(directory))]


def drawn(directory: Path) -> list[Path]:
    """Pictures that a run has made there."""
    found = (directory / f"{name}.{end}" for name in DRAWN for end in FORMATS)
    return [path for path in found if path.exists()]
