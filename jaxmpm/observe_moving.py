"""What a state of moving points says: gauges, energies, and the points themselves."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import carry, cracks, holds, moving, nodal, tensor
from jaxmpm.laws.finite import plus_one
from jaxmpm.observe import Reading
from jaxmpm.points import listed, separate


@jax.jit
def read(model, state, dt, sets) -> Reading:
    """Gauges and energies of a state.

    Args:
        model, state, dt: as of `moving.step`.
        sets: what gauges read, by name, see `moving_simulation`.
    """
    n, points = model.numerics, separate(state.points)
    time = model.begin + state.step * dt
    w = carry.weights(n, points)
    kinetic, stored, dissipated = moving.energies(model, points, state.pool)
    none = jnp.zeros_like(kinetic)
    opening = none
    if model.cracking is not None:
        found, lanes = cracks.current(model, points, state.pool)
        opening = jnp.where(lanes.used, jnp.hypot(*found.jump), 0.0).max()
    return Reading(
        time=time,
        gauges=_gauges(model, points, w, time, sets),
        external=state.work.external + state.work.initial,
        stored=stored + _half_step(points, dt) if n.transfer.kind == "taylor" else stored,
        kinetic=kinetic,
        dissipated=dissipated + state.work.released,
        damping=state.work.damping,
        contact=state.rubbed,
        cracked=state.pool.count if state.pool is not None else jnp.zeros((), jnp.int32),
        gradient=none,
        gradient_cell=jnp.zeros((), jnp.int32),
        opening=opening,
        opening_cell=jnp.zeros((), jnp.int32),
        opening_rate=none,
        displacement=none,
    )


def _half_step(points, dt):
    """Stored energy where velocities are, half a step before the stresses, less that of these."""
    power, rate = 0.0, points.affine
    for value, (i, j) in zip(points.stress, tensor.IN_SPACE[len(points.velocity)], strict=True):
        power = power + value * (rate[i, j] if i == j else rate[i, j] + rate[j, i])
    return -dt / 2 * (points.volume * power).sum()


def _gauges(model, points, w, time, sets):
    found = {}
    moved, reactions = sets
    if reactions:
        force = carry.internal_force(model.numerics, points, w)
        mass = carry.mass_and_momentum(model.numerics, points, w, points.velocity)[0]
        if (external := nodal.external_force(model, points, w, mass, time)) is not None:
            force = [a + b for a, b in zip(force, external, strict=True)]
        force = jnp.stack(force).sum(1)
        for name, parts in reactions.items():
            total = 0.0
            for hold, weight in zip(model.holds, parts, strict=True):
                if weight is None:
                    continue
                shift = holds.shift_of(model.numerics, hold, time)
                total = total - (holds.on_window(model.numerics, points, weight, shift) * force).sum()
            found[name] = total
    first = len(model.forces)
    displacement = None
    for k, (name, offset) in enumerate(moved.items()):
        if displacement is None:
            displacement = located(model, points) - jnp.stack(points.home)
        share = jnp.stack(points.share[2 * (first + k) : 2 * (first + k) + 2])
        found[name] = jnp.where(points.mass > 0, share * displacement, 0.0).sum() + offset
    return found


def located(model, points):
    """Positions (d, slots, *bins), mm, from the corner where the grid begins."""
    n, bins = model.numerics, points.mass.shape[1:]
    rows = []
    for axis, y in enumerate(points.place):
        number = points.window[axis] + jnp.arange(bins[axis])
        number = number.reshape([-1 if a == axis else 1 for a in range(len(bins))])
        rows.append((number - (0.5 if n.shape.centred else 0.0) + y) * n.cell)
    return jnp.stack(rows)


def frame(model, state, origin, thickness):
    """Positions of the points (N, 3), mm, and their fields, in NumPy."""
    n = model.numerics
    position, fields = listed(state.points, origin, n.cell, n.shape.centred)
    count = position.shape[1]
    gradient = np.asarray(fields["gradient"], float)
    jacobian = np.linalg.det(np.moveaxis(np.asarray(plus_one(gradient)), -1, 0))
    data = {
        "displacement": _three((position - np.reshape(origin, (-1, 1)) - fields["home"]).T),
        "stress": (fields["stress"] / jacobian).T,
        "damage": np.zeros(count), "opening": np.zeros(count), "normal": np.zeros((count, 3)),
        "material": fields["material"].astype(float),
        "side": np.sqrt(fields["volume"] / thickness),
        "velocity": _three(fields["velocity"].T),
    }  # fmt: skip
    if model.cracking is not None:
        band = fields["band"] - 1
        has = band >= 0
        for name, values in jax.tree.map(np.asarray, _bands(model, state)).items():
            data[name][has] = values[..., band[has]].T if values.ndim == 1 else _three(values[:, band[has]].T)
    return _three(position.T), data


@jax.jit
def _bands(model, state):
    found, lanes = cracks.current(model, state.points, state.pool)
    _, integrity = lanes.laws.law.soften(found.softening, lanes.laws.bulk)
    normal = jnp.stack([sum(lanes.turn[i, j] * found.normal[j] for j in range(2)) for i in range(2)])
    return {"damage": 1 - integrity, "opening": (found.normal * found.jump).sum(0), "normal": normal}


def _three(columns):
    return np.pad(columns, ((0, 0), (0, 3 - columns.shape[1])))
