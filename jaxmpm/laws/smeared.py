"""The smeared crack (crack band): the damage law spread over the whole cell, without a band.

What the method of the project is measured against. The softening is scaled so that a cell of
size H dissipates the fracture energy, H g_F(E_p') = h g_F(E_p) (Bazant, Oh 1983). Beyond
H = 2 E G_F / f_t² no E_p' does: the law is perfectly brittle there and dissipates too much.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import tensor
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic

DIRECTIONS = ("isotropic", "fixed", "rotating")
BRITTLE = 1e12  # E_p'/E that is as good as infinite


class SmearedHistory(NamedTuple):
    """History of a smeared crack."""

    softening: jax.Array  # p = −ln(1 − D)
    normal: jax.Array  # of the crack (dimension,); zero while there is none


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Smeared:
    """A point law: damage of the whole stress, or of the tractions on a crack plane only."""

    E: float  # Young's modulus, MPa
    nu: float  # Poisson's ratio
    ft: float  # tensile strength, MPa
    Ep: float  # softening parameter scaled to the cell, MPa
    n: float  # exponent
    direction: str = field(default="isotropic", metadata={"static": True})

    @classmethod
    def of(cls, damage, bulk, size, direction="isotropic"):
        """The law of cells of a size H (mm) that stands for a band with `damage` in them."""
        log_Ep = scaled_softening(damage, bulk, size)
        one = jnp.ones_like(log_Ep)
        return cls(bulk.E * one, bulk.nu * one, damage.ft * one, jnp.exp(log_Ep), damage.n * one, direction)

    @property
    def elastic(self):
        """Its elastic part."""
        return Elastic(self.E, self.nu)

    def _damage(self):
        return Damage(self.ft, self.Ep, self.n, jnp.ones_like(self.ft))

    def initial(self, size):
        """No crack."""
        zero = jnp.zeros_like(self.ft)
        return SmearedHistory(zero, jnp.stack([zero] * tensor.DIMENSION[size]))

    def respond(self, strain, history):
        """Stress (size,), MPa, and new history."""
        effective = self.elastic.stress(strain)
        principal = tensor.first_principal_direction(effective)
        uncracked = tensor.dot(history.normal, history.normal) == 0
        normal = jnp.where(uncracked, principal, history.normal)
        if self.direction == "isotropic":
            drive = self._damage().onset(effective, self.elastic)
        else:
            normal = principal if self.direction == "rotating" else normal
            pull = tensor.dot(tensor.traction(effective, normal), normal)
            drive = jnp.maximum(pull, 0.0) / self.ft
        softening = jnp.maximum(
            history.softening, softening_at(jnp.maximum(drive, 1.0), self.Ep / self.E, self.n)
        )
        integrity = jnp.exp(-softening)
        if self.direction == "isotropic":
            stress = integrity * effective
        else:
            left = integrity * tensor.traction(effective, normal)
            stress = tensor.with_traction(effective, normal, left)
        cracked = (softening > 0) | ~uncracked
        return stress, SmearedHistory(softening, jnp.where(cracked, normal, history.normal))

    def stored(self, strain, history):
        """Energy per volume that unloading gives back (isotropic damage), N/mm²."""
        stress = self.elastic.stress(strain)
        return jnp.exp(-history.softening) * tensor.dot(strain, stress) / 2

    def dissipated(self, history):
        """Energy per volume dissipated in tension, N/mm²."""
        return self._damage().given_up(history.softening, self.elastic)


def scaled_softening(damage, bulk, size):
    """ln E_p' at which cells of size H (mm) dissipate what the band does; by bisection."""
    everything = 700.0 * jnp.ones_like(size * damage.ft)
    wanted = damage.given_up(everything, bulk)
    low = jnp.log(1e-9 * bulk.E) * jnp.ones_like(wanted)
    high = jnp.log(BRITTLE * bulk.E) * jnp.ones_like(wanted)

    def halve(_, ends):
        low, high = ends
        middle = (low + high) / 2
        law = Damage(damage.ft, jnp.exp(middle), damage.n, size)
        more = law.given_up(everything, bulk) > wanted
        return jnp.where(more, middle, low), jnp.where(more, high, middle)

    low, high = lax.fori_loop(0, 60, halve, (low, high))
    return (low + high) / 2


@jax.custom_jvp
def softening_at(ratio, e, n):
    """The softening p at a strength ratio r̂ ≥ 1 of the damage criterion, e = E_p/E.

    With z = −p, g(z) = r̂ eᶻ + e (r̂ − 1) eⁿᶻ − 1 is increasing and convex, so Newton from the
    right of the root, z = −ln r̂, converges without overshooting.
    """

    def iterate(carry):
        z, _, count = carry
        whole, power = ratio * jnp.exp(z), e * (ratio - 1) * jnp.exp(n * z)
        move = (whole + power - 1) / (whole + n * power)
        close = 8 * jnp.finfo(move.dtype).eps * (1 + jnp.abs(z))
        return z - move, jnp.abs(move) <= close, count + 1

    start = -jnp.log(ratio) + 0 * e * n
    z, done, _ = lax.while_loop(
        lambda carry: (~carry[1]).any() & (carry[2] < 400),
        iterate,
        (start, jnp.zeros_like(start, bool), 0),
    )
    return jnp.where(done, jnp.maximum(-z, 0.0), jnp.nan)


@softening_at.defjvp
def _softening_at_jvp(primals, tangents):
    ratio, e, n = primals
    p = softening_at(ratio, e, n)
    power = jnp.exp(-n * p)
    slope = ratio * jnp.exp(-p) + n * e * (ratio - 1) * power
    change = (jnp.exp(-p) + e * power) * tangents[0] + (ratio - 1) * power * tangents[1]
    change -= e * (ratio - 1) * p * power * tangents[2]
    return p, change / slope
