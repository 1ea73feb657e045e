"""Von Mises plasticity with linear isotropic hardening, in every stress state.

With the accumulated plastic strain α, R = σ_y + H α and the stress deviator s:

    q = sqrt(3/2 s : s) ≤ R,    dε_p = 3/2 s/q dα,    dα ≥ 0

Backward Euler. A vector carries n direct components of the stress (1, 2 or 3; the others are
zero). The return only scales their mean m and the rest d of the stress, each by its own factor:

    q² = n(3 − n)/2 m² + 3/2 d : d
    m = m* R/(R + C_m Δα),   C_m = (3 − n)/2 E/(1 − (n − 1)ν)      * elastic trial
    d = d* R/(R + C_d Δα),   C_d = 3G

R + C Δα is linear in Δα. In uniaxial stress d = 0, in 3D m is out of q, and R/q is linear too:
radial return. In plane stress both are there (Simo, Taylor 1986; Simo, Hughes 1998, box 3.3,
whose multiplier is 3/2 Δα/R), R/q is a concave function of Δα, and Newton's method from zero
comes from below to R/q = 1, never past it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxmpm import tensor
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.law import law

# Of Newton's method, by the number of direct components. One does where R/q is linear. In plane
# stress six are at round-off for all −0.9 < ν < 0.5, and steps of any size.
ITERATIONS = {1: 2, 2: 7, 3: 2}


class Plastic(NamedTuple):
    """History of a point."""

    plastic_strain: jax.Array  # ε_p (size,); in plane stress and uniaxial stress what of it
    # the vector carries: the rest follows from constant volume and is not needed
    accumulated: jax.Array  # α, accumulated plastic strain
    dissipated: jax.Array  # energy dissipated per volume, N/mm²


@law
class J2:
    """Von Mises plasticity, a point law of all sizes.

    Needs −1 < ν < 1/2, σ_y > 0 and R > 0 throughout: H may be negative until softening has used
    up the strength. Where the return fails, the stress is NaN.
    """

    E: float  # Young's modulus, MPa
    nu: float  # Poisson's ratio
    yield_stress: float  # initial yield stress in uniaxial tension σ_y, MPa
    hardening: float  # H, slope of the yield stress over the plastic strain, MPa

    @property
    def elastic(self):
        """The elastic part."""
        return Elastic(self.E, self.nu)

    def initial(self, size):
        """No plastic strain."""
        zero = 0.0 * (self.E + self.nu + self.yield_stress + self.hardening)
        zero = jnp.asarray(zero)
        return Plastic(jnp.stack([zero] * size), zero, zero)

    def respond(self, strain, history):
        """Stress (size,), MPa, and the new history, at a strain (size,)."""
        size = len(strain)
        count = tensor.NORMALS[size]
        bulk, shear = self._moduli(size)
        mean, rest = _split(strain - history.plastic_strain)
        mean, rest = bulk * mean, [2 * shear * r for r in rest]
        squares = count * (3 - count) / 2 * mean * mean, 1.5 * _square(rest, count)
        start = self.yield_stress + self.hardening * history.accumulated
        yields = squares[0] + squares[1] > start * start

        slopes = (3 - count) / 2 * bulk, 3 * shear
        safe = [jnp.where(yields, square, start * start) for square in squares]
        more, fails = self._increment(safe, slopes, start, ITERATIONS[count])
        more = jnp.where(yields, more, 0.0)
        now = start + self.hardening * more
        scales = [now / (now + slope * more) for slope in slopes]
        mean, rest = mean * scales[0], [r * scales[1] for r in rest]
        stress = [mean + r for r in rest[:count]] + rest[count:]

        third = count * mean / 3
        flow = [1.5 * (s - third) for s in stress[:count]] + [3 * s for s in stress[count:]]
        new = Plastic(
            history.plastic_strain + more / now * jnp.stack(flow),
            history.accumulated + more,
            history.dissipated + self.yield_stress * more,  # of R Δα, H α Δα is stored
        )
        return jnp.where(yields & fails, jnp.nan, jnp.stack(stress)), new

    def stored(self, strain, history):
        """Elastic energy and that of hardening, H α²/2, per volume, N/mm²."""
        size = len(strain)
        count = tensor.NORMALS[size]
        bulk, shear = self._moduli(size)
        mean, rest = _split(strain - history.plastic_strain)
        energy = count / 2 * bulk * mean * mean + shear * _square(rest, count)
        return energy + self.hardening / 2 * history.accumulated**2

    def dissipated(self, history):
        """Energy dissipated so far, ∫ σ_y dα, per volume, N/mm²."""
        return history.dissipated

    def _moduli(self, size):
        """Moduli of the mean of the direct components and of the rest (G), MPa."""
        count = tensor.NORMALS[size]
        return self.E / (1 - (count - 1) * self.nu), self.E / (2 * (1 + self.nu))

    def _increment(self, squares, slopes, start, iterations):
        """Δα of a yielding point and whether the search for it failed."""

        def excess(more):  # R/q − 1
            reach = [start + (self.hardening + slope) * more for slope in slopes]
            return 1 / jnp.sqrt(squares[0] / reach[0] ** 2 + squares[1] / reach[1] ** 2) - 1

        def newton(function, more):
            for _ in range(iterations):
                value, slope = jax.jvp(function, (more,), (jnp.ones_like(more),))
                more = more - value / slope
            return more

        # the derivative is that of the equation, not of the iterations
        more = jax.lax.custom_root(
            excess,
            jnp.zeros_like(squares[0]),
            newton,
            lambda linear, y: y / linear(jnp.ones_like(y)),
        )
        close = jnp.abs(excess(more)) <= 64 * jnp.finfo(more.dtype).eps
        return more, ~(close & (more >= 0) & (start + self.hardening * more > 0))


def _split(strain):
    """Mean of the direct components of a strain, and the rest as tensor components."""
    count = tensor.NORMALS[len(strain)]
    mean = tensor.trace(strain) / count
    rest = [strain[i] - mean for i in range(count)]
    return mean, rest + [strain[i] / 2 for i in range(count, len(strain))]


def _square(rest, count):
    """d : d."""
    return sum(d * d for d in rest[:count]) + 2 * sum(d * d for d in rest[count:])
