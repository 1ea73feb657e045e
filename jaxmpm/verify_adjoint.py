"""Derivatives of a path of equilibria in reverse against the slope of a line through paths on either side."""

from collections.abc import Iterator

import jax
import numpy as np

from calibration import leaves
from jaxmpm.differentiable_static import StaticRun
from jaxmpm.scene import load_scene
from jaxmpm.verify_gradients import RANGE, RUNS
from jaxmpm.verify_points import row

NAMES = ("GF", "ft")


def peak(run, values):
    """Peak load, N, for numbers of the plate's concrete."""
    known = leaves.known(run)
    changed = leaves.leaves(run, known, values)
    return run(run.with_values(changed)).gauges["load"].max()


def adjoint(cell=5.0) -> Iterator[dict]:
    """Of the peak of the plate in equilibrium by G_F and by f_t, as per cent a per cent."""
    run = StaticRun.of(load_scene("den", [f"grid.cell={cell}", 'solver.kind="quasistatic"', "solver.damping=0.02"]))
    known = leaves.known(run)
    changes = np.linspace(-RANGE, RANGE, RUNS)
    for name in (f"concrete.{leaf}" for leaf in NAMES):
        here = known[name]
        slope = float(jax.grad(lambda x: peak(run, {name: x}))(here)) * here  # noqa: B023
        values = [float(peak(run, {name: here * (1 + x)})) for x in changes]
        line, level = np.polyfit(changes, values, 1)
        yield row(f"peak by {name}, in equilibrium", slope / level, line / level, 0.01)
