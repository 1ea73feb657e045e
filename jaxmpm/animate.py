"""All frames of a run as one animation: a GIF, or an MP4 where there is ffmpeg."""

from __future__ import annotations

import contextlib
import functools
import io
import math
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmpm.errors import written
from jaxmpm.plot import picture_name
from jaxmpm.plot_fields import Field, find_field, opening_colours
from jaxmpm.plot_frame import Frame, draw_bar, draw_frame, load_frame, scale_of
from jaxmpm.plot_style import ACCENT, EDGE, FAINT, PHASES, frame_axes, styled, styled_figure, title
from jaxmpm.results import ResultError, read_summary
from jaxmpm.vtkhdf import read_frames

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

DPI = 100
# Frames a second: a GIF counts in hundredths of a second, and viewers slow down below two.
SLOWEST, FASTEST, USUAL = 0.1, 50.0, 10.0
LAST_SHOWN = 1000  # ms, before a GIF begins again
COLOURS = 255  # of a GIF, less one that stands for "as in the frame before"


def animate(
    directory: str | os.PathLike,
    path: str | os.PathLike | None = None,
    field: str = "material",
    deformed: float | None = None,
    fps: float | None = None,
) -> Path:
    """Draw every frame of a run, on the same axes and colours, and return the animation's path.

    `directory`: of a run; `path`: of the animation (.gif, or .mp4 where there is ffmpeg), None for
    cracks.gif or its like in the directory; `field` and `deformed`: as in `plot.plot_cracks`;
    `fps`: frames a second, 0.1 to 50, None for 10. Raises ResultError for anything else, and where
    the results are missing, broken, not plane or without that field.
    """
    directory = Path(directory)
    path = Path(path or directory / f"{picture_name(field, deformed)}.gif")
    fps = USUAL if fps is None else fps
    write = _writer(path, fps)
    summary = read_summary(directory)
    count, times = read_frames(directory / "result.vtkhdf")
    if not count:
        raise ResultError(f"{directory / 'result.vtkhdf'}: has no frame; nothing to draw")
    load = functools.partial(load_frame, directory, summary=summary, deformed=deformed)
    colouring = find_field(field, load(0).data, directory / "result.vtkhdf")
    film = Film(load, times, colouring, summary, deformed)
    aside = path.with_name(path.name + ".part")
    try:
        write(film, aside, fps)
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)
    return path


class Film:
    """The pictures of a run one after another, each an array (height, width, 3) of bytes.

    All have the same even height and width; `len` tells how many there are, `film[k]` draws one.
    """

    def __init__(
        self,
        load: Callable[[int], Frame],
        times: np.ndarray,
        field: Field,
        summary: dict[str, Any],
        deformed: float | None,
    ):
        self._load, self.field, self._summary = load, field, summary
        self._notes = [] if deformed is None else [f"displacements × {deformed:g}"]
        self._times = clock(times)
        scales = (scale_of(load(k), field) for k in range(len(times)))
        self.scale = functools.reduce(lambda one, other: one.joined(other), scales)
        self._drawn: list = []
        with styled_figure() as self.figure:
            self.figure.set_dpi(DPI)
            self.axes = frame_axes(self.figure, self.scale.low, self.scale.high)
            draw_bar(self.axes, field, self.scale)
        # The last frame has the longest title.
        self.draw(len(times) - 1)
        self._box = _even_box(self.figure)

    def __len__(self) -> int:
        return len(self._times)

    def __iter__(self) -> Iterator[np.ndarray]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, k: int) -> np.ndarray:
        self.draw(k)
        return _pixels(self.figure, self._box)

    def draw(self, k: int) -> None:
        """Put frame `k` into the axes, in the place of the one that is there."""
        for artist in self._drawn:
            artist.remove()
        with styled():
            self._drawn = draw_frame(self.axes, self._load(k), self.field, self.scale)
            self._drawn += title(self.axes, self._summary, [*self._notes, self._times[k]])


def clock(times: np.ndarray) -> list[str]:
    """How to write the times (frames,), in s: one unit, digits to a tenth of the shortest step."""
    longest = np.abs(times).max()
    unit, factor = "s", 1.0
    if 0 < longest < 0.1:
        unit, factor = ("ms", 1e3) if longest >= 1e-4 else ("µs", 1e6)
    scaled = np.asarray(times, float) * factor
    steps = np.diff(scaled)
    limit = 0.1 * steps[steps > 0].min(initial=np.inf)
    fits = (digits for digits in range(7) if np.abs(scaled.round(digits) - scaled).max() < limit)
    digits = next(fits, 6)
    return [f"t = {time:.{digits}f} {unit}" for time in scaled]


