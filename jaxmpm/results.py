"""What a run leaves behind: its history, its summary and its restart file."""

from __future__ import annotations

import contextlib
import csv
import json
import math
import os
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from jaxmpm.errors import ResultError, did_you_mean
from jaxmpm.reference import Reference

RESTART_FORMAT = "jaxmpm restart"
RESTART_VERSION = 1
SUMMARY = "summary.json"


class History:
    """A table that grows by one row per recorded step, as CSV with units in its header."""

    def __init__(self, path: Path, width: int, mode: str):
        self.path, self.width = path, width
        self._file = open(path, mode, encoding="utf-8", newline="")

    @classmethod
    def create(cls, path: str | os.PathLike, columns: Sequence[tuple[str, str]]) -> History:
        """Start an empty history, replacing the file that may be there.

        `columns`: (name, unit) of each column, unit "" for a number without one.
        Raises ValueError for a name or unit that the header cannot hold.
        """
        header = _header(columns)
        history = cls(Path(path), len(columns), "w")
        history._write(header)
        return history

    @classmethod
    def reopen(
        cls, path: str | os.PathLike, columns: Sequence[tuple[str, str]], rows: int
    ) -> History:
        """Continue a history after its first `rows` rows; later ones are cut off.

        Raises ResultError where the file is missing, has another header or fewer rows.
        """
        path = Path(path)
        lines = _complete_lines(path)
        expected = _header(columns)
        if lines[0].decode("utf-8", "replace").rstrip("\r\n") != expected:
            raise ResultError(
                f"{path}: the header is not '{expected}'; the scene has changed since the run "
                "was stopped: start it afresh, without --resume"
            )
        if not 0 <= rows <= len(lines) - 1:
            raise ResultError(
                f"{path}: has {len(lines) - 1} rows, the restart file expects {rows}; "
                "start the run afresh, without --resume"
            )
        with open(path, "r+b") as file:
            file.truncate(sum(len(line) for line in lines[: rows + 1]))
        return cls(path, len(columns), "a")

    def append(self, values: Sequence[float]) -> None:
        """Add one row, on disk when this returns, in digits that read back the same number.

        `values`: one number per column. Raises ValueError for another count.
        """
        if len(values) != self.width:
            raise ValueError(f"{self.path}: {len(values)} values for {self.width} columns")
        self._write(",".join(_digits(value) for value in values))

    def close(self) -> None:
        """Close the file; closing twice does nothing."""
        self._file.close()

    def __enter__(self) -> History:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def _write(self, line: str) -> None:
        self._file.write(line + "\n")
        self._file.flush()


def read_history(path: str | os.PathLike) -> dict[str, np.ndarray]:
    """Read a history: for each column name (without unit) its values, shape (rows,).

    Raises ResultError where the file is missing or is not a history.
    """
    header, *rows = _complete_lines(Path(path))
    names = [name for name, _ in _columns(header)]
    try:
        table = np.array([row.split(b",") for row in rows]).astype(float)
        table = table.reshape(len(rows), len(names))
    except ValueError as error:
        raise ResultError(f"{path}: not a table of {len(names)} columns of numbers") from error
    return {name: table[:, i].copy() for i, name in enumerate(names)}


def read_units(path: str | os.PathLike) -> dict[str, str]:
    """Read a history's units: for each column name its unit, "" where it has none.

    Raises ResultError where the file is missing or is not a history.
    """
    return dict(_columns(_complete_lines(Path(path))[0]))


def write_summary(directory: str | os.PathLike, summary: Mapping[str, Any]) -> None:
    """Write `summary` as the directory's summary.json, all of it or nothing; see `write_object`."""
    write_object(Path(directory) / SUMMARY, summary)


