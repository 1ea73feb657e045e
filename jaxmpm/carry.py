"""What points bring to the nodes, and take back, in the terms of mechanics.

Points are given by components, see `points.separate`. A nodal vector is a list of components, each
with an axis of velocity fields first, (fields, *nodes): one field, or one for each body where they rub.
"""

import jax
import jax.numpy as jnp

from jaxmpm import tensor
from jaxmpm import transfer as transfers
from jaxmpm.shape_functions import Gimp
from jaxmpm.tensor import Matrix
from jaxmpm.transfer import apart, at_bins, slope_at, stencil, to_nodes, to_points, value_at


def weights(n, points):
    """`transfer.Weights` of the points; those of uGIMP are as wide as their volume says."""
    own = (half_width(n, points),) if n.shape == Gimp() else ()
    return transfers.weights(n.shape, points.place, n.cell, *own)


def half_width(n, points, stretch=1.0):
    """Half the width of GIMP points over the cell size, that of their undeformed volume times a `stretch`."""
    share = jnp.where(points.volume > 0, points.volume / n.cell_volume, 1.0)
    half = 0.5 * (share, jnp.sqrt(share), jnp.cbrt(share))[n.dimension - 1]
    return jnp.clip(half * stretch, 0.01, 0.5)


def to_fields(n, points, contribution):
    """Nodal sums of `contribution(node)`, a list of (slots, *bins), the ghosts' share handed on.

    Returns:
        a list of (fields, *nodes)
    """

    def total(mine):
        part = to_nodes(n.shape, lambda node: [mine(c) for c in contribution(node)], n.dimension)
        return transfers.fold(n.shape, part, points.window, n.cells)

    if n.fields == 1:
        return list(total(lambda part: part)[:, None])
    belongs = [points.body == k for k in range(n.fields)]
    return list(jnp.stack([total(lambda part: jnp.where(own, part, 0.0)) for own in belongs], 1))  # noqa: B023


def from_fields(n, points, take, values):
    """`take` of the components (*nodes) of a nodal vector in the field that each point moves in."""
    out = take([v[0] for v in values])
    for k in range(1, n.fields):
        mine = points.body == k
        other = take([v[k] for v in values])
        out = jax.tree.map(lambda a, b: jnp.where(mine, a, b), other, out)  # noqa: B023
    return out


def at_points(n, points, w, values):
    """A nodal vector at the points, a list of (slots, *bins)."""
    return from_fields(n, points, lambda v: to_points(n.shape, w, v), values)


def unfolded(n, points, values):
    """Nodal values with ghosts as the continuation of what is inside."""
    if not n.shape.lead:
        return list(values)
    return list(transfers.unfold(n.shape, apart(values), points.window, n.cells))


def mass_and_momentum(n, points, w, velocity):
    """Mass (fields, *nodes), tonne, and momentum, tonne mm/s."""

    def contribution(node):
        share = value_at(w, node) * points.mass
        moves = velocity
        if n.affine:
            arm = arms(n, points, node)
            moves = [
                v + sum(row[b] * arm[b] for b in range(len(arm)))
                for v, row in zip(velocity, points.affine, strict=True)
            ]
        return [share, *(share * v for v in moves)]

    mass, *momentum = to_fields(n, points, contribution)
    return mass, momentum


def arms(n, points, node):
    """From points to a node, mm, one an axis."""
    middle = 0.5 if n.shape.centred else 0.0
    return [(k - n.shape.lead + middle - y) * n.cell for k, y in zip(node, points.place, strict=True)]


def mass_arm(n, points, w):
    """Mass times its place seen from the node, tonne mm."""

    def contribution(node):
        share = value_at(w, node) * points.mass
        return [-a * share for a in arms(n, points, node)]

    return to_fields(n, points, contribution)


def internal_force(n, points, w):
    """−Σ V τ·∇N, N."""
    d = n.dimension
    stress = [-points.volume * value for value in points.stress]

    def contribution(node):
        slopes = [slope_at(w, node, b) for b in range(d)]
        rows = [0.0] * d
        for value, (i, j) in zip(stress, tensor.IN_SPACE[d], strict=True):
            rows[i] = rows[i] + value * slopes[j]
            if i != j:
                rows[j] = rows[j] + value * slopes[i]
        return rows

    return to_fields(n, points, contribution)