def _writer(path: Path, fps: float) -> Callable[[Film, Path, float], None]:
    if not SLOWEST <= fps <= FASTEST:
        raise ResultError(
            f"fps = {fps:g}: expected {SLOWEST:g} to {FASTEST:g} frames a second"
        )
    writers = {".gif": _write_gif, ".mp4": _write_mp4}
    if path.suffix not in writers:
        raise ResultError(
            f"format = {written(path.suffix[1:])}: expected gif or mp4 for an animation"
        )
    if path.suffix == ".mp4" and not shutil.which("ffmpeg"):
        raise ResultError(
            'format = "mp4": expected gif, as ffmpeg, which makes mp4, is not on the PATH '
            "(install it)"
        )
    return writers[path.suffix]


def _even_box(figure: Figure) -> Bbox:
    """The part of the figure, in inches, that holds all that is in it: whole, even pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.transforms import Bbox

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    box = figure.get_tightbbox(canvas.get_renderer()).padded(0.08)
    width, height = (2 * math.ceil(DPI * inches / 2) for inches in box.size)
    # Half a pixel more, so that rounding never takes one away.
    return Bbox.from_bounds(box.x0, box.y0, (width + 0.5) / DPI, (height + 0.5) / DPI)


def _pixels(figure: Figure, box: Bbox) -> np.ndarray:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="rgba", dpi=DPI, bbox_inches=box)
    width, height = (int(DPI * inches) for inches in box.size)
    return np.frombuffer(buffer.getvalue(), np.uint8).reshape(height, width, 4)[..., :3].copy()


def _write_gif(film: Film, path: Path, fps: float) -> None:
    """One set of colours for all frames, so that nothing flickers and what stays costs nothing."""
    from PIL import Image

    palette = Image.new("P", (1, 1))
    palette.putpalette(_palette(film).tobytes())
    images = [
        Image.fromarray(pixels).quantize(palette=palette, dither=Image.Dither.NONE)
        for pixels in film
    ]
    pause = 10 * round(100 / fps)
    pauses = [pause] * (len(images) - 1) + [max(pause, LAST_SHOWN)]
    images[0].save(
        path, format="GIF", save_all=True, append_images=images[1:], duration=pauses, loop=0
    )


def _palette(film: Film) -> np.ndarray:
    """At most COLOURS colours (n, 3), of bytes: those of the maps, and of what is blurred between them."""
    from matplotlib.colors import to_rgba_array
    from PIL import Image

    used = film.field.colours() if film.field.source != "material" else opening_colours()
    known = [to_rgba_array(["white", "black", EDGE, FAINT, ACCENT, *PHASES])]
    known += [used(np.linspace(0, 1, COLOURS // 2))]
    known = np.rint(255 * np.concatenate(known)[:, :3]).astype(np.uint8)
    some = [film[k] for k in sorted({0, len(film) // 2, len(film) - 1})]
    others = Image.fromarray(np.concatenate(some)).quantize(COLOURS - len(known)).getpalette()
    others = np.array(others, np.uint8).reshape(-1, 3)[: COLOURS - len(known)]
    # Pillow takes a colour near to the nearest: white would become something nearly white.
    apart = np.abs(others[:, None].astype(int) - known).max(axis=2).min(axis=1) > 8
    return np.concatenate([known, others[apart]])


def _write_mp4(film: Film, path: Path, fps: float) -> None:
    height, width, _ = film[0].shape
    command = ["ffmpeg", "-y", "-loglevel", "error", "-f", "rawvideo", "-pixel_format", "rgb24"]
    command += ["-video_size", f"{width}x{height}", "-framerate", f"{fps:g}", "-i", "-"]
    # Colours at half the resolution: what every player can show.
    command += ["-pix_fmt", "yuv420p", "-q:v", "3", "-movflags", "+faststart", "-f", "mp4", path]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stderr=pipe) as process:
        # Where ffmpeg ends early, it says itself why.
        with contextlib.suppress(BrokenPipeError):
            for pixels in film:
                process.stdin.write(pixels.tobytes())
        _, said = process.communicate()
    if process.returncode:
        raise ResultError(f"ffmpeg: {said.decode(errors='replace').strip() or 'failed'}")
