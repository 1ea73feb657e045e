"""Animations of made-up runs: as many frames as the results, of one size and one scale."""

import flying_halves as halves
import numpy as np
import pytest
from PIL import Image

from jaxmpm import animate, cli, results
from jaxmpm.plot_fields import FIELDS
from jaxmpm.results import ResultError, write_summary
from jaxmpm.vtkhdf import PointCloudWriter


def write_block(directory, stretches=(0.0, 0.01, 0.03)):
    """A block of 6 x 4 cells of 5 mm in the total frame, ever more stretched, cracked at last."""
    fields = {name: size for name, size in halves.FIELDS.items() if name not in ("side", "velocity")}
    centres = 5.0 * (np.stack(np.indices((6, 4)), axis=-1).reshape(-1, 2) + 0.5)
    points = np.pad(centres, ((0, 0), (0, 1)))
    with PointCloudWriter.create(directory / "result.vtkhdf", fields) as writer:
        for k, stretch in enumerate(stretches):
            cracked = (centres[:, 0] == 12.5) & (k > 0)
            data = {
                "displacement": points * (stretch, 0, 0),
                "stress": np.tile([100 * stretch, 0.0, 0.0], (24, 1)),
                "damage": 0.3 * cracked,
                "opening": 0.1 * k * cracked,
                "normal": cracked[:, None] * [1.0, 0, 0],
                "material": np.zeros(24),
            }
            writer.write(0.5 * k, points, data)
    write_summary(directory, {"scene": "block", "title": "Block", "cell_size": 5.0, "status": "completed"})


def gif_frames(path):
    with Image.open(path) as image:
        pauses, frames = [], []
        for k in range(image.n_frames):
            image.seek(k)
            pauses.append(image.info["duration"])
            frames.append(np.asarray(image.convert("RGB")))
    return np.stack(frames).astype(int), pauses


def film_of(directory, monkeypatch, **options):
    """The film that `animate` makes, without the file."""
    films = []
    monkeypatch.setattr(animate, "_write_gif", lambda film, path, fps: films.append(film) or path.touch())
    animate.animate(directory, **options)
    return films[0]


def test_gif_has_every_frame_at_one_size(tmp_path):
    halves.write_halves(tmp_path)
    path = animate.animate(tmp_path, fps=20)
    assert path == tmp_path / "cracks.gif" and not list(tmp_path.glob("*.part"))
    frames, pauses = gif_frames(path)
    assert len(frames) == len(halves.TIMES) and pauses == [50] * 4 + [1000]
    height, width = frames.shape[1:3]
    assert 300 < height < 1000 and 600 < width < 1000 and height % 2 == width % 2 == 0
    assert path.stat().st_size < 500_000
    assert all((one != other).any() for one, other in zip(frames[:-1], frames[1:], strict=True))


def test_what_does_not_move_is_the_same_in_every_frame_of_a_gif(tmp_path):
    halves.write_halves(tmp_path)
    frames, _ = gif_frames(animate.animate(tmp_path, field="stress"))
    assert (frames[:, :5] == 255).all()  # the margin is white, not nearly so
    bar = frames[:, 60:, -100:]
    assert (bar == bar[0]).all() and np.ptp(bar) > 100


def test_gif_shows_what_was_drawn(tmp_path, monkeypatch):
    halves.write_halves(tmp_path)
    path = animate.animate(tmp_path, field="displacement")
    shown, _ = gif_frames(path)
    film = film_of(tmp_path, monkeypatch, field="displacement")
    drawn = np.stack(list(film)).astype(int)
    assert drawn.shape == shown.shape
    assert np.abs(drawn - shown).mean() < 1


