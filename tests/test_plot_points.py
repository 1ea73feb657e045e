"""Pictures of points that move, on a made-up strip whose right half flies off and spins."""


import flying_halves as halves
import numpy as np
import pytest

from jaxmpm import plot, plot_points, plot_style
from jaxmpm.plot_points import find_squares, turns
from jaxmpm.results import ResultError


def squares_in(axes):
    from matplotlib.collections import PolyCollection

    rims, below, squares = (each for each in axes.collections if isinstance(each, PolyCollection))
    corners = lambda drawn: np.array([path.vertices[:4] for path in drawn.get_paths()])  # noqa: E731
    assert corners(rims) == pytest.approx(corners(below)) and rims.zorder < below.zorder < squares.zorder
    assert corners(below).mean(axis=1) == pytest.approx(corners(squares).mean(axis=1))
    return squares, corners(squares)


def cracks_in(axes):
    from matplotlib.collections import LineCollection

    return [each for each in axes.collections if isinstance(each, LineCollection)]


@pytest.mark.parametrize("k", range(len(halves.TIMES)))
def test_every_point_is_a_square_of_its_side_where_it_is(tmp_path, figures, k):
    halves.write_halves(tmp_path)
    plot.plot_cracks(tmp_path, frame=k)
    squares, corners = squares_in(figures[0].axes[0])
    home, side = halves.points_of(halves.TIMES[k])
    place, angle = halves.flying(home, halves.TIMES[k])
    assert len(corners) == (72 if k < 2 else 6 + 4 * 66)
    assert corners.mean(axis=1) == pytest.approx(place, abs=1e-4)
    edge = np.roll(corners, -1, axis=1) - corners
    assert np.linalg.norm(edge, axis=2) == pytest.approx(np.repeat(side[:, None], 4, axis=1))
    x, y = edge[:, 0].T
    area = x * edge[:, 1, 1] - y * edge[:, 1, 0]
    assert area == pytest.approx(side**2)
    turned = np.exp(1j * (np.arctan2(y, x) - angle))
    assert turned == pytest.approx(np.ones(len(side)), abs=1e-3)


def test_materials_have_muted_colours_and_axes_show_what_flies(tmp_path, figures):
    from matplotlib.colors import to_rgba

    halves.write_halves(tmp_path)
    path = plot.plot_cracks(tmp_path)
    assert path == tmp_path / "cracks.png" and path.stat().st_size > 5000
    axes = figures[0].axes[0]
    squares, corners = squares_in(axes)
    squares.update_scalarmappable()
    upper = halves.points_of(halves.TIMES[-1])[0][:, 1] > halves.NY * halves.CELL / 2
    wanted = np.array([to_rgba(plot_style.PHASES[each]) for each in upper.astype(int)])
    assert squares.get_facecolors() == pytest.approx(wanted)
    for limits, seen in zip((axes.get_xlim(), axes.get_ylim()), corners.reshape(-1, 2).T, strict=True):
        assert limits[0] < seen.min() and seen.max() < limits[1]
    assert axes.get_xlim()[1] > halves.CENTRE[0] + halves.FLIGHT[0] * 0.015
    box, (x, y) = axes.get_window_extent(), (axes.get_xlim(), axes.get_ylim())
    assert box.width / np.ptp(x) == pytest.approx(box.height / np.ptp(y))


def test_cracks_cross_their_points_perpendicular_to_the_normal(tmp_path, figures):
    halves.write_halves(tmp_path)
    plot.plot_cracks(tmp_path)
    faint, main = cracks_in(figures[0].axes[0])
    segments = np.array(main.get_segments())
    points, data = halves.frame_of(halves.TIMES[-1])
    order = np.argsort(data["opening"])[-halves.NY :]
    assert len(faint.get_segments()) == 0 and len(segments) == halves.NY
    assert np.asarray(main.get_array()) == pytest.approx(data["opening"][order], rel=1e-6)
    along = segments[:, 1] - segments[:, 0]
    assert (along * data["normal"][order, :2]).sum(axis=1) == pytest.approx(0, abs=1e-5)
    assert segments.mean(axis=1) == pytest.approx(points[order, :2], abs=1e-5)
    # These points have not turned: the segments end on the sides of upright squares.
    assert np.abs(along).max(axis=1) == pytest.approx(halves.CELL, rel=1e-5)
    assert figures[0].axes[0].child_axes[0].get_ylabel() == "opening [mm]"


def test_segments_of_a_turned_point_end_on_its_own_sides():
    angle, tilt, side = 0.6, 0.25, 2.0
    squares = plot_points.Squares(np.array([[3.0, 4.0]]), np.array([side]), np.array([angle]), np.zeros(1))
    normal = np.array([[np.cos(angle + tilt), np.sin(angle + tilt), 0.0]])
    cracked, segments = squares.crack_segments(normal)
    length = np.linalg.norm(segments[0, 1] - segments[0, 0])
    assert list(cracked) == [0] and length == pytest.approx(side / np.cos(tilt))


