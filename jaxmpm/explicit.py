"""The explicit step in the total frame, and the loop over it.

One step, in the order of the textbooks: strain from displacement, stress (intact cells, then
bands), cells that have reached onset get a band, internal force, acceleration, velocity,
displacement. `step` is a pure function of pytrees.

Steps are discrete and onset is not: a cell cracks somewhere within a step, and what its band keeps
of that moment (normal, onset strain) is taken there, between the step and the one before. So the
answer depends smoothly on the parameters, and its derivative knows that a stronger cell cracks later.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxmpm import bands, bands_reverse, grid, periodic, tensor
from jaxmpm.grid import CellStress
from jaxmpm.laws import band as band_law
from jaxmpm.model import Model, State, cell_strain_vectors, fields

PRECISION = 1e-5  # traction left over in a band, as a share of its strength
ROOM = 64  # the most cells that crack in one step; more wait for the next, most critical first
LETTING_GO = 20.0  # steps in which a cracked cell gives up most of its hourglass stiffness


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


def _step(model, prepared, state, dt, reverse=False):
    n = model.numerics
    solve = bands_reverse.solve if reverse else bands.solve
    strain = grid.strain(state.displacement, n.cell)
    elastic = intact_stress(prepared, state, strain, n.size)
    if not n.cracks:
        plane = elastic._replace(mean=elastic.mean[:3])
        return _move(model, prepared, state, plane, dt)._replace(step=state.step + 1)
    flat = tuple(component.reshape(-1) for component in strain.mean)
    pool, failed = solve(
        state.pool, model.embedding, model.material.reshape(-1), flat, n.size, PRECISION
    )
    stress = with_bands(elastic, state.place, pool.stress)
    keep = jnp.asarray(np.exp(-1 / LETTING_GO), state.grip.dtype)
    grip = jnp.where(state.intact > 0, state.grip, keep * state.grip)
    cracked, mean = _open(model, prepared, state, pool, grip, elastic, stress, strain, dt, reverse)
    given_up = _let_go(n, prepared, state, cracked, strain.hourglass, dt)
    stiffness = prepared.hourglass * cracked.grip
    stress = grid.CellStress(mean, tuple(stiffness * q for q in strain.hourglass))
    moved = _move(model, prepared, cracked, stress, dt)
    ledger = moved.work._replace(released=moved.work.released + given_up)
    return moved._replace(step=state.step + 1, failed=failed, work=ledger)


def _let_go(n, prepared, state, cracked, modes, dt):
    """Energy (N·mm) given up as cracked cells lose their hourglass stiffness.

    A band answers the mean strain alone. What the hourglass modes bear at onset goes over some
    steps: at once it would start waves, which say little of the material and much of the mesh.
    """
    rates = grid.strain(state.velocity, n.cell).hourglass  # twice the energy half a step ago:
    product = sum(q * (q - dt * rate) for q, rate in zip(modes, rates, strict=True))
    return jnp.vdot(state.grip - cracked.grip, prepared.hourglass * product) * (0.5 * n.thickness)


def intact_stress(prepared, state, strain, size):
    """Stress of the uncracked cells, zero elsewhere; with size 4 the zz stress is last of mean."""
    xx, yy, xy = strain.mean
    direct, cross = prepared.direct * state.intact, prepared.cross * state.intact
    shear = prepared.shear * state.intact
    mean = (direct * xx + cross * yy, cross * xx + direct * yy, shear * xy)
    stiffness = prepared.hourglass * state.grip
    if size == 4:
        mean = (*mean, cross * (xx + yy))
    return CellStress(mean, tuple(stiffness * q for q in strain.hourglass))


def with_bands(elastic, place, stress):
    """In-plane stress of all cells: of the bands (3, capacity) where there are, else elastic."""
    mean = zip(elastic.mean[:3], stress, strict=True)
    put = lambda field, own: jnp.where(place < 0, field, own[jnp.maximum(place, 0)])  # noqa: E731
    return elastic._replace(mean=tuple(put(*pair) for pair in mean))


def _move(model, prepared, state, stress, dt):
    """Integrate the motion and book the work of the loads and of the damping."""
    n = model.numerics
    time, after = state.step * dt, (state.step + 1) * dt  # of the forces; of the new positions
    internal = grid.internal_force(stress, n.cell, n.thickness)
    if model.macro is not None:
        return _move_periodic(model, prepared, state, internal, dt)
    external = external_force(model, prepared.mass, time).reshape(-1)
    push, lost = external.reshape(internal.shape) - internal, 0.0
    if model.damping is not None:
        damping = model.damping * jnp.abs(push) * jnp.sign(state.velocity)
        push = push - damping
    if model.viscosity is not None:
        viscous, lost = _viscous(model.numerics, prepared, state, dt)
        push = push - viscous
    velocity = state.velocity + (dt * prepared.mobility) * push
    flat = velocity.reshape(-1)
    for load in model.displacements:
        target = load.at(after)
        flat = flat.at[load.dofs].set((target - state.displacement.reshape(-1)[load.dofs]) / dt)
    velocity = flat.reshape(velocity.shape)
    moved = (0.5 * dt) * (state.velocity + velocity)
    work = jnp.vdot(external.reshape(internal.shape) * model.free, moved)
    if model.viscosity is not None:
        internal = internal + viscous
    for load in model.displacements:
        take = lambda a: a.reshape(-1)[load.dofs]  # noqa: B023, E731
        mass = jnp.broadcast_to(prepared.mass, internal.shape)
        inertia = take(mass) * (take(velocity) - take(state.velocity)) / dt
        work += (take(internal) + inertia) @ take(moved)
    if model.damping is not None:
        lost += jnp.vdot(damping * model.free, moved)
    ledger = state.work._replace(
        external=state.work.external + work, damping=state.work.damping + lost
    )
    displacement = state.displacement + dt * velocity
    return state._replace(displacement=displacement, velocity=velocity, work=ledger)


def _move_periodic(model, prepared, state, internal, dt):
    """The same for a periodic cell, which its mean strain drives."""
    lost = 0.0
    if model.viscosity is not None:
        viscous, lost = _viscous(model.numerics, prepared, state, dt)
        internal = internal + viscous
    displacement, velocity, work, damped = periodic.move(model, prepared, state, internal, dt)
    external, damping = state.work.external + work, state.work.damping + lost + damped
    ledger = state.work._replace(external=external, damping=damping)
    return state._replace(displacement=displacement, velocity=velocity, work=ledger)


def _viscous(n, prepared, state, dt):
    """Nodal forces of the viscosity of intact cells, and the work (N·mm) that they take in a step.

    The stress is 2ξ/ω times that of the rate of strain, ω = 2/Δt_s the highest frequency: the
    share ξ of critical damping there, less in proportion at lower ones, and none of a rigid motion.
    """
    rate = grid.strain(state.velocity, n.cell)
    stress = intact_stress(prepared, state, rate, 3)
    stress = grid.CellStress(*(tuple(prepared.relaxation * s for s in part) for part in stress))
    power = sum(jnp.vdot(s, e) for s, e in zip(stress.mean, rate.mean, strict=True)) * n.cell**2
    power += sum(jnp.vdot(s, q) for s, q in zip(stress.hourglass, rate.hourglass, strict=True))
    return grid.internal_force(stress, n.cell, n.thickness), power * n.thickness * dt


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


def _open(model, prepared, state, pool, grip, elastic, stress, strain, dt, reverse=False):
    """The state with this pool and grip, and a band for every intact cell that has reached onset.

    Returns:
        (state, in-plane stress of all cells; those that crack bear no more than they did at onset)
    """
    n = model.numerics
    # which cells are meant is no matter of derivatives; those of the few that crack are taken below
    ratio = onset_ratio(*lax.stop_gradient((prepared, elastic)), n.size)
    # a matrix-vector product counts several times faster than a reduction of booleans
    critical = (ratio >= 1).astype(ratio.dtype)
    number = (critical @ jnp.ones(ratio.shape[1], ratio.dtype)).sum()

    def open_them(intact, grip, place, pool, mean):
        cells, new = most_critical(ratio, number)
        cells = jnp.where(new, cells, cells[0])  # spare lanes do as the first: all is finite
        before = grid.strain(state.displacement - dt * state.velocity, n.cell)
        earlier = intact_stress(prepared, state, before, n.size)
        ratios = (onset_ratio(prepared, s, n.size) for s in (earlier, elastic))
        share = _onset_share(*ratios, cells, new)
        borne = with_bands(earlier, state.place, state.pool.stress)
        between = lambda a, b: a + share * (b - a)  # noqa: E731
        periodic_cell = model.macro is not None
        averages = (averaged(s.mean, cells, n.normal_window, periodic_cell, n.half) for s in (borne, stress))
        normal = tensor.first_principal_direction(between(*averages))
        size = effective_size(n, normal, cells, ratio.shape[1])
        laws = bands.at(model.embedding, model.material.reshape(-1)[cells])
        vectors = (cell_strain_vectors(e.mean, cells, n.size) for e in (before, strain))
        records = bands.unsolved(band_law.open_band(laws, between(*vectors), normal, size), n.size)
        own = jnp.stack([component.reshape(-1)[cells] for component in mean])
        own = between(jnp.stack([component.reshape(-1)[cells] for component in borne.mean[:3]]), own)
        pool, places = bands.add(pool, records, cells, new, own)
        index = jnp.where(new, cells, ratio.size)
        put = lambda field, value: (  # noqa: E731
            field.reshape(-1).at[index].set(value, mode="drop").reshape(field.shape)
        )
        left = jnp.exp((share - 1) / LETTING_GO)
        mean = tuple(put(*pair) for pair in zip(mean, own, strict=True))
        return put(intact, 0.0), put(grip, left), put(place, places.astype(place.dtype)), pool, mean

    if reverse:  # few steps open a crack: the others need not keep what its derivative takes
        open_them = jax.checkpoint(open_them)
    parts = (state.intact, grip, state.place, pool, stress.mean[:3])
    *parts, mean = lax.cond(number > 0, open_them, lambda *parts: parts, *parts)
    return state._replace(**dict(zip(("intact", "grip", "place", "pool"), parts, strict=True))), mean


def _onset_share(earlier, ratio, cells, new):
    """Share of the last step after which cells have reached onset, by r̂ before and after it."""
    before, after = (r.reshape(-1)[cells] for r in (earlier, ratio))
    grows = new & (after > before)
    return jnp.clip((1 - before) / jnp.where(grows, after - before, 1.0), 0.0, 1.0)


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


def effective_size(n, normal, cells, rows):
    """Effective size H (mm) of the bands of cells, by flat index on a grid of so many `rows`, with normals (2, k).

    A crack along a plane of symmetry is one crack in two cells, that of the half that is modelled and its image: one
    band in twice the size, not two.
    """
    size = bands.effective_size(n.effective_size, normal, n.cell)
    if n.half is None:
        return size
    number = cells // rows if n.half == 0 else cells % rows
    shared = (number == 0) & (jnp.abs(normal[n.half]) > jnp.abs(normal[1 - n.half]))
    return jnp.where(shared, 2 * size, size)


def averaged(mean, cells, window, wraps=False, half=None):
    """Stress averaged over window × window cells around some, but for a factor, (3, k).

    What lies beyond an edge counts nothing, or, where the grid `wraps`, is what lies at the opposite one. Beyond the
    plane of symmetry of a `half` along an axis lies its image, and cells at the plane are taken with theirs: without shear.
    """
    nx, ny = mean[0].shape
    reach = window // 2
    i, j = cells // ny, cells % ny
    di, dj = jnp.meshgrid(*(jnp.arange(-reach, reach + 1),) * 2, indexing="ij")
    ii, jj = i[:, None] + di.reshape(-1), j[:, None] + dj.reshape(-1)
    if wraps:
        ii, jj = ii % nx, jj % ny
    mirrored = None if half is None else (ii, jj)[half] < 0
    if half is not None:
        ii, jj = (jnp.where(k < 0, -1 - k, k) if axis == half else k for axis, k in enumerate((ii, jj)))
    inside = (ii >= 0) & (ii < nx) & (jj >= 0) & (jj < ny)
    index = jnp.where(inside, ii * ny + jj, 0)
    taken = [jnp.where(inside, c.reshape(-1)[index], 0.0) for c in mean[:3]]
    if half is not None:
        turned = jnp.where(mirrored, -taken[2], taken[2])
        taken[2] = jnp.where((i, j)[half][:, None] == 0, 0.0, turned)
    return jnp.stack([c.sum(1) for c in taken])
