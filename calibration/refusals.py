"""What is said to people where there is no E_p and n: the key, its value, what was expected and why."""

import math
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from calibration import energy
from calibration.energy import Centroid, Given, InitialSlope, Modulus, Point
from calibration.width import widths

KEYS = {"Ep": "Ep", "factor": "slope-factor", "w": "w", "ratio": "ratio"}


def refusal(status, E, ft, GF, h, condition) -> str:
    """One line for a status other than `FOUND`; h is None where it was to be found too."""
    given = {"E": E, "ft": ft, "GF": GF} | ({} if h is None else {"h": h})
    if status == energy.NOT_POSITIVE:
        return _not_positive(given | {KEYS[key]: value for key, value in vars(condition).items()})
    if status == energy.ELASTIC:
        return (
            f"GF = {GF:g}: expected above h ft²/(2E) = {h * ft**2 / (2 * E):.4g} N/mm, "
            f"the elastic energy in the width h = {h:g} mm at onset"
        )
    if status == energy.TOO_STEEP:
        f = condition.factor
        return (
            f"h = {h:g}: expected below E GF/({f:g} ft²) = {E * GF / (f * ft**2):.4g} mm, or GF above "
            f"{f * h * ft**2 / E:.4g} N/mm: the initial slope -{f:g} ft²/GF would be steeper than -E/h"
        )
    if status == energy.TOO_BRITTLE:
        return _too_brittle(E, ft, GF, h, condition)
    if status == energy.NOT_ATTAINED:
        return _not_attained(E, ft, GF, h, condition)
    return (
        f"GF = {GF:g}: expected a curve with n further from 1/2, no root was found in the precision "
        "at hand (a larger GF or a smaller h helps)"
    )


def _not_positive(values):
    bad = [key for key, value in values.items() if not (math.isfinite(value) and value > 0)]
    return "; ".join(f"{key} = {values[key]:g}: expected a finite number above 0" for key in bad)


def _too_brittle(E, ft, GF, h, condition):
    if isinstance(condition, Modulus):
        least = h * ft**2 / 2 * (1 / E + 1 / condition.Ep)
        return (
            f"GF = {GF:g}: expected above {least:.6g} N/mm, the attainable range with Ep = "
            f"{condition.Ep:g} MPa for n in (0, 1/2) is ({least:.6g}, infinity)"
        )
    factor = getattr(condition, "factor", None)
    return (
        f"slope-factor = {factor:g}: expected above 0.5, the straight line n = 0; with this slope n in "
        f"(0, 1/2) gives GF in ({GF / (2 * factor):.6g}, infinity) N/mm, GF = {GF:g} is not in it"
    )


def _not_attained(E, ft, GF, h, condition):
    low, high = attainable(E, ft, GF, h, condition)
    where = f"at ratio = {condition.ratio:g}" if isinstance(condition, Point) else "of the centroid"
    return (
        f"w = {condition.w:g}: expected {low:.4g} to {high:.4g} mm {where}, what curves with "
        f"GF = {GF:g} N/mm and ft = {ft:g} MPa can have"
        + (f" for some width h at slope-factor = {InitialSlope().factor:g}" if h is None else "")
    )


def attainable(E, ft, GF, h, condition):
    """Least and largest opening, mm, of a `Point` or `Centroid` on curves with this G_F."""
    values = np.exp(_measured(E, ft, GF, h, condition))
    return float(np.nanmin(values)), float(np.nanmax(values))


def crossings(E, ft, GF, h, condition) -> int:
    """How many curves with this G_F meet a condition."""
    if not isinstance(condition, Point | Centroid):
        return 1
    above = np.asarray(_measured(E, ft, GF, h, condition)) > math.log(condition.w)
    return int((above[1:] != above[:-1]).sum())


def _measured(E, ft, GF, h, condition):
    values = (E, ft, GF) if h is None else (E, ft, GF, h)
    return _program(len(values))(*map(float, values), condition)


@cache
def _program(count):
    """ln of the openings of a family of curves, compiled; of E, f_t, G_F (and h) and a condition."""

    def measured(*values):
        *values, condition = values
        values = [jnp.asarray(value) for value in values]
        if count == 3:
            grid, measure = widths(*values, condition, InitialSlope())
        else:
            top = 1 / 3 if isinstance(condition, Centroid) else 0.5
            grid, measure = energy.family(condition, Given(*values), top)
        return jax.vmap(lambda x: measure(x)[0])(grid)

    return jax.jit(measured)
