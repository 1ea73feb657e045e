"""Paths of equilibria as functions that JAX can differentiate in reverse: model in, curve out.

    run = StaticRun.of(load_scene("den", ["grid.cell=5", "solver.kind=quasistatic", "solver.damping=0"]))
    peak = lambda ft: run(run.with_values({"concrete.ft": ft})).gauges["load"].max()
    value, slope = jax.value_and_grad(peak)(3.0)

Nothing vibrates, so that loads at an instant have derivatives as good as those of work or peak; and the way back costs a part of the
way there, however many parameters there are. Derivatives are by the laws of the materials (bulk and band), those by anything else in
the model are NaN. The way there is no compiled function: call `jax.grad` outside `jit`.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import model as models
from jaxmpm.adjoint import Tape, WayBack
from jaxmpm.errors import SceneError
from jaxmpm.layout import lay_out
from jaxmpm.mesostructure.sampling import Local
from jaxmpm.one_thread import on_one_thread
from jaxmpm.parameters import OfMaterials
from jaxmpm.quasistatic import QuasiStatic
from jaxmpm.scene import Scene


class Curve(NamedTuple):
    """What a path says at its equilibria, each array (increments,)."""

    time: jax.Array  # s, not differentiated
    gauges: dict  # by name, N or mm


@dataclass(frozen=True)
class StaticRun(OfMaterials):
    """A scene in equilibrium made ready to be differentiated; call it with a model."""

    scene: Scene
    layout: object
    model: models.Model
    named: models.Model  # the model by materials, before what is local made one of every cell
    local: Local | None
    materials: tuple  # names of the materials, in order

    @classmethod
    def of(cls, scene: Scene) -> "StaticRun":
        """Lay out a scene with solver.kind = "quasistatic"; raises SceneError."""
        if scene.solver.kind != "quasistatic":
            raise SceneError(f'solver.kind = "{scene.solver.kind}": expected "quasistatic" for a path of equilibria')
        layout = lay_out(scene)
        model = models.from_layout(scene, layout)
        named = models.by_materials(scene, layout) if layout.local else model
        return cls(scene, layout, model, named, layout.local, tuple(layout.materials))

    def __call__(self, model=None) -> Curve:
        """The curve of a model, the scene's own if None; raises RunError where there is no way on."""
        return _curve(self, self.model if model is None else model)


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def _curve(run, model):
    return _followed(run, model)[0]


def _followed(run, model):
    """The curve of a model, and the tape of its way."""
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(model)):
        raise SceneError("a path of equilibria inside jax.jit, vmap or jvp: expected jax.grad or jax.vjp outside of them")
    tape = Tape()
    sim = QuasiStatic.of(run.scene, run.layout, model, tape)
    sim.at_rest()
    sample = 0
    while not sim.finished:
        sample += 1
        sim.advance(sample)
    steps = tape.steps
    readings = jnp.asarray(np.stack([step.readings for step in steps]))
    gauges = {name: readings[:, k] for k, name in enumerate(tape.gauges.names)}
    return Curve(jnp.asarray([step.time for step in steps]), gauges), tape


def _forward(run, model):
    curve, tape = _followed(run, model)
    return curve, (tape, model)


@on_one_thread
def _backward(run, kept, by):
    tape, model = kept
    by_readings = np.stack([np.asarray(by.gauges[name]) for name in tape.gauges.names], axis=1)
    laws = WayBack(tape).go(by_readings)
    unknown = jax.tree.map(lambda leaf: jnp.full_like(leaf, jnp.nan) if jnp.issubdtype(leaf.dtype, jnp.inexact) else _none(leaf), model)
    return (replace(unknown, embedding=laws),)


def _none(leaf):
    """What JAX takes for the derivative by integers."""
    return np.zeros(leaf.shape, jax.dtypes.float0)


_curve.defvjp(_forward, _backward)
