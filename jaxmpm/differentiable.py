"""Whole runs as functions that JAX can differentiate: model in, history out.

    run = Run.of(load_scene("den", ["grid.cell=5", "solver.damping=0", "solver.viscosity=0.1"]))
    load = lambda ft: run(run.with_values({"concrete.ft": ft})).gauges["load"]
    history, slope = jax.jit(lambda ft: jax.jvp(load, (ft,), (1.0,)))(3.0)

Few parameters: forward mode (`jax.jvp`, `jax.jacfwd`): no tape, memory stays as it is. Many (a field
of strength, the history of a load): `jax.grad` with `run(model, reverse=True)`; states are kept at the
samples, and made again between them.

What a gradient means where cells crack: the moment of a step in which a cell cracks depends smoothly on
the parameters, and derivatives know it. They are those of one order of events. Where a change of
parameters lets another cell crack first the response bends, and no derivative says so; what vibrates
makes that worse, so judge a response over a span of time rather than at an instant (`smooth_peak`,
`about_displacement`, work). Local damping (`solver.damping`) leaps wherever a velocity changes sign, and derivatives grow
without bound in it: it is refused. Viscosity does the same service smoothly.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import compilation, explicit, observe
from jaxmpm import model as models
from jaxmpm.errors import RunError, SceneError
from jaxmpm.mesostructure.sampling import Local
from jaxmpm.parameters import OfMaterials
from jaxmpm.scene import Scene
from jaxmpm.simulation import Simulation

TAPE = 6e8  # bytes that the steps between two samples may leave for the way back
WELL, NOT_CONVERGED, NO_ROOM = range(3)
WHY = {
    NOT_CONVERGED: "a band did not converge: try a smaller solver.time_step_factor",
    NO_ROOM: "more cells cracked than `capacity` has room for",
}


class History(NamedTuple):
    """What a run says at its samples, each array (samples,); NaN from where it went wrong."""

    time: jax.Array  # s
    gauges: dict  # by name, N or mm
    work: jax.Array  # of the loads, N·mm
    stored: jax.Array
    kinetic: jax.Array
    dissipated: jax.Array
    damping: jax.Array
    cracked: jax.Array  # cells with a band
    status: jax.Array  # WELL, or why not


def simulate(model, state, dt, every, samples, reverse=False) -> History:
    """Advance a state by every × samples steps, and read it every so often, one step behind.

    Args:
        model, state: `jaxmpm.model.Model` and `State`; the pool of the state must have room for all cells that
            crack.
        dt: time step, s.
        every: steps from sample to sample, static.
        samples: static.
        reverse: a version that can be differentiated in reverse too.

    Returns:
        History; differentiable in the model, the state and dt.
    """
    prepared = models.fields(model)
    go, read = (_onward, jax.checkpoint(observe.read)) if reverse else (_steps, observe.read)

    def sample(carry, k):
        state, status = go(every, model, prepared, dt, *carry, (k + 1) * every)
        return (state, status), (read(model, state, dt), status)

    (_, _), (reading, status) = lax.scan(sample, (state, _status(state, WELL)), jnp.arange(samples))
    well = status == WELL
    told = {
        "time": reading.time, "gauges": reading.gauges, "work": reading.external, "stored": reading.stored,
        "kinetic": reading.kinetic, "dissipated": reading.dissipated, "damping": reading.damping,
    }  # fmt: skip
    told = jax.tree.map(lambda a: jnp.where(well, a, jnp.nan), told)
    return History(**told, cracked=reading.cracked, status=status)


def _steps(every, model, prepared, dt, state, status, until):
    """The steps from one sample to the next."""
    on = lambda s: (s.step < until) & (_status(s, status) == WELL)  # noqa: E731
    state = lax.while_loop(on, lambda s: explicit._step(model, prepared, s, dt), state)
    return state, _status(state, status)


# On the way back they are made again, as many as there are, with all that their derivatives need.
_onward = jax.custom_vjp(_steps, nondiff_argnums=(0,))


def _onward_kept(every, *start):
    return _steps(every, *start), start


def _onward_back(every, start, by):
    return jax.vjp(partial(_taped, every), *start)[1](by)


_onward.defvjp(_onward_kept, _onward_back)


def _taped(every, model, prepared, dt, state, status, until):
    """As `_steps`, for differentiation in reverse."""

    def step(carry, _):
        state, status = carry
        state = explicit._step(model, prepared, state, dt, reverse=True)
        return (state, _status(state, status)), None

    taped = step if _tape(state) * every < TAPE else jax.checkpoint(step)
    return lax.scan(taped, (state, status), None, length=every)[0]


def _tape(state):
    """About what one step leaves for the way back, bytes: several times the state (measured)."""
    return 6 * sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(state))


def _status(state, status):
    """A status once bad stays."""
    now = jnp.where(state.failed >= 0, NOT_CONVERGED, jnp.where(explicit.needs_room(state), NO_ROOM, WELL))
    return jnp.where(jnp.asarray(status) == WELL, now, status).astype(jnp.int32)


@dataclass(frozen=True)
class Run(OfMaterials):
    """A scene made ready for `simulate`; call it with a model."""

    scene: Scene
    model: models.Model
    state: models.State
    named: models.Model  # the model by materials, before what is local made one of every cell
    local: Local | None
    materials: tuple  # names of the materials, in order
    dt: float  # s
    every: int
    samples: int

    @classmethod
    def of(cls, scene: Scene, samples: int = 200, stiffer: float = 1.1, capacity: int | None = None) -> "Run":
        """Lay out a scene.

        Args:
            scene: in the total frame.
            samples: at which it is read.
            stiffer: how many times stiffer than in the scene a material may become; the time step allows for it.
            capacity: room for cracked cells; a quarter of the cells if None (it is what states cost in reverse).

        Raises:
            SceneError: where its gradients would not be right, or it needs points that move.
        """
        solver = scene.solver
        if solver.damping:
            raise SceneError(
                f"solver.damping = {solver.damping:g}: expected 0 for a run that is differentiated (it leaps where "
                "velocities change sign); use solver.viscosity, 0.1 for instance"
            )
        if solver.elastic_rise != "motion":
            raise SceneError('solver.elastic_rise = "equilibrium": expected "motion" for a run that is differentiated')
        if solver.frame == "updated":
            raise SceneError('solver.frame = "updated": expected "total" or "auto" for a run that is differentiated')
        sim = Simulation.of(scene, crop=False)  # fields of parameters are those of all cells of the grid
        steps = int(np.ceil((sim.steps - 1) * np.sqrt(stiffer)))
        every = -(-steps // samples)
        room = capacity or max(explicit.ROOM, sim.model.material.size // 4)
        return cls(
            scene, sim.model, models.first_state(sim.model, sim.layout.velocity, room + explicit.ROOM),
            models.by_materials(scene, sim.layout) if sim.layout.local else sim.model, sim.layout.local,
            tuple(sim.layout.materials), solver.duration / (every * samples - 1), every, samples,
        )  # fmt: skip

    def __call__(self, model=None, reverse=False) -> History:
        """The history of a model, the scene's own if None; a pure function."""
        model = self.model if model is None else model
        dt = jnp.asarray(self.dt, model.free.dtype)
        return simulate(model, self.state, dt, self.every, self.samples, reverse)

    def compiled(self, function, *args):
        """`function` compiled for arguments like these, as the project compiles its steps."""
        return compilation.compiled(jax.jit(function).lower(*args))


