"""Checks of the representative volume: two meshes of one structure, slower loading, localisation."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jaxmpm.verify_points import row

LATE = 4e-4  # strain at which dissipated energies are compared: the crack bears nothing any more
INTERFACE, MATRIX = 1.5, 2.0  # strengths, MPa


def _run(directory, *changes):
    from jaxmpm.results import read_history
    from jaxmpm.run import run_scene
    from jaxmpm.scene import load_scene

    summary = run_scene(load_scene("rve", changes), Path(directory), progress=False)
    return summary, read_history(Path(directory) / "history.csv")


def _spent(history):
    return float(np.interp(LATE, history["strain"], history["dissipated_energy"]))


def rve(cell=0.25) -> Iterator[dict]:
    """Cells half as large see the same stones; loading twice as slow asks for nearly the same peak."""
    from jaxmpm.stages import find_stages

    with tempfile.TemporaryDirectory() as directory:
        coarse, history = _run(Path(directory) / "coarse", f"grid.cell={cell}")
        stages = find_stages(Path(directory) / "coarse")
        peak, spent = coarse["peak_load"], _spent(history)
        yield row("rve, energy balance", coarse["largest_energy_error"], 0.0, 0.01)
        middle = (INTERFACE + MATRIX) / 2
        yield row("rve, peak between those of interface and matrix", peak, middle, (MATRIX - INTERFACE) / 2 / middle)
        at_peak = max(range(len(stages)), key=lambda k: stages[k].load)
        yield row("rve, share of opening in the final crack, before", stages[at_peak - 1].share_of_opening, 0.0, 0.5)
        yield row("rve, share of opening in the final crack, after", stages[at_peak + 1].share_of_opening, 1.0, 0.2)
        fine, history = _run(Path(directory) / "fine", f"grid.cell={cell / 2}", "output.frames=2")
        yield row("rve, peak of half the cell", fine["peak_load"], peak, 0.02)
        yield row("rve, energy spent of half the cell", _spent(history), spent, 0.08)
        slow, _ = _run(Path(directory) / "slow", f"grid.cell={cell}", "parameters.time=2e-3", "output.frames=2")
        yield row("rve, peak twice as slow", slow["peak_load"], peak, 0.01)