def test_axes_and_colours_span_all_frames(tmp_path, monkeypatch):
    halves.write_halves(tmp_path)
    film = film_of(tmp_path, monkeypatch, field="speed")
    speed, seen = np.hypot(*halves.FLIGHT), []
    for k, when in enumerate(halves.TIMES):
        film.draw(k)
        place, _ = halves.flying(halves.points_of(when)[0], when)
        (left, right), (bottom, top) = film.axes.get_xlim(), film.axes.get_ylim()
        assert left < place[:, 0].min() and place[:, 0].max() < right
        assert bottom < place[:, 1].min() and place[:, 1].max() < top
        squares = film.axes.collections[1]
        assert squares.get_clim() == pytest.approx((0, speed))
        seen.append((left, right, bottom, top, len(film.axes.collections)))
        texts = [text.get_text() for text in film.axes.texts]
        assert texts == [f"t = {1e3 * when:.0f} ms", "A strip in two halves"]
    assert len(set(seen)) == 2  # no cracks in the first, nothing left over from frame to frame
    assert len(squares.get_paths()) == len(place)


def test_cracks_keep_their_colours_through_the_frames(tmp_path, monkeypatch):
    halves.write_halves(tmp_path)
    film = film_of(tmp_path, monkeypatch)
    widest = halves.frame_of(halves.TIMES[-1])[1]["opening"].max()
    for k in (1, 4):
        film.draw(k)
        lines = film.axes.collections[-1]
        assert lines.get_clim() == pytest.approx((0, widest))
        assert lines.get_array().max() == pytest.approx(widest * halves.TIMES[k] / halves.TIMES[-1])


def test_the_total_frame_is_animated_deformed(tmp_path, monkeypatch):
    write_block(tmp_path)
    path = animate.animate(tmp_path, deformed=10)
    assert path == tmp_path / "deformed.gif" and len(gif_frames(path)[0]) == 3
    film = film_of(tmp_path, monkeypatch, deformed=10, field="stress")
    for k, stretch in enumerate((0.0, 0.01, 0.03)):
        film.draw(k)
        mesh = film.axes.collections[0]
        assert mesh.get_array().compressed() == pytest.approx(100 * stretch, abs=1e-5)
        # Nodes at the edge move as the cells beside them.
        assert mesh.get_coordinates()[-1, 0, 0] == pytest.approx(30 + 10 * stretch * 27.5, rel=1e-6)
        assert film.axes.texts[0].get_text() == f"displacements × 10, t = {0.5 * k:.1f} s"
        assert mesh.get_clim() == pytest.approx((0, 3), abs=1e-5)
    assert film.axes.get_xlim()[1] > 30 + 10 * 0.03 * 27.5


@pytest.mark.parametrize("field", FIELDS)
def test_every_field_of_moving_points_can_be_animated(tmp_path, monkeypatch, field):
    halves.write_halves(tmp_path)
    film = film_of(tmp_path, monkeypatch, field=field)
    assert len(film) == 5 and film[0].shape == film[4].shape and film[2].dtype == np.uint8
    label = "opening [mm]" if field == "material" else FIELDS[field].label
    assert film.axes.child_axes[0].get_ylabel() == label


def test_a_run_without_cracks_and_with_one_frame(tmp_path):
    halves.write_halves(tmp_path, times=[0.0])
    assert len(gif_frames(animate.animate(tmp_path))[0]) == 1


@pytest.mark.parametrize(
    "times, words",
    [
        ([0, 0.5, 1.0], ["t = 0.0 s", "t = 0.5 s", "t = 1.0 s"]),
        ([0, 2, 4], ["t = 0 s", "t = 2 s", "t = 4 s"]),
        ([0, 0.00025, 0.0005], ["t = 0.00 ms", "t = 0.25 ms", "t = 0.50 ms"]),
        ([0, 1e-6, 2e-5], ["t = 0 µs", "t = 1 µs", "t = 20 µs"]),
        ([0], ["t = 0 s"]),
        ([0, 5 / 60, 10 / 60], ["t = 0.00 s", "t = 0.08 s", "t = 0.17 s"]),
    ],
)
def test_times_are_told_apart(times, words):
    assert animate.clock(np.array(times, float)) == words


