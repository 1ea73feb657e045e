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

from jaxmpm import carry, cracks, nodal
from jaxmpm.bands import Pool
from jaxmpm.explicit import needs_room
from jaxmpm.laws.finite import inverse, plus_one, times
from jaxmpm.model import Ledger
from jaxmpm.points import MATRICES, Points, Room, joined, separate
from jaxmpm.rebinning import rebin_parts
from jaxmpm.tensor import Matrix
from jaxmpm.transfer import apart, together

FEW = 8  # results of one loop over points
CHANGES = ("place", "velocity", *MATRICES)  # in every step


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

    law: Any  # a hyperelastic law: kirchhoff(H), a list, and energy(H), leaves (materials,)
    gravity: jax.Array | None  # (d,), mm/s²
    numerics: Numerics = field(metadata={"static": True})
    body: Any = field(default=None, metadata={"static": True})  # acceleration(points, time), mm/s²
    holds: tuple = ()  # supports and moved sets, see `holds`
    forces: tuple = ()  # loads whose rows of `Points.share` say where they pull, in this order
    cracking: cracks.Cracking | None = None
    damping: Any = None  # local damping coefficient
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
    return State(points, counted, Room(no, no, no), pool, counted - 1, Ledger(kinetic, zero, zero, zero), zero)


def step(model, state, dt):
    """The state after one step of dt (s)."""
    state = _step(model, state._replace(points=separate(state.points)), dt)
    return _whole(model, state)


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

    def turn(state):
        state = _step(model, state, dt)
        return _step(model, state, dt, go(state)) if twice else state

    # what the first of two steps writes the second reads, and nothing need be copied to where the loop
    # began: a fifth of a short step, little of a long one, which would only take longer to compile
    twice = model.cracking is None and not model.numerics.affine and model.numerics.shape.count == 2
    points = separate(state.points)
    if model.cracking is None:
        points = points._replace(stress=())
    state = lax.while_loop(go, turn, state._replace(points=points))
    return _whole(model, state)


def _whole(model, state):
    """A state whose points are whole arrays, with their stress."""
    points = state.points
    return state._replace(points=joined(_with_stress(model, points) if model.cracking is None else points))


def _step(model, state, dt, on=True):
    """The state, points by components, after one step; the same where not `on`.

    Without bands the stress is not kept: it follows from the deformation wherever it is needed.
    """
    n, points, pool, failed = model.numerics, state.points, state.pool, state.failed
    time = model.begin + state.step * dt
    w = carry.weights(n, points)
    mass, momentum = carry.mass_and_momentum(n, points, w, points.velocity)
    before = nodal.held(model, points, carry.velocity_of(mass, momentum), time, dt)
    if n.order == "usf":
        points = _written(_deformed(n, points, w, before, dt), points, on)
        points, pool, failed = stressed(model, points, pool)
    elif model.cracking is None:
        points = _with_stress(model, points)
    after, ledger = nodal.accelerated(model, points, w, mass, before, time, dt)
    after = nodal.less_lumped(model, points, w, mass, before, after, time + dt, dt)
    both = apart([*after, *(a - b for a, b in zip(after, before, strict=True))])
    after, change = list(both[: n.dimension]), list(both[n.dimension :])
    moved = carry.moved(n, points, w, before, after, change, mass, dt)
    if n.order == "usl":
        moved = _deformed(n, moved, w, after, dt)
    moved = _written(moved, points, on)
    if n.order == "musl":
        again = carry.mass_and_momentum(n, moved, w, moved.velocity)[1]
        again = apart(nodal.held(model, points, carry.velocity_of(mass, again), time + dt, dt))
        moved = _written(_deformed(n, moved, w, list(again), dt), moved, on)
    if n.order != "usf":
        moved, pool, failed = stressed(model, moved, pool)
    if model.cracking is not None:
        moved, pool = cracks.open_bands(model, moved, pool)
    return _next(model, state, moved, pool, failed, ledger, on)


