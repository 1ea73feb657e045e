"""What points bring to the nodes, and take back, in the terms of mechanics.

Nodal arrays begin with an axis of velocity fields: one, or one for each body where they rub.
"""

import jax.numpy as jnp

from jaxmpm import tensor
from jaxmpm import transfer as transfers
from jaxmpm.shape_functions import Gimp
from jaxmpm.transfer import at_bins, slope_at, stencil, to_nodes, to_points, value_at


def weights(n, points):
    """`transfer.Weights` of the points; those of uGIMP are as wide as their volume says."""
    own = ()
    if n.shape == Gimp():
        share = points.volume / n.cell_volume
        half = 0.5 * jnp.where(points.volume > 0, share, 1.0) ** (1 / n.dimension)
        own = (jnp.clip(half, 0.01, 0.5),)
    return transfers.weights(n.shape, points.place, n.cell, *own)


def to_fields(n, points, contribution):
    """Nodal sums (fields, ..., *nodes) of `contribution(node)`, the ghosts' share handed on."""

    def total(mine):
        part = to_nodes(n.shape, lambda node: mine(contribution(node)), n.dimension)
        return transfers.fold(n.shape, part, points.window, n.cells)

    if n.fields == 1:
        return total(lambda part: part)[None]
    belongs = [points.body == k for k in range(n.fields)]
    return jnp.stack([total(lambda part: jnp.where(own, part, 0.0)) for own in belongs])  # noqa: B023


def from_fields(n, points, take, values):
    """`take(values[k])` of the field k that each point moves in."""
    out = take(values[0])
    for k in range(1, n.fields):
        out = jnp.where(points.body == k, take(values[k]), out)
    return out


def mass_and_momentum(n, points, w, velocity):
    """Mass (fields, *nodes), tonne, and momentum (fields, d, *nodes), tonne mm/s."""

    def contribution(node):
        share = value_at(w, node) * points.mass
        moves = velocity
        if n.affine:
            arm = arms(n, points, node)
            moves = velocity + jnp.stack(
                [sum(row[b] * arm[b] for b in range(len(arm))) for row in points.affine]
            )
        return jnp.concatenate([share[None], share * moves])

    total = to_fields(n, points, contribution)
    return total[:, 0], total[:, 1:]


def arms(n, points, node):
    """From points to a node, mm, one an axis."""
    middle = 0.5 if n.shape.centred else 0.0
    return [(k - n.shape.lead + middle - y) * n.cell for k, y in zip(node, points.place, strict=True)]


def mass_arm(n, points, w):
    """Mass times its place seen from the node (fields, d, *nodes), tonne mm."""

    def contribution(node):
        return jnp.stack([-a for a in arms(n, points, node)]) * (value_at(w, node) * points.mass)

    return to_fields(n, points, contribution)


def internal_force(n, points, w):
    """−Σ V τ·∇N (fields, d, *nodes), N."""
    d = n.dimension

    def contribution(node):
        slopes = [slope_at(w, node, b) for b in range(d)]
        rows = [0.0] * d
        for value, (i, j) in zip(points.stress, tensor.IN_SPACE[d], strict=True):
            rows[i] = rows[i] + value * slopes[j]
            if i != j:
                rows[j] = rows[j] + value * slopes[i]
        return -points.volume * jnp.stack(rows)

    return to_fields(n, points, contribution)


def heavy(mass):
    """Nodes that carry more than round-off, and their mass, 1 elsewhere."""
    carries = mass > jnp.finfo(mass.dtype).eps * mass.max()
    return carries, jnp.where(carries, mass, 1.0)


def velocity_of(mass, momentum):
    """Velocity of the nodes (fields, d, *nodes), zero where there is no mass."""
    carries, safe = heavy(mass)
    return jnp.where(carries[:, None], momentum / safe[:, None], 0.0)


def kinetic_energy(n, points, w):
    """Energy of the motion that points bring to the nodes, N·mm: their own and of their affine fields."""
    energy = (points.mass * (points.velocity**2).sum(0)).sum() / 2
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


def moved(n, points, w, before, after, mass, dt):
    """Points at their places and with their velocities after the step."""
    d, kind = n.dimension, n.transfer.kind
    value = lambda v: to_points(n.shape, w, v, d)  # noqa: E731
    carried = from_fields(n, points, value, after)
    used = points.mass > 0
    if kind in ("flip", "taylor"):
        flip = n.transfer.flip
        velocity = points.velocity + from_fields(n, points, value, after - before)
        if flip != 1:
            velocity = flip * velocity + (1 - flip) * carried
    elif kind == "apic":
        velocity = carried
        points = points._replace(affine=_affine(n, points, w, after))
    else:
        velocity = _xpic(n, points, w, before, after, mass)
    place = points.place + jnp.where(used, dt / n.cell * carried, 0.0)
    return points._replace(place=place, velocity=jnp.where(used, velocity, 0.0))


def velocity_gradient(n, points, w, velocity):
    """∇v (d, d, slots, *bins) of nodal velocities (fields, d, *nodes), 1/s."""
    take = lambda v: transfers.gradient(n.shape, w, v, n.dimension)  # noqa: E731
    return from_fields(n, points, take, velocity)


def _affine(n, points, w, velocity):
    """Affine velocity field of APIC: Σ N v ⊗ (x_i − x_p) D⁻¹, D of the B-splines; else ∇v."""
    d = n.dimension
    inverse = {"Quadratic": 4.0, "Cubic": 3.0}.get(type(n.shape).__name__)
    if inverse is None:
        return velocity_gradient(n, points, w, velocity)

    def take(v):
        total = 0.0
        for node in stencil(n.shape, d):
            arm = jnp.stack(arms(n, points, node))
            share = value_at(w, node) * at_bins(n.shape, v, node, d)
            total = total + share[:, None] * arm[None]
        return total * (inverse / n.cell**2)

    return from_fields(n, points, take, velocity)


def _xpic(n, points, w, before, after, mass):
    """(I − (I − S S⁺)^m) v + Σ N (v_new − v_old): what the grid does not see is filtered out."""
    value = lambda v: to_points(n.shape, w, v, n.dimension)  # noqa: E731
    left = points.velocity
    for k in range(n.transfer.order):
        if k == 0:
            seen = before
        else:
            momentum = mass_and_momentum(n, points, w, left)[1]
            seen = transfers.unfold(n.shape, velocity_of(mass, momentum), points.window, n.cells)
        left = left - from_fields(n, points, value, seen)
    return points.velocity - left + from_fields(n, points, value, after - before)
