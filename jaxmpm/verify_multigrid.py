"""Checks of multigrid: how its steps grow with the grid, elastic and late in cracking, and what a large elastic system takes.

The plates are the scene den, on cells from 2.5 to 0.3125 mm. Cracked states come from the step in motion, loaded five times too
fast: that spreads the cracks, which makes it no easier. Systems are those of Newton's method, under given loads.
"""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator

import jax
import numpy as np

from jaxmpm import bands_static, grid
from jaxmpm import model as models
from jaxmpm.condensed import GRIP
from jaxmpm.elastic_grid import Multigrid, OnGrid
from jaxmpm.krylov import gmres, no_border
from jaxmpm.layout import lay_out
from jaxmpm.multigrid_system import positive
from jaxmpm.scene import load_scene
from jaxmpm.simulation import Simulation
from jaxmpm.verify_points import row

TOLERANCE = 1e-8  # of the right side
COARSE, FINE, LARGE = 2.5, 0.625, 0.3125  # mm: 80, 320 and 640 cells along the plate
FAST = 5.0  # times the speed of the scene


class Plate:
    """The plate den laid out on cells of a size, as fields: uncracked, or with the bands of a state."""

    def __init__(self, model):
        prepared, n = models.fields(model), model.numerics
        direct, cross, shear, hourglass, mass = (
            np.array(getattr(prepared, name)) for name in ("direct", "cross", "shear", "hourglass", "mass")
        )  # fmt: skip
        none = 0 * direct
        self.tangent = np.stack([direct, cross, none, cross, direct, none, none, none, shear]).reshape(3, 3, *direct.shape)
        self.near, self.hourglass = self.tangent, hourglass  # `near` is what is preconditioned
        self.free = np.asarray(model.free) * (mass > 0)
        self.cell, self.thickness = n.cell, n.thickness

    @classmethod
    def of(cls, cell):
        """Uncracked."""
        scene = load_scene("den", [f"grid.cell={cell}"])
        return cls(models.from_layout(scene, lay_out(scene)))

    @classmethod
    def cracked(cls, cell):
        """At the end of a run in motion; tangents of bands as they are, softening ones negative."""
        scene = load_scene("den", [f"grid.cell={cell}", f"solver.duration={5e-3 / FAST}", *_histories()])
        simulation = Simulation.of(scene)
        simulation.at_rest()
        samples = scene.output.samples
        for sample in range(1, samples + 1):
            simulation.advance(simulation.step_at(sample, samples))
        plate, pool = cls(simulation.model), simulation.state.pool
        cells = np.asarray(pool.cell)[: int(pool.count)]
        mean = grid.strain(simulation.state.displacement, cell).mean
        strain = np.stack([np.asarray(component).reshape(-1)[cells] for component in mean], axis=1)
        answers = bands_static.answers(simulation.model, pool, bands_static.strains_of(pool, strain.reshape(-1)))
        tangent = np.asarray(answers.tangent)[: len(cells)]
        plate._break(cells, tangent)
        return plate

    def _break(self, cells, tangent):
        """Give some cells (flat indices) the tangents (k, 3, 3) of their bands."""
        elastic = np.moveaxis(self.tangent.reshape(3, 3, -1)[..., cells], -1, 0)
        self.near = self.tangent.copy()
        for field, blocks in ((self.near, positive(tangent, elastic)), (self.tangent, tangent)):
            field.reshape(3, 3, -1)[..., cells] = np.moveaxis(blocks, 0, -1)
        self.hourglass.reshape(-1)[cells] *= GRIP

    def pulled(self):
        """Forces that stretch the top edge, as prescribing it does to the nodes below."""
        moved = np.zeros(self.free.shape)
        moved[1, :, -1] = 1e-3
        strain = grid.strain(moved * (1 - self.free), self.cell)
        mean = [sum(self.tangent[a, b] * strain.mean[b] for b in range(3)) for a in range(3)]
        stress = grid.CellStress(tuple(mean), tuple(self.hourglass * q for q in strain.hourglass))
        return -np.asarray(grid.internal_force(stress, self.cell, self.thickness)) * self.free

    def steps(self) -> int:
        """Steps of GMRES to `TOLERANCE`."""
        on = OnGrid(self.free, self.cell, self.thickness)
        operator, levels = on.operator(self.tangent, self.hourglass), on.preconditioner(self.near, self.hourglass)
        found = gmres(levels, operator, no_border(on.free.shape[1:]), on.vector(self.pulled()), TOLERANCE, most=200)
        return found.steps if found.residual <= TOLERANCE else 10_000


def _histories():
    names = [f"displacements.{k}.history" for k in (0, 1)]
    return [f"{name}.time=[0.0, {5e-3 / FAST}]" for name in names] + [f"{name}.smooth_start={5e-4 / FAST}" for name in names]


def large() -> dict:
    """Seconds and memory (GB) of the largest elastic plate in this process, which should be a new one."""
    plate = Plate.of(LARGE)
    forces = plate.pulled()
    seconds = {}
    for name in ("first", "again"):
        start = time.perf_counter()
        solver = Multigrid(plate.tangent, plate.hourglass, plate.free, plate.cell, plate.thickness)
        jax.block_until_ready(solver.levels)
        ready = time.perf_counter()
        found = solver.solve(forces, TOLERANCE)[1]
        seconds[name] = ready - start, time.perf_counter() - ready
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1e-9 if sys.platform == "darwin" else 1024e-9)
    return {
        "unknowns": int(plate.free.sum()), "set-up": seconds["again"][0], "solution": seconds["again"][1],
        "with compilation": sum(seconds["first"]), "memory": peak, "steps": found.steps, "residual": found.residual,
    }  # fmt: skip


def multigrid() -> Iterator[dict]:
    """Steps from 80 × 80 to 320 × 320 cells, uncracked and late in cracking; seconds and memory of 820 000 unknowns."""
    for name, make, most in (("elastic", Plate.of, 1.5), ("cracked", Plate.cracked, 4.0)):
        coarse = make(COARSE).steps()
        yield row(f"steps to 1e-8, {name}, 80 cells", coarse, 40, 0.0, side="≤")
        yield row(f"steps, {name}, 320 over 80 cells", make(FINE).steps() / coarse, most, 0.0, side="≤")
    environment = os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "0"}
    asked = subprocess.run([sys.executable, "-m", __name__], env=environment, capture_output=True, text=True, check=True)
    found = json.loads(asked.stdout)
    yield row("640 × 640 cells, residual", found["residual"], 0.0, TOLERANCE)
    for name in ("set-up", "solution", "with compilation"):
        yield row(f"640 × 640 cells, {name}, s", found[name], 20.0, 0.0, side="≤")
    yield row("640 × 640 cells, memory, GB", found["memory"], 3.0, 0.0, side="≤")


if __name__ == "__main__":
    print(json.dumps(large()))