@pytest.mark.parametrize(
    "options, message",
    [
        ({"fps": 0}, "fps = 0: expected 0.1 to 50 frames a second"),
        ({"fps": float("nan")}, "fps = nan: expected 0.1 to 50"),
        ({"field": "sped"}, r'field = "sped": expected one of material, .* \(did you mean "speed"\?\)'),
        ({"deformed": float("inf")}, "deformed = inf: expected a finite factor"),
        ({"path": "a.avi"}, 'format = "avi": expected gif or mp4'),
    ],
)
def test_bad_options_name_themselves(tmp_path, options, message):
    halves.write_halves(tmp_path, times=halves.TIMES[:2])
    with pytest.raises(ResultError, match=message):
        animate.animate(tmp_path, **options)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["result.vtkhdf", results.SUMMARY]


def test_broken_results_say_so(tmp_path):
    halves.write_halves(tmp_path)
    path = tmp_path / "result.vtkhdf"
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(ResultError, match="result.vtkhdf: cannot be opened"):
        animate.animate(tmp_path)
    with PointCloudWriter.create(path, {"displacement": 3}):
        pass
    with pytest.raises(ResultError, match="has no frame"):
        animate.animate(tmp_path)
    write_block(tmp_path)
    write_summary(tmp_path, {"scene": "block"})
    with pytest.raises(ResultError, match="cell_size = None: expected more than 0 mm"):
        animate.animate(tmp_path)


def test_mp4_needs_ffmpeg(tmp_path, monkeypatch, capsys):
    halves.write_halves(tmp_path, times=halves.TIMES[:2])
    monkeypatch.setenv("PATH", str(tmp_path))
    assert cli.main(["plot", str(tmp_path), "--animate", "--format", "mp4"]) == cli.BAD_INPUT
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and 'format = "mp4"' in error and "ffmpeg" in error


def tool(directory, script):
    """A stand-in for ffmpeg, the only program on the PATH that is returned."""
    program = directory / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    return f"{program.parent}:/bin:/usr/bin"


def test_mp4_is_made_of_all_pixels(tmp_path, monkeypatch):
    halves.write_halves(tmp_path)
    keep = 'for last; do :; done\nprintf "%s " "$@" > "$0.said"\ncat > "$last"'
    monkeypatch.setenv("PATH", tool(tmp_path, keep))
    path = animate.animate(tmp_path, tmp_path / "cracks.mp4", fps=24)
    said = (tmp_path / "bin" / "ffmpeg.said").read_text().split()
    width, height = map(int, said[said.index("-video_size") + 1].split("x"))
    assert said[said.index("-framerate") + 1] == "24"
    pixels = np.frombuffer(path.read_bytes(), np.uint8).reshape(-1, height, width, 3)
    assert len(pixels) == 5
    film = film_of(tmp_path, monkeypatch)
    assert (pixels[3] == film[3]).all()


def test_what_ffmpeg_says_is_passed_on(tmp_path, monkeypatch):
    halves.write_halves(tmp_path)
    monkeypatch.setenv("PATH", tool(tmp_path, "echo no such encoder >&2; exit 1"))
    with pytest.raises(ResultError, match="ffmpeg: no such encoder"):
        animate.animate(tmp_path, tmp_path / "cracks.mp4")
    assert not list(tmp_path.glob("cracks*"))


def test_command_line(tmp_path, capsys):
    halves.write_halves(tmp_path, times=halves.TIMES[:3])
    run = lambda *options: cli.main(["plot", str(tmp_path), *options])  # noqa: E731
    assert run("--animate", "--field", "damage", "--fps", "5") == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "damage.gif")
    assert gif_frames(tmp_path / "damage.gif")[1][:2] == [200, 200]
    assert run("--field", "damage", "--frame", "1", "--deformed", "2") == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "damage_deformed.png")
    for options, words in (
        (("--fps", "5"), "--fps = 5: expected only with --animate"),
        (("--animate", "--frame", "0"), "--frame = 0: expected none with --animate"),
        (("--animate", "--format", "png"), "--format = png: expected gif or mp4 with --animate"),
        (("--format", "gif"), "--format = gif: expected png, pdf or svg without --animate"),
        (("--animate", "--fps", "90"), "fps = 90: expected 0.1 to 50"),
        (("--frame", "9"), "no frame 9 among its 3 frames"),
    ):
        assert run(*options) == cli.BAD_INPUT
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1
