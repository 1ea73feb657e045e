"""A periodic cell whose mean strain is driven: opposite edges move alike but for that strain.

The velocity of a node is that of the mean strain's rate, L x, and a fluctuation v that is the same on
opposite edges. Either has inertia of its own, as in the dynamics of molecules (Parrinello and Rahman, J. Appl. Phys. 52,
1981): m v̇ = −f, M_k L̇_k = −V σ̄_k where a component is free, M_k the inertia of its mode of motion. The
kinetic energy is ½ Σ m v² + ½ Σ M_k L_k².
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxmpm import layout_macro
from jaxmpm.loads import Load


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Macro:
    """What drives the mean strain xx, yy, xy."""

    load: Load  # the history; drives no degree of freedom by itself
    strain: jax.Array  # per unit of the history, (3,)
    driven: jax.Array  # 1 where a component is driven, 0 where it is free, (3,)


class Motion(NamedTuple):
    """A nodal velocity in parts."""

    rate: jax.Array  # of the mean strain, 1/s, (3,)
    own: jax.Array  # fluctuation, mm/s, (2, nx+1, ny+1)


def mean(field, cell):
    """Mean strain (3,) of a field (2, nx+1, ny+1) whose opposite edges differ by it alone."""
    nx, ny = (n - 1 for n in field.shape[1:])
    across_x, across_y = (field[:, -1, 0] - field[:, 0, 0]) / (nx * cell), (field[:, 0, -1] - field[:, 0, 0]) / (ny * cell)
    return jnp.stack([across_x[0], across_y[1], across_x[1] + across_y[0]])


def split(velocity, cell) -> Motion:
    """A velocity in its parts."""
    rate = mean(velocity, cell)
    return Motion(rate, velocity - _affine(rate, velocity, cell))


def _affine(rate, like, cell):
    """Displacement of the nodes of a mean strain."""
    shape = [n - 1 for n in like.shape[1:]]
    return jnp.tensordot(rate, jnp.asarray(layout_macro.modes(shape, cell), like.dtype), 1)


def fold(nodal):
    """A nodal sum (..., nx+1, ny+1): what the edges at the far ends have goes to those they are tied to."""
    nodal = nodal.at[..., 0, :].add(nodal[..., -1, :])
    nodal = nodal.at[..., :, 0].add(nodal[..., :, -1])
    return wrap(nodal)


def wrap(nodal):
    """The edges at the far ends do as those they are tied to."""
    nodal = nodal.at[..., -1, :].set(nodal[..., 0, :])
    return nodal.at[..., :, -1].set(nodal[..., :, 0])


def inertia(mass, cell):
    """Inertia (3,) of each mode of mean strain, tonne·mm², from the nodes' own mass (nx+1, ny+1)."""
    shape = [n - 1 for n in mass.shape]
    return jnp.stack([(mass * (mode**2).sum(0)).sum() for mode in jnp.asarray(layout_macro.modes(shape, cell), mass.dtype)])


def kinetic_energy(mass, velocity, cell):
    """Of fluctuation and mean strain, N·mm."""
    motion = split(velocity, cell)
    return (mass * (motion.own**2).sum(0)).sum() / 2 + inertia(mass, cell) @ motion.rate**2 / 2


def move(model, prepared, state, internal, dt):
    """Integrate the motion.

    Args:
        internal: forces that the cells exert, N, (2, nx+1, ny+1).

    Returns:
        (displacement, velocity, work of what drives the mean strain, that taken by damping, N·mm)
    """
    cell, macro = model.numerics.cell, model.macro
    rate, own = split(state.velocity, cell)
    shape = [n - 1 for n in prepared.mass.shape]
    resists = jnp.tensordot(jnp.asarray(layout_macro.modes(shape, cell), own.dtype), internal, 3)  # V σ̄
    push, pull, lost = -fold(internal), -resists, 0.0
    if model.damping is not None:
        drag = model.damping * jnp.abs(push) * jnp.sign(own)
        slow = model.damping * jnp.abs(pull) * jnp.sign(rate) * (1 - macro.driven)
        push, pull = push - drag, pull - slow
    fluctuation = wrap(own + (dt * prepared.mobility) * push)
    wanted = (macro.strain * macro.load.amplitude((state.step + 1) * dt) - mean(state.displacement, cell)) / dt
    after = jnp.where(macro.driven > 0, wanted, rate + dt * pull / prepared.inertia)
    strained, shaken = 0.5 * dt * (rate + after), 0.5 * dt * (own + fluctuation)
    work = (macro.driven * (resists + prepared.inertia * (after - rate) / dt)) @ strained
    if model.damping is not None:
        lost = jnp.vdot(drag * model.free, shaken) + slow @ strained
    velocity = fluctuation + _affine(after, fluctuation, cell)
    return state.displacement + dt * velocity, velocity, work, lost
