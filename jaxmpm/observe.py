"""What a state says: gauges, energies and the fields of a frame.

A step solves the bands at the positions it starts from, so a state is read there: at time
(step − 1) dt, one step before the positions that it holds.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxmpm import bands, explicit, grid
from jaxmpm.laws import band as band_law
from jaxmpm.model import cell_strain_vectors, fields, kinetic_energy


class Reading(NamedTuple):
    """Numbers of one state; energies in N·mm."""

    time: jax.Array  # s
    gauges: dict  # by name, N or mm
    external: jax.Array  # work of the loads, and the kinetic energy at the start
    stored: jax.Array
    kinetic: jax.Array
    dissipated: jax.Array  # in bands
    damping: jax.Array
    contact: jax.Array  # taken by friction and impact
    cracked: jax.Array  # cells with a band
    gradient: jax.Array  # largest displacement gradient of an uncracked cell
    gradient_cell: jax.Array  # its flat index
    opening: jax.Array  # largest displacement jump of a band, mm
    opening_cell: jax.Array
    opening_rate: jax.Array  # how fast the edges of that cell part, mm/s
    displacement: jax.Array  # largest of a node, mm

    def energies(self):
        """Work of the loads, then where it has gone, N·mm."""
        return self[2:8]


@jax.jit
def read(model, state, dt) -> Reading:
    """Gauges and energies of a state."""
    n = model.numerics
    at = _Cells(model, state, dt)
    force = grid.internal_force(at.stress, n.cell, n.thickness)
    volume = n.cell**2 * n.thickness
    mean = sum(jnp.vdot(s, e) for s, e in zip(at.elastic.mean, at.strain.mean, strict=False))
    bend = sum(
        jnp.vdot(s, q) for s, q in zip(at.elastic.hourglass, at.strain.hourglass, strict=True)
    )
    stored, dissipated = band_law.energies(at.laws, at.bands, at.vectors)
    total = lambda each: jnp.where(at.used, each, 0.0).sum()  # noqa: E731
    # work and velocities are half a step ahead of the stresses: bring the energy there too
    half_step = jnp.vdot(force, state.velocity) * dt / 2
    gradient = _gradient(at.displacement, n.cell) * state.intact
    jump = jnp.where(at.used, jnp.hypot(*at.bands.jump), 0.0)
    widest = state.pool.cell[jump.argmax()]
    parting = _gradient(state.velocity, n.cell).reshape(-1)[widest] * n.cell
    return Reading(
        time=(state.step - 1) * dt,
        gauges=_gauges(model, at, force),
        external=state.work.external + state.work.initial,
        stored=volume * (mean / 2 + total(stored)) + n.thickness * bend / 2 + half_step,
        kinetic=kinetic_energy(model, at.prepared.mass, state.velocity),
        dissipated=volume * total(dissipated) + state.work.released,
        damping=state.work.damping,
        contact=jnp.zeros_like(state.work.damping),
        cracked=state.pool.count,
        gradient=gradient.max(),
        gradient_cell=gradient.argmax(),
        opening=jump.max(),
        opening_cell=widest,
        opening_rate=parting,
        displacement=jnp.where(at.prepared.mass > 0, jnp.hypot(*at.displacement), 0.0).max(),
    )


class _Cells:
    """Strain and stress of every cell of a state; the bands as they were last solved."""

    def __init__(self, model, state, dt):
        n = model.numerics
        self.prepared = fields(model)
        self.displacement = state.displacement - dt * state.velocity
        self.time = (state.step - 1) * dt
        self.strain = grid.strain(self.displacement, n.cell)
        self.elastic = explicit.intact_stress(self.prepared, state, self.strain, n.size)
        pool = state.pool
        self.used = jnp.arange(pool.cell.shape[0]) < pool.count
        self.laws = bands.at(model.embedding, model.material.reshape(-1)[pool.cell])
        self.vectors = cell_strain_vectors(self.strain.mean, pool.cell, n.size)
        self.stress = explicit.with_bands(self.elastic, state.place, pool.stress)
        flat = tuple(component.reshape(-1) for component in self.strain.mean)
        material = model.material.reshape(-1)
        self.bands = bands.current(pool, model.embedding, material, flat, n.size)


def _gauges(model, at, internal):
    external = explicit.external_force(model, at.prepared.mass, at.time)
    source = {True: (internal - external).reshape(-1), False: at.displacement.reshape(-1)}
    return {name: source[g.reaction][g.dofs] @ g.weights for name, g in model.gauges.items()}


def _gradient(field, cell):
    """Largest component of the gradient of displacement or velocity in each cell, along its edges, (nx, ny)."""
    along_x = jnp.abs(jnp.diff(field, axis=1)).max(0) / cell
    along_y = jnp.abs(jnp.diff(field, axis=2)).max(0) / cell
    by_x = jnp.maximum(along_x[:, :-1], along_x[:, 1:])
    by_y = jnp.maximum(along_y[:-1], along_y[1:])
    return jnp.maximum(by_x, by_y)


@jax.jit
def frame(model, state, dt) -> dict:
    """Fields over the cells (nx, ny): displacement, in-plane stress, and what the bands say."""
    at = _Cells(model, state, dt)
    u = at.displacement
    middle = (u[:, :-1, :-1] + u[:, 1:, :-1] + u[:, 1:, 1:] + u[:, :-1, 1:]) / 4
    pool = state.pool
    cells = jnp.where(at.used, pool.cell, state.intact.size)

    _, integrity = at.laws.law.soften(at.bands.softening, at.laws.bulk)

    def put(values):
        flat = jnp.zeros((*values.shape[:-1], state.intact.size), values.dtype)
        flat = flat.at[..., cells].set(values, mode="drop")
        return flat.reshape(*values.shape[:-1], *state.intact.shape)

    return {
        "displacement": middle,
        "stress": jnp.stack(at.stress.mean),
        "damage": put(1 - integrity),
        "opening": put((at.bands.normal * at.bands.jump).sum(0)),
        "normal": put(at.bands.normal),
    }
