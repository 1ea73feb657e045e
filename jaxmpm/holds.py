"""What holds the nodes under moving points: walls at the edges of the grid, supports, moved sets.

A support holds its nodes, which stay where they are: a body that comes there is held too. The nodes
of a moved set ride with it, by whole cells.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
from jax import lax

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
    d, rank = n.dimension, values.ndim - n.dimension
    counts = [bins + n.shape.count - 1 for bins in points.mass.shape[1:]]
    first = points.window - n.shape.lead + jnp.array(counts)
    if shift is not None:
        first = first - shift
    # where the window is off the grid altogether it is off the slice too, in the zeros beside it
    padded = jnp.pad(values, [(0, 0)] * rank + [(count, count) for count in counts])
    starts = [jnp.clip(first[a], 0, values.shape[rank + a] + counts[a]) for a in range(d)]
    return lax.dynamic_slice(padded, [0] * rank + starts, values.shape[:rank] + tuple(counts))


def shift_of(n, hold, time):
    """By how many cells a hold has moved along each axis (d,), or None for a support."""
    if not hold.rides:
        return None
    moved = hold.load.amplitude(time)
    return jnp.round(moved * hold.cosines / n.cell).astype(jnp.int32)


def held(n, holds, points, velocity, time, dt):
    """Velocities, a list of (fields, *nodes), with those of the walls and of the holds put in.

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
        # by its derivative: a difference would lose most digits in single precision
        middle = time - dt / 2
        rate = jax.jvp(hold.load.amplitude, (middle,), (jnp.ones_like(middle),))[1]
        velocity = [
            jnp.where(here > 0, rate * along, v)
            for here, along, v in zip(which, hold.cosines, velocity, strict=True)
        ]
    return velocity


def _walls(n, points, velocity):
    d, velocity = n.dimension, list(velocity)
    for axis, sides in enumerate(n.walls):
        number = points.window[axis] - n.shape.lead + jnp.arange(velocity[0].shape[1 + axis])
        number = number.reshape([-1 if a == axis else 1 for a in range(d)])
        for side, at_edge in zip(sides, (number <= 0, number >= n.cells[axis]), strict=True):
            for row in {"slip": (axis,), "stick": range(d)}.get(side, ()):
                velocity[row] = jnp.where(at_edge, 0.0, velocity[row])
    return velocity