def heavy(mass):
    """Nodes that carry more than round-off, and their mass, 1 elsewhere."""
    carries = mass > jnp.finfo(mass.dtype).eps * mass.max()
    return carries, jnp.where(carries, mass, 1.0)


def velocity_of(mass, momentum):
    """Velocity of the nodes, zero where there is no mass."""
    carries, safe = heavy(mass)
    return [jnp.where(carries, p / safe, 0.0) for p in momentum]


def kinetic_energy(n, points, w):
    """Energy of the motion that points bring to the nodes, N·mm: their own and of their affine fields."""
    energy = (points.mass * sum(v**2 for v in points.velocity)).sum() / 2
    if not n.affine:
        return energy
    for b in range(n.dimension):
        spread = _second_moment(n, points, w, b)
        energy += (points.mass * spread * sum(row[b] ** 2 for row in points.affine)).sum() / 2
    return energy


def _second_moment(n, points, w, axis):
    """Σ N (x_i − x_p)² along an axis, mm²."""
    middle = 0.5 if n.shape.centred else 0.0
    y = points.place[axis]
    return sum(v * ((k - n.shape.lead + middle - y) * n.cell) ** 2 for k, v in enumerate(w.value[axis]))


def moved(n, points, w, before, after, change, mass, dt):
    """Points at their places and with their velocities after the step, not written yet.

    Args:
        n: `moving.Numerics`.
        points, w: before the step, and their weights.
        before, after, change: velocities of the nodes, and the difference.
        mass: of the nodes.
        dt: s.
    """
    kind = n.transfer.kind
    carried = at_points(n, points, w, after)
    if kind in ("flip", "taylor"):
        flip = n.transfer.flip
        velocity = _added(points.velocity, at_points(n, points, w, change))
        if flip != 1:
            velocity = [flip * v + (1 - flip) * c for v, c in zip(velocity, carried, strict=True)]
    elif kind == "apic":
        velocity = carried
        points = points._replace(affine=_affine(n, points, w, after))
    else:
        velocity = _xpic(n, points, w, before, change, mass)
    place = _added(points.place, [dt / n.cell * c for c in carried])
    return points._replace(place=place, velocity=velocity)


def _added(a, b):
    return [x + y for x, y in zip(a, b, strict=True)]


def velocity_gradient(n, points, w, velocity):
    """∇v, `Matrix`, of nodal velocities, 1/s."""
    return from_fields(n, points, lambda v: transfers.gradient(n.shape, w, v), velocity)


def _affine(n, points, w, velocity):
    """Affine velocity field of APIC: Σ N v ⊗ (x_i − x_p) D⁻¹, D of the B-splines; else ∇v."""
    d = n.dimension
    inverse = {"Quadratic": 4.0, "Cubic": 3.0}.get(type(n.shape).__name__)
    if inverse is None:
        return velocity_gradient(n, points, w, velocity)

    def take(values):
        total = [[0.0] * d for _ in values]
        for node in stencil(n.shape, d):
            share = value_at(w, node) * (inverse / n.cell**2)
            arm = [share * a for a in arms(n, points, node)]
            for row, v in zip(total, values, strict=True):
                row[:] = _added(row, [a * at_bins(n.shape, v, node) for a in arm])
        return Matrix(total)

    return from_fields(n, points, take, velocity)


def _xpic(n, points, w, before, change, mass):
    """(I − (I − S S⁺)^m) v + Σ N (v_new − v_old): what the grid does not see is filtered out."""
    left, seen = points.velocity, apart(before)
    for k in range(n.transfer.order):
        if k > 0:
            momentum = mass_and_momentum(n, points, w, left)[1]
            seen = unfolded(n, points, velocity_of(mass, momentum))
        left = [v - s for v, s in zip(left, at_points(n, points, w, list(seen)), strict=True)]
    filtered = [v - rest for v, rest in zip(points.velocity, left, strict=True)]
    return _added(filtered, at_points(n, points, w, change))
