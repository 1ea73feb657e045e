"""Softening curves as CSV: reading what was measured, and the curves that come with the program."""

import csv
import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmpm.errors import SceneError, did_you_mean

DATA = Path(__file__).parent / "data"
UNITS = {"w": "mm", "sigma": "MPa", "weight": ""}


class Curve(NamedTuple):
    """Traction against opening."""

    w: np.ndarray  # (m,), mm
    sigma: np.ndarray  # (m,), MPa
    weight: np.ndarray  # (m,), of the squares of residuals
    name: str


def read_curve(source: str | Path) -> Curve:
    """A curve from a CSV file, or a bundled one by its name.

    The first line that is not a comment (#) names the columns, with units: `w [mm],sigma [MPa]`
    and if there is one `weight`; others are passed over.

    Raises:
        SceneError: names the file, line and column, and says what was expected.
    """
    path = _path(source)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{source}: expected a CSV file that can be read ({error})") from error
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    lines = [(number, line) for number, line in lines if not line.lstrip().startswith("#")]
    if not lines:
        raise SceneError(f"{source}: empty, expected columns w [mm] and sigma [MPa]")
    columns = _columns(source, lines[0][1])
    rows = [_row(source, number, line, columns) for number, line in lines[1:]]
    table = {name: np.array([row[name] for row in rows]) for name in columns}
    weight = table.get("weight", np.ones(len(rows)))
    _check(source, table, weight)
    return Curve(table["w"], table["sigma"], weight, path.stem)


def _path(source):
    path = Path(source)
    names = sorted(file.stem for file in DATA.glob("*.csv"))
    if path.exists() or path.suffix:
        if not path.is_file():
            raise SceneError(
                f"{source}: no such file, expected a CSV file or one of {', '.join(names)}"
            )
        return path
    if str(source) not in names:
        near = did_you_mean(source, names)
        hint = f" (did you mean {near}?)" if near else ""
        raise SceneError(
            f"{source}: no such file, expected a CSV file or one of {', '.join(names)}{hint}"
        )
    return DATA / f"{source}.csv"


def _columns(source, header) -> dict[str, int]:
    found = {}
    for place, cell in enumerate(next(csv.reader([header]))):
        match = re.fullmatch(r"\s*(\w+)\s*(?:[\[(](.*)[\])])?\s*", cell)
        name, unit = (match[1].lower(), (match[2] or "").strip()) if match else (cell, "")
        if name not in UNITS:
            continue
        if name != "weight" and unit != UNITS[name]:
            raise SceneError(f"{source}: column {cell.strip()!r}: expected {name} [{UNITS[name]}]")
        found[name] = place
    missing = [f"{name} [{UNITS[name]}]" for name in ("w", "sigma") if name not in found]
    if missing:
        raise SceneError(
            f"{source}: header {header.strip()[:60]!r}: expected a column {' and a column '.join(missing)}"
        )
    return found


def _row(source, number, line, columns) -> dict[str, float]:
    cells, row = next(csv.reader([line])), {}
    for name, place in columns.items():
        text = cells[place].strip() if place < len(cells) else ""
        try:
            row[name] = float(text)
        except ValueError:
            row[name] = math.nan
        least = -math.inf if name == "sigma" else 0.0
        if not (math.isfinite(row[name]) and row[name] >= least):
            expected = "a finite number" + ("" if name == "sigma" else ", 0 or more")
            raise SceneError(f"{source}, line {number}: {name} = {text!r}: expected {expected}")
    return row


def _check(source, table, weight):
    if len(weight) < 2:
        raise SceneError(f"{source}: {len(weight)} rows: expected at least 2")
    if not (weight > 0).any():
        raise SceneError(f"{source}: weight: expected some above 0")
    if not (table["sigma"] > 0).any():
        raise SceneError(f"{source}: sigma: expected some above 0, tension is positive")
