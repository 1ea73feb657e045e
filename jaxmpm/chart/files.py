"""What a chart writes and reads: chart.json, which it also goes on from, and chart.csv."""

import os
from pathlib import Path

from jaxmpm import __version__
from jaxmpm.restart import difference
from jaxmpm.results import ResultError, read_object, write_object, write_table

NAME = "chart.json"
GIVEN_UP = "given up"  # how the status of a run begins that another budget may bring to its end
COLUMNS = {
    "label": "setting", "status": "status", "front": "front", "seconds": "seconds [s]", "low": "low [s]", "high": "high [s]",
    "compile_seconds": "compilation [s]", "steps": "steps", "cells": "cells", "cracked": "cracked", "error": "error",
}  # fmt: skip
ERRORS = {"peak": "error of peak", "work": "error of work", "end": "error of end", "balance": "energy lost", "curve": "error of curve", "path": "path apart [mm]"}


def read_chart(directory: str | os.PathLike) -> dict:
    """What chart.json of a directory says; raises ResultError where it is missing or no chart."""
    path = Path(directory) / NAME
    chart = read_object(path)
    if not isinstance(chart.get("runs"), list):
        raise ResultError(f"{path}: no chart; run jaxmpm chart again")
    return chart


def write_chart(directory: Path, chart: dict) -> None:
    """Write chart.json and chart.csv."""
    write_object(directory / NAME, chart)
    rows = table(chart)
    header = [column for column in (*COLUMNS.values(), *ERRORS.values()) if any(column in row for row in rows)]
    write_table(directory / "chart.csv", header, [[row.get(column, "") for column in header] for row in rows])


def table(chart: dict) -> list[dict]:
    """The rows of chart.csv: settings by their time, those that failed at the end."""
    rows = []
    for record in sorted(chart["runs"], key=lambda record: record.get("seconds") or float("inf")):
        row = {column: record[name] for name, column in COLUMNS.items() if record.get(name) is not None}
        errors = record.get("errors") or {}
        rows.append(row | {column: errors[name] for name, column in ERRORS.items() if errors.get(name) is not None})
    return rows


def kept(directory: Path, scene: dict) -> list[dict]:
    """The runs of a chart to go on with, but those that took too long, none where there is no chart; raises ResultError where it is of another scene."""
    if not (directory / NAME).exists():
        return []
    chart = read_chart(directory)
    if chart["scene"] != scene:
        raise ResultError(
            f"{directory / NAME}: the scene differs from that of the chart so far ({difference(chart['scene'], scene)}); go on "
            "with the same scene and --set, or without --resume to start anew"
        )
    return [record for record in chart["runs"] if not record["status"].startswith(GIVEN_UP)]


def provenance() -> dict:
    """On what a chart was made."""
    import datetime
    import platform

    import jax

    # Those that the process may use, where the system says.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "jaxmpm": __version__, "jax": jax.__version__, "python": platform.python_version(),
        "device": jax.devices()[0].device_kind, "cores": cores, "date": datetime.date.today().isoformat(),
    }  # fmt: skip