def check(history: History) -> None:
    """Raise RunError where a history went wrong."""
    status = np.asarray(history.status)
    if (status != WELL).any():
        k = int(np.argmax(status != WELL))
        raise RunError(f"the run went wrong before sample {k + 1} of {len(status)}: {WHY[int(status[k])]}")
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(history)):
        raise RunError("the run has become unstable: its numbers are not finite; lower solver.time_step_factor")


def smooth_peak(load, width):
    """A smooth maximum of a curve (samples,): width · ln of the mean of exp(load/width).

    It is below the maximum by about width times the logarithm of how narrow the peak is in samples, and
    differentiable where the highest sample changes.

    Args:
        load: of any sign of which the largest value is meant.
        width: in the units of the load; a hundredth of the peak looks at about a tenth of it.
    """
    top = lax.stop_gradient(load.max())
    return top + width * jnp.log(jnp.mean(jnp.exp((load - top) / width)))


def at_displacement(load, displacement, where):
    """The load at a displacement (linear between samples), at which a growing displacement arrives first."""
    return jnp.interp(where, displacement, load)


def about_displacement(load, displacement, where, width):
    """The load about a displacement: a mean over the samples, whose weight falls to nothing `width` to either side.

    Vibrations pass within a few samples, and with them what a derivative at one instant says of them alone. A curve that is
    straight there keeps its value if the displacement grows evenly.

    Args:
        load, displacement: (samples,), the displacement growing.
        where, width: in its units; no further from its ends than `width`. NaN where no sample is as near as that.
    """
    weight = jnp.maximum(1 - jnp.abs(displacement - where) / width, 0.0)
    return weight @ load / weight.sum()
