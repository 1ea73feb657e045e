"""Where methods for a cracked point fail: a map over size and strain increment.

A point is pulled from onset until its crack is open, by equal strain increments, and what the
method says was dissipated is compared with G_F. Across: the effective size H over H_max, the
largest whose response does not snap back; up: the increment over the onset strain f_t/E. The four
methods are those of `stability_methods.py`, on two paths and in two precisions.

**The measure** of energy is what the law gave up in the states that the method went through (a
closed form of the softening; and what the project's solver adds to it as `Band.spent`, nothing on
these paths; not what comes free in a snap-back), plus the work ∫ (σ·n − t_L)·d[u] of tractions
that band and bulk do not agree on, by the trapezoidal rule over the steps, up to the jump `FAR`.
The second part vanishes where traction is continuous, and is all that tells a method that drifts
from one that does not. Hence a large increment counts only where the method makes an error, not
because a coarse polygon is integrated; with small ones the sum is ∫ σ·n·d[u] less what the band
stores. The smeared crack has the first part only.

**Number of steps.** An increment that would take more steps than `Method.most` is enlarged until
that many are enough. Such cells are hatched in the figure and `enlarged` in the table; there a
method that drifts would do better with the increment that the axis says.
"""

import csv
import json
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import tensor
from jaxmpm.laws import band as bands
from jaxmpm.laws.band import Embedding
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.smeared import Smeared, scaled_softening
from jaxmpm.stability_methods import METHODS, Laws, Point

E, FT, EP, N, WIDTH = 32000.0, 3.0, 8.184, 0.128, 0.05  # the paper's concrete; MPa, mm
OPENING = 0.21  # mm, normal, at the end: 99.9 % of G_F is spent and 2.5e-4 f_t left
LANES = 64  # cells that run together
WORKERS = 2  # panels that run side by side
RIGHT, DRIFTS = 0.01, 0.1  # error of the energy up to which a cell counts as such
VERDICTS = ("right", "drifts", "wrong", "not converged", "not finite")

# Strain after onset per unit of normal strain (xx, yy, xy), and Poisson's ratio. The first is the
# uniaxial problem; in the second the faces slide as much as they part. With ν = 0.2 the band is
# in tension all round there, so that its law has to dissipate G_F there too.
PATHS = {"uniaxial": ((1.0, 0.0, 0.0), 0.0), "mixed": ((1.0, 0.0, 1.0), 0.2)}
PRECISIONS = ("float64", "float32")


