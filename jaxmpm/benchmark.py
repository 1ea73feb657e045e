"""Times a scene over cell sizes, or cracked points alone: ms per step, points per second, memory."""

import resource
import tempfile
import time
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import tensor
from jaxmpm.compilation import compiled
from jaxmpm.laws import balance
from jaxmpm.laws.band import Embedding, open_band
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic
from jaxmpm.run import run_scene
from jaxmpm.scene import load_scene


POINTS = 100_000
ONSETS = 20.0  # strain over onset strain at which points are timed: a third of G_F is spent
INCREMENTS = (1e-3, 2e-2)  # strain increments that are timed, as a share of the strain
REPEATS = 5  # the best of so many counts
STATES = {"plane_stress": 3, "plane_strain": 4, "solid": 6}


def points(show: Callable[[str], None] | None = None) -> list[dict]:
    """Time the update of cracked points whose bands all load, float64, 1e-11 of the strength.

    Returns a row of million points per second for each stress state and strain increment:
    `update` (stress, new state, energies, status) and `tangent` (the same and the consistent
    tangent).
    """
    rows, count = [], POINTS
    if show:
        show(f"{count} cracked points, all loading, M points/s")
        show(f"{'':14}{'increment':>10}{'update':>10}{'with tangent':>14}{'tangent costs':>20}")
    for name, size in STATES.items():
        embedding, band, strain = _loading(count, size)
        update, tangent = (
            compiled(jax.jit(function).lower(embedding, band, strain))
            for function in (balance.respond, balance.respond_with_tangent)
        )
        for increment in INCREMENTS:
            ask = (embedding, band, (1 + increment) * strain)
            status = np.asarray(update(*ask).status)
            if not (status == balance.LOADS).all():
                raise RuntimeError(f"not every point loads: {np.bincount(status)}")
            rates = [count / _best(function, ask) / 1e6 for function in (update, tangent)]
            row = {"state": name, "increment": increment, "update": rates[0], "tangent": rates[1]}
            rows.append(row)
            if show:
                cost = rates[0] / rates[1] - 1
                show(f"{name:14}{increment:>10.1%}{rates[0]:>10.2f}{rates[1]:>14.2f}{cost:>17.1f} ×")
    return rows


def _loading(count, size):
    """Random normals in the paper's concrete, pulled until a good part of G_F is spent."""
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(tensor.DIMENSION[size], count))
    normal = jnp.asarray(normal / np.linalg.norm(normal, axis=0))
    embedding = Embedding(Elastic(32000.0, 0.2), Damage(3.0, 8.184, 0.128, 0.05))
    onset = tensor.along(normal, size) * (3.0 / 32000.0)
    band = open_band(embedding, onset, normal, jnp.asarray(rng.uniform(1.0, 5.0, count)))
    respond = jax.jit(balance.respond)
    for times in np.geomspace(1.01, ONSETS, 40):
        band = respond(embedding, band, times * onset).band
    return embedding, band, ONSETS * onset


def _best(function, arguments):
    """Shortest time of a call, s."""
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - began)
    return min(times)


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
    scenes = [load_scene(name, [*overrides, f"grid.cell={cell}"]) for cell in cells]
    rows = []
    line = "{:>8}{:>9}{:>9}{:>9}{:>10}{:>10}{:>9}{:>16}{:>9}{:>11}{:>12}"
    keys = ("cell_size", "cells", "cracked", "steps", "peak_load", "run_seconds",
            "ms_per_step", "cell_steps_per_second", "compile_seconds", "memory_mb",
            "energy_error")  # fmt: skip
    head = ("cell mm", "cells", "cracked", "steps", "peak kN", "run s", "ms/step",
            "M cell-steps/s", "comp. s", "memory MB", "energy err")  # fmt: skip
    if show:
        show(line.format(*head))
    for cell, scene in zip(cells, scenes, strict=True):
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
