"""What holds the nodes under moving points: walls at the edges of the grid, supports, moved sets.

A support holds its nodes, which stay where they are: a body that comes there is held too. The nodes
of a moved set ride with it, by whole cells.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from jaxmpm.loads import Load


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Hold:
    """Nodes whose velocity is known."""

    which: jax.Array  # 1 where a component is held or moved, (d, *nodes of the grid)
    cosines: jax.Array  # direction of the motion (d,), zero for a support
    load: Load  # its history, mm; constant for a support
    rides: bool = field(metadata={"static": True}, default=True)  # moved, not a support


def on_window(n, points, values, shift=None):
    """A field (..., *nodes of the grid) on the nodes (..., *nodes) of the window, zero outside.

    With `shift` (d,) in cells, as it would be had it moved so far.
    """
    shape, d = values.shape[-n.dimension :], n.dimension
    out = values
    for axis in range(d):
        count = points.mass.shape[1 + axis] + n.shape.count - 1
        number = points.window[axis] - n.shape.lead + jnp.arange(count)
        if shift is not None:
            number = number - shift[axis]
        number = jnp.where(number < 0, shape[axis], number)  # a negative index would count from behind
        out = jnp.take(out, number, axis=axis - d, mode="fill", fill_value=0)
    return out


def shift_of(n, hold, time):
    """By how many cells a hold has moved along each axis (d,), or None for a support."""
    if not hold.rides:
        return None
    moved = hold.load.amplitude(time) - hold.load.value[0]
    return jnp.round(moved * hold.cosines / n.cell).astype(jnp.int32)


def held(n, holds, points, velocity, time, dt):
    """Velocities (..., d, *nodes) with those of the walls and of the holds put in.

    Args:
        n: `Numerics`.
        holds: of the model.
        points: for the window.
        velocity: of the nodes, mm/s.
        time: at the end of the step that the velocities hold over, s.
        dt: s.
    """
    velocity = _walls(n, points, velocity)
    for hold in holds:
        which = on_window(n, points, hold.which, shift_of(n, hold, time - dt))
        rate = (hold.load.amplitude(time) - hold.load.amplitude(time - dt)) / dt
        known = (rate * hold.cosines).reshape(-1, *[1] * n.dimension)
        velocity = jnp.where(which > 0, known, velocity)
    return velocity


def _walls(n, points, velocity):
    d = n.dimension
    rank = velocity.ndim - d - 1
    for axis, sides in enumerate(n.walls):
        count = velocity.shape[rank + 1 + axis]
        number = points.window[axis] - n.shape.lead + jnp.arange(count)
        number = number.reshape([-1 if a == axis else 1 for a in range(d)])
        for side, at_edge in zip(sides, (number <= 0, number >= n.cells[axis]), strict=True):
            for row in {"slip": (axis,), "stick": range(d)}.get(side, ()):
                here = (slice(None),) * rank + (row,)
                velocity = velocity.at[here].set(jnp.where(at_edge, 0.0, velocity[here]))
    return velocity
