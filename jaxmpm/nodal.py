"""What happens on the nodes in a step of moving points: forces, what holds them, and the work done."""

import jax.numpy as jnp

from jaxmpm import carry, contact, holds
from jaxmpm.points import joined
from jaxmpm.transfer import apart, value_at


def less_lumped(model, points, w, mass, before, after, time, dt):
    """Velocities whose increment has more of the inverse of the consistent mass, Σ_k (1 − M_L⁻¹ M)^k."""
    n = model.numerics
    less = lambda a, b: [x - y for x, y in zip(a, b, strict=True)]  # noqa: E731
    change = less(after, before)
    for _ in range(n.transfer.inverse - 1):
        at = carry.at_points(n, points, w, list(apart(less(after, before))))
        bring = lambda node: [value_at(w, node) * points.mass * a for a in at]  # noqa: B023, E731
        seen = carry.velocity_of(mass, carry.to_fields(n, points, bring))
        after = [a + c - s for a, c, s in zip(after, change, seen, strict=True)]
        after = held(model, points, after, time, dt)
    return after


def held(model, points, velocity, time, dt):
    """Nodal velocities as walls and holds have them, ghosts continued."""
    velocity = holds.held(model.numerics, model.holds, points, velocity, time, dt)
    return carry.unfolded(model.numerics, points, velocity)


def accelerated(model, points, w, mass, before, time, dt):
    """Nodal velocities after the step; work of loads and supports, of damping and of contact, N·mm."""
    n = model.numerics
    carries, safe = carry.heavy(mass)
    internal = carry.internal_force(n, points, w)
    push = internal
    if (external := external_force(model, points, w, mass, time)) is not None:
        push = [a + b for a, b in zip(internal, external, strict=True)]
    damping = None
    if model.damping is not None:
        damping = [model.damping * jnp.abs(p) * jnp.sign(v) for p, v in zip(push, before, strict=True)]
        push = [p - each for p, each in zip(push, damping, strict=True)]
    free = [v + dt * jnp.where(carries, p / safe, 0.0) for v, p in zip(before, push, strict=True)]
    rubbed = free
    if n.fields > 1:
        arm = jnp.stack(carry.mass_arm(n, points, w), 1)
        rubbed = contact.rub(n, mass, arm, jnp.stack(free, 1), model.friction)
        rubbed = [rubbed[:, a] for a in range(n.dimension)]
    after = held(model, points, rubbed, time + dt, dt)
    if damping is None and external is None and not model.holds and n.fields == 1:
        return after, (jnp.zeros_like(mass, shape=()),) * 3  # nothing does work
    return after, _works(mass, before, free, rubbed, after, internal, damping, dt)


def _works(mass, before, free, rubbed, after, internal, damping, dt):
    """Work of loads and supports, of damping and of contact, N·mm."""
    carries, _ = carry.heavy(mass)
    total = lambda parts: sum(parts).sum()  # noqa: E731
    middle = [jnp.where(carries, (b + a) / 2, 0.0) for b, a in zip(before, after, strict=True)]
    of = lambda a, b: total(mass * (y - x) * v for x, y, v in zip(a, b, middle, strict=True))  # noqa: E731
    by_contact = of(free, rubbed)
    by_damping = jnp.zeros_like(by_contact)
    if damping is not None:
        by_damping = dt * total(f * v for f, v in zip(damping, middle, strict=True))
    stored = dt * total(f * v for f, v in zip(internal, middle, strict=True))
    return of(before, after) - stored + by_damping - by_contact, by_damping, -by_contact


def external_force(model, points, w, mass, time):
    """Forces of gravity, of loads and of a body force, N, or None without any."""
    n = model.numerics
    force, pulls = None, []
    if model.gravity is not None:
        force = [mass * g for g in model.gravity]
    for k, load in enumerate(model.forces):
        share = points.share[n.dimension * k : n.dimension * (k + 1)]
        used = points.mass > 0  # a free slot keeps the share of the point that has left it
        pulls.append([load.amplitude(time) * jnp.where(used, each, 0.0) for each in share])
    if model.body is not None:
        pulls.append([points.mass * a for a in model.body(joined(points), time)])
    if pulls:
        whole = [sum(parts) for parts in zip(*pulls, strict=True)]
        brought = carry.to_fields(n, points, lambda node: [value_at(w, node) * pull for pull in whole])
        force = brought if force is None else [a + b for a, b in zip(force, brought, strict=True)]
    return force
