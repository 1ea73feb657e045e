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

from jaxmpm import tensor
from jaxmpm import transfer as transfers
from jaxmpm.laws.finite import times
from jaxmpm.points import Points, Room, rebin
from jaxmpm.transfer import at_bins, fold, gradient, slope_at, stencil, to_nodes, to_points, unfold, value_at


@dataclass(frozen=True)
class Transfer:
    """How velocities go from points to nodes and back.

    "flip": a share `flip` of FLIP (increments), the rest PIC (values); "taylor": the same, but
    points bring their velocity gradient to the nodes too, so that those at a free edge see a
    rotation as it is (after the Taylor transfer of Nakamura et al. 2023, here with increments); "apic": values and an
    affine field (Jiang et al. 2015); "xpic": PIC with its smoothing undone to an order
    (Hammerquist, Nairn 2017). Measured: in a quarter turn of a block of 8×8 cells FLIP loses 7 % of the
    spin and XPIC(3) nearly all (the mass of nodes at a free edge is lumped), "taylor" 0.02 %, APIC none; of
    the kinetic energy of two discs that collide FLIP and "taylor" give back 81 %, APIC 37 %.
    """

    kind: str = "taylor"
    flip: float = 1.0
    order: int = 2


@dataclass(frozen=True)
class Numerics:
    """What is fixed when the step is compiled."""

    cell: float  # mm
    cells: tuple  # of the whole grid along each axis
    shape: Any  # one of `shape_functions`
    transfer: Transfer = Transfer()
    order: str = "usl"  # or "usf", "musl"
    walls: tuple = ()  # for each axis what its low and high edge do: "open", "slip" or "stick"

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

    law: Any  # a hyperelastic law: kirchhoff(F) and energy(F), leaves (materials,) or ()
    gravity: jax.Array  # (d,), mm/s²
    numerics: Numerics = field(metadata={"static": True})
    body: Any = field(default=None, metadata={"static": True})  # acceleration(points, time), mm/s²


class State(NamedTuple):
    """All that changes from step to step."""

    points: Points
    step: jax.Array
    room: Room  # asked for by the last step


def first_state(points):
    """State at the begin."""
    no = jnp.zeros((), bool)
    return State(points, jnp.zeros((), jnp.int32), Room(no, no))


def step(model, state, dt):
    """The state after one step of dt (s)."""
    n = model.numerics
    d = n.dimension
    points = state.points
    w = transfers.weights(n.shape, points.place, n.cell)
    mass, momentum = _to_grid(n, points, w, points.velocity)
    if n.order == "usf":
        points = _deform(model, points, w, _velocity(n, points, mass, momentum), dt)
    force = to_nodes(n.shape, lambda node: _force(n, points, w, node), d)
    if model.body is not None:
        pull = points.mass * model.body(points, state.step * dt)
        force += to_nodes(n.shape, lambda node: value_at(w, node) * pull, d)
    force = fold(n.shape, force, points.window, n.cells)
    before = _velocity(n, points, mass, momentum)
    heavy, safe = _heavy(mass)
    gravity = model.gravity.reshape(d, *[1] * d)
    after = before + dt * (jnp.where(heavy, force / safe, 0.0) + jnp.where(heavy, gravity, 0.0))
    after = _held(n, points, after)
    moved = _move_points(n, points, w, before, after, mass, dt)
    if n.order == "usl":
        moved = _deform(model, moved, w, after, dt)
    elif n.order == "musl":
        again = _to_grid(n, moved, w, moved.velocity)[1]
        moved = _deform(model, moved, w, _velocity(n, points, mass, again), dt)
    moved, room = rebin(moved)
    return State(moved, state.step + 1, room)


def advance(model, state, dt, until):
    """Repeat `step` to step `until`, or to where a point finds no room."""

    def go(state):
        return (state.step < until) & ~state.room.slots & ~state.room.window

    return lax.while_loop(go, lambda state: step(model, state, dt), state)


advance = jax.jit(advance)


# ------------------------------------------------------------------ points to nodes


def _to_grid(n, points, w, velocity):
    """Mass (*nodes) and momentum (d, *nodes), ghosts folded in."""
    affine = n.affine

    def contribution(node):
        share = value_at(w, node) * points.mass
        moves = velocity
        if affine:
            arm = _arm(n, points, node)
            moves = velocity + jnp.stack([sum(row[b] * arm[b] for b in range(len(arm))) for row in points.affine])
        return jnp.concatenate([share[None], share * moves])

    total = to_nodes(n.shape, contribution, n.dimension)
    total = fold(n.shape, total, points.window, n.cells)
    return total[0], total[1:]


def _arm(n, points, node):
    """From points to a node, mm, one an axis."""
    middle = 0.5 if n.shape.centred else 0.0
    return [(k - n.shape.lead + middle - y) * n.cell for k, y in zip(node, points.place, strict=True)]