def write_object(path: str | os.PathLike, tree: Mapping[str, Any]) -> None:
    """Write nested tables as JSON, all of it or nothing.

    NumPy (and JAX) numbers and arrays become plain ones, non-finite numbers null.
    """
    text = json.dumps(_plain(tree, finite=True), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_table(path: str | os.PathLike, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Write a table as CSV, words with commas in quotes, all of it or nothing."""

    def write(aside: Path) -> None:
        with open(aside, "w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([header, *rows])

    _replace(Path(path), write)


def write_text(path: str | os.PathLike, text: str) -> Path:
    """Write a text, all of it or nothing; returns its path."""
    path = Path(path)
    _replace(path, lambda aside: aside.write_text(text, encoding="utf-8"))
    return path


def read_summary(directory: str | os.PathLike) -> dict[str, Any]:
    """Read the directory's summary.json.

    Raises ResultError where it is missing or is not a JSON object.
    """
    directory = Path(directory)
    if not (directory / SUMMARY).exists():
        raise ResultError(f"{directory / SUMMARY}: No such file or directory; {_advice(directory)}")
    return read_object(directory / SUMMARY)


def _advice(directory: Path) -> str:
    """What to do where no run has ended."""
    if (directory / "history.csv").exists():
        return "the run there has not ended: go on with it by --resume"
    ended = [path.parent.as_posix() for path in [*Path().glob(f"*/{SUMMARY}"), *Path().glob(f"results/*/{SUMMARY}")]]
    by_name = {path.rpartition("/")[2]: path for path in ended}
    near = did_you_mean(directory.name, by_name)
    return f"did you mean {by_name[near]}?" if near else "has the scene been run?"


def read_reference(directory: str | os.PathLike) -> Reference | None:
    """What was measured, of the scene of the directory's run; None where it gave nothing.

    Raises ResultError where scene.json is missing or holds something else.
    """
    path = Path(directory) / "scene.json"
    given = (read_object(path).get("response") or {}).get("reference")
    try:
        return given and Reference.model_validate(given)
    except ValueError as error:
        raise ResultError(f"{path}: response.reference is broken; run the scene again") from error


def read_object(path: Path) -> dict[str, Any]:
    """Read nested tables as JSON; raises ResultError where the file is missing or holds something else."""
    try:
        tree = json.loads(_bytes(path))
    except ValueError as error:
        raise ResultError(f"{path}: not JSON ({error}); run the scene again") from error
    if not isinstance(tree, dict):
        raise ResultError(f"{path}: not a JSON object; run the scene again")
    return tree


def save_restart(
    path: str | os.PathLike, arrays: Mapping[str, np.ndarray], meta: Mapping[str, Any]
) -> None:
    """Save arrays, bit for bit, and a JSON-able `meta`; a kill leaves the previous file whole.

    `arrays`: any shape (0-d and empty too), numbers or booleans. A "/" in a name makes a folder
    in the file. Raises ValueError for a name or a data type that HDF5 cannot hold.
    """
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    for name, array in arrays.items():
        _check_array(name, array)
    text = json.dumps(_plain(meta, finite=False))

    def write(aside: Path) -> None:
        # The old format limits an attribute to 64 kB, which a long scene's meta would pass.
        with h5py.File(aside, "w", libver="latest") as file:
            for name, array in arrays.items():
                data = file.create_dataset(name, data=array)
                data.attrs["crc32"] = _checksum(array)
            file.attrs["meta"] = text
            file.attrs["names"] = json.dumps(list(arrays))
            file.attrs["version"] = RESTART_VERSION
            file.attrs["format"] = RESTART_FORMAT

    _replace(Path(path), write)


def load_restart(path: str | os.PathLike) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Load what `save_restart` saved: (arrays, meta), names in the order they were given.

    Raises ResultError for a missing, broken or foreign file.
    """
    path = Path(path)
    advice = "start the run afresh, without --resume"
    if not path.is_file():
        raise ResultError(f"{path}: there is no restart file; {advice}")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != RESTART_FORMAT:
                raise ResultError(f"{path}: not a restart file of jaxmpm; {advice}")
            version = int(file.attrs["version"])
            if version != RESTART_VERSION:
                raise ResultError(
                    f"{path}: restart format {version}, this jaxmpm reads {RESTART_VERSION}; "
                    f"{advice}, or resume it with the version that wrote it"
                )
            arrays = {name: _intact(file[name]) for name in json.loads(file.attrs["names"])}
            return arrays, json.loads(file.attrs["meta"])
    except (OSError, KeyError, ValueError, RuntimeError, TypeError) as error:
        raise ResultError(f"{path}: the restart file is broken ({error}); {advice}") from error


def _header(columns: Sequence[tuple[str, str]]) -> str:
    names = [name for name, _ in columns]
    for name, unit in columns:
        if not name or name != name.strip() or re.search(r'[,\[\]"\r\n]', name + unit):
            raise ValueError(f"history column {name!r} [{unit}]: no commas, brackets or quotes")
    if not names or len(set(names)) != len(names):
        raise ValueError(f"history columns must be different and at least one, got {names}")
    return ",".join(f"{name} [{unit}]" if unit else name for name, unit in columns)


def _columns(header: bytes) -> list[tuple[str, str]]:
    cells = header.decode("utf-8", "replace").rstrip("\r\n").split(",")
    matches = [re.fullmatch(r"(.*?)(?: \[(.*)\])?", cell) for cell in cells]
    return [(match[1], match[2] or "") for match in matches]


def _digits(value: Any) -> str:
    value = value.item() if hasattr(value, "item") else value
    return repr(int(value) if isinstance(value, bool) else value)


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ResultError(f"{path}: {error.strerror}; has the scene been run?") from error


def _complete_lines(path: Path) -> list[bytes]:
    # A kill in the middle of a row leaves a last line without its end: it is no row.
    lines = [line for line in _bytes(path).splitlines(True) if line.endswith(b"\n")]
    if not lines:
        raise ResultError(f"{path}: empty; run the scene again")
    return lines


def _plain(value: Any, finite: bool) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item, finite) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item, finite) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist(), finite)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if finite and isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _check_array(name: str, array: np.ndarray) -> None:
    if any(part in ("", ".") for part in name.split("/")):
        raise ValueError(f"restart array {name!r}: an empty name or a '.' between slashes")
    if array.dtype.kind not in "biufc":
        raise ValueError(f"restart array {name!r}: numbers or booleans expected, not {array.dtype}")


def _checksum(array: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(array).reshape(-1).view(np.uint8))


def _intact(data: h5py.Dataset) -> np.ndarray:
    array = np.asarray(data[()])
    if _checksum(array) != int(data.attrs["crc32"]):
        raise ValueError(f"the checksum of {data.name} is wrong")
    return array


def _replace(path: Path, write: Callable[[Path], Any]) -> None:
    aside = path.with_name(path.name + ".part")
    try:
        write(aside)
        _sync(aside)
        os.replace(aside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            aside.unlink()
        raise
    _sync(path.parent)


def _sync(path: Path) -> None:
    # Opening a folder like a file is a POSIX habit; elsewhere the rename itself must do.
    if path.is_dir() and os.name != "posix":
        return
    handle = os.open(path, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
