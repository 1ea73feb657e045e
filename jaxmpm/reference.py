"""What was measured, to be drawn behind a response: one curve, or the band that tests lie in."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, model_validator

from jaxmpm.errors import SceneError, written
from jaxmpm.shapes import Number, Table

LOADS = (["load_N"], ["low_N", "high_N"])  # columns of a curve and of a band


class Reference(Table):
    """A curve, or the lower and the upper edge of a band; straight between its points."""

    file: str = Field("", description="where it was read from")
    displacement: tuple[Number, ...] = Field(description="increasing displacements, mm")
    loads: tuple[tuple[Number, ...], ...] = Field(
        min_length=1, max_length=2, description="loads of the curve, or of its low and high edge, N"
    )

    @model_validator(mode="after")
    def _fits(self):
        for row in _rows(self.displacement, self.loads):
            raise ValueError(row)
        return self

    @property
    def is_band(self) -> bool:
        """Whether it has a low and a high edge."""
        return len(self.loads) == 2

    def at(self, displacement) -> np.ndarray:
        """Its loads (1 or 2, ...), N, at displacements in mm; NaN where it does not reach."""
        lines = [np.interp(displacement, self.displacement, line, np.nan, np.nan) for line in self.loads]
        return np.stack(lines)

    def share_inside(self, displacement, load) -> float | None:
        """Share of the samples within the reach of the band that lie in it, None where there is none."""
        low, high = self.at(displacement)
        within = np.isfinite(low)
        if not within.any():
            return None
        return float(((load >= low) & (load <= high))[within].mean())


def _rows(displacement, loads):
    """What is expected of the numbers and is not so."""
    if len(displacement) < 2 or any(len(line) != len(displacement) for line in loads):
        yield f"two rows or more, with a load for each of the {len(displacement)} displacements"
        return
    for before, now in zip(displacement, displacement[1:], strict=False):
        if now <= before:
            yield f"displacements that increase; {now:g} mm comes after {before:g} mm"
            return
    for at, *edges in zip(displacement, *loads, strict=True):
        if edges[0] > edges[-1]:
            yield f"a low load no larger than the high one; at {at:g} mm they are {edges[0]:g} and {edges[1]:g} N"
            return


def find_reference(tree: dict[str, Any], folder: Path) -> None:
    """Put the numbers of the response's reference file in; it is looked for beside the scene.

    With its numbers in the scene a run needs the file no more, and is not resumed against other
    numbers unnoticed. An empty name takes a reference out.
    """
    response = tree.get("response")
    source = response.get("reference") if isinstance(response, dict) else None
    if not isinstance(source, str):
        return
    if not source:
        del response["reference"]
        return
    try:
        response["reference"] = _read(folder / source, response.get("displacement"))
    except _Unfit as error:
        raise SceneError(f"response.reference = {written(source)}: expected {error}") from None


def read_reference_file(path: Path, displacement: str) -> dict[str, Any]:
    """The numbers of a file of measurements over the gauge `displacement`, as a Reference has them; raises SceneError."""
    try:
        return _read(path, displacement)
    except _Unfit as error:
        raise SceneError(f"reference = {written(str(path))}: expected {error}") from None


class _Unfit(Exception):
    """What is expected of a file and is not so."""


def _read(path: Path, name: Any) -> dict[str, Any]:
    try:
        lines = path.read_bytes().decode("utf-8").splitlines()
    except OSError as error:
        raise _Unfit(f"a file beside the scene to read ({error.strerror}: {path})") from None
    except UnicodeDecodeError:
        raise _Unfit("a CSV table in UTF-8") from None
    rows = [
        (number, [cell.strip() for cell in line.split(",")])
        for number, line in enumerate(lines, 1)
        if line.strip() and not line.startswith("#")
    ]
    header = rows[0][1] if rows else []
    if header[:1] != [f"{name}_mm"] or header[1:] not in LOADS:
        heads = " or ".join(",".join([f"{name}_mm", *loads]) for loads in LOADS)
        found = f"it is {written(','.join(header))}" if header else "it is empty"
        raise _Unfit(f"a CSV table that begins with the line {heads}, as response.displacement asks ({found})")
    columns = list(zip(*(_numbers(number, cells, len(header)) for number, cells in rows[1:]), strict=True))
    columns = columns or [()] * len(header)
    for problem in _rows(columns[0], columns[1:]):
        raise _Unfit(problem)
    return {"file": path.name, "displacement": columns[0], "loads": tuple(columns[1:])}


def _numbers(number: int, cells: list[str], count: int) -> list[float]:
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise _Unfit(f"{count} finite numbers a row (line {number} is {written(','.join(cells))})")
    return values
