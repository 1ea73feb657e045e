"""E_p and n of the damage law from the fracture energy and one more condition.

The area under σ(w) is G_F; the second condition is one of `InitialSlope`, `Point`, `Centroid`
and `Modulus`. In numbers without dimension the curve depends on e = E_p/E and n alone
(`calibration.damage_curve`), and G_F on γ = h f_t²/(2 E G_F): γ g(e, n) = 1. At onset
dσ/dw = −k/h with 1/k = 1/E + 1/E_p, so that a slope gives E_p in closed form. g grows with n,
from (1 + e)/e for the straight line n = 0 without bound to n = 1/2: one n at most for one E_p.

Pure JAX: `fit_energy` can be compiled, mapped and differentiated in E, f_t, G_F and h.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from calibration import damage_curve as curve
from calibration.roots import root
from jaxmpm.laws.law import law

FOUND, TOO_STEEP, TOO_BRITTLE, ELASTIC, NOT_ATTAINED, NOT_POSITIVE, NOT_CONVERGED = range(7)
CONCRETE = (32e3, 3.0, 0.11, 0.05)  # what is computed, and thrown away, in place of the refused
SCAN = 48  # exponents at which a condition is tried before its root is bracketed


class Fit(NamedTuple):
    """What `fit_energy` returns: E_p, MPa, and n, both NaN where refused; and why."""

    Ep: jax.Array
    n: jax.Array
    status: jax.Array


class Given(NamedTuple):
    """Young's modulus, MPa; strength, MPa; fracture energy, N/mm; width of the band, mm."""

    E: jax.Array
    ft: jax.Array
    GF: jax.Array
    h: jax.Array

    @property
    def gamma(self):
        """Elastic energy of the width h at onset over G_F."""
        return self.h * self.ft**2 / (2 * self.E * self.GF)


@law
class InitialSlope:
    """σ(w) starts with the slope −factor f_t²/G_F; factor 2 gives the parameters of Nguyen's plate."""

    factor: float = 2.0  # 1/2 is the straight line

    def residual(self, e, n, given):
        """ln of the slope over that wanted."""
        return jnp.log(e / (1 + e) / (2 * self.factor * given.gamma))

    def solve(self, given):
        """(e, n, status): E_p = k/(1 − k/E), k = factor h f_t²/G_F; n from the energy."""
        k = 2 * self.factor * given.gamma  # over E
        possible = k < 1
        k = jnp.where(possible, k, 0.5)
        e = k / (1 - k)
        n, status = exponent(e, given.gamma)
        return e, n, jnp.where(possible, status, TOO_STEEP)


@law
class Modulus:
    """E_p itself is given, MPa."""

    Ep: float

    def residual(self, e, n, given):
        """ln of E_p over that wanted."""
        return jnp.log(e * given.E / self.Ep)

    def solve(self, given):
        """(e, n, status)."""
        e = self.Ep / given.E + 0 * given.gamma
        return e, *exponent(e, given.gamma)


@law
class Point:
    """σ(w) passes the opening w, mm, at the share `ratio` of the strength."""

    w: float
    ratio: float = 0.5

    def solve(self, given):
        """(e, n, status); of two curves through a point low on the tail that with the lesser n."""
        return _along(self, given, 0.5)

    def measure(self, e, n, given):
        """ln of the opening, mm, of a curve at this share of the strength."""
        ratio = self.ratio + 0 * e
        return jnp.log(curve.opening_at(ratio, e, n) * given.h * given.ft / given.E)

    def residual(self, e, n, given):
        """ln of the opening over that wanted."""
        return self.measure(e, n, given) - jnp.log(self.w)


@law
class Centroid:
    """The area under σ(w) has its centre of gravity at the opening w, mm; only for n < 1/3."""

    w: float

    def solve(self, given):
        """(e, n, status)."""
        return _along(self, given, 1 / 3)

    def measure(self, e, n, given):
        """ln of the opening, mm, of a curve's centre of gravity."""
        return jnp.log(curve.moment(e, n) * 2 * given.gamma * given.h * given.ft / given.E)

    def residual(self, e, n, given):
        """ln of the opening over that wanted."""
        return self.measure(e, n, given) - jnp.log(self.w)