def run(directory, coarse=False, show=None) -> dict:
    """Compute the map, write stability.png, .csv and .json to a directory, return the summary.

    Args:
        directory: where to write; made if need be.
        coarse: a quick map of 9 by 7 cells a panel, float64 only, instead of 25 by 19.
        show: called with each line of the table of shares.

    Returns:
        What stability.json holds; `passed` tells whether the project's solver converged in every
        cell and was right in every one below H_max, `faults` how many cells were not so.
    """
    from jaxmpm import stability_plot

    begin = time.perf_counter()
    table = cells(coarse)
    summary = summarise(table)
    summary["seconds"] = round(time.perf_counter() - begin, 2)
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    with open(directory / "stability.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, table[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)
    (directory / "stability.json").write_text(json.dumps(summary, indent=1))
    stability_plot.draw(table, directory / "stability.png")
    for line in report(summary) if show else ():
        show(line)
    return summary


def summarise(table) -> dict:
    """Shares of the verdicts in each panel, and whether the project's solver passed."""
    panels = []
    for method, path, precision in dict.fromkeys(map(panel_of, table)):
        here = [row for row in table if panel_of(row) == (method, path, precision)]
        count = {v: sum(row["verdict"] == v for row in here) for v in VERDICTS}
        shares = {v: round(count[v] / len(here), 4) for v in VERDICTS}
        panels.append({"method": method, "path": path, "precision": precision, "shares": shares})
    faults = sum(_is_fault(row) for row in table)
    return {
        "largest_size": largest_size(), "fracture_energy": fracture_energy(),
        "onset_strain": FT / E, "opening": OPENING, "cells_per_panel": len(here),
        "panels": panels, "faults": faults, "passed": faults == 0,
    }  # fmt: skip


def panel_of(row):
    """The panel that a row of the table belongs to."""
    return row["method"], row["path"], row["precision"]


def _is_fault(row):
    if row["method"] != "balance":
        return False
    return row["verdict"] in VERDICTS[3:] or (row["size_ratio"] < 1 and row["verdict"] != "right")


def report(summary):
    """The lines of the table of shares, in per cent."""
    line = "{:<26}{:<10}{:<9}" + "{:>15}" * len(VERDICTS)
    yield line.format("method", "path", "", *VERDICTS)
    for panel in summary["panels"]:
        shares = [f"{100 * panel['shares'][v]:.1f} %" for v in VERDICTS]
        title = METHODS[panel["method"]].title
        yield line.format(title, panel["path"], panel["precision"], *shares)
    state = "pass" if summary["passed"] else f"FAIL ({summary['faults']} cells)"
    yield f"this project, right below H_max and converged everywhere: {state}"


# ------------------------------------------------------------------ the map


@partial(jax.jit, static_argnums=(0, 1))
def _pull(name, precision, size, direction, nu, smeared_Ep, increment, steps):
    """Points pulled from onset by as many equal increments as each asks for.

    `smeared_Ep` (MPa) is the softening parameter of the smeared crack, that of cells of the size.
    Returns energy (N/mm), traction left (MPa), and whether the point is lost and finite, (many,).
    """
    method = METHODS[name]
    size, direction, nu, smeared_Ep, increment = (
        jnp.asarray(value, precision) for value in (size, direction, nu, smeared_Ep, increment)
    )
    laws, point = _at_onset(size, nu, smeared_Ep)
    start = point.strain

    def goes(point, k):
        return (k < steps) & ~point.lost

    def advance(carry):
        point, k = carry
        strain = start + direction * (increment * (k + 1).astype(increment.dtype))
        moved = method.step(laws, point, strain)
        keep = goes(point, k)
        return jax.tree.map(lambda new, old: jnp.where(keep, new, old), moved, point), k + 1

    point, _ = lax.while_loop(lambda carry: goes(*carry).any(), advance, (point, 0))
    energy = method.energy(laws, point)
    left = tensor.norm(tensor.traction(point.stress, point.band.normal))
    finite = jnp.isfinite(point.band.jump).all(0) & (jnp.isfinite(energy) | point.lost)
    return energy, left, point.lost, finite


def _at_onset(size, nu, smeared_Ep):
    """Laws and points at onset."""
    one = jnp.ones_like(size)
    embedding = Embedding(Elastic(E * one, nu), _damage(size))
    along = jnp.stack([FT / E * one, 0 * one, 0 * one])
    band = bands.open_band(embedding, along, jnp.stack([one, 0 * one]), size)
    stress = embedding.bulk.stress(band.onset_strain)
    none = jnp.zeros_like(size, bool)
    point = Point(band, band.onset_strain, stress, 0 * band.jump, 0 * one, none)
    smeared = Smeared(E * one, nu, FT * one, smeared_Ep, N * one)
    return Laws(embedding, smeared), point


@jax.jit
def _smeared_softening(size):
    """E_p' (MPa) of the smeared crack in cells of these sizes."""
    return jnp.exp(scaled_softening(_damage(size), Elastic(E * jnp.ones_like(size), 0.0), size))


def _damage(size):
    """The law of the band, its parameters one for each of these sizes."""
    one = jnp.ones_like(size)
    return Damage(FT * one, EP * one, N * one, WIDTH * one)


def fracture_energy():
    """G_F = h g_F of the concrete by its closed form, N/mm."""
    law = Damage(FT, EP, N, WIDTH)
    return float(law.given_up(jnp.asarray(600.0), Elastic(E, 0.0)))


def largest_size():
    """H_max of the concrete, mm."""
    return Damage(FT, EP, N, WIDTH).largest_size(Elastic(E, 0.0))


def axes(coarse=False):
    """H/H_max across and increment over onset strain up."""
    columns, rows = (9, 7) if coarse else (25, 19)
    return np.geomspace(0.01, 20.0, columns), np.geomspace(1e-3, 1e3, rows)


def cells(coarse=False, methods=tuple(METHODS), precisions=None) -> list[dict]:
    """One row of the table for every cell of every panel.

    Args:
        coarse: panels of 9 by 7 cells instead of 25 by 19, in float64 only unless said otherwise.
        methods, precisions: which panels.
    """
    panels = list(product(methods, precisions or (PRECISIONS[:1] if coarse else PRECISIONS)))
    with ThreadPoolExecutor(WORKERS) as pool:
        parts = pool.map(lambda panel: _rows(*panel, coarse), panels)
        return [row for part in parts for row in part]


def _rows(name, precision, coarse):
    most = METHODS[name].most // (10 if coarse else 1)
    plan, exact, rows = _plan(coarse, most), fracture_energy(), []
    for cell, found in zip(plan, _found(name, precision, plan), strict=True):
        energy, left, lost, finite = found
        rows.append({
            "method": name, "path": cell.path, "precision": precision,
            "size_ratio": cell.ratio, "increment": cell.increment,
            "verdict": verdict(energy / exact, lost, finite), "energy_ratio": float(energy / exact),
            "traction_left": float(left / FT), "steps": cell.steps,
            "enlarged": cell.taken > cell.increment * FT / E,
        })  # fmt: skip
    return rows


class _Cell(NamedTuple):
    """What is asked of one cell."""

    path: str
    ratio: float  # H/H_max
    increment: float  # over the onset strain
    size: float  # mm
    smeared_Ep: float  # softening parameter of the smeared crack, MPa
    taken: float  # strain increment that the number of steps leaves
    steps: int


def _plan(coarse, most):
    """Every `_Cell` of the two panels of a method and a precision, with at `most` so many steps."""
    ratios, increments = (values.tolist() for values in axes(coarse))
    sizes = [ratio * largest_size() for ratio in ratios]
    softenings = np.asarray(_smeared_softening(np.array(sizes))).tolist()
    plan = []
    for path, increment in product(PATHS, increments):
        for ratio, size, smeared_Ep in zip(ratios, sizes, softenings, strict=True):
            asked, end = increment * FT / E, OPENING / size
            steps, taken = min(int(np.ceil(end / asked)), most), max(asked, end / most)
            plan.append(_Cell(path, ratio, increment, size, smeared_Ep, taken, steps))
    return plan


def _found(name, precision, plan):
    """Energy, traction left, lost and finite (cells, 4); equal cells once, those as long together."""
    keys = [(cell.path, cell.size, cell.smeared_Ep, cell.taken, cell.steps) for cell in plan]
    each = sorted(set(keys), key=lambda key: -key[-1])
    rows = []
    for k in range(0, len(each), LANES):
        block = each[k : k + LANES]
        path, size, smeared_Ep, taken, steps = zip(
            *(block + block[-1:] * (LANES - len(block))), strict=True
        )
        direction, nu = (np.array([PATHS[p][i] for p in path]).T for i in (0, 1))
        size, smeared_Ep, taken, steps = map(np.array, (size, smeared_Ep, taken, steps))
        ask = size, direction, nu, smeared_Ep, taken, steps
        rows.append(np.stack([np.asarray(v, float) for v in _pull(name, precision, *ask)], 1))
    return np.concatenate(rows)[[each.index(key) for key in keys]]


def verdict(energy_ratio, lost, finite) -> str:
    """What to say of a cell."""
    if not finite:
        return VERDICTS[4]
    if lost:
        return VERDICTS[3]
    error = abs(energy_ratio - 1)
    return VERDICTS[0] if error <= RIGHT else VERDICTS[1] if error <= DRIFTS else VERDICTS[2]
