"""The explicit step in the total frame, and the loop over it.

One step, in the order of the textbooks: strain from displacement, stress (intact cells, then
bands), internal force, acceleration, velocity, displacement; cells that reach onset get a
band for the next step. `step` is a pure function of pytrees.
"""

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import bands, grid, tensor
from jaxmpm.grid import CellStress
from jaxmpm.laws import band as band_law
from jaxmpm.model import Model, State, cell_strain_vectors, fields

PRECISION = 1e-5  # traction left over in a band, as a share of its strength
ROOM = 64  # the most cells that crack in one step; more wait for the next, most critical first


def step(model: Model, state: State, dt) -> State:
    """Advance a state by one time step dt (s)."""
    return _step(model, fields(model), state, dt)


@jax.jit
def advance(model: Model, state: State, dt, until) -> State:
    """Advance to step number `until`, or to the step where the driver must look.

    That is where a band did not converge (`state.failed`) or the pool needs to grow
    (`needs_room(state)`); nothing is lost or skipped there.
    """
    prepared = fields(model)
    go = lambda s: (s.step < until) & (s.failed < 0) & ~needs_room(s)  # noqa: E731
    return lax.while_loop(go, lambda s: _step(model, prepared, s, dt), state)


def needs_room(state):
    """True where the pool has not room enough for another step."""
    return state.pool.count + ROOM > state.pool.cell.shape[0]


def _step(model, prepared, state, dt):
    n = model.numerics
    strain = grid.strain(state.displacement, n.cell)
    elastic = intact_stress(prepared, state.intact, strain, n.size)
    if not n.cracks:
        plane = elastic._replace(mean=elastic.mean[:3])
        force = grid.internal_force(plane, n.cell, n.thickness)
        return _move(model, prepared, state, force, dt)._replace(step=state.step + 1)
    flat = tuple(component.reshape(-1) for component in strain.mean)
    pool, failed = bands.solve(
        state.pool, model.embedding, model.material.reshape(-1), flat, n.size, PRECISION
    )
    stress = with_bands(elastic, state.place, pool.stress)
    force = grid.internal_force(stress, n.cell, n.thickness)
    moved = _move(model, prepared, state, force, dt)
    opened = _open(model, prepared, moved._replace(pool=pool), elastic, stress, strain)
    return opened._replace(step=state.step + 1, failed=failed)


def intact_stress(prepared, intact, strain, size):
    """Stress of the uncracked cells, zero elsewhere; with size 4 the zz stress is last of mean."""
    xx, yy, xy = strain.mean
    direct, cross = prepared.direct * intact, prepared.cross * intact
    shear = prepared.shear * intact
    mean = (direct * xx + cross * yy, cross * xx + direct * yy, shear * xy)
    stiffness = grid.hourglass_stiffness(direct, shear)
    if size == 4:
        mean = (*mean, cross * (xx + yy))
    return CellStress(mean, tuple(stiffness * q for q in strain.hourglass))


def with_bands(elastic, place, stress):
    """In-plane stress of all cells: of the bands (3, capacity) where there are, else elastic."""
    mean = zip(elastic.mean[:3], stress, strict=True)
    put = lambda field, own: jnp.where(place < 0, field, own[jnp.maximum(place, 0)])  # noqa: E731
    return elastic._replace(mean=tuple(put(*pair) for pair in mean))


def _move(model, prepared, state, internal, dt):
    """Integrate the motion and book the work of the loads and of the damping."""
    time, after = state.step * dt, (state.step + 1) * dt  # of the forces; of the new positions
    external = external_force(model, prepared.mass, time).reshape(-1)
    out_of_balance = external.reshape(internal.shape) - internal
    damping = model.damping * jnp.abs(out_of_balance) * jnp.sign(state.velocity)
    velocity = state.velocity + (dt * prepared.mobility) * (out_of_balance - damping)
    flat = velocity.reshape(-1)
    for load in model.displacements:
        target = load.at(after)
        flat = flat.at[load.dofs].set((target - state.displacement.reshape(-1)[load.dofs]) / dt)
    velocity = flat.reshape(velocity.shape)
    moved = (0.5 * dt) * (state.velocity + velocity)
    work = jnp.vdot(external.reshape(internal.shape) * model.free, moved)
    for load in model.displacements:
        take = lambda a: a.reshape(-1)[load.dofs]  # noqa: B023, E731
        mass = jnp.broadcast_to(prepared.mass, internal.shape)
        inertia = take(mass) * (take(velocity) - take(state.velocity)) / dt
        work += (take(internal) + inertia) @ take(moved)
    lost = jnp.vdot(damping * model.free, moved)
    ledger = state.work._replace(
        external=state.work.external + work, damping=state.work.damping + lost
    )
    displacement = state.displacement + dt * velocity
    return state._replace(displacement=displacement, velocity=velocity, work=ledger)


