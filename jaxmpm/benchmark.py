"""Times a scene over cell sizes: ms per step, cell-steps per second, memory."""

import resource
import tempfile
from collections.abc import Callable, Sequence

from jaxmpm.run import run_scene
from jaxmpm.scene import load_scene


def run(
    name: str,
    cells: Sequence[float],
    overrides: Sequence[str] = (),
    show: Callable[[str], None] | None = None,
) -> list[dict]:
    """Run a scene on each cell size (mm); returns a row of figures for each.

    `memory_mb` is the largest resident memory of the process so far, so give cells from coarse
    to fine.
    """
    rows = []
    line = "{:>8}{:>9}{:>9}{:>9}{:>10}{:>10}{:>9}{:>14}{:>9}{:>10}{:>11}"
    keys = ("cell_size", "cells", "cracked", "steps", "peak_load", "run_seconds",
            "ms_per_step", "cell_steps_per_second", "compile_seconds", "memory_mb",
            "energy_error")  # fmt: skip
    head = ("cell mm", "cells", "cracked", "steps", "peak kN", "run s", "ms/step",
            "M cell-steps/s", "comp. s", "memory MB", "energy err")  # fmt: skip
    if show:
        show(line.format(*head))
    for cell in cells:
        scene = load_scene(name, [*overrides, f"grid.cell={cell}"])
        with tempfile.TemporaryDirectory() as directory:
            summary = run_scene(scene, directory, progress=False)
        peak_memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        row = {key: (summary | {"memory_mb": peak_memory}).get(key) for key in keys}
        rows.append(row)
        if show:
            show(line.format(
                f"{cell:g}", row["cells"], row["cracked"], row["steps"],
                f"{row['peak_load'] / 1e3:.3f}" if row["peak_load"] else "-",
                f"{row['run_seconds']:.1f}", f"{row['ms_per_step']:.3f}",
                f"{row['cell_steps_per_second'] / 1e6:.1f}", f"{row['compile_seconds']:.1f}",
                f"{row['memory_mb']:.0f}", f"{row['energy_error']:.1e}",
            ))  # fmt: skip
    return rows