def test_turning_is_found_for_pieces_parts_of_cells_and_lone_points():
    rng = np.random.default_rng(2)
    home = 0.5 + np.stack(np.indices((8, 8)), axis=-1).reshape(-1, 2).astype(float)
    home = np.concatenate([home, [[6.25, 4.25]]])  # a part of a cell, with no like beside it
    side = np.append(np.ones(64), 0.5)
    angle = np.where(home[:, 0] > 4, 2.5, -1.0)
    cos, sin = np.cos(angle), np.sin(angle)
    moved = np.stack([cos * home[:, 0] - sin * home[:, 1], sin * home[:, 0] + cos * home[:, 1]], axis=1)
    moved += rng.uniform(-1e-3, 1e-3, moved.shape)
    assert turns(home, moved, side) == pytest.approx(angle, abs=5e-3)
    assert turns(home, home, side) == pytest.approx(0)
    scattered = rng.uniform(0, 100, (65, 2))
    assert np.isfinite(turns(home, scattered, side)).all()
    assert turns(home[:1], moved[:1], side[:1]) == pytest.approx(0)


def test_displacements_of_moving_points_can_be_drawn_smaller():
    points, data = halves.frame_of(halves.TIMES[-1])
    there = find_squares(points, data["displacement"], data["side"])
    home, _ = halves.points_of(halves.TIMES[-1])
    at_home = find_squares(points, data["displacement"], data["side"], 0.0)
    assert at_home.centre == pytest.approx(home) and at_home.turn == pytest.approx(0)
    assert there.centre == pytest.approx(points[:, :2])
    # A crack turns back with its square: its angle to the square stays.
    normal = np.tile([[np.cos(0.4), np.sin(0.4), 0.0]], (len(points), 1))
    _, back = at_home.crack_segments(normal)
    along = back[:, 1] - back[:, 0]
    angle = there.turn - 0.4
    assert along @ [1, 0] * np.cos(angle) == pytest.approx(along @ [0, 1] * np.sin(angle), abs=1e-6)


@pytest.mark.parametrize(
    "field, label, value",
    [
        ("stress", "first principal stress [MPa]", lambda data: data["stress"][:, 0]),
        ("speed", "speed [mm/s]", lambda data: np.hypot(*data["velocity"][:, :2].T)),
        ("displacement", "displacement [mm]", lambda data: np.hypot(*data["displacement"][:, :2].T)),
        ("opening", "opening [mm]", lambda data: data["opening"]),
        ("damage", "damage", lambda data: data["damage"]),
    ],
)
def test_a_field_colours_the_points(tmp_path, figures, field, label, value):
    halves.write_halves(tmp_path)
    path = plot.plot_cracks(tmp_path, field=field)
    assert path == tmp_path / f"{field}.png"
    axes = figures[0].axes[0]
    squares, _ = squares_in(axes)
    wanted = value(halves.frame_of(halves.TIMES[-1])[1])
    assert np.asarray(squares.get_array()) == pytest.approx(wanted, rel=1e-5, abs=1e-5)
    assert axes.child_axes[0].get_ylabel() == label
    assert len(cracks_in(axes)) == (0 if field in ("opening", "damage") else 1)
    low, high = squares.get_clim()
    assert low == (0.0 if field != "stress" else pytest.approx(wanted.min(), abs=0.01))
    assert high == (1.0 if field == "damage" else pytest.approx(wanted.max(), rel=0.01))


def test_many_points_are_drawn_as_a_few_collections(tmp_path):
    """An artist for each would take minutes."""
    count = 450
    home = 0.1 * np.stack(np.indices((count, count)), axis=-1).reshape(-1, 2)
    squares = find_squares(home, 0 * home, np.full(len(home), 0.1))
    from matplotlib.colors import Normalize

    with plot_style.styled_figure() as figure:
        axes = plot_style.frame_axes(figure, *squares.extent())
        before = len(axes.get_children())
        drawn = squares.draw(axes, home[:, 0], plot_style.shades("GnBu", 0, 1), Normalize(0, 45))
        plot_style.save(figure, tmp_path / "many.png")
        assert len(drawn) == len(axes.get_children()) - before == 3 and len(drawn[-1].get_paths()) == count**2
    assert (tmp_path / "many.png").stat().st_size > 500


@pytest.mark.parametrize(
    "drop, changed, message",
    [
        (("velocity",), {}, 'field = "speed": expected one of material, stress, displacement, .*no velocity'),
        (("normal", "opening"), {}, "has no opening, normal"),
        ((), {"side": lambda side: 0 * side}, "side = 0 of a point: expected more than 0 mm"),
        ((), {"displacement": lambda u: u * np.nan}, "displacement that are not finite"),
    ],
)
def test_results_that_cannot_be_drawn_say_why(tmp_path, drop, changed, message):
    halves.write_halves(tmp_path, drop=drop, **changed)
    with pytest.raises(ResultError, match=message):
        plot.plot_cracks(tmp_path, field="speed")


def test_points_off_a_plane_are_refused():
    points = np.array([[0.0, 0, 0], [0, 0, 2]])
    with pytest.raises(ResultError, match="moving points needs those of a plane body"):
        find_squares(points, 0 * points, np.ones(2))


def test_points_a_little_apart_show_no_rim_between():
    """A gap of a twentieth of a side is closed by what is below; the outline stays."""
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    points = np.array([[0.0, 0.0], [1.05, 0.0]])
    squares = find_squares(points, 0 * points, np.ones(2))
    axes = Figure().add_subplot()
    rims, below, faces = squares.draw(axes, np.zeros(2), plot_style.shades("GnBu", 0, 1), Normalize(0, 1))
    assert rims.get_zorder() < below.get_zorder() < faces.get_zorder()
    left, right = (path.vertices[:, 0] for path in below.get_paths())
    assert left.max() > right.min()