def external_force(model, mass, time):
    """Forces of gravity and of the loads on the nodes (2, nx+1, ny+1), N."""
    weight = mass * model.gravity.reshape(2, 1, 1)
    external = weight.reshape(-1)
    for load in model.forces:
        external = external.at[load.dofs].add(load.at(time).astype(external.dtype))
    return external.reshape(weight.shape)


def onset_ratio(prepared, elastic, size):
    """Strength ratio r̂ of every intact cell, (nx, ny); zero in empty and cracked cells."""
    xx, yy, xy, *zz = elastic.mean
    stress = jnp.stack([xx, yy, xy] if size == 3 else [xx, yy, zz[0], xy])
    return prepared.embedding.law.onset(stress, prepared.embedding.bulk)


def _open(model, prepared, state, elastic, stress, strain):
    """Give a band to every intact cell that has reached onset."""
    n = model.numerics
    ratio = onset_ratio(prepared, elastic, n.size)
    # a matrix-vector product counts several times faster than a reduction of booleans
    critical = (ratio >= 1).astype(ratio.dtype)
    number = (critical @ jnp.ones(ratio.shape[1], ratio.dtype)).sum()

    def open_them(intact, place, pool):
        cells, new = most_critical(ratio, number)
        normal = normals(stress.mean, cells, n.normal_window)
        size = bands.effective_size(n.effective_size, normal, n.cell)
        laws = bands.at(model.embedding, model.material.reshape(-1)[cells])
        vectors = cell_strain_vectors(strain.mean, cells, n.size)
        fresh = band_law.open_band(laws, vectors, normal, size)
        # a band answers the mean strain alone: the energy of the hourglass modes is given up
        modes = zip(elastic.hourglass, strain.hourglass, strict=True)
        bent = sum(force.reshape(-1)[cells] * q.reshape(-1)[cells] for force, q in modes)
        fresh = fresh._replace(released=bent / (2 * n.cell**2))
        records = bands.unsolved(fresh, n.size)
        borne = jnp.stack([component.reshape(-1)[cells] for component in stress.mean[:3]])
        pool, places = bands.add(pool, records, cells, new, borne)
        index = jnp.where(new, cells, ratio.size)
        put = lambda field, value: (  # noqa: E731
            field.reshape(-1).at[index].set(value, mode="drop").reshape(field.shape)
        )
        return put(intact, 0.0), put(place, places.astype(place.dtype)), pool

    parts = (state.intact, state.place, state.pool)
    intact, place, pool = lax.cond(number > 0, open_them, lambda *parts: parts, *parts)
    return state._replace(intact=intact, place=place, pool=pool)


def most_critical(ratio, number):
    """Flat indices (ROOM,) of the cells with the largest strength ratio, and which are meant.

    One at a time by the largest of each row: few cells crack in one step, and sorting all of
    them costs more than the step.
    """
    rows, columns = ratio.shape

    def pick(k, carry):
        ratio, largest, cells = carry
        i = largest.argmax().astype(jnp.int32)
        row = lax.dynamic_index_in_dim(ratio, i, keepdims=False)
        j = row.argmax().astype(jnp.int32)
        row = row.at[j].set(0.0)
        ratio = lax.dynamic_update_index_in_dim(ratio, row, i, 0)
        return ratio, largest.at[i].set(row.max()), cells.at[k].set(i * columns + j)

    count = jnp.minimum(number, ROOM).astype(jnp.int32)
    none = jnp.zeros((ROOM,), jnp.int32)
    *_, cells = lax.fori_loop(0, count, pick, (ratio, ratio.max(1), none))
    return cells, jnp.arange(ROOM) < count


def normals(mean, cells, window):
    """First principal direction (2, k) of the stress averaged over window × window cells."""
    nx, ny = mean[0].shape
    reach = window // 2
    i, j = cells // ny, cells % ny
    di, dj = jnp.meshgrid(*(jnp.arange(-reach, reach + 1),) * 2, indexing="ij")
    ii, jj = i[:, None] + di.reshape(-1), j[:, None] + dj.reshape(-1)
    inside = (ii >= 0) & (ii < nx) & (jj >= 0) & (jj < ny)
    index = jnp.where(inside, ii * ny + jj, 0)
    total = [jnp.where(inside, c.reshape(-1)[index], 0.0).sum(1) for c in mean]
    return tensor.first_principal_direction(jnp.stack(total))
