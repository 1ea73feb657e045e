"""History, summary and restart files: what is read back is what was written, kills included."""

import json
import signal
import subprocess
import sys
import textwrap

import h5py
import numpy as np
import pytest

from jaxmpm.results import (
    History,
    ResultError,
    load_restart,
    read_history,
    read_summary,
    read_units,
    save_restart,
    write_summary,
)

COLUMNS = [("step", ""), ("time", "s"), ("load", "N"), ("delta", "mm")]
ROWS = [(k, k / 3, np.float64(1e3) / (k + 7), np.float32(0.1) * k) for k in range(5)]


@pytest.fixture
def path(tmp_path):
    with History.create(tmp_path / "history.csv", COLUMNS) as history:
        for row in ROWS:
            history.append(row)
    return tmp_path / "history.csv"


def test_history_reads_back_the_same_numbers(path):
    assert path.read_text().splitlines()[:2] == [
        "step,time [s],load [N],delta [mm]",
        "0,0.0,142.85714285714286,0.0",
    ]
    history = read_history(path)
    assert list(history) == ["step", "time", "load", "delta"]
    for column, values in enumerate(history.values()):
        assert values.tolist() == [float(row[column]) for row in ROWS]
    assert read_units(path) == {"step": "", "time": "s", "load": "N", "delta": "mm"}


def test_history_holds_numbers_that_are_not_finite(tmp_path):
    with History.create(tmp_path / "h.csv", [("a", ""), ("b", "N/mm")]) as history:
        history.append((float("nan"), np.float32("-inf")))
        history.append(np.array([5e-324, 1.7976931348623157e308]))
    read = read_history(tmp_path / "h.csv")
    assert np.isnan(read["a"][0]) and read["b"][0] == -np.inf
    assert read["a"][1] == 5e-324 and read["b"][1] == 1.7976931348623157e308


def test_history_without_rows(tmp_path):
    History.create(tmp_path / "h.csv", COLUMNS).close()
    assert {name: values.shape for name, values in read_history(tmp_path / "h.csv").items()} == {
        name: (0,) for name, _ in COLUMNS
    }


def test_history_is_on_disk_after_every_row(tmp_path):
    with History.create(tmp_path / "h.csv", COLUMNS) as history:
        for count, row in enumerate(ROWS, start=1):
            history.append(row)
            assert len(read_history(tmp_path / "h.csv")["step"]) == count


def test_history_refuses_a_row_or_a_column_that_does_not_fit(tmp_path):
    with History.create(tmp_path / "h.csv", COLUMNS) as history:
        with pytest.raises(ValueError, match="3 values for 4 columns"):
            history.append((1, 2, 3))
    for columns in ([("a,b", "")], [("a", "N]")], [("", "N")], [("a", ""), ("a", "N")], []):
        with pytest.raises(ValueError, match="history column"):
            History.create(tmp_path / "other.csv", columns)
    assert not (tmp_path / "other.csv").exists()


def test_reopened_history_is_as_if_never_interrupted(path):
    whole = path.read_bytes()
    with open(path, "a") as file:
        file.write("5,1.66,12")  # a kill in the middle of a row
    assert len(read_history(path)["step"]) == 5
    with History.reopen(path, COLUMNS, 3) as history:
        assert len(read_history(path)["step"]) == 3
        for row in ROWS[3:]:
            history.append(row)
    assert path.read_bytes() == whole
    History.reopen(path, COLUMNS, 0).close()
    assert len(read_history(path)["step"]) == 0


def test_reopening_refuses_another_history(path, tmp_path):
    with pytest.raises(ResultError, match="has 5 rows, the restart file expects 6"):
        History.reopen(path, COLUMNS, 6)
    with pytest.raises(ResultError, match="header"):
        History.reopen(path, COLUMNS[:3], 2)
    with pytest.raises(ResultError, match="absent.csv"):
        History.reopen(tmp_path / "absent.csv", COLUMNS, 0)
    assert len(read_history(path)["step"]) == 5


@pytest.mark.parametrize("text", ["", "a,b", "a,b\n1\n", "a,b\n1,2\n1,2,3\n", "a,b\n1,x\n"])
def test_a_file_that_is_no_history_is_refused(tmp_path, text):
    (tmp_path / "h.csv").write_text(text)
    with pytest.raises(ResultError, match="h.csv"):
        read_history(tmp_path / "h.csv")


def test_summary_reads_back_in_order(tmp_path):
    write_summary(
        tmp_path,
        {
            "scene": "büchse",
            "peak_load": np.float64(0.1),
            "cells": np.int64(7),
            "done": np.bool_(True),
            "energy_error": float("nan"),
            "nested": {"b": [np.float32(np.inf), 2], "a": np.arange(3)},
            "path": tmp_path,
            "nothing": None,
        },
    )
    read = read_summary(tmp_path)
    assert list(read)[:3] == ["scene", "peak_load", "cells"]
    assert read["scene"] == "büchse" and read["peak_load"] == 0.1 and read["cells"] == 7
    assert read["done"] is True and read["energy_error"] is None and read["nothing"] is None
    assert list(read["nested"].items()) == [("b", [None, 2]), ("a", [0, 1, 2])]
    assert read["path"] == str(tmp_path)


