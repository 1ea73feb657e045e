"""The paper's isotropic damage law with a tensile criterion (Eqs. 11-13).

With s = 1 − D, effective stress σ̄ = a_L : ε_L, its positive part σ̄⁺ and e = E_p/E:

    r̂ = sqrt(E σ̄⁺ : a_L⁻¹ : σ̄⁺) / f_t          strength ratio, 1 at onset
    r̂ (s + e sⁿ) = 1 + e sⁿ                      damage criterion at equality
    σ_L = s σ̄

The history is the running maximum of r̂ and z = ln s. Not D: at 1 % of the strength 1 − D is
about 4e-7 for ordinary concrete, which no float32 D can hold.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import tensor
from jaxmpm.laws.law import law


class DamageHistory(NamedTuple):
    """History of one band; a pytree of scalars."""

    ratio: jax.Array  # largest strength ratio r̂ so far, ≥ 1
    log_integrity: jax.Array  # z = ln(1 − D)
    dissipated: jax.Array  # energy dissipated so far per band volume, N/mm²


@law
class Damage:
    """Damage law of Nguyen and Houlsby (2007) as used by Nguyen's enriched model."""

    ft: float  # uniaxial tensile strength f_t', MPa
    Ep: float  # softening parameter E_p, MPa: the slope of the curve at onset is −E_p
    n: float  # exponent; the dissipation is finite for 0 < n < 1/2
    h: float  # width of the band, mm

    def initial(self):
        """History at onset: r̂ = 1, D = 0."""
        one = jnp.ones_like(self.ft * 1.0)
        return DamageHistory(one, jnp.zeros_like(one), jnp.zeros_like(one))

    def onset(self, stress, bulk):
        """Strength ratio r̂ of an effective stress (size,); a band opens where it reaches 1."""
        positive = jnp.maximum(tensor.principal_values(stress), 0.0)
        total = positive[0] + positive[1] + positive[2]
        square = (1 + bulk.nu) * tensor.dot(positive, positive) - bulk.nu * total**2
        none = square <= 0
        return jnp.where(none, 0.0, jnp.sqrt(jnp.where(none, 1.0, square))) / self.ft

    def respond(self, strain, history, bulk):
        """Stress (size,), MPa, and new history for a band strain (size,)."""
        effective = bulk.stress(strain)
        trial = self.onset(effective, bulk)
        ratio = jnp.where(trial > history.ratio, trial, history.ratio)
        z = log_integrity(ratio, self.Ep / bulk.E, self.n, lax.stop_gradient(history.log_integrity))
        # -ds times ½ ε : a_L : ε, which is f_t² r̂²/2E where nothing is compressed and more where
        # something is. r̂ s changes slowly while r̂² and s race, so the product of the old ratio
        # and the new integrates 1/s² exactly where the trapezoidal rule fails.
        lost = jnp.exp(history.log_integrity) * -jnp.expm1(z - history.log_integrity)
        energy = tensor.dot(strain, effective) / 2 * (history.ratio / ratio)
        dissipated = history.dissipated + energy * lost
        return jnp.exp(z) * effective, DamageHistory(ratio, z, dissipated)

    def loads(self, strain, history, bulk):
        """Whether a band strain (size,) takes the history further."""
        return self.onset(bulk.stress(strain), bulk) > history.ratio

    def frozen(self, strain, history, bulk):
        """Stress (size,), MPa, with the history held: the secant of unloading and reloading."""
        return jnp.exp(history.log_integrity) * bulk.stress(strain)

    def cohesion(self, history):
        """Traction that the band can carry over its strength, ψ = s r̂, from 1 to 0."""
        return jnp.exp(history.log_integrity) * history.ratio

    def stored(self, strain, history, bulk):
        """Elastic energy per band volume, ½ s ε_L : a_L : ε_L, N/mm²."""
        return jnp.exp(history.log_integrity) * tensor.dot(strain, bulk.stress(strain)) / 2

    def dissipated(self, history):
        """Energy dissipated so far per band volume, N/mm²."""
        return history.dissipated

    def largest_size(self, bulk):
        """H_max = h (1 + E/E_p), mm: beyond it the response of the point snaps back."""
        return self.h * (1 + bulk.E / self.Ep)


def _criterion(z, ratio, e, n):
    """g(z) = r̂ eᶻ + e (r̂ − 1) eⁿᶻ − 1 and its slope; its terms are of order one at the root."""
    whole, power = ratio * jnp.exp(z), e * (ratio - 1) * jnp.exp(n * z)
    return whole + power - 1, whole + n * power


@jax.custom_jvp
def log_integrity(ratio, e, n, start):
    """The root z = ln(1 − D) of the damage criterion at strength ratio r̂ ≥ 1.

    g is increasing and convex, so Newton from the right of the root converges without
    overshooting: from −ln r̂, or from the last root `start`, whichever is smaller. The
    derivative is that of the implicit function, whatever the iteration did.
    """
    tolerance = 8 * jnp.finfo(jnp.result_type(ratio)).eps

    def iterate(carry):
        z, _, count = carry
        value, slope = _criterion(z, ratio, e, n)
        return z - value / slope, jnp.abs(value) <= tolerance * (1 + jnp.abs(z)), count + 1

    z = jnp.minimum(-jnp.log(ratio), start)
    z, done, _ = lax.while_loop(
        lambda carry: ~carry[1] & (carry[2] < 60), iterate, (z, jnp.zeros_like(z, bool), 0)
    )
    return jnp.where(done, jnp.minimum(z, 0.0), jnp.nan)


@log_integrity.defjvp
def _log_integrity_jvp(primals, tangents):
    ratio, e, n, start = primals
    z = log_integrity(ratio, e, n, start)
    power = jnp.exp(n * z)
    _, slope = _criterion(z, ratio, e, n)
    by_ratio = jnp.exp(z) + e * power
    by_e = (ratio - 1) * power
    by_n = e * (ratio - 1) * z * power
    change = by_ratio * tangents[0] + by_e * tangents[1] + by_n * tangents[2]
    return z, -change / slope
