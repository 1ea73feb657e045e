"""The methods for a cracked point that the map of `stability.py` compares.

| method | what it does in a step |
|---|---|
| rate | Eqs. 8-10 as printed: [u] and σ move along the tangent at the start of the step |
| newton | σ_b·n = t_L solved for [u] with the law inside, Newton from the last [u], no safeguard |
| balance | the solver of the project, `balance.respond` |
| smeared | no band: isotropic damage of the whole cell, softening scaled to its size |

A step takes the laws, a `Point` and the new macroscopic strain, and gives the new `Point`. Points
lie along a trailing axis.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import tensor
from jaxmpm.laws import balance
from jaxmpm.laws import band as bands
from jaxmpm.laws.band import Band, Embedding
from jaxmpm.laws.law import jacobian
from jaxmpm.laws.smeared import Smeared, SmearedHistory, softening_at

ITERATIONS = 25  # of the plain Newton before it counts as not converged
FAR = 0.42  # mm, twice the opening at the end: jump up to which the work of tractions counts


class Laws(NamedTuple):
    """What the methods integrate."""

    embedding: Embedding
    smeared: Smeared


class Point(NamedTuple):
    """State of points along a trailing axis, whatever the method."""

    band: Band
    strain: jax.Array  # macroscopic (size, many)
    stress: jax.Array  # macroscopic (size, many), MPa
    lack: jax.Array  # σ·n − t_L (dimension, many), MPa
    drift: jax.Array  # work of what lacks (many,), N/mm
    lost: jax.Array  # a step was not converged (many,)


def _moved(laws, point, strain, stress, jump, softening, lost):
    """The `Point` with a new jump and softening, and the work of tractions not in balance."""
    law, bulk = laws.embedding.law, laws.embedding.bulk
    band = point.band
    cohesive, _ = law.effective(bands.inside(band, jump), bulk)
    _, integrity = law.soften(softening, bulk)
    lack = tensor.traction(stress, band.normal) - integrity * cohesive
    move = _near(jump) - _near(band.jump)
    drift = point.drift + tensor.dot(lack + point.lack, move) / 2
    band = band._replace(jump=jump, softening=softening)
    return Point(band, strain, stress, lack, drift, point.lost | lost)


def _near(jump):
    """A jump cut to the length up to which the work of tractions counts."""
    length = tensor.norm(jump)
    return jump * jnp.where(length > FAR, FAR / length, 1.0)


def _softened(laws, band, jump):
    """The softening by the law at a jump; it follows the jump where the band loads.

    Of a state on the damage surface the derivative is that of loading.
    """
    law, bulk = laws.embedding.law, laws.embedding.bulk
    _, drive = law.effective(bands.inside(band, jump), bulk)
    off = 64 * jnp.finfo(drive.dtype).eps
    there = softening_at(jnp.where(drive > 1 - off, drive, 1.0), law.Ep / bulk.E, law.n)
    return jnp.where(there >= band.softening * (1 - off), there, band.softening)


def rate(laws, point, strain):
    """One explicit step of Eqs. 8-10: [u]˙ = C⁻¹·(a_b : ε˙·n), σ˙ = a_b : ε_b˙; damage by its law."""
    embedding, band = laws.embedding, point.band
    law, bulk, normal = embedding.law, embedding.bulk, band.normal
    fraction = law.h / band.size

    def dyad(jump):
        return tensor.symmetric_product(normal, jump, len(strain))

    def in_bulk(jump):
        return tensor.traction(bulk.stress(dyad(jump)), normal), None

    def in_band(jump):
        _, integrity = law.soften(_softened(laws, band, jump), bulk)
        return integrity * law.effective(bands.inside(band, jump), bulk)[0], None

    tangent, *_ = jacobian(in_band, band.jump)  # n · a_L^T · n / h
    stiffness, *_ = jacobian(in_bulk, band.jump)  # n · a_b · n
    C = (1 - fraction) * tangent + fraction / law.h * stiffness  # Eq. 9
    change = strain - point.strain
    move = tensor.solve(C, tensor.traction(bulk.stress(change), normal))  # Eq. 8
    bulk_change = (change - fraction / law.h * dyad(move)) / (1 - fraction)
    stress = point.stress + bulk.stress(bulk_change)  # Eq. 10
    jump = band.jump + move
    return _moved(laws, point, strain, stress, jump, _softened(laws, band, jump), False)


def newton(laws, point, strain):
    """Newton on the jump alone, the softening following it, from the last jump."""
    embedding, band = laws.embedding, point.band
    most = sum(jnp.abs(component) for component in strain) / (1 - embedding.law.h / band.size)
    round_off = 16 * jnp.finfo(most.dtype).eps * embedding.bulk.E * most
    limit = 1e-11 * embedding.law.ft + round_off  # MPa

    def residual(jump):
        softening = _softened(laws, band, jump)
        reached = bands.answer(embedding, band, strain, jump, softening)
        return reached.out_of_balance, (softening, reached.bulk_stress)

    def iterate(carry):
        jump, _, count = carry
        matrix, value, _ = jacobian(residual, jump)
        even = jnp.abs(value).max(0) <= limit
        return jnp.where(even, jump, jump - tensor.solve(matrix, value)), even, count + 1

    def going(carry):
        return (~carry[1] & ~point.lost).any() & (carry[2] <= ITERATIONS)

    start = band.jump, jnp.zeros_like(limit, bool), 0
    jump, even, _ = lax.while_loop(going, iterate, start)
    _, (softening, stress) = residual(jump)
    return _moved(laws, point, strain, stress, jump, softening, ~even)


def ours(laws, point, strain):
    """`balance.respond`: jump and softening together, with a search where Newton fails."""
    found = balance.respond(laws.embedding, point.band, strain)
    lost = found.status == balance.FAILS
    band = found.band
    moved = _moved(laws, point, strain, found.stress, band.jump, band.softening, lost)
    return moved._replace(band=band)


def smeared(laws, point, strain):
    """Isotropic damage of the whole cell."""
    band = point.band
    history = SmearedHistory(band.softening, band.normal)
    stress, history = laws.smeared.respond(strain, history)
    return point._replace(
        band=band._replace(softening=history.softening), strain=strain, stress=stress
    )


def _of_the_band(laws, point):
    """Energy by the measure of the map (many,), N/mm."""
    spent = laws.embedding.law.given_up(point.band.softening, laws.embedding.bulk)
    return spent + point.band.spent + point.drift


def _of_the_cell(laws, point):
    history = SmearedHistory(point.band.softening, point.band.normal)
    return laws.smeared.dissipated(history) * point.band.size


class Method(NamedTuple):
    """One of the methods compared."""

    title: str
    step: Callable[[Laws, Point, Any], Point]
    energy: Callable[[Laws, Point], Any]
    most: int  # steps from onset to the end; a tenth of it for a coarse map


METHODS = {
    "rate": Method("rate form, Eqs. 8–10", rate, _of_the_band, 200_000),
    "newton": Method("plain Newton on the jump", newton, _of_the_band, 20_000),
    "balance": Method("this project", ours, _of_the_band, 20_000),
    "smeared": Method("smeared crack", smeared, _of_the_cell, 20_000),
}
