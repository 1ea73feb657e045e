"""Derivatives of a whole run against the slope of a line through runs on either side."""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

from calibration.energy import fit_energy, fracture_energy
from jaxmpm.differentiable import Run, about_displacement, smooth_peak
from jaxmpm.scene import load_scene
from jaxmpm.verify_points import row

RANGE, RUNS = 0.03, 9  # of a parameter on either side; runs over it
LIMIT = 0.02  # relative
LEAST = 0.3  # per cent a per cent: what changes an answer by less is judged by that
WIDTH = 0.004  # mm: about a displacement
ANSWERS = ("load about 0.03 mm", "work to 0.05 mm", "smooth peak")
NAMES = ("ft", "GF", "Ep", "n", "E")


def answers(history):
    """Load about 0.03 mm, N; work about 0.05 mm, where half the peak is left, N·mm; smooth peak, N."""
    load, displacement = history.gauges["load"], history.gauges["delta"]
    there = about_displacement(load, displacement, 0.03, WIDTH)
    done = about_displacement(history.work, displacement, 0.05, WIDTH)
    return jnp.stack([there, done, smooth_peak(load, 170.0)])


def plate(cell=5.0) -> Run:
    """The double-edge-notched plate, made ready to be differentiated."""
    settings = [f"grid.cell={cell}", "solver.damping=0", "solver.viscosity=0.1"]
    return Run.of(load_scene("den", settings), samples=150)


def over_a_range(run, names=NAMES):
    """Answers and derivatives, both (names, RUNS, answers), by the logarithm of each parameter.

    G_F, the energy of the scene's law, changes E_p and n together, by the rule that gave them.
    """
    start = {name: run.values([f"concrete.{name}"])[f"concrete.{name}"] for name in ("E", "ft", "Ep", "n", "h")}
    start["GF"] = fracture_energy(*(start[name] for name in ("E", "ft", "Ep", "n", "h")))

    def of(changes):
        values = dict(start)
        for name, x in zip(names, changes, strict=True):
            values[name] = start[name] * (1 + x)
        energy = values.pop("GF")
        rule = [fit_energy(start["E"], start["ft"], g, start["h"]) for g in (energy, start["GF"])]
        for name in ("Ep", "n"):
            values[name] = values[name] * getattr(rule[0], name) / getattr(rule[1], name)
        return answers(run(run.with_values({f"concrete.{name}": value for name, value in values.items()})))

    none, units = jnp.zeros(len(names)), jnp.eye(len(names))
    both = run.compiled(lambda x, d: jax.jvp(of, (x,), (d,)), none, none)
    x = np.linspace(-RANGE, RANGE, RUNS)
    pairs = [[both(none + each * unit, unit) for each in x] for unit in units]
    return x, *np.moveaxis(np.array(pairs), 2, 0)


def gradients() -> Iterator[dict]:
    """Of the load about 0.03 mm, the work to 0.05 mm and a smooth peak of the plate (5 mm) by each parameter.

    Both as per cent a per cent. Errors are relative to the slope, or to `LEAST` where it is less.
    """
    x, values, slopes = over_a_range(plate())
    for name, value, slope in zip(NAMES, values, slopes, strict=True):
        for k, answer in enumerate(ANSWERS):
            line, level = np.polyfit(x, value[:, k], 1)
            yield row(f"{answer} by {name}", slope[RUNS // 2, k] / level, line / level, LIMIT, least=LEAST)
