"""The heart of the project: any band law embedded in any bulk law (Nguyen, Eqs. 1-10).

A cracked volume of effective size H holds a band of width h and normal n, f = h/H:

    ε_L = ε_c + (n ⊗ [u])^s / h                    strain in the band            (3)
    ε_b = (ε − f ε_L) / (1 − f)                    strain in the bulk            (2)
    σ   = σ_b(ε_b)                                 macroscopic stress            (4)
    r([u]; ε) = (σ_b(ε_b) − σ_L(ε_L)) · n = 0      continuity of traction        (6)

The equations are solved in this total form for the jump [u] since onset; the rate form of
the paper has the same tangent but drifts. Every derivative comes from `jax.jacfwd`.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import tensor
from jaxmpm.laws.elastic import released_stress
from jaxmpm.laws.law import jacobian


class Band(NamedTuple):
    """State of one localisation band."""

    normal: jax.Array  # unit normal n (2,), fixed at onset
    size: jax.Array  # effective size H, mm
    onset_strain: jax.Array  # ε_c (size,)
    strain: jax.Array  # macroscopic strain of the last step (size,)
    jump: jax.Array  # displacement jump [u] since onset (2,), mm
    history: Any  # of the band law
    released: jax.Array  # energy given up otherwise than by the band law, per cell volume, N/mm²


class Embedding(NamedTuple):
    """The two laws of a cracked point, and how it releases the stress parallel to the crack."""

    bulk: Any
    law: Any
    release: jax.Array  # exponent p of the release of crack-parallel stress, 0: none


class Response(NamedTuple):
    """What a band answers to a strain."""

    band: Band  # new state
    stress: jax.Array  # macroscopic stress (size,), MPa
    residual: jax.Array  # |r|, MPa: traction that is out of balance
    tolerance: jax.Array  # the residual that counts as converged, MPa


def open_band(embedding, strain, normal, size):
    """A band at onset: the strain is scaled back to where the strength ratio is exactly 1."""
    ratio = embedding.law.onset(embedding.bulk.stress(strain), embedding.bulk)
    zero = jnp.zeros_like(size)
    return Band(
        normal=normal,
        size=size,
        onset_strain=strain / ratio,
        strain=strain,
        jump=jnp.zeros_like(normal),
        history=embedding.law.initial(),
        released=zero,
    )


def band_strain(embedding, band, jump):
    """Strain in the band, Eq. 3 in total form, (size,)."""
    size = band.onset_strain.shape[0]
    opening = tensor.symmetric_product(band.normal, jump, size)
    return band.onset_strain + opening / embedding.law.h


def bulk_strain(embedding, band, strain, jump):
    """Strain in the bulk, Eq. 2, (size,)."""
    fraction = embedding.law.h / band.size
    return (strain - fraction * band_strain(embedding, band, jump)) / (1 - fraction)


def kept(embedding, band):
    """Share ψᵖ, with the cohesion ψ of the band, of what the release has not let go of yet."""
    cohesion = embedding.law.cohesion(band.history)
    return jnp.maximum(cohesion, jnp.finfo(cohesion.dtype).tiny) ** embedding.release


def bulk_stress(embedding, band, strain):
    """Stress of the bulk (size,), its crack-parallel part released as the band loses cohesion."""
    return released_stress(embedding.bulk, strain, band.normal, kept(embedding, band))


def equilibrium(embedding, band, strain, jump):
    """Residual r (2,) of Eq. 6 for a trial jump, with the stress and history that go with it."""
    stress = bulk_stress(embedding, band, bulk_strain(embedding, band, strain, jump))
    inside, history = embedding.law.respond(
        band_strain(embedding, band, jump), band.history, embedding.bulk
    )
    return tensor.traction(stress - inside, band.normal), (stress, history)


class Trial(NamedTuple):
    """One trial jump and what it says."""

    jump: jax.Array  # (2,)
    stress: jax.Array
    history: Any
    residual: jax.Array  # (2,)
    balanced: jax.Array  # the residual is as good as zero
    newton: jax.Array  # the jump that Newton would try next


def _try(embedding, band, strain, jump, precision):
    """Evaluate a jump once: residual and its matrix by forward differentiation, stress, history."""

    def residual(jump):
        value, rest = equilibrium(embedding, band, strain, jump)
        return value, (value, *rest)

    matrix, (value, stress, history) = jacobian(residual, jump)
    largest = jnp.maximum(jnp.abs(value[0]), jnp.abs(value[1]))
    balanced = largest <= tolerance(embedding, strain, precision)
    return Trial(jump, stress, history, value, balanced, jump - solve2(matrix, value))


def _secant(embedding, band, strain, trial):
    """The jump (2,) that balances with the history held at that of a trial."""

    def residual(jump):
        stress = bulk_stress(embedding, band, bulk_strain(embedding, band, strain, jump))
        inside = band_strain(embedding, band, jump)
        held = embedding.law.frozen(inside, trial.history, embedding.bulk)
        return tensor.traction(stress - held, band.normal), None

    matrix, _ = jacobian(residual, trial.jump)
    return trial.jump - solve2(matrix, trial.residual)


def solve2(matrix, vector):
    """Solution of a 2×2 system in closed form."""
    (a, b), (c, d) = matrix
    determinant = a * d - b * c
    return jnp.stack([d * vector[0] - b * vector[1], a * vector[1] - c * vector[0]]) / determinant


def tolerance(embedding, strain, precision):
    """Out-of-balance traction (MPa) that is as good as zero: a share of f_t, or round-off."""
    eps = jnp.finfo(strain.dtype).eps
    largest = sum(jnp.abs(component) for component in strain)
    return precision * embedding.law.ft + 16 * eps * embedding.bulk.E * largest


BURST = 1e-3  # work that went nowhere in one step and counts as a jump of equilibrium, of f_t²/E
TURN = 8  # steps of one kind before the local solver turns to the other
STEPS = 400  # steps in all before it gives up


class _Search(NamedTuple):
    """Where the local solver stands."""

    trial: Trial
    count: jax.Array
    walked: jax.Array  # where the secant steps have come to (2,)
    move: jax.Array  # last secant step (2,)
    pace: jax.Array  # how many times over the next one is taken


def _balance(embedding, band, strain, precision):
    """Find the jump that balances the tractions: the last trial.

    Newton from the last jump settles nearly every point in one or two steps. Where it has found
    nothing after eight, the loaded band softens faster than the bulk can follow (a band whose
    normal is not principal sheds its shear at onset) and equilibrium jumps: then `_search`.
    """
    attempt = partial(_try, embedding, band, strain, precision=precision)
    trial, _ = lax.while_loop(
        lambda carry: ~carry[0].balanced & (carry[1] < TURN),
        lambda carry: (attempt(carry[0].newton), carry[1] + 1),
        (attempt(band.jump), 0),
    )
    return _search(embedding, band, strain, trial, attempt)


def _search(embedding, band, strain, trial, attempt):
    """Eight secant steps and eight of Newton in turn, until one of them balances the tractions.

    The secant steps start from the last state: with the history of a trial held the band is
    elastic and the balancing jump one solve away. They lead away from an equilibrium that is
    not stable and towards the first that is, faster and faster until they have passed it.
    """

    def iterate(s):
        newton = (s.count // TURN) % 2 == 1
        first, last = s.count % TURN == 0, s.count % TURN == TURN - 1
        move = _secant(embedding, band, strain, s.trial) - s.trial.jump
        ahead = tensor.dot(move, s.move) >= 0
        pace = jnp.where(newton | first, s.pace, jnp.where(ahead, 2 * s.pace, 1.0))
        jump = jnp.where(newton, s.trial.newton, s.trial.jump + pace * move)
        walked = jnp.where(newton, s.walked, jump)
        jump = jnp.where(newton & last, s.walked, jump)
        move = jnp.where(newton, s.move, move)
        return _Search(attempt(jump), s.count + 1, walked, move, pace)

    # one before a turn to secant steps: the first thing is to go back to the last jump
    start = _Search(
        trial, 2 * TURN - 1, band.jump, jnp.zeros_like(band.jump), jnp.ones_like(band.size)
    )
    go = lambda s: ~s.trial.balanced & (s.count < STEPS)  # noqa: E731
    return lax.while_loop(go, iterate, start).trial


class Solution(NamedTuple):
    """What balances the tractions at a macroscopic strain."""

    jump: jax.Array  # (2,), mm
    stress: jax.Array  # macroscopic (size,), MPa
    history: Any
    residual: jax.Array  # what is left of r (2,), MPa


@partial(jax.custom_jvp, nondiff_argnums=(3,))
def solve(embedding, band, strain, precision=1e-11):
    """Jump, stress and history that balance the tractions at a macroscopic strain.

    The derivative is that of the implicit function r([u]; ε) = 0, whatever the iteration did.

    Args:
        embedding: the laws.
        band: state at the end of the last step.
        strain: macroscopic strain (size,).
        precision: out-of-balance traction that is accepted, as a share of f_t.

    Returns:
        Solution; where the iteration did not converge the residual is larger than `tolerance`
        or not finite.
    """
    trial = _balance(embedding, band, strain, precision)
    return Solution(trial.jump, trial.stress, trial.history, trial.residual)


@solve.defjvp
def _solve_jvp(precision, primals, tangents):
    found = solve(*primals, precision)
    # where the iteration started (the last jump) does not matter to where it ended
    _, change = jax.jvp(lambda *args: equilibrium(*args, found.jump)[0], primals, tangents)
    matrix = jax.jacfwd(lambda jump: equilibrium(*primals, jump)[0])(found.jump)
    by_jump = -solve2(matrix, change)
    _, (by_stress, by_history) = jax.jvp(
        lambda *args: equilibrium(*args)[1], (*primals, found.jump), (*tangents, by_jump)
    )
    return found, Solution(by_jump, by_stress, by_history, jnp.zeros_like(found.residual))


def respond(embedding, band, strain, precision=1e-11):
    """Solve the band at a macroscopic strain (size,): new state, stress and what is left over."""
    found = solve(embedding, band, strain, precision)
    new = band._replace(jump=found.jump, history=found.history, strain=strain)
    # energy given up by softening the bulk parallel to the crack, at fixed strain
    inside = bulk_strain(embedding, band, strain, found.jump)
    fraction = embedding.law.h / band.size
    softening = tensor.dot(found.stress - bulk_stress(embedding, new, inside), inside) / 2
    given = (1 - fraction) * softening
    # and by a jump of equilibrium to another branch, which shows as work that went nowhere
    before, dissipated = energies(embedding, band, band.strain)
    after, dissipating = energies(embedding, new, strain)
    mean = (found.stress + bulk_stress(embedding, band, bulk_strain(embedding, band, band.strain, band.jump))) / 2
    lost = tensor.dot(mean, strain - band.strain) - (after - before) - (dissipating - dissipated) - given
    sudden = lost > BURST * embedding.law.ft**2 / embedding.bulk.E
    given += jnp.where(sudden, lost, 0.0)
    new = new._replace(released=band.released + given)
    left = jnp.maximum(jnp.abs(found.residual[0]), jnp.abs(found.residual[1]))
    return Response(new, found.stress, left, tolerance(embedding, strain, precision))


class Rest(NamedTuple):
    """What a band answers if it does not load."""

    jump: jax.Array  # (2,), mm
    stress: jax.Array  # macroscopic (size,), MPa
    loads: jax.Array  # it does load, or does not answer linearly: use `respond`


def rest(embedding, band, strain, precision):
    """Answer of a band whose history stays: linear, so one solve and no iteration."""
    aim = lambda jump: bulk_strain(embedding, band, strain, jump)  # noqa: E731

    def residual(jump):
        stress = bulk_stress(embedding, band, aim(jump))
        inside = band_strain(embedding, band, jump)
        held = embedding.law.frozen(inside, band.history, embedding.bulk)
        return tensor.traction(stress - held, band.normal), (stress, inside)

    def left(jump):
        value, _ = residual(jump)
        return value, value

    matrix, value = jacobian(left, band.jump)
    jump = band.jump - solve2(matrix, value)
    value, (stress, inside) = residual(jump)
    good = jnp.maximum(jnp.abs(value[0]), jnp.abs(value[1])) <= tolerance(
        embedding, strain, precision
    )
    loads = embedding.law.loads(inside, band.history, embedding.bulk)
    return Rest(jump, stress, loads | ~good)


def stress_at(strain, embedding, band):
    """Macroscopic stress (size,) at a strain: the function whose `jacfwd` is the tangent."""
    return solve(embedding, band, strain)[1]


def energies(embedding, band, strain):
    """Stored and dissipated energy of a cracked point per volume of the cell, N/mm²."""
    fraction = embedding.law.h / band.size
    bulk = bulk_strain(embedding, band, strain, band.jump)
    inside = band_strain(embedding, band, band.jump)
    stored = (1 - fraction) * tensor.dot(bulk, bulk_stress(embedding, band, bulk)) / 2
    stored += fraction * embedding.law.stored(inside, band.history, embedding.bulk)
    return stored, fraction * embedding.law.dissipated(band.history) + band.released
