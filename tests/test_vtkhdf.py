"""The VTKHDF file, read by vtk's own reader and by ours, after kills and cuts too."""

import signal
import subprocess
import sys
import textwrap

import h5py
import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
from vtkmodules.vtkIOHDF import vtkHDFReader

from jaxmpm.results import ResultError
from jaxmpm.vtkhdf import PointCloudWriter, read_frame, read_frames

FIELDS = {"velocity": 3, "damage": 1, "stress": 4}
COUNTS = (5, 9, 9, 1, 20_000)
TIMES = (0.0, 1 / 3, 0.5, 1.25, 1e3)


def cloud(k):
    """Points and fields of frame k, COUNTS[k] points, representable in single precision."""
    count = COUNTS[k]
    points = np.arange(3.0 * count).reshape(count, 3) + 1000 * k
    values = np.arange(float(count)) - 7 * k
    return points, {
        "stress": np.stack([values, 2 * values, -values, 0 * values], axis=1),
        "velocity": points[:, ::-1] / 4,
        "damage": values / 8,
    }


def write(path, frames=range(len(COUNTS))):
    with PointCloudWriter.create(path, FIELDS) as writer:
        for k in frames:
            writer.write(TIMES[k], *cloud(k))
    return path


def vtk_frames(path):
    """Every frame as vtk's reader sees it: (time, points, vertices, {field: values})."""
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    assert reader.CanReadFile(str(path))
    reader.UpdateInformation()
    key = vtkStreamingDemandDrivenPipeline.TIME_STEPS()
    times = reader.GetOutputInformation(0).Get(key) or ()
    assert len(times) == reader.GetNumberOfSteps()
    for time in times:
        reader.UpdateTimeStep(time)
        output = reader.GetOutput()
        count = output.GetNumberOfPoints()
        points = vtk_to_numpy(output.GetPoints().GetData())
        ids = vtk_to_numpy(output.GetVerts().GetConnectivityArray())
        offsets = vtk_to_numpy(output.GetVerts().GetOffsetsArray())
        assert output.GetNumberOfCells() == output.GetNumberOfVerts() == count
        assert offsets.tolist() == list(range(count + 1))
        data = output.GetPointData()
        arrays = [data.GetArray(i) for i in range(data.GetNumberOfArrays())]
        yield time, points, ids, {a.GetName(): vtk_to_numpy(a) for a in arrays}


def same_frame(k, points, fields):
    wanted, data = cloud(k)
    assert np.array_equal(points, wanted)
    assert set(fields) == set(data)
    for name, values in data.items():
        assert fields[name].shape == values.shape and np.array_equal(fields[name], values), name


def test_vtk_reads_every_frame_of_a_cloud_that_changes_size(tmp_path):
    seen = list(vtk_frames(write(tmp_path / "a.vtkhdf")))
    assert [time for time, *_ in seen] == list(TIMES)
    for k, (_, points, ids, fields) in enumerate(seen):
        assert ids.tolist() == list(range(COUNTS[k]))
        same_frame(k, points, fields)


def test_we_read_what_we_wrote(tmp_path):
    path = write(tmp_path / "a.vtkhdf")
    count, times = read_frames(path)
    assert count == len(TIMES) and times.tolist() == list(TIMES)
    for k in range(-count, count):
        frame = read_frame(path, k)
        assert frame.pop("time") == TIMES[k]
        same_frame(k % count, frame.pop("points"), frame)
    assert list(read_frame(path))[2:] == list(FIELDS)
    assert read_frame(path)["damage"].dtype == np.float32


def test_precision_is_chosen_at_the_start(tmp_path):
    with PointCloudWriter.create(tmp_path / "a.vtkhdf", {"a": 1}, dtype="float64") as writer:
        for time in (0.1, 0.2):
            writer.write(time, np.full((1, 3), 1 / 3), {"a": np.array([[0.1]])})
    frame = read_frame(tmp_path / "a.vtkhdf")
    assert frame["points"][0, 0] == 1 / 3 and frame["a"][0] == 0.1
    *_, (_, points, _, fields) = vtk_frames(tmp_path / "a.vtkhdf")
    assert points[0, 0] == 1 / 3 and fields["a"][0] == 0.1


def test_a_file_without_frames(tmp_path):
    write(tmp_path / "a.vtkhdf", [])
    assert read_frames(tmp_path / "a.vtkhdf")[0] == 0
    with pytest.raises(ResultError, match="no frame -1 among its 0 frames"):
        read_frame(tmp_path / "a.vtkhdf")
    with pytest.raises(ResultError, match="no frame 5 among its 5 frames"):
        read_frame(write(tmp_path / "b.vtkhdf"), 5)


@pytest.mark.parametrize("keep", [0, 1, 3, 5])
def test_reopened_file_is_as_if_never_interrupted(tmp_path, keep):
    path = write(tmp_path / "a.vtkhdf")
    with PointCloudWriter.reopen(path, keep) as writer:
        assert writer.frames == keep and writer.fields == FIELDS
        for k in range(keep, len(COUNTS)):
            writer.write(TIMES[k], *cloud(k))
    assert datasets(path) == datasets(write(tmp_path / "whole.vtkhdf"))
    assert [time for time, *_ in vtk_frames(path)] == list(TIMES)