def fit_energy(E, ft, GF, h, condition=InitialSlope()) -> Fit:
    """E_p and n of the damage law with fracture energy G_F, h ∫ F dD = G_F.

    Args:
        E, ft, GF, h: MPa, MPa, N/mm, mm; scalars (map it for arrays).
        condition: what else the curve obeys.

    Returns:
        Fit; its status is `FOUND` or says why there is none, see `calibration.refusals`.
    """
    dtype = jnp.result_type(E, ft, GF, h, 1.0)
    given = Given(*(jnp.asarray(x, dtype) for x in (E, ft, GF, h)))
    numbers = jnp.stack([*given, *(jnp.asarray(x) for x in jax.tree.leaves(condition))])
    positive = (jnp.isfinite(numbers) & (numbers > 0)).all()
    elastic = given.gamma >= 1
    usable = positive & ~elastic
    safe = Given(*(jnp.where(usable, x, easy) for x, easy in zip(given, CONCRETE, strict=True)))
    e, n, status = condition.solve(safe)
    status = jnp.where(elastic, ELASTIC, status)
    status = jnp.where(positive, status, NOT_POSITIVE)
    fine = status == FOUND
    return Fit(jnp.where(fine, e * safe.E, jnp.nan), jnp.where(fine, n, jnp.nan), status)


def fracture_energy(E, ft, Ep, n, h):
    """G_F = h ∫ F dD, N/mm; elementwise."""
    return h * ft**2 / (2 * E) * curve.energy(Ep / E, n)


def exponent(e, gamma):
    """n with γ g(e, n) = 1, and the status; scalars."""
    far = -jnp.log(jnp.finfo(e.dtype).eps) / 1.5
    miss = lambda u: jnp.log(gamma * curve.energy(e, 0.5 * jax.nn.sigmoid(u)))  # noqa: E731
    u = root(miss, -2 * far + 0 * e, far + 0 * e)
    close = jnp.abs(miss(u)) < jnp.sqrt(jnp.finfo(e.dtype).eps)
    brittle = gamma * (1 + e) / e >= 1  # the straight line dissipates more already
    return 0.5 * jax.nn.sigmoid(u), jnp.where(
        brittle, TOO_BRITTLE, jnp.where(close, FOUND, NOT_CONVERGED)
    )


def modulus(n, gamma):
    """e with γ g(e, n) = 1, for γ < 1; scalar."""
    line = jnp.log(gamma / (1 - gamma))  # e of n = 0, the least
    return jnp.exp(root(lambda v: -jnp.log(gamma * curve.energy(jnp.exp(v), n)), line, line + 40))


def family(condition, given, top):
    """The curves with the same G_F, n from 0 to `top`.

    Returns:
        logits u (SCAN,) of n/top, and the function u -> (what the condition measures, (e, n)).
    """

    def measure(u):
        n = top * jax.nn.sigmoid(u)
        e = modulus(n, given.gamma)
        return condition.measure(e, n, given), (e, n)

    return jnp.linspace(-12, 12, SCAN, dtype=given.gamma.dtype), measure


def _along(condition, given, top):
    """The first curve of the `family` that meets the condition."""
    (e, n), status = first_crossing(*family(condition, given, top), jnp.log(condition.w))
    return e, n, status


def first_crossing(grid, measure, target):
    """What belongs to the first place on an increasing `grid` where `measure` reaches `target`.

    Args:
        grid: (k,).
        measure: scalar -> (scalar, anything).
        target: scalar.

    Returns:
        (the second part of what `measure` returns there, status)
    """
    above = jax.vmap(lambda x: measure(x)[0])(grid) > target
    crossed = above[1:] != above[:-1]
    first = jnp.argmax(crossed)
    sign = jnp.where(above[first], -1.0, 1.0)
    place = root(lambda x: sign * (measure(x)[0] - target), grid[first], grid[first + 1])
    value, what = measure(place)
    close = jnp.abs(value - target) < jnp.sqrt(jnp.finfo(grid.dtype).eps)
    status = jnp.where(close, FOUND, NOT_CONVERGED)
    return what, jnp.where(crossed.any(), status, NOT_ATTAINED)
