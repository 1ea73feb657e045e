"""The paper's isotropic damage law with a tensile criterion (Eqs. 11-13).

With s = 1 − D, effective stress σ̄ = a_L : ε_L, its positive part σ̄⁺ and e = E_p/E:

    r̂ = sqrt(E σ̄⁺ : a_L⁻¹ : σ̄⁺) / f_t          strength ratio, 1 at onset
    r̂ (s + e sⁿ) = 1 + e sⁿ                      damage criterion at equality
    σ_L = s σ̄

The softening is p = −ln s. Not D: at 1 % of the strength 1 − D is about 4e-7 for ordinary
concrete, which no float32 D can hold; and r̂ is a closed form of p, so that nothing is iterated.
"""

import jax.numpy as jnp
from jax import lax

from jaxmpm import tensor
from jaxmpm.laws.law import law

SERIES = 40  # terms of the incomplete beta function; each halves what is left


@law
class Damage:
    """Damage law of Nguyen and Houlsby (2007) as used by Nguyen's enriched model."""

    ft: float  # uniaxial tensile strength f_t', MPa
    Ep: float  # softening parameter E_p, MPa: the slope of the curve at onset is −E_p
    n: float  # exponent; the dissipation is finite for 0 < n < 1/2
    h: float  # width of the band, mm

    def onset(self, stress, bulk):
        """Strength ratio r̂ of an effective stress (size,); a band opens where it reaches 1."""
        positive = jnp.maximum(tensor.principal_values(stress), 0.0)
        total = positive[0] + positive[1] + positive[2]
        square = (1 + bulk.nu) * tensor.dot(positive, positive) - bulk.nu * total**2
        none = square <= 0
        return jnp.where(none, 0.0, jnp.sqrt(jnp.where(none, 1.0, square))) / self.ft

    def strain(self, inside):
        """Strain in the band, Eq. 3 in total form, (size,)."""
        size = len(inside.onset_strain)
        opening = tensor.symmetric_product(inside.normal, inside.jump, size)
        return inside.onset_strain + opening / self.h

    def effective(self, inside, bulk):
        """Traction (dimension,), MPa, of the effective stress on the band, and its r̂."""
        stress = bulk.stress(self.strain(inside))
        return tensor.traction(stress, inside.normal), self.onset(stress, bulk)

    def soften(self, softening, bulk):
        """r̂ and integrity s at a softening p."""
        integrity = jnp.exp(-softening)
        power = self.Ep / bulk.E * jnp.exp(-self.n * softening)
        return (1 + power) / (integrity + power), integrity

    def stored(self, inside, integrity, closes, bulk):
        """Elastic energy per area of the crack, h ½ s ε_L : a_L : ε_L, N/mm."""
        strain = self.strain(inside)
        stress = bulk.stress(strain)
        energy = integrity * tensor.dot(strain, stress) / 2
        if closes:
            energy += (1 - integrity) * _closing(stress, inside, bulk)
        return self.h * energy

    def given_up(self, softening, bulk):
        """Energy per area of the crack dissipated up to a softening, h ∫ F(D) dD, N/mm.

        In closed form: with x = s^(1−n)/e and y = x/(1 + x) the integral of Eq. 13 over s is
        [B_y(1 − m, 1 + m)/k + 2y + k B_y(1 + m, 1 − m)] / (1 − n), m = n/(1 − n), k = e^(1 + m),
        with incomplete beta functions.
        """
        e = self.Ep / bulk.E
        now = jnp.exp(-(1 - self.n) * softening) / e
        first, last = self._primitive(jnp.stack(jnp.broadcast_arrays(1 / e, now)), e)
        return self.h * self.ft**2 / (2 * bulk.E) * (first - last)

    def fracture_energy(self, bulk):
        """Energy per area of the crack dissipated in all, G_F = h ∫₀¹ F(D) dD, N/mm.

        What is left at a softening falls as exp(−(1 − 2n) p): for n near 1/2 `given_up` comes
        close to this only at softenings that floating point does not reach.
        """
        e = self.Ep / bulk.E
        return self.h * self.ft**2 / (2 * bulk.E) * self._primitive(1 / e, e)

    def _primitive(self, x, e):
        """∫ F dD over f_t²/2E from a state x = s^(1−n)/e to the end."""
        m = self.n / (1 - self.n) + 0 * x
        scale = jnp.exp((1 + m) * jnp.log(e))
        y, rest = x / (1 + x), 1 / (1 + x)
        y, rest, m = jnp.broadcast_arrays(y, rest, m)
        first, second = _beta(jnp.stack([y, y]), jnp.stack([rest, rest]), jnp.stack([-m, m]))
        return (first / scale + 2 * y + scale * second) / (1 - self.n)

    def largest_size(self, bulk):
        """H_max = h (1 + E/E_p), mm: beyond it the response of the point snaps back."""
        return self.h * (1 + bulk.E / self.Ep)


def _beta(y, rest, a):
    """∫₀^y t^a (1 − t)^(−a) dt for |a| < 1, rest = 1 − y, by its series on the nearer side."""
    near = y < 0.5
    whole = jnp.where(a == 0, 1.0, jnp.pi * a / jnp.sin(jnp.pi * jnp.where(a == 0, 0.5, a)))
    power = jnp.where(near, a, -a)
    base = jnp.maximum(jnp.where(near, y, rest), jnp.finfo(jnp.result_type(y)).tiny)

    def add(k, carry):
        term, total = carry
        return term * base * ((power + k) / (k + 1)), total + term / (power + 1 + k)

    start = jnp.ones_like(base + power)
    _, total = lax.fori_loop(0, SERIES, add, (start, 0 * start))
    side = total * jnp.exp((power + 1) * jnp.log(base))
    return jnp.where(near, side, whole - side)


def _closing(stress, inside, bulk):
    """Energy per volume of the compression on the faces of a band, N/mm²."""
    direct, *_ = bulk.coefficients(len(stress))
    pressure = jnp.minimum(
        tensor.dot(tensor.traction(stress, inside.normal), inside.normal), 0.0
    )
    return pressure**2 / (2 * direct)