def datasets(path):
    found = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, data: found.update({name: data[()].tolist()})
            if isinstance(data, h5py.Dataset)
            else None
        )
        return found | dict(file["VTKHDF/Steps"].attrs)


def test_a_cut_file_holds_only_what_is_kept(tmp_path):
    PointCloudWriter.reopen(write(tmp_path / "a.vtkhdf"), 2).close()
    assert datasets(tmp_path / "a.vtkhdf") == datasets(write(tmp_path / "b.vtkhdf", range(2)))
    assert len(list(vtk_frames(tmp_path / "a.vtkhdf"))) == 2


def test_what_does_not_fit_is_refused_and_the_file_stays_whole(tmp_path):
    points, data = cloud(1)
    with PointCloudWriter.create(tmp_path / "a.vtkhdf", FIELDS) as writer:
        writer.write(0.0, points, data)
        with pytest.raises(ValueError, match=r"points must be \(N, 3\) .*not \(9, 2\)"):
            writer.write(1.0, points[:, :2], data)
        with pytest.raises(ValueError, match=r"at least one, not \(0, 3\)"):
            writer.write(1.0, points[:0], {name: values[:0] for name, values in data.items()})
        with pytest.raises(ValueError, match=r"field 'damage' must be \(9,\), not \(8,\)"):
            writer.write(1.0, points, data | {"damage": data["damage"][1:]})
        with pytest.raises(ValueError, match="fields"):
            writer.write(1.0, points, data | {"more": data["damage"]})
        with pytest.raises(ValueError, match="fields"):
            writer.write(1.0, points, {})
    assert read_frames(tmp_path / "a.vtkhdf")[0] == 1
    for fields in ({"a/b": 1}, {"": 1}, {"a": 0}):
        with pytest.raises(ValueError, match="not possible"):
            PointCloudWriter.create(tmp_path / "b.vtkhdf", fields)


def test_broken_and_foreign_files_are_refused(tmp_path):
    path = tmp_path / "a.vtkhdf"
    for use in (read_frames, read_frame, lambda p: PointCloudWriter.reopen(p, 0)):
        path.unlink(missing_ok=True)
        with pytest.raises(ResultError, match="no such file"):
            use(path)
        path.write_bytes(b"not HDF5")
        with pytest.raises(ResultError, match="cannot be opened"):
            use(path)
        with h5py.File(path, "w") as file:
            file["VTKHDF/Points"] = np.zeros((1, 3))
        with pytest.raises(ResultError, match="not a VTKHDF animation"):
            use(path)
    with pytest.raises(ResultError, match="has 5 frames, the restart file expects 6"):
        PointCloudWriter.reopen(write(path), 6)
    assert read_frames(path)[0] == 5


@pytest.mark.parametrize("death", ["exit", "kill", "kill between"])
def test_a_killed_writer_leaves_a_readable_file(tmp_path, death):
    path = tmp_path / "a.vtkhdf"
    code = f"""
        import os, sys, time
        import numpy as np
        from jaxmpm.vtkhdf import PointCloudWriter
        writer = PointCloudWriter.create({str(path)!r}, {{"a": 1, "v": 3}})
        for k in range(100_000):
            n = 100 + 50 * k
            data = {{"a": np.full(n, k), "v": np.full((n, 3), -k)}}
            writer.write(k / 4, np.full((n, 3), k), data)
            print(k, flush=True)
            if k == 6 and {death!r} == "exit":
                os._exit(9)
            if k == 6 and {death!r} == "kill between":
                writer._root["Points"].resize(10 ** 6, axis=0)  # a write that was only begun
                writer._root["Vertices/NumberOfCells"].resize(8, axis=0)
                writer._root["Steps/PointOffsets"].resize(8, axis=0)
                writer._root.file.flush()
                print("begun", flush=True)
            if k == 6:
                time.sleep(600)
    """
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, text=True
    ) as child:
        while int(child.stdout.readline()) < 6:
            pass
        if death == "kill between":
            child.stdout.readline()
        child.send_signal(signal.SIGKILL)
    assert read_frames(path)[0] == 7
    seen = list(vtk_frames(path))
    assert [time for time, *_ in seen] == [k / 4 for k in range(7)]
    for k, (_, points, _, fields) in enumerate(seen):
        assert points.shape == (100 + 50 * k, 3) and (points == k).all()
        assert (fields["a"] == k).all() and (fields["v"] == -k).all()
    with PointCloudWriter.reopen(path, 7) as writer:
        writer.write(1.75, np.zeros((2, 3)), {"a": np.ones(2), "v": np.ones((2, 3))})
    *_, (time_, points, _, fields) = vtk_frames(path)
    assert time_ == 1.75 and len(points) == 2 and (fields["v"] == 1).all()


def test_frames_stay_small_and_quick_on_disk(tmp_path):
    count = 20_000
    points = np.stack([*np.indices((200, 100)).reshape(2, -1), np.zeros(count)], axis=1)
    with PointCloudWriter.create(tmp_path / "a.vtkhdf", {"opening": 1, "normal": 3}) as writer:
        for k in range(20):
            writer.write(k, points, {"opening": np.zeros(count), "normal": np.zeros((count, 3))})
    raw = 20 * count * 4 * 7
    assert (tmp_path / "a.vtkhdf").stat().st_size < 0.1 * raw
