"""Progress of a run: a line that rewrites itself on a terminal, plain lines elsewhere."""

import sys
import time

BAR = 24  # characters


class Progress:
    """Shows displacement, load, cracked cells, energy error and the time left."""

    def __init__(self, wanted: bool = True, stream=None):
        self.stream = stream or sys.stderr
        self.wanted = wanted
        self.terminal = self.stream.isatty()
        self.tenth = -1
        self.open = False

    def start(self, recorder) -> None:
        """Say what is about to run."""
        self.began, self.first = time.perf_counter(), recorder.done
        if not self.wanted:
            return
        sim, scene = recorder.sim, recorder.scene
        if recorder.done >= 0 and recorder.complete:
            print(f"{scene.name}: {recorder.directory} is already complete, nothing is left to run", file=self.stream)
            return
        cells = int((sim.layout.material >= 0).sum())
        print(
            f"{scene.name}: {cells} cells of {scene.grid.cell:g} mm, "
            + (
                f"in equilibrium, control by {scene.solver.control}, "
                if recorder.static
                else f"{sim.steps} steps of {sim.dt:.3g} s ({scene.solver.time_step_factor:g} of the stable {sim.stable_dt:.3g} s), "
            )
            + f"{scene.solver.precision}"
            + (f", resumed at sample {recorder.done + 1}" if recorder.done >= 0 else ""),
            file=self.stream,
        )

    def say(self, text: str) -> None:
        """A line that stays."""
        if self.wanted:
            self.close()
            print(text, file=self.stream, flush=True)

    def show(self, recorder) -> None:
        """Show where the run is."""
        if not self.wanted:
            return
        total, done = recorder.scene.output.samples, recorder.done
        if recorder.static and recorder.sim.open_ended:
            total, done = 1.0, recorder.sim.follower.time / recorder.scene.solver.duration
        share = done / total
        if not self.terminal:
            if int(10 * share) == self.tenth:
                return
            self.tenth = int(10 * share)
        passed = time.perf_counter() - self.began
        left = passed * (total - done) / max(done - max(self.first, 0), 1e-3 if total == 1.0 else 1)
        row = dict(zip((name for name, _ in recorder.columns), recorder.rows[-1], strict=True))
        text = f"{share:4.0%}"
        if recorder.scene.response:
            names, (load, displacement) = recorder.scene.response, recorder.units()
            text += f"  {written(row[names.displacement], displacement)}  {written(row[names.load], load):>11}"
        if recorder.can_crack:
            text += f"  {row['cracked']} cracked"
        text += f"  energy error {row['energy_error']:.1e}  {left:.0f} s left"
        if self.terminal:
            filled = round(BAR * share)
            bar = "█" * filled + "·" * (BAR - filled)
            print(f"\r\033[K{bar} {text}", end="", file=self.stream, flush=True)
            self.open = True
        else:
            print(text, file=self.stream, flush=True)

    def close(self) -> None:
        """End the line."""
        if self.open:
            print(file=self.stream)
            self.open = False


def written(value: float, unit: str) -> str:
    """A number of the response, as exact as its unit deserves: N, mm, MPa or a strain."""
    return {"N": f"{value:.1f} N", "mm": f"{value:.4f} mm", "MPa": f"{value:.3f} MPa"}.get(unit, f"{value:.3e}")