def _beyond_open_edges(n, points):
    """Whether a point is past an edge that lets it go; bins around the nodes there reach beyond it."""
    found = jnp.zeros((), bool)
    for axis, sides in enumerate(n.walls):
        count = points.mass.shape[1 + axis]
        for side, row, past in zip(sides, (0, count - 1), (jnp.less, jnp.greater), strict=True):
            if side != "open":
                continue
            y, mass = (lax.index_in_dim(a, row, 1 + axis) for a in (points.place[axis], points.mass))
            at_edge = points.window[axis] + row == (0 if row == 0 else n.cells[axis])
            found |= at_edge & (past(y, 0.5) & (mass > 0)).any()
    return found


def _next(model, state, points, pool, failed, ledger, on):
    """The state of points that have moved."""
    n = model.numerics
    if model.cracking is None:
        points = points._replace(stress=())
    points, address, room = rebin_parts(points, None if pool is None else pool.cell)
    if n.shape.centred:
        room = room._replace(window=room.window | _beyond_open_edges(n, points))
    pool = None if pool is None else pool._replace(cell=address)
    external, damping, rubbed = (jnp.where(on, part, 0.0) for part in ledger)
    work = state.work._replace(external=state.work.external + external, damping=state.work.damping + damping)
    room = Room(*(jnp.where(on, new, old) for new, old in zip(room, state.room, strict=True)))
    return State(points, state.step + on, room, pool, failed, work, state.rubbed + rubbed)


def _written(new, old, on):
    """Points written to memory, in few loops; the `old` ones where not `on` or where a slot is free."""
    used = (new.mass > 0) & on
    changed = [name for name in CHANGES if getattr(new, name) is not getattr(old, name)]
    groups = [changed]
    if len(jax.tree.leaves([getattr(new, name) for name in changed])) > FEW:
        groups = [[name for name in changed if (name in MATRICES) is which] for which in (False, True)]
    for group in filter(None, groups):
        before, tree = jax.tree.flatten([getattr(old, name) for name in group])
        after = jax.tree.leaves([getattr(new, name) for name in group])
        made = together([jnp.where(used, a, b) for a, b in zip(after, before, strict=True)])
        new = new._replace(**dict(zip(group, jax.tree.unflatten(tree, made), strict=True)))
    return new


def _deformed(n, points, w, velocity, dt):
    """Points with the deformation after a step of these nodal velocities, not written yet."""
    old, d = points.gradient, range(n.dimension)
    rate = carry.velocity_gradient(n, points, w, velocity)
    change = times(rate, old)
    gradient = Matrix([old[i, j] + dt * (rate[i, j] + change[i, j]) for j in d] for i in d)
    if n.transfer.kind == "taylor":  # as the points carry it to where they have gone
        advanced = inverse(plus_one(jax.tree.map(lambda a: dt * a, rate)))
        points = points._replace(affine=times(rate, advanced))
    return points._replace(gradient=gradient)


def _with_stress(model, points):
    """Points by components with the stress of their deformation, zero where a slot is free."""
    stress = law_of(model, points).kirchhoff(points.gradient)
    return points._replace(stress=tuple(jnp.where(points.mass > 0, s, 0.0) for s in stress))


def stressed(model, points, pool):
    """Points with their stress, the pool, and the place of a band that did not converge or -1."""
    points = _with_stress(model, points)
    if model.cracking is None:
        return points, pool, jnp.full((), -1, jnp.int32)
    points = points._replace(stress=tuple(together(points.stress)))
    return cracks.solve(model, points, pool)


def law_of(model, points):
    """The law of every point; one for all where there is one material."""

    def own(leaf):
        chosen = leaf[0]
        for k in range(1, leaf.shape[0]):  # comparisons run faster than a gather
            chosen = jnp.where(points.material == k, leaf[k], chosen)
        return chosen

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
