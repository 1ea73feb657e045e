"""Every code on the scene, in turns, and what comes out as a table.

A code is a name and a maker `(scene, dtype) -> (reset, step, read)`; `read` gives positions and
velocities (4, count). The codes take turns, so that a busy machine slows all of them alike, and
the best of several turns counts.
"""

import importlib.util
import os
import time

import numpy as np

from tests.benchmarks.scene import Scene

NEEDED = ("numba", "taichi")
CELLS = 224  # 200 704 points
SCALING = (50, 158, 224, 500, 1000)  # 10⁴ to 4·10⁶ points
STEPS, TURNS = 60, 7
TOTAL, TOTAL_SAME, MOVING = "jaxmpm total", "jaxmpm total, same cells", "jaxmpm moving"
LOOPS = ("Numba, 1 thread", "Numba", "Numba fused, 1 thread", "Numba fused")
TAICHI = "Taichi"


def missing():
    """Packages that the comparison needs and that are not installed."""
    return [name for name in NEEDED if importlib.util.find_spec(name) is None]


def threads():
    """Threads that every code may use."""
    return len(os.sched_getaffinity(0))


def codes(dtype):
    """Makers of all codes by name, for a precision; only one set can be alive (Taichi)."""
    from tests.benchmarks import jaxmpm_codes, numba_mpm, taichi_mpm

    taichi_mpm.start(dtype, threads())
    table = {}
    for name, kind, count in zip(
        LOOPS, (numba_mpm.PLAIN,) * 2 + (numba_mpm.FUSED,) * 2, (1, threads()) * 2, strict=True
    ):
        table[name] = lambda scene, dtype, kind=kind, count=count: _loops(numba_mpm, scene, dtype, count, kind)
    table[TAICHI] = lambda scene, dtype: _taichi(taichi_mpm, numba_mpm.points(scene, dtype), scene)
    table[MOVING] = jaxmpm_codes.moving_runner
    table[TOTAL_SAME] = jaxmpm_codes.total_runner
    table[TOTAL] = lambda scene, dtype: jaxmpm_codes.total_runner(Scene(2 * scene.cells), dtype)
    return table


def _loops(numba_mpm, scene, dtype, count, kind):
    first = numba_mpm.points(scene, dtype)
    points = first.copy()

    def reset():
        points[:] = first

    return reset, lambda steps: numba_mpm.run(scene, points, steps, count, kind), lambda: points[:, :4].T


def _taichi(taichi_mpm, first, scene):
    reset, step, read = taichi_mpm.runner(scene, first)
    return reset, step, lambda: read()[:, :4].T


def rates(scene, dtype, names=None, steps=STEPS, turns=TURNS):
    """Million point-steps per second of every code, best of the turns."""
    table = codes(dtype)  # anew: it holds no memory of what was timed before
    made = {name: table[name](scene, dtype) for name in names or table}
    best = dict.fromkeys(made, np.inf)
    for reset, step, _ in made.values():
        for _ in range(2):  # what is compiled on the way, room for points included, is not timed
            reset()
            step(steps)
    for _ in range(turns):
        for name, (reset, step, _) in made.items():
            reset()
            began = time.perf_counter()
            step(steps)
            best[name] = min(best[name], time.perf_counter() - began)
    return {name: scene.count * steps / seconds / 1e6 for name, seconds in best.items()}


def summary(rate):
    """The ratios that the project promises, of the rates of one precision."""
    others = max(rate[name] for name in (*LOOPS, TAICHI) if name in rate)
    ours = {name: rate[name] / others for name in (TOTAL, TOTAL_SAME, MOVING) if name in rate}
    return {"fastest of the others": others} | ours


def scaling(name, dtype, cells=SCALING):
    """Nanoseconds per point and step, by number of points."""
    rows = {}
    for count in cells:
        scene = Scene(count)
        steps = min(STEPS, max(20, STEPS * CELLS**2 // count**2))
        rows[scene.count] = 1e3 / rates(scene, dtype, [name], steps, 3)[name]
    return rows
