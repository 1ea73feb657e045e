"""Cohesive traction-separation: a softening curve σ(w) in a thin band, with mixed mode.

The band is as stiff as the material of its width h until onset, K_n = E/h and K_s = β² K_n; its
faces part by δ = K⁻¹ t_c + [u], t_c the traction at onset, so that a crack opens continuously
in whatever direction it is loaded. With an effective traction K δ and

    r̂ = sqrt(⟨t̄_n⟩² + |t̄_s|²/β²) / f_t            1 at onset (Camacho, Ortiz 1996)
    σ(w) = f_t g(p),  p = w f_t / G_F                 softening curve
    r̂ = g(p) + p E G_F / (h f_t²),  s = g / r̂        so that σ = s f_t r̂ and w = (r̂ f_t − σ)/K_n

the traction is s K δ: unloading goes along the secant. In pure opening it is σ(w) exactly.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import tensor


class Linear:
    """g = 1 − p/2 up to p = 2."""

    steepest = 0.5

    @staticmethod
    def value(p):
        """Traction over strength."""
        return jnp.maximum(1 - p / 2, 0.0)

    @staticmethod
    def area(p):
        """∫ g dp from 0."""
        p = jnp.minimum(p, 2.0)
        return p - p * p / 4


class Bilinear:
    """Petersson (1981): kink at w = 0.8 G_F/f_t and f_t/3, end at 3.6 G_F/f_t."""

    steepest = 2 / 3 / 0.8

    @staticmethod
    def value(p):
        """Traction over strength."""
        first, second = 1 - p / 1.2, (3.6 - p) / 8.4
        return jnp.where(p < 0.8, first, jnp.maximum(second, 0.0))

    @staticmethod
    def area(p):
        """∫ g dp from 0."""
        left = jnp.maximum(3.6 - p, 0.0)
        return jnp.where(p < 0.8, p - p * p / 2.4, 1 - left * left / 16.8)


class Exponential:
    """g = exp(−p)."""

    steepest = 1.0

    @staticmethod
    def value(p):
        """Traction over strength."""
        return jnp.exp(-p)

    @staticmethod
    def area(p):
        """∫ g dp from 0."""
        return -jnp.expm1(-p)


class Hordijk:
    """Hordijk (1991): (1 + (c₁x)³) exp(−c₂x) − x (1 + c₁³) exp(−c₂), x = w/w_c, c = 3, 6.93.

    The published w_c = 5.136 G_F/f_t is the inverse of the area under the curve, which is taken
    exactly here.
    """

    c1, c2 = 3.0, 6.93
    end = float((1 + 27.0) * np.exp(-6.93))

    @classmethod
    def _primitive(cls, x, exp):
        c, cube = cls.c2, cls.c1**3
        powers = x**3 / c + 3 * x**2 / c**2 + 6 * x / c**3 + 6 / c**4
        return (1 / c + 6 * cube / c**4) - exp(-c * x) * (1 / c + cube * powers) - cls.end * x * x / 2

    @classmethod
    def value(cls, p):
        """Traction over strength."""
        x = jnp.minimum(p * cls.total, 1.0)
        curve = (1 + (cls.c1 * x) ** 3) * jnp.exp(-cls.c2 * x) - x * cls.end
        return jnp.where(x < 1, jnp.maximum(curve, 0.0), 0.0)

    @classmethod
    def area(cls, p):
        """∫ g dp from 0."""
        return cls._primitive(jnp.minimum(p * cls.total, 1.0), jnp.exp) / cls.total


Hordijk.total = float(Hordijk._primitive(1.0, np.exp))  # area in x, which is also dx/dp
Hordijk.steepest = Hordijk.total * (Hordijk.c2 + Hordijk.end)

CURVES = {"linear": Linear, "bilinear": Bilinear, "exponential": Exponential, "hordijk": Hordijk}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Cohesive:
    """Cohesive law with one of the `CURVES`; also usable alone, see `alone`."""

    ft: float  # tensile strength, MPa
    GF: float  # fracture energy, N/mm
    beta: float  # shear strength over tensile strength, β
    h: float  # width of the band, mm; small against the cell
    curve: str = field(default="exponential", metadata={"static": True})

    def onset(self, stress, bulk):
        """Largest principal stress over the strength (a normal that is principal has no shear)."""
        values = tensor.principal_values(stress)
        return jnp.maximum(jnp.maximum(jnp.maximum(*values[:2]), values[2]), 0.0) / self.ft

    def effective(self, inside, bulk):
        """Traction K δ (dimension,), MPa, and its r̂."""
        n = inside.normal
        start = tensor.traction(bulk.stress(inside.onset_strain), n)
        opening = tensor.dot(inside.jump, n)
        sliding = inside.jump - opening * n
        traction = start + bulk.E / self.h * (opening * n + self.beta**2 * sliding)
        return traction, self._ratio(traction, n)

    def _ratio(self, traction, normal):
        direct = tensor.dot(traction, normal)
        shear = traction - direct * normal
        return tensor.norm([jnp.maximum(direct, 0.0), *(shear / self.beta)]) / self.ft

    def soften(self, softening, bulk):
        """r̂ and integrity s at a softening p = w f_t / G_F."""
        value = CURVES[self.curve].value(softening)
        ratio = value + softening * (bulk.E * self.GF / (self.h * self.ft**2))
        return ratio, value / ratio

    def stored(self, inside, integrity, closes, bulk):
        """Elastic energy per area of the crack since onset, and that of the width h at onset."""
        n, strain = inside.normal, inside.onset_strain
        now, _ = self.effective(inside, bulk)
        then, _ = self.effective(inside._replace(jump=0 * inside.jump), bulk)
        before = self.h * tensor.dot(strain, bulk.stress(strain)) / 2 - self._elastic(then, n, bulk)
        energy = integrity * self._elastic(now, n, bulk)
        if closes:
            energy += (1 - integrity) * self._pressed(now, n, bulk)
        return before + energy

    def _elastic(self, traction, normal, bulk):
        """½ t·K⁻¹·t, N/mm."""
        direct = tensor.dot(traction, normal)
        shear = traction - direct * normal
        square = direct**2 + tensor.dot(shear, shear) / self.beta**2
        return self.h / (2 * bulk.E) * square

    def _pressed(self, traction, normal, bulk):
        return self.h / (2 * bulk.E) * jnp.minimum(tensor.dot(traction, normal), 0.0) ** 2

    def given_up(self, softening, bulk):
        """Energy per area dissipated up to a softening, G_F [∫ g dp − ½ g p], N/mm."""
        curve = CURVES[self.curve]
        return self.GF * (curve.area(softening) - curve.value(softening) * softening / 2)

    def largest_size(self, bulk):
        """H_max, mm: E over the steepest slope of σ(w); beyond it a point snaps back."""
        return bulk.E * self.GF / (self.ft**2 * CURVES[self.curve].steepest)


def alone(law, opening, softening, bulk, normal):
    """The traction-separation law by itself: traction and new softening.

    Args:
        law: a `Cohesive`.
        opening: separation of the faces δ (dimension,), mm, elastic part included.
        softening: p reached so far, 0 to begin with.
        bulk: the `Elastic` material.
        normal: (dimension,).

    Returns:
        (traction (dimension,), MPa; softening)
    """
    direct = tensor.dot(opening, normal)
    traction = bulk.E / law.h * (direct * normal + law.beta**2 * (opening - direct * normal))
    ratio = law._ratio(traction, normal)

    def closer(_, p):
        """Newton on r̂(p) = r̂; the curve is convex or close to it, so clipped at what is known."""
        value, slope = jax.jvp(lambda q: law.soften(q, bulk)[0], (p,), (jnp.ones_like(p),))
        return jnp.maximum(p - (value - ratio) / slope, softening)

    p = jax.lax.fori_loop(0, 30, closer, jnp.asarray(softening, traction.dtype))
    p = jnp.where(law.soften(softening, bulk)[0] < ratio, p, softening)
    _, integrity = law.soften(p, bulk)
    pressed = jnp.minimum(tensor.dot(traction, normal), 0.0) * normal
    return integrity * traction + (1 - integrity) * pressed, p
