"""The pictures of a run, on a made-up notched plate with a known diagonal crack."""

import struct
import subprocess
import sys

import numpy as np
import pytest

from jaxmpm import plot
from jaxmpm.plot_body import find_body, outline
from jaxmpm.results import History, ResultError, write_summary
from jaxmpm.vtkhdf import PointCloudWriter

SIZE = 2.0
NX, NY, NOTCH = 24, 16, 5
FIELDS = {"displacement": 3, "stress": 3, "damage": 1, "opening": 1, "normal": 3, "material": 1}
COLUMNS = (("step", ""), ("time", "s"), ("load", "N"), ("delta", "mm"))


def notched_plate():
    """Cells of a plate of NX x NY, lower left at (0, 0), less a column of NOTCH cells below."""
    i, j = np.indices((NX, NY))
    filled = ~((i == NX // 2) & (j < NOTCH))
    return np.stack([i[filled], j[filled]], axis=1)


def plate_frame(index, phases=1):
    """One frame: a crack climbing at 45 degrees from the notch, and a row of closed bands."""
    centres = np.pad((index + 0.5) * SIZE, ((0, 0), (0, 1)))
    zero = np.zeros(len(index))
    climb = index[:, 1] - NOTCH
    crack = (index[:, 0] - NX // 2 == climb) & (climb >= 0) & (climb < 9)
    closed = (index[:, 1] == 3) & (index[:, 0] < 8)
    opening = np.where(crack, 0.09 - 0.01 * climb, 0.0) + np.where(closed, 1e-5, 0.0)
    normal = np.zeros((len(index), 3))
    normal[crack] = np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    normal[closed] = [0.6, 0.8, 0.0]
    side = index[:, 0] - NX // 2 > np.clip(climb, 0, 9)
    displacement = np.stack([np.where(side, 0.05, -0.05), 0.001 * index[:, 1], zero], axis=1)
    return centres, {
        "displacement": displacement,
        "stress": np.zeros((len(index), 3)),
        "damage": (opening > 0).astype(float),
        "opening": opening,
        "normal": normal,
        "material": (index.sum(axis=1) // 6 % phases).astype(float),
    }


def write_run(directory, rows=None, summary=None, phases=1, frames=1):
    """A result directory; its load peaks at 2375 N and 0.06 mm unless `rows` says otherwise."""
    if rows is None:
        delta = np.linspace(0, 0.4, 201)
        load = 2375 * (delta / 0.06) * np.exp(1 - delta / 0.06)
        rows = [(k, 0.1 * k, f, d) for k, (f, d) in enumerate(zip(load, delta, strict=True))]
    with History.create(directory / "history.csv", COLUMNS) as history:
        for row in rows:
            history.append(row)
    points, data = plate_frame(notched_plate(), phases)
    with PointCloudWriter.create(directory / "result.vtkhdf", FIELDS) as writer:
        for k in range(frames):
            writer.write(float(k), points, data)
    known = {"scene": "plate", "title": "Notched plate in tension", "cell_size": SIZE}
    known |= {"status": "completed", "response": {"load": "load", "displacement": "delta"}}
    write_summary(directory, known | (summary or {}))


def png_size(path):
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", head[16:24])


def words(figure):
    import matplotlib.text

    return "\n".join(text.get_text() for text in figure.findobj(matplotlib.text.Text))


def lengths(segments):
    return np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)


def test_outline_is_the_perimeter_of_the_notched_plate():
    body = find_body(plate_frame(notched_plate())[0], SIZE)
    edges = outline(body)
    assert lengths(edges).sum() == pytest.approx(SIZE * (2 * (NX + NY) + 2 * NOTCH))
    assert edges.reshape(-1, 2).min(axis=0) == pytest.approx([0, 0])
    assert edges.reshape(-1, 2).max(axis=0) == pytest.approx([SIZE * NX, SIZE * NY])
    # A closed outline meets every node an even number of times.
    _, meets = np.unique(edges.reshape(-1, 2).round(6), axis=0, return_counts=True)
    assert (meets % 2 == 0).all()


def test_outline_surrounds_a_hole():
    i, j = np.indices((5, 5)).reshape(2, -1)
    keep = (i != 2) | (j != 2)
    centres = np.stack([i[keep] - 7.0, j[keep] + 3.0], axis=1)
    assert len(outline(find_body(centres, 1.0))) == 20 + 4


def test_segments_cross_the_cell_square_perpendicular_to_the_normal():
    rng = np.random.default_rng(1)
    index = np.stack(np.indices((9, 7)), axis=-1).reshape(-1, 2)
    centres = (index + (0.5, -3.5)) * SIZE
    angle = np.concatenate([rng.uniform(0, 2 * np.pi, 59), np.arange(4) * np.pi / 2])
    normal = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    normal[::5] = 0
    cracked, segments = find_body(centres, SIZE).crack_segments(normal)
    assert list(cracked) == list(np.flatnonzero(normal.any(axis=1)))
    along = segments[:, 1] - segments[:, 0]
    assert np.abs((along * normal[cracked, :2]).sum(axis=1)).max() < 1e-12
    local = segments - centres[cracked, None]
    assert np.abs(local).max(axis=2) == pytest.approx(SIZE / 2)
    assert local.sum(axis=1) == pytest.approx(0)


def test_segments_of_a_diagonal_crack_join_into_one_line():
    centres, data = plate_frame(notched_plate())
    cracked, segments = find_body(centres, SIZE).crack_segments(data["normal"])
    main = segments[data["opening"][cracked] > 0.005]
    assert len(main) == 9
    assert main[1:, 0] == pytest.approx(main[:-1, 1])
    assert lengths(main) == pytest.approx(SIZE * np.sqrt(2))


def test_a_homogeneous_displacement_deforms_outline_and_segments():
    centres, data = plate_frame(notched_plate())
    stretch = np.array([[1.2, 0.1], [0.0, 0.9]])
    shift = centres[:, :2] @ (stretch - np.eye(2)).T
    rest, moved = find_body(centres, SIZE), find_body(centres, SIZE, shift)
    inner = tuple(np.array([[3, 3], [8, 7], [20, 12]]).T)
    assert moved.nodes[inner] == pytest.approx(rest.nodes[inner] @ stretch.T)
    normal = np.where((centres[:, :1] - 13) ** 2 < 30, data["normal"], 0)
    _, before = rest.crack_segments(normal)
    _, after = moved.crack_segments(normal)
    assert len(before) > 1
    inside = (before[..., 1] > SIZE).all(axis=1)
    assert after[inside] == pytest.approx(before[inside] @ stretch.T)


def test_two_halves_moved_apart_leave_a_stretched_column():
    centres = np.array([[0.5, 0.5], [1.5, 0.5], [2.5, 0.5]])
    body = find_body(centres, 1.0, np.array([[-1.0, 0], [0, 0], [1.0, 0]]))
    assert body.nodes[:, 0, 0] == pytest.approx([-1.0, 0.5, 2.5, 4.0])


def test_peak_row():
    assert plot.peak_row(np.array([0.0, 2.0, 1.0])) == 1
    assert plot.peak_row(np.array([0.0, -2.0, 1.0])) == 1
    assert plot.peak_row(np.array([0.0, -2.0, 1.0]), known=1.0) == 2
    assert plot.peak_row(np.array([np.nan, 1.0])) == 1
    assert plot.peak_row(np.array([np.nan])) is None


def test_response_in_kilonewtons_with_its_peak(tmp_path, figures):
    write_run(tmp_path)
    path = plot.plot_response(tmp_path)
    assert path == tmp_path / "response.png"
    width, height = png_size(path)
    assert 800 < width < 1600 and 500 < height < 1200
    text = words(figures[0])
    assert "load [kN]" in text and "delta [mm]" in text and "Notched plate in tension" in text
    assert "2.375 kN at 0.06 mm" in text and "stopped" not in text
    dot = next(line for line in figures[0].axes[0].lines if line.get_marker() == "o")
    assert dot.get_xydata()[0] == pytest.approx([0.06, 2.375])


def test_response_of_a_run_that_stopped_says_so(tmp_path, figures):
    write_run(tmp_path, summary={"status": "stopped: no equilibrium at step 41 for $1 a_b", "title": "50 $"})
    plot.plot_response(tmp_path)
    plot.plot_cracks(tmp_path)
    for figure in figures:
        assert "stopped early: no equilibrium at step 41 for $1 a_b" in words(figure)


@pytest.mark.parametrize(
    "rows, note",
    [
        ([(0, 0, 3.0, 0.1)], "3 N at 0.1 mm"),
        ([(0, 0, 0.0, 0.0)], "0 N at 0 mm"),
        ([(0, 0, 0.0, 0.0), (1, 1, -4e3, -0.2), (2, 2, -1e3, -0.4)], "−4 kN at −0.2 mm"),
        ([(0, 0, 1.0, 0.0), (1, 1, float("nan"), 0.2)], "1 N at 0 mm"),
        ([(0, 0, float("nan"), 0.0)], "load [N]"),
    ],
)
def test_response_of_odd_histories(tmp_path, figures, rows, note):
    write_run(tmp_path, rows=rows)
    png_size(plot.plot_response(tmp_path))
    assert note in words(figures[0])


def test_response_without_its_gauge_says_which(tmp_path):
    write_run(tmp_path, summary={"response": {"load": "force", "displacement": "delta"}})
    with pytest.raises(ResultError, match=r"response.load = 'force'.*step, time, load, delta"):
        plot.plot_response(tmp_path)
    write_run(tmp_path, rows=[])
    with pytest.raises(ResultError, match="no row"):
        plot.plot_response(tmp_path)


def test_cracks_coloured_by_opening_in_equal_aspect(tmp_path, figures):
    from matplotlib.collections import LineCollection

    write_run(tmp_path, phases=2, frames=2)
    path = plot.plot_cracks(tmp_path)
    assert path == tmp_path / "cracks.png"
    width, height = png_size(path)
    assert 800 < width < 1800 and 500 < height < 1800
    axes = figures[0].axes[0]
    faint, main = (c for c in axes.collections if isinstance(c, LineCollection))
    assert len(faint.get_segments()) == 8 and len(main.get_segments()) == 9
    assert main.get_array().max() == pytest.approx(0.09) and main.get_clim()[0] == 0
    assert faint.get_linewidth()[0] < 0.5 * main.get_linewidth()[0]
    text = words(figures[0])
    assert "opening [mm]" in text and "x [mm]" in text and "y [mm]" in text and "t =" not in text
    box, (x, y) = axes.get_window_extent(), (axes.get_xlim(), axes.get_ylim())
    assert box.width / np.ptp(x) == pytest.approx(box.height / np.ptp(y))


@pytest.mark.parametrize("suffix, head", [(".pdf", b"%PDF"), (".svg", b"<?xml")])
def test_cracks_of_a_deformed_body_as_vectors(tmp_path, figures, suffix, head):
    write_run(tmp_path, frames=3)
    path = plot.plot_cracks(tmp_path, tmp_path / f"a{suffix}", frame=1, deformed=30)
    assert path.read_bytes().startswith(head)
    assert "displacements × 30, t = 1 s" in words(figures[0])


@pytest.mark.parametrize("cells", [(200, 1), (1, 60), (1, 1)])
def test_bodies_of_extreme_shape_without_cracks(tmp_path, figures, cells):
    write_run(tmp_path)
    index = np.stack(np.indices(cells), axis=-1).reshape(-1, 2)
    points, data = plate_frame(index)
    data |= {"normal": 0 * data["normal"], "opening": 0 * data["opening"]}
    with PointCloudWriter.create(tmp_path / "result.vtkhdf", FIELDS) as writer:
        writer.write(0.0, points, data)
    assert max(png_size(plot.plot_cracks(tmp_path))) < 1800
    assert "no cracks" in words(figures[0]) and "opening" not in words(figures[0])


def test_a_body_that_cannot_crack_is_not_said_to_have_no_cracks(tmp_path, figures):
    write_run(tmp_path, summary={"can_crack": False})
    points, data = plate_frame(np.stack(np.indices((2, 2)), axis=-1).reshape(-1, 2))
    data |= {"normal": 0 * data["normal"], "opening": 0 * data["opening"]}
    with PointCloudWriter.create(tmp_path / "result.vtkhdf", FIELDS) as writer:
        writer.write(0.0, points, data)
    plot.plot_cracks(tmp_path)
    assert "no cracks" not in words(figures[0])


def test_bands_that_are_all_closed_need_no_colour_bar(tmp_path, figures):
    write_run(tmp_path)
    points, data = plate_frame(notched_plate())
    data["opening"] = -data["opening"]
    with PointCloudWriter.create(tmp_path / "result.vtkhdf", FIELDS) as writer:
        writer.write(0.0, points, data)
    plot.plot_cracks(tmp_path)
    assert "opening" not in words(figures[0])


def test_points_that_are_no_plane_grid_are_refused():
    with pytest.raises(ResultError, match="cell centres of a grid of 2 mm"):
        find_body(np.array([[0.0, 0, 0], [2, 0, 0], [5, 0, 0]]), 2.0)
    with pytest.raises(ResultError, match="plane"):
        find_body(np.array([[0.0, 0, 0], [0, 0, 2]]), 2.0)
    with pytest.raises(ResultError, match="plane"):
        find_body(np.zeros((0, 3)), 2.0)


def test_importing_the_room_loads_neither_jax_nor_matplotlib():
    code = (
        "import sys, jaxmpm.results, jaxmpm.vtkhdf, jaxmpm.plot, jaxmpm.animate\n"
        "assert not {'jax', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_drawing_leaves_pyplot_alone(tmp_path):
    write_run(tmp_path)
    code = (
        "import sys, jaxmpm.plot as p, jaxmpm.animate as a\n"
        f"[draw({str(tmp_path)!r}) for draw in (p.plot_response, p.plot_cracks, a.animate)]\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
