"""The explicit step of points that move: the material point method proper.

Points carry mass, velocity, deformation and stress through a grid that is fresh in every step:

    m_i = Σ N_i m_p,  p_i = Σ N_i m_p v_p,  f_i = −Σ V_p τ_p·∇N_i + Σ N_i m_p b
    v_i ← v_i + dt f_i/m_i                         on the grid, held by its supports
    x_p += dt Σ N_i v_i,  F_p ← (I + dt ∇v) F_p    and v_p by one of the transfers

(Sulsky, Chen, Schreyer 1994.) The stress follows from F by a hyperelastic law, in total form, so
that a rigid motion of any size does no work. `order` says when it is updated: before the forces
(USF), after the motion by the velocities of the grid (USL), or by velocities mapped once more
(MUSL, which tames nodes of little mass).
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import carry, contact, cracks
from jaxmpm import transfer as transfers
from jaxmpm.bands import Pool
from jaxmpm.explicit import needs_room
from jaxmpm.holds import held
from jaxmpm.laws.finite import inverse, plus_one, times
from jaxmpm.model import Ledger
from jaxmpm.points import Points, Room, rebin
from jaxmpm.transfer import to_points, value_at


@dataclass(frozen=True)
class Transfer:
    """How velocities go from points to nodes and back.

    "flip": a share `flip` of FLIP (increments), the rest PIC (values); "taylor": the same, but
    points bring their velocity gradient to the nodes too, so that those at a free edge see a
    rotation as it is (after the Taylor transfer of Nakamura et al. 2023, here with increments); "apic": values and an
    affine field (Jiang et al. 2015); "xpic": PIC with its smoothing undone to an order
    (Hammerquist, Nairn 2017). With `inverse` above 1 the increment of the velocities solves for more of the
    consistent mass (FMPM(k), Nairn, Hammerquist 2021), in all but XPIC: on cubic splines 2 has a tenth of the error. Measured: in a quarter turn of a block of 8×8 cells FLIP loses 7 % of the
    spin and XPIC(3) nearly all (the mass of nodes at a free edge is lumped), "taylor" 0.02 %, APIC none; of
    the kinetic energy of two discs that collide FLIP and "taylor" give back 81 %, APIC 37 %.
    """

    kind: str = "taylor"
    flip: float = 1.0
    order: int = 2  # of XPIC
    inverse: int = 1  # order of the inverse of the consistent mass that increments get, 1: lumped


@dataclass(frozen=True)
class Numerics:
    """What is fixed when the step is compiled."""

    cell: float  # mm
    cells: tuple  # of the whole grid along each axis
    shape: Any  # one of `shape_functions`
    transfer: Transfer = Transfer()
    order: str = "usl"  # or "usf", "musl"
    walls: tuple = ()  # for each axis what its low and high edge do: "open", "slip" or "stick"
    cell_volume: float = 1.0  # mm³, for the width of uGIMP points
    fields: int = 1  # of velocity, more than one where bodies rub

    @property
    def affine(self):
        """Points keep a velocity gradient."""
        return self.transfer.kind in ("apic", "taylor")

    @property
    def dimension(self):
        """Number of axes."""
        return len(self.cells)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Model:
    """What moves, and how."""

    law: Any  # a hyperelastic law: kirchhoff(H) and energy(H), leaves (materials,)
    gravity: jax.Array  # (d,), mm/s²
    numerics: Numerics = field(metadata={"static": True})
    body: Any = field(default=None, metadata={"static": True})  # acceleration(points, time), mm/s²
    holds: tuple = ()  # supports and moved sets, see `holds`
    forces: tuple = ()  # loads whose rows of `Points.share` say where they pull, in this order
    cracking: cracks.Cracking | None = None
    damping: Any = 0.0  # local damping coefficient
    friction: Any = 0.0  # coefficient between bodies that have fields of their own
    begin: Any = 0.0  # time of step 0, s


class State(NamedTuple):
    """All that changes from step to step."""

    points: Points
    step: jax.Array
    room: Room  # asked for by the last step
    pool: Pool | None  # of bands, `cell` the flat index of each one's point
    failed: jax.Array  # place in the pool of a band that did not converge, or -1
    work: Ledger
    rubbed: jax.Array  # energy that contact has taken, N·mm


def first_state(points, pool=None, kinetic=0.0):
    """State at the begin; its kinetic energy, N·mm, is the first entry of the ledger."""
    no, zero = jnp.zeros((), bool), jnp.zeros((), points.mass.dtype)
    kinetic = zero + kinetic
    counted = jnp.zeros((), jnp.int32)
    return State(points, counted, Room(no, no, no), pool, counted - 1, Ledger(kinetic, zero, zero), zero)


def step(model, state, dt):
    """The state after one step of dt (s)."""
    n, points = model.numerics, state.points
    time = model.begin + state.step * dt
    w = carry.weights(n, points)
    mass, momentum = carry.mass_and_momentum(n, points, w, points.velocity)
    before = _held(model, points, carry.velocity_of(mass, momentum), time, dt)
    pool, failed = state.pool, state.failed
    if n.order == "usf":
        points, pool, failed = _deform(model, points, pool, w, before, dt)
    after, ledger = _accelerate(model, points, w, mass, before, time, dt)
    after = _less_lumped(model, points, w, mass, before, after, time + dt, dt)
    moved = carry.moved(n, points, w, before, after, mass, dt)
    if n.order == "usl":
        moved, pool, failed = _deform(model, moved, pool, w, after, dt)
    elif n.order == "musl":
        again = carry.mass_and_momentum(n, moved, w, moved.velocity)[1]
        again = _held(model, points, carry.velocity_of(mass, again), time + dt, dt)
        moved, pool, failed = _deform(model, moved, pool, w, again, dt)
    if model.cracking is not None:
        moved, pool = cracks.open_bands(model, moved, pool)
    moved, address, room = rebin(moved, None if pool is None else pool.cell)
    pool = None if pool is None else pool._replace(cell=address)
    work = state.work._replace(
        external=state.work.external + ledger[0], damping=state.work.damping + ledger[1]
    )
    return State(moved, state.step + 1, room, pool, failed, work, state.rubbed + ledger[2])


@jax.jit
def advance(model, state, dt, until):
    """Repeat `step` to step `until`, or to where the driver must look.

    That is where a point finds no room, the pool of bands needs to grow, or a band did not
    converge; nothing is lost or skipped there.
    """

    def go(state):
        room = state.room.slots | state.room.window | state.room.wild
        on = (state.step < until) & ~room & (state.failed < 0)
        return on if state.pool is None else on & ~needs_room(state)

    return lax.while_loop(go, lambda state: step(model, state, dt), state)


def _less_lumped(model, points, w, mass, before, after, time, dt):
    """Velocities whose increment has more of the inverse of the consistent mass, Σ_k (1 − M_L⁻¹ M)^k."""
    n = model.numerics
    change = after - before
    for _ in range(n.transfer.inverse - 1):
        value = lambda v: to_points(n.shape, w, v, n.dimension)  # noqa: E731
        at = carry.from_fields(n, points, value, after - before)
        seen = carry.to_fields(n, points, lambda node: value_at(w, node) * points.mass * at)  # noqa: B023
        after = _held(model, points, after + change - carry.velocity_of(mass, seen), time, dt)
    return after


def _held(model, points, velocity, time, dt):
    """Nodal velocities as walls and holds have them, ghosts continued."""
    n = model.numerics
    velocity = held(n, model.holds, points, velocity, time, dt)
    return transfers.unfold(n.shape, velocity, points.window, n.cells)


def _accelerate(model, points, w, mass, before, time, dt):
    """Nodal velocities after the step; work of loads and supports, of damping and of contact, N·mm."""
    n = model.numerics
    carries, safe = (each[:, None] for each in carry.heavy(mass))
    per_mass = lambda force: jnp.where(carries, force / safe, 0.0)  # noqa: E731
    internal = carry.internal_force(n, points, w)
    push = internal + external_force(model, points, w, mass, time)
    damping = model.damping * jnp.abs(push) * jnp.sign(before)
    free = before + dt * per_mass(push - damping)
    rubbed = free
    if n.fields > 1:
        rubbed = contact.rub(n, mass, carry.mass_arm(n, points, w), free, model.friction)
    after = _held(model, points, rubbed, time + dt, dt)
    middle = jnp.where(carries, (before + after) / 2, 0.0)
    by_contact = (mass[:, None] * (rubbed - free) * middle).sum()
    by_damping = dt * (damping * middle).sum()
    change = (mass[:, None] * (after - before) * middle).sum()
    external = change - dt * (internal * middle).sum() + by_damping - by_contact
    return after, (external, by_damping, -by_contact)


def external_force(model, points, w, mass, time):
    """Forces of gravity, of loads and of a body force, (fields, d, *nodes), N."""
    n = model.numerics
    force = mass[:, None] * model.gravity.reshape(n.dimension, *[1] * n.dimension)
    pulls = 0.0
    for k, load in enumerate(model.forces):
        share = points.share[n.dimension * k : n.dimension * (k + 1)]
        pulls = pulls + load.amplitude(time) * jnp.where(points.mass > 0, share, 0.0)  # not of free slots
    if model.body is not None:
        pulls = pulls + points.mass * model.body(points, time)
    if jnp.ndim(pulls):
        force = force + carry.to_fields(n, points, lambda node: value_at(w, node) * pulls)
    return force


def _deform(model, points, pool, w, velocity, dt):
    """Deformation and stress after a step of these nodal velocities."""
    n, old = model.numerics, points.gradient
    rate = carry.velocity_gradient(n, points, w, velocity)
    if n.transfer.kind == "taylor":  # as the points carry it to where they have gone
        points = points._replace(affine=times(rate, inverse(plus_one(dt * rate))))
    gradient = old + dt * (rate + times(rate, old))
    stress = law_of(model, points).kirchhoff(gradient)
    used = points.mass > 0
    points = points._replace(
        gradient=jnp.where(used, gradient, 0.0), stress=jnp.where(used, stress, 0.0)
    )
    if model.cracking is None:
        return points, pool, jnp.full((), -1, jnp.int32)
    return cracks.solve(model, points, pool)


def law_of(model, points):
    """The law of every point; one for all where there is one material."""
    own = lambda leaf: leaf[0] if leaf.shape == (1,) else leaf[points.material]  # noqa: E731
    return jax.tree.map(lambda leaf: own(leaf) if jnp.ndim(leaf) else leaf, model.law)


def energies(model, points, pool=None):
    """Kinetic, stored and dissipated energy of all points, N·mm."""
    n = model.numerics
    kinetic = carry.kinetic_energy(n, points, carry.weights(n, points))
    intact = (points.mass > 0) & (points.band == 0)
    stored = law_of(model, points).energy(points.gradient)
    stored = jnp.where(intact, points.volume * stored, 0.0).sum()
    if pool is None:
        return kinetic, stored, jnp.zeros_like(stored)
    in_bands, dissipated = cracks.energies(model, points, pool)
    return kinetic, stored + in_bands, dissipated
