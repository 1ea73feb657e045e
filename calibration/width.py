"""The width h of the band too, from an initial slope and a point or centre of gravity of σ(w).

With the slope −factor f_t²/G_F, k/E = e/(1 + e) and h = k E G_F/(factor f_t² E): every e gives an
h and, with G_F, an n. The shape of σ(w) changes little with h (for ordinary concrete an opening
at half the strength 1 % larger makes h 40 % smaller): a width from a curve is hardly determined.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from calibration import energy
from calibration.energy import Given, InitialSlope, exponent, first_crossing

LEAST, LARGEST = 1e-9, 0.15  # e: of thinner bands; of n < 0.31, so that the centroid exists


class WidthFit(NamedTuple):
    """What `fit_width` returns: h, mm, E_p, MPa, n, NaN where refused; and why (as of `energy`)."""

    h: jax.Array
    Ep: jax.Array
    n: jax.Array
    status: jax.Array


def fit_width(E, ft, GF, condition, slope=InitialSlope()) -> WidthFit:
    """h, E_p and n from E, MPa, f_t, MPa, G_F, N/mm (scalars) and a `Point` or `Centroid`.

    Of several widths that obey all conditions it returns the least.
    """
    E, ft, GF = (jnp.asarray(x, jnp.result_type(E, ft, GF, 1.0)) for x in (E, ft, GF))
    numbers = jnp.stack([E, ft, GF, *map(jnp.asarray, (*jax.tree.leaves(condition), slope.factor))])
    positive = (jnp.isfinite(numbers) & (numbers > 0)).all()
    grid, measure = widths(E, ft, GF, condition, slope)
    (h, e, n), status = first_crossing(grid, measure, jnp.log(condition.w))
    status = jnp.where(slope.factor > 0.5, status, energy.TOO_BRITTLE)
    status = jnp.where(positive, status, energy.NOT_POSITIVE)
    blank = jnp.where(status == energy.FOUND, 1.0, jnp.nan)
    return WidthFit(h * blank, e * E * blank, n * blank, status)


def widths(E, ft, GF, condition, slope):
    """ln e (SCAN,), and the function ln e -> (what the condition measures, (h, e, n))."""

    def measure(x):
        e = jnp.exp(x)
        k = e / (1 + e)
        h = k * E * GF / (slope.factor * ft**2)
        n, _ = exponent(e, k / (2 * slope.factor))
        return condition.measure(e, n, Given(E, ft, GF, h)), (h, e, n)

    return jnp.linspace(jnp.log(LEAST), jnp.log(LARGEST), energy.SCAN, dtype=E.dtype), measure
