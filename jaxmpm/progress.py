"""Progress of a run: a line that rewrites itself on a terminal, a bar in a notebook, plain lines elsewhere."""

import sys
import time
from html import escape

BAR = 24  # characters
PAUSE = 0.2  # s between two looks at a bar in a notebook, whose every change is a message


class Progress:
    """Shows displacement, load, cracked cells, energy error and the time left."""

    def __init__(self, wanted: bool = True, stream=None):
        self.wanted = wanted
        self.screen = screen(stream)

    def start(self, recorder) -> None:
        """Say what is about to run."""
        self.began, self.first = time.perf_counter(), recorder.done
        if not self.wanted:
            return
        sim, scene = recorder.sim, recorder.scene
        if recorder.done >= 0 and recorder.complete:
            self.screen.line(f"{scene.name}: {recorder.directory} is already complete, nothing is left to run")
            return
        cells = int((sim.layout.material >= 0).sum())
        self.screen.line(
            f"{scene.name}: {cells} cells of {scene.grid.cell:g} mm, "
            + (
                f"in equilibrium, control by {scene.solver.control}, "
                if recorder.static
                else f"{sim.steps} steps of {sim.dt:.3g} s ({scene.solver.time_step_factor:g} of the stable {sim.stable_dt:.3g} s), "
            )
            + f"{scene.solver.precision}"
            + (f", resumed at sample {recorder.done + 1}" if recorder.done >= 0 else "")
            + (f", half of the scene (grid.half = \"{scene.grid.half}\")" if scene.grid.half else "")
        )
        if recorder.offer and recorder.done < 0:
            self.screen.line(recorder.offer)

    def say(self, text: str) -> None:
        """A line that stays."""
        if self.wanted:
            self.screen.line(text)

    def show(self, recorder) -> None:
        """Show where the run is."""
        if not self.wanted:
            return
        total, done = recorder.scene.output.samples, recorder.done
        if recorder.static and recorder.sim.open_ended:
            total, done = 1.0, recorder.sim.follower.time / recorder.scene.solver.duration
        passed = time.perf_counter() - self.began
        left = passed * (total - done) / max(done - max(self.first, 0), 1e-3 if total == 1.0 else 1)
        row = dict(zip((name for name, _ in recorder.columns), recorder.rows[-1], strict=True))
        text = f"{done / total:4.0%}"
        if recorder.scene.response:
            names, (load, displacement) = recorder.scene.response, recorder.units()
            text += f"  {written(row[names.displacement], displacement)}  {written(row[names.load], load):>11}"
        if recorder.can_crack:
            text += f"  {row['cracked']} cracked"
        text += f"  energy error {row['energy_error']:.1e}  {left:.0f} s left"
        self.screen.bar(done / total, text)

    def close(self) -> None:
        """Nothing more is to come."""
        self.screen.close()


def screen(stream=None):
    """Where progress is shown: the notebook that runs this, else a stream, stderr if None."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if stream is None and hasattr(shell, "kernel"):  # which the shell in a terminal has not
        return Notebook()
    stream = stream or sys.stderr
    return Terminal(stream) if stream.isatty() else Lines(stream)


class Lines:
    """Plain lines, one for every tenth."""

    def __init__(self, stream):
        self.stream, self.tenth = stream, -1

    def line(self, text: str) -> None:
        """A line that stays."""
        print(text, file=self.stream, flush=True)

    def bar(self, share: float, text: str) -> None:
        """Where it is, from 0 to 1."""
        if int(10 * share) != self.tenth:
            self.tenth = int(10 * share)
            self.line(text)

    def close(self) -> None:
        """Nothing more is to come."""


class Terminal:
    """A bar in a line that is written over and over."""

    def __init__(self, stream):
        self.stream, self.open = stream, False

    def line(self, text: str) -> None:
        """A line that stays."""
        self.close()
        print(text, file=self.stream, flush=True)

    def bar(self, share: float, text: str) -> None:
        """Where it is, from 0 to 1."""
        filled = round(BAR * share)
        bar = "█" * filled + "·" * (BAR - filled)
        print(f"\r\033[K{bar} {text}", end="", file=self.stream, flush=True)
        self.open = True

    def close(self) -> None:
        """End the line."""
        if self.open:
            print(file=self.stream)
            self.open = False


class Notebook:
    """A bar below the cell, and above it the lines that stay: one output that changes in place."""

    def __init__(self):
        self.lines: list[str] = []
        self.handle, self.state, self.shown = None, None, 0.0

    def line(self, text: str) -> None:
        """A line that stays."""
        self.lines.append(text)
        self._show()

    def bar(self, share: float, text: str) -> None:
        """Where it is, from 0 to 1."""
        self.state = share, text
        if time.perf_counter() - self.shown > PAUSE:
            self._show()

    def close(self) -> None:
        """Show the last of it."""
        if self.state:
            self._show()
            self.state = None

    def _show(self):
        from IPython.display import display

        self.shown = time.perf_counter()
        text, marks = list(self.lines), [f"<div>{escape(line)}</div>" for line in self.lines]
        if self.state:
            share, words = self.state
            text.append(words.strip())
            marks.append(f'<div><progress value="{share:.4f}" max="1"></progress> {escape(words.strip())}</div>')
        data = {"text/plain": "\n".join(text), "text/html": "".join(marks)}
        if self.handle is None:
            self.handle = display(data, raw=True, display_id=True)
        else:
            self.handle.update(data, raw=True)


def written(value: float, unit: str) -> str:
    """A number of the response, as exact as its unit deserves: N, mm, MPa or a strain."""
    return {"N": f"{value:.1f} N", "mm": f"{value:.4f} mm", "MPa": f"{value:.3f} MPa"}.get(unit, f"{value:.3e}")