def _force(n, points, w, node):
    """−V τ·∇N of a node, (d, slots, *bins)."""
    d = n.dimension
    slopes = [slope_at(w, node, b) for b in range(d)]
    rows = [0.0] * d
    for value, (i, j) in zip(points.stress, tensor.IN_SPACE[d], strict=True):
        rows[i] = rows[i] + value * slopes[j]
        if i != j:
            rows[j] = rows[j] + value * slopes[i]
    return -points.volume * jnp.stack(rows)


def _heavy(mass):
    """Nodes that carry more than round-off, and their mass, 1 elsewhere."""
    heavy = mass > jnp.finfo(mass.dtype).eps * mass.max()
    return heavy, jnp.where(heavy, mass, 1.0)


def _velocity(n, points, mass, momentum):
    """Velocity of the nodes, with what holds them."""
    heavy, safe = _heavy(mass)
    return _held(n, points, jnp.where(heavy, momentum / safe, 0.0))


def _held(n, points, velocity):
    """Velocities (d, *nodes) with those of the edges of the grid, ghosts continued."""
    d = n.dimension
    for axis, sides in enumerate(n.walls):
        number = points.window[axis] - n.shape.lead + jnp.arange(velocity.shape[1 + axis])
        number = number.reshape([-1 if a == axis else 1 for a in range(d)])
        for side, at_edge in zip(sides, (number <= 0, number >= n.cells[axis]), strict=True):
            rows = {"open": (), "slip": (axis,), "stick": range(d)}[side]
            for row in rows:
                velocity = velocity.at[row].set(jnp.where(at_edge, 0.0, velocity[row]))
    return unfold(n.shape, velocity, points.window, n.cells)


# ------------------------------------------------------------------ nodes to points


def _move_points(n, points, w, before, after, mass, dt):
    """Places and velocities after the step."""
    d, kind = n.dimension, n.transfer.kind
    carried = to_points(n.shape, w, after, d)
    used = points.mass > 0
    if kind in ("flip", "taylor"):
        change = to_points(n.shape, w, after - before, d)
        flip = n.transfer.flip
        velocity = points.velocity + change
        if flip != 1:
            velocity = flip * velocity + (1 - flip) * carried
        if kind == "taylor":
            points = points._replace(affine=gradient(n.shape, w, after, d))
    elif kind == "apic":
        velocity = carried
        points = points._replace(affine=_affine(n, points, w, after))
    else:
        velocity = _xpic(n, points, w, before, after, mass)
    place = points.place + jnp.where(used, dt / n.cell * carried, 0.0)
    return points._replace(place=place, velocity=jnp.where(used, velocity, 0.0))


def _affine(n, points, w, velocity):
    """Affine velocity field of APIC: Σ N v ⊗ (x_i − x_p) D⁻¹, D of the B-splines; else ∇v."""
    d = n.dimension
    inverse = {"Quadratic": 4.0, "Cubic": 3.0}.get(type(n.shape).__name__)
    if inverse is None:
        return gradient(n.shape, w, velocity, d)
    total = 0.0
    for node in stencil(n.shape, d):
        arm = jnp.stack(_arm(n, points, node))
        share = value_at(w, node) * at_bins(n.shape, velocity, node, d)
        total = total + share[:, None] * arm[None]
    return total * (inverse / n.cell**2)


def _xpic(n, points, w, before, after, mass):
    """(I − (I − S S⁺)^m) v + Σ N (v_new − v_old): what the grid does not see is filtered out."""
    d = n.dimension
    left = points.velocity
    for k in range(n.transfer.order):
        if k == 0:
            seen = before
        else:
            seen = _velocity(n, points, mass, _to_grid(n, points, w, left)[1])
        left = left - to_points(n.shape, w, seen, d)
    return points.velocity - left + to_points(n.shape, w, after - before, d)


def _deform(model, points, w, velocity, dt):
    """Deformation and stress after a step of these nodal velocities."""
    n = model.numerics
    old = points.deformation
    deformation = old + dt * times(gradient(n.shape, w, velocity, n.dimension), old)
    stress = law_of(model, points).kirchhoff(deformation)
    used = points.mass > 0
    return points._replace(
        deformation=jnp.where(used, deformation, old), stress=jnp.where(used, stress, 0.0)
    )


def law_of(model, points):
    """The law of every point; one for all where there is one material."""
    own = lambda leaf: leaf[0] if leaf.shape == (1,) else leaf[points.material]  # noqa: E731
    return jax.tree.map(lambda leaf: own(leaf) if jnp.ndim(leaf) else leaf, model.law)


def energies(model, points):
    """Kinetic and stored energy of all points, N·mm."""
    kinetic = (points.mass * (points.velocity**2).sum(0)).sum() / 2
    stored = law_of(model, points).energy(points.deformation)
    return kinetic, jnp.where(points.mass > 0, points.volume * stored, 0.0).sum()