def test_a_summary_that_cannot_be_written_leaves_the_old_one(tmp_path):
    write_summary(tmp_path, {"a": 1})
    with pytest.raises(TypeError):
        write_summary(tmp_path, {"a": object()})
    assert read_summary(tmp_path) == {"a": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["summary.json"]


def test_a_missing_or_broken_summary_is_refused(tmp_path):
    with pytest.raises(ResultError, match="has the scene been run"):
        read_summary(tmp_path)
    for text in ("{", "[1]", "\xff"):
        (tmp_path / "summary.json").write_text(text, encoding="latin-1")
        with pytest.raises(ResultError, match="run the scene again"):
            read_summary(tmp_path)


def awkward_arrays():
    bits = np.array([0x7FF8000000001234, 0x8000000000000000, 1], np.uint64)
    return {
        "z/last": np.arange(24, dtype=np.float32).reshape(2, 3, 4)[:, ::2, ::-1],
        "nan payload": bits.view(np.float64),
        "step": np.int32(41),
        "time": np.array(1 / 3),
        "flags": np.array([[True, False], [False, True]]),
        "flag": np.array(True),
        "none": np.zeros((0, 3), np.float16),
        "wave": np.array([1 + 2j], np.complex64),
        "bytes": np.arange(256, dtype=np.uint8),
        "big": np.array([1.5, 2.5], ">f8"),
    }


def test_restart_is_exact_to_the_bit(tmp_path):
    meta = {"step": 41, "rows": np.int64(7), "scene": {"b": 1e-300, "a": None}, "load": np.inf}
    save_restart(tmp_path / "restart.h5", awkward_arrays(), meta)
    arrays, read = load_restart(tmp_path / "restart.h5")
    assert list(arrays) == list(awkward_arrays())
    for name, array in awkward_arrays().items():
        assert isinstance(arrays[name], np.ndarray)
        assert arrays[name].dtype == array.dtype and arrays[name].shape == array.shape, name
        assert arrays[name].tobytes() == array.tobytes(), name
    assert read == {"step": 41, "rows": 7, "scene": {"b": 1e-300, "a": None}, "load": np.inf}
    assert [file.name for file in tmp_path.iterdir()] == ["restart.h5"]


def test_restart_holds_a_long_meta_and_no_arrays(tmp_path):
    meta = {"scene": "x" * 300_000}
    save_restart(tmp_path / "restart.h5", {}, meta)
    assert load_restart(tmp_path / "restart.h5") == ({}, meta)


def test_restart_refuses_what_it_cannot_hold_and_keeps_the_old_file(tmp_path):
    path = tmp_path / "restart.h5"
    save_restart(path, {"a": np.ones(3)}, {})
    for name, array in (("a", ["x"]), ("", [1]), ("./a", [1]), ("a//b", [1])):
        with pytest.raises(ValueError, match="restart array"):
            save_restart(path, {name: np.array(array)}, {})
    with pytest.raises(TypeError):
        save_restart(path, {}, {"a": object()})
    with pytest.raises((ValueError, TypeError)):
        save_restart(path, {"b": np.ones(1), "b/c": np.ones(1)}, {})
    assert load_restart(path)[0]["a"].tolist() == [1, 1, 1]
    assert [file.name for file in tmp_path.iterdir()] == ["restart.h5"]


def test_broken_and_foreign_restart_files_are_refused(tmp_path):
    path = tmp_path / "restart.h5"
    with pytest.raises(ResultError, match="no restart file; start the run afresh"):
        load_restart(path)
    save_restart(path, {"a": np.arange(1000.0)}, {"step": 1})
    whole = path.read_bytes()
    at = whole.index(np.arange(1000.0).tobytes()) + 500
    flipped = whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]
    for content in (b"", b"not HDF5", whole[: len(whole) // 2], flipped):
        path.write_bytes(content)
        with pytest.raises(ResultError, match="broken.*start the run afresh"):
            load_restart(path)
    with h5py.File(path, "w") as file:
        file["a"] = 1
    with pytest.raises(ResultError, match="not a restart file"):
        load_restart(path)
    path.write_bytes(whole)
    with h5py.File(path, "a") as file:
        file.attrs["version"] = 99
    with pytest.raises(ResultError, match="restart format 99"):
        load_restart(path)


def test_a_kill_at_any_time_leaves_a_whole_restart_file(tmp_path):
    path = tmp_path / "restart.h5"
    code = f"""
        import numpy as np
        from jaxmpm.results import save_restart
        for k in range(100_000):
            save_restart({str(path)!r}, {{"a": np.full(20_000, k), "b": np.full(7, k)}}, {{"k": k}})
            print(k, flush=True)
    """
    for wait in (1, 4, 9):
        with subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, text=True
        ) as child:
            for _ in range(wait):
                last = int(child.stdout.readline())
            child.send_signal(signal.SIGKILL)
            last = [last, *map(int, child.stdout.read().split())][-1]
        arrays, meta = load_restart(path)
        assert meta["k"] in (last, last + 1)
        assert (arrays["a"] == meta["k"]).all() and (arrays["b"] == meta["k"]).all()


def test_a_summary_is_plain_json(tmp_path):
    write_summary(tmp_path, {"a": float("-inf"), "b": [float("nan")]})
    text = (tmp_path / "summary.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail) == {"a": None, "b": [None]}
