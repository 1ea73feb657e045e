"""The softening curve σ(w) of the damage law, free of dimensions.

With e = E_p/E, s = exp(−p) and q = e sⁿ, p from 0 to infinity (see `jaxmpm.laws.damage`):

    σ / f_t      = S = s (1 + q)/(s + q)
    w E/(h f_t)  = ω = (1 − s)(1 + q)/(s + q)          opening w = h (ε_L − σ/E)
    G_F 2E/(h f_t²) = g(e, n)                          area under the curve: ∫ S dω = g/2

G.D. Nguyen, G.T. Houlsby, Int. J. Numer. Anal. Meth. Geomech. 31 (2007) 867–891.
"""

import jax.numpy as jnp

from calibration.roots import root
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic

LAST = 600.0  # softening beyond which nothing is left, in double precision


def energy(e, n):
    """g, fracture energy over the elastic energy f_t²/2E of the width h at onset."""
    one = jnp.ones_like(e)
    return 2 * Damage(one, e, n, one).fracture_energy(Elastic(one, 0.0))


def stress(p, e, n):
    """S, stress over strength."""
    return jnp.exp(_logs(p, e, n)[0])


def opening(p, e, n):
    """ω, opening over the elongation h f_t/E of the width h at onset."""
    return -jnp.expm1(-p) * jnp.exp(_logs(p, e, n)[1])


def softening_at(opened, e, n):
    """p where the opening is ω = `opened` ≥ 0, scalar; `LAST` where that is farther."""
    low = jnp.zeros_like(opened * e * n)
    return root(lambda p: jnp.log1p(opening(p, e, n)) - jnp.log1p(opened), low, low + LAST)


def opening_at(ratio, e, n):
    """ω where the stress has fallen to a share `ratio` of the strength, scalar."""
    return opening(root(lambda p: jnp.log(ratio) - _logs(p, e, n)[0], 0 * e, LAST + 0 * e), e, n)


def moment(e, n):
    """∫ ω S dω = ∫ ½ ω² dS, for n < 1/3; beyond, it does not exist.

    Trapezoids after p = exp(t − exp(−t))/(1 − 3n), which suits what falls as exp(−(1 − 3n) p).
    """
    t = jnp.linspace(-4.5, 4.5, 361, dtype=jnp.result_type(e))
    p = jnp.exp(t - jnp.exp(-t)) / (1 - 3 * n)
    log_stress, log_strain = _logs(p, e, n)
    s, q = jnp.exp(-(1 - n) * p) / e, e * jnp.exp(-n * p)  # s over q, and q
    falls = ((1 - n) / (1 + s) + n * q / (1 + q)) * p * (1 + jnp.exp(-t))  # −dS/dt over S
    square = jnp.exp(log_stress + 2 * log_strain) * jnp.expm1(-p) ** 2  # S ω²
    return (t[1] - t[0]) * jnp.sum(square / 2 * falls)


def _logs(p, e, n):
    """ln S, and ln of (1 + q)/(s + q) = r̂, without overflow at any p."""
    ratio = jnp.log1p(e * jnp.exp(-n * p)) - jnp.log1p(jnp.exp(-(1 - n) * p) / e) - jnp.log(e)
    return ratio - (1 - n) * p, ratio + n * p
