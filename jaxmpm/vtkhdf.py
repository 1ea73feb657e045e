"""A growing point cloud in VTKHDF, which ParaView opens as an animation.

Layout: VTKHDF file format 2.3, transient PolyData, one part and one vertex per point
(docs.vtk.org, "VTKHDF File Format").
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

import h5py
import numpy as np

from jaxmpm.results import ResultError

VERSION = (2, 3)
TOPOLOGIES = ("Vertices", "Lines", "Polygons", "Strips")
COUNTS = ("NumberOfCells", "NumberOfConnectivityIds")
# (rows per chunk): large enough to compress well, small enough to rewrite at each frame.
ROWS, FRAMES = 8192, 256


class PointCloudWriter:
    """Writes one frame after another; what `write` has returned from survives a kill."""

    def __init__(self, file: h5py.File):
        self._root = file["VTKHDF"]
        self.path = Path(file.filename)
        self.frames = int(self._root["Steps"].attrs["NSteps"])
        self.rows = int(self._root["NumberOfPoints"][: self.frames].sum())
        self.fields = _fields(self._root)

    @classmethod
    def create(
        cls, path: str | os.PathLike, fields: Mapping[str, int], dtype: str = "float32"
    ) -> PointCloudWriter:
        """Start a file without frames, replacing the one that may be there.

        `fields`: components of each field, 1 for a scalar; `dtype`: of points and fields.
        Raises ValueError for a field's name or components that VTKHDF cannot hold.
        """
        for name, components in fields.items():
            if not name or name == "." or "/" in name or components < 1:
                raise ValueError(f"field {name!r} of {components} components: not possible")
        file = h5py.File(path, "w")
        try:
            _lay_out(file.create_group("VTKHDF", track_order=True), fields, np.dtype(dtype))
            file.flush()
            return cls(file)
        except BaseException:
            file.close()
            raise

    @classmethod
    def reopen(cls, path: str | os.PathLike, frames: int) -> PointCloudWriter:
        """Continue a file after its first `frames` frames; later ones are cut off.

        Raises ResultError where the file is missing, broken, foreign or has fewer frames.
        """
        file = _open(path, "r+")
        try:
            root = file["VTKHDF"]
            present = int(root["Steps"].attrs["NSteps"])
            if not 0 <= frames <= present:
                raise ResultError(
                    f"{path}: has {present} frames, the restart file expects {frames}; "
                    "start the run afresh, without --resume"
                )
            # These two go first, so that a kill during the cut leaves frames that are whole.
            root["Steps/Values"].resize(frames, axis=0)
            root["Steps"].attrs["NSteps"] = np.int64(frames)
            file.flush()
            _cut(root, frames)
            file.flush()
            return cls(file)
        except BaseException:
            file.close()
            raise

    def write(self, time: float, points: np.ndarray, data: Mapping[str, np.ndarray]) -> None:
        """Add one frame, readable when this returns.

        `time` in s; `points` (N, 3) in mm, N > 0 may differ between frames; `data`: every field
        of the file, (N, components), or (N,) for a scalar. Raises ValueError for another shape
        or another set of fields; the file is then as before.
        """
        points = np.asarray(points)
        # After a frame without points VTK's reader takes the next one's vertices from its place.
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            raise ValueError(f"points must be (N, 3) and at least one, not {points.shape}")
        if set(data) != set(self.fields):
            raise ValueError(f"fields {sorted(data)} given, the file has {sorted(self.fields)}")
        data = {name: self._shaped(name, data[name], len(points)) for name in self.fields}

        root, frame, row, count = self._root, self.frames, self.rows, len(points)
        _put(root["Points"], row, points)
        _put(root["NumberOfPoints"], frame, [count])
        for name, values in data.items():
            _put(root["PointData"][name], row, values)
        for topology in TOPOLOGIES:
            cells = count if topology == "Vertices" else 0
            first = row if topology == "Vertices" else 0
            for name in COUNTS:
                _put(root[topology][name], frame, [cells])
            _put(root[topology]["Offsets"], first + frame, np.arange(cells + 1))
            _put(root[topology]["Connectivity"], first, np.arange(cells))
        self._put_step()
        # VTK reads as many times as there are into room for NSteps of them, and crashes where
        # they differ: the two go to disk together, after all the rest is there.
        root.file.flush()
        _put(root["Steps/Values"], frame, [float(time)])
        root["Steps"].attrs["NSteps"] = np.int64(frame + 1)
        root.file.flush()
        self.frames, self.rows = frame + 1, row + count

    def close(self) -> None:
        """Close the file; closing twice does nothing."""
        if self._root:
            self._root.file.close()

    def __enter__(self) -> PointCloudWriter:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def _shaped(self, name: str, values: np.ndarray, count: int) -> np.ndarray:
        values = np.asarray(values)
        components = self.fields[name]
        wanted = (count,) if components == 1 else (count, components)
        if values.shape != wanted and values.shape != (count, components):
            raise ValueError(f"field {name!r} must be {wanted}, not {values.shape}")
        return values.reshape(wanted)

    def _put_step(self) -> None:
        steps, frame, row = self._root["Steps"], self.frames, self.rows
        _put(steps["PartOffsets"], frame, [frame])
        _put(steps["NumberOfParts"], frame, [1])
        _put(steps["PointOffsets"], frame, [row])
        for name in ("CellOffsets", "ConnectivityIdOffsets"):
            _put(steps[name], frame, [[row, 0, 0, 0]])
        for name in self.fields:
            _put(steps["PointDataOffsets"][name], frame, [row])


def read_frames(path: str | os.PathLike) -> tuple[int, np.ndarray]:
    """Read the number of frames and their times, shape (frames,), in s.

    Raises ResultError where the file is missing, broken or foreign.
    """
    with _reading(path) as root:
        count = int(root["Steps"].attrs["NSteps"])
        return count, root["Steps"]["Values"][:count]


def read_frame(path: str | os.PathLike, k: int = -1) -> dict:
    """Read frame `k` (negative: from the end): "time" in s, "points" (N, 3) in mm, every field.

    Raises ResultError where the file is missing, broken or foreign, or has no such frame.
    """
    with _reading(path) as root:
        steps = root["Steps"]
        count = int(steps.attrs["NSteps"])
        if not -count <= k < count:
            raise ResultError(f"{path}: no frame {k} among its {count} frames")
        k %= count
        first = int(steps["PointOffsets"][k])
        here = slice(first, first + int(root["NumberOfPoints"][k]))
        frame = {"time": float(steps["Values"][k]), "points": root["Points"][here]}
        return frame | {name: data[here] for name, data in root["PointData"].items()}


@contextlib.contextmanager
def _reading(path: str | os.PathLike) -> Iterator[h5py.Group]:
    with _open(path, "r") as file:
        try:
            yield file["VTKHDF"]
        except (OSError, KeyError, ValueError, RuntimeError) as error:
            raise ResultError(f"{path}: broken ({error}); run the scene again") from error


def _open(path: str | os.PathLike, mode: str) -> h5py.File:
    if not Path(path).is_file():
        raise ResultError(f"{path}: there is no such file; has the scene been run?")
    try:
        file = h5py.File(path, mode)
    except OSError as error:
        raise ResultError(
            f"{path}: cannot be opened ({error}); it is broken, or another program is writing it"
        ) from error
    if "VTKHDF" not in file or "NSteps" not in file.get("VTKHDF/Steps", file).attrs:
        file.close()
        raise ResultError(f"{path}: not a VTKHDF animation; run the scene again")
    return file


def _fields(root: h5py.Group) -> dict[str, int]:
    return {
        name: 1 if data.ndim == 1 else data.shape[1] for name, data in root["PointData"].items()
    }


def _lay_out(root: h5py.Group, fields: Mapping[str, int], dtype: np.dtype) -> None:
    root.attrs["Version"] = np.array(VERSION, np.int64)
    # VTK compares this attribute as a string of fixed length; h5py would write a variable one.
    root.attrs.create("Type", b"PolyData", dtype=h5py.string_dtype("ascii", len(b"PolyData")))
    _grow(root, "NumberOfPoints", (), np.int64, FRAMES)
    _grow(root, "Points", (3,), dtype, ROWS)
    for topology in TOPOLOGIES:
        group = root.create_group(topology)
        for name in COUNTS:
            _grow(group, name, (), np.int64, FRAMES)
        for name in ("Offsets", "Connectivity"):
            _grow(group, name, (), np.int64, ROWS)
    data = root.create_group("PointData", track_order=True)
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(0)
    _grow(steps, "Values", (), np.float64, FRAMES)
    for name in ("PartOffsets", "NumberOfParts", "PointOffsets"):
        _grow(steps, name, (), np.int64, FRAMES)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        _grow(steps, name, (len(TOPOLOGIES),), np.int64, FRAMES)
    offsets = steps.create_group("PointDataOffsets")
    for name, components in fields.items():
        _grow(data, name, () if components == 1 else (components,), dtype, ROWS)
        _grow(offsets, name, (), np.int64, FRAMES)


def _grow(group: h5py.Group, name: str, width: tuple, dtype: np.dtype, rows: int) -> None:
    packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    group.create_dataset(
        name,
        shape=(0, *width),
        maxshape=(None, *width),
        chunks=(rows, *width),
        dtype=dtype,
        **(packed if rows == ROWS else {}),
    )


def _put(data: h5py.Dataset, first: int, values) -> None:
    count = len(values)
    data.resize(first + count, axis=0)
    if count:
        data[first:] = values


def _cut(root: h5py.Group, frames: int) -> None:
    rows = int(root["NumberOfPoints"][:frames].sum())
    sizes = {root["Points"]: rows, root["NumberOfPoints"]: frames}
    sizes |= {data: rows for data in root["PointData"].values()}
    for topology in TOPOLOGIES:
        group, cells = root[topology], rows if topology == "Vertices" else 0
        sizes |= {group[name]: frames for name in COUNTS}
        sizes |= {group["Offsets"]: cells + frames, group["Connectivity"]: cells}
    for data in (*root["Steps"].values(), *root["Steps"]["PointDataOffsets"].values()):
        if isinstance(data, h5py.Dataset):
            sizes[data] = frames
    for data, size in sizes.items():
        data.resize(size, axis=0)
