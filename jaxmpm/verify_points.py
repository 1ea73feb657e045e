"""What the checks of points that move are made of: bodies of points, and rows of the table."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm.moving import advance
from jaxmpm.points import in_bins, listed


def row(*args, **kwargs) -> dict:
    """As in `verify`, which imports this file."""
    from jaxmpm import verify

    return verify._row(*args, **kwargs)


def body(numerics, position, velocity, volume, density=1.0, origin=None, slots=12, margin=1) -> Any:
    """`Points` at rest in shape, with a velocity field of the positions.

    Args:
        position: (d, count), from the corner of the grid.
        velocity: of one position (d,), in `jax.numpy`; its gradient goes along where points keep one.
        volume: of each point (count,), or one number.
        origin: what `home` is measured from (d,); the corner of the grid if None.
        margin: empty bins around the body.
    """
    d, count = position.shape
    x = jnp.asarray(position.T)
    gradient = np.moveaxis(np.asarray(jax.vmap(jax.jacfwd(velocity))(x)), 0, -1)
    fields = {
        "velocity": np.asarray(jax.vmap(velocity)(x)).T,
        "gradient": np.zeros((d, d, count)),
        "stress": np.zeros((d * (d + 1) // 2, count)),
        "mass": density * volume * np.ones(count),
        "volume": volume * np.ones(count),
        "material": np.zeros(count, int),
        "home": position - np.reshape(np.zeros(d) if origin is None else origin, (d, 1)),
        "affine": gradient if numerics.affine else np.zeros((0, 0, count)),
    }
    centred, cell = numerics.shape.centred, numerics.cell
    bin_of = np.floor(position / cell + 0.5 * centred).astype(int)
    last = np.array(numerics.cells) - 1 + centred
    low = np.maximum(bin_of.min(1) - margin, 0)
    high = np.minimum(bin_of.max(1) + margin, last)
    return in_bins(position, fields, np.zeros(d), cell, centred, slots, tuple(high - low + 1), low)


def lattice(low, high, spacing) -> np.ndarray:
    """Positions (d, count) of points in a box, half a spacing from its sides."""
    lines = [spacing * (np.arange(round((b - a) / spacing)) + 0.5) + a for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*lines, indexing="ij")).reshape(len(low), -1)


def forward(model, state, dt, until):
    """`advance`; raises RuntimeError where points find no room."""
    state = advance(model, state, jnp.asarray(dt), until)
    if int(state.step) != until:
        raise RuntimeError(f"no room for points after step {int(state.step)} of {until}: {state.room}")
    return state


def points_of(model, state):
    """Positions from the corner of the grid, and fields, as lists."""
    n = model.numerics
    return listed(state.points, np.zeros(n.dimension), n.cell, n.shape.centred)
