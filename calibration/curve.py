"""A band law fitted to a softening curve σ(w) by least squares.

Damage (f_t, E_p, n; E and h given) or cohesive (f_t, G_F; linear, bilinear, exponential,
hordijk). On logarithms of the parameters, from many starts at once with Adam, from the best of
them to the end with Gauss-Newton.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from calibration import damage_curve, descent, energy
from calibration.parameters import Free, Parameters
from calibration.tables import Curve
from calibration.uncertainty import Uncertainty, uncertainty
from jaxmpm.errors import SceneError, did_you_mean
from jaxmpm.laws.cohesive import CURVES

LAWS = ("damage", *CURVES)
UNITS = {"ft": "MPa", "Ep": "MPa", "n": "", "GF": "N/mm"}
STARTS, LINE = 12, 801


@dataclass(frozen=True)
class CurveFit:
    """A law fitted to a curve."""

    law: str
    data: Curve
    values: dict[str, float]  # all parameters, MPa, N/mm, mm
    fixed: list[str]
    beyond: float  # share of GF beyond the last point of the curve
    model: np.ndarray  # (m,) MPa
    line: tuple[np.ndarray, np.ndarray]  # w, mm, and σ, MPa, of the law from 0 to the last point
    residual_norm: float  # MPa, root of the weighted sum of squares
    uncertainty: Uncertainty
    steps: int
    rejected: int
    converged: bool

    @property
    def rms(self) -> float:
        """Root of the weighted mean square, MPa."""
        return self.residual_norm / float(np.sqrt(self.data.weight.sum()))


@partial(jax.jit, static_argnums=0)
def traction(law: str, values: dict[str, Any], w):
    """σ, MPa, of a band law at openings w (m,), mm.

    `values` of ft and GF; of ft, Ep, E, h and n for damage, or GF in place of n.
    """
    w, ft = jnp.asarray(w), values["ft"]
    if law != "damage":
        return ft * CURVES[law].value(w * ft / values["GF"])
    e, n = jnp.asarray(values["Ep"] / values["E"]), _exponent(values)
    opened = w * values["E"] / (values["h"] * ft)
    p = jax.vmap(damage_curve.softening_at, (0, None, None))(opened, e, n)
    return ft * damage_curve.stress(p, e, n)


def _exponent(values):
    """n, or that which gives GF; NaN where none does."""
    if "n" in values:
        return jnp.asarray(values["n"])
    gamma = values["h"] * values["ft"] ** 2 / (2 * values["E"] * values["GF"])
    n, status = energy.exponent(jnp.asarray(values["Ep"] / values["E"]), jnp.asarray(gamma))
    return jnp.where(status == energy.FOUND, n, jnp.nan)


def sampled(law: str, ft: float, GF: float, count: int = 60) -> Curve:
    """Another cohesive law as a curve to fit, down to 1 % of its strength."""
    w = np.linspace(0.0, 6.0 * GF / ft, 1201)
    sigma = np.asarray(traction(law, {"ft": ft, "GF": GF}, w))
    last = w[max(1, int((sigma > 0.01 * ft).sum()))]
    at = np.linspace(0.0, last, count)
    return Curve(at, np.asarray(traction(law, {"ft": ft, "GF": GF}, at)), np.ones(count), law)


def fit_curve(data: Curve, law="damage", E=None, h=None, fix=None, show=None) -> CurveFit:
    """The parameters of a band law whose σ(w) is nearest to a curve.

    Args:
        data: the curve.
        law: one of `LAWS`.
        E, h: MPa and mm, of the damage law.
        fix: parameters that are known, such as {"ft": 3.0}; with "GF" for damage, n follows.
        show: takes lines of progress.

    Raises:
        SceneError: an unknown parameter, none or too many to find.
    """
    parameters = _parameters(data, law, E, h, dict(fix or {}))
    w, sigma, root = (jnp.asarray(x) for x in (data.w, data.sigma, np.sqrt(data.weight)))

    def residual(theta):
        return root * (traction(law, parameters.values(theta), w) - sigma)

    many = jax.jit(jax.vmap(descent.linearised(residual)))

    def slopes(thetas):
        value, jacobian = many(thetas)
        return (value**2).sum(1) / 2, jnp.einsum("im,imk->ik", value, jacobian)

    def one(theta):  # by the same program, which takes as many
        value, jacobian = many(jnp.tile(theta, (STARTS, 1)))
        return value[0], jacobian[0]

    thetas, losses = descent.adam(
        slopes, parameters.about(STARTS), 100, show=show, name=parameters.show
    )
    end = descent.gauss_newton(one, thetas[jnp.argmin(losses)], show=show, name=parameters.show)
    return _summary(data, law, parameters, end)


def _summary(data, law, parameters, end):
    values = {name: float(value) for name, value in parameters.values(end.theta).items()}
    fixed = sorted(set(values) - set(parameters.names) - {"E", "h"})
    if law == "damage":
        values |= {name: float(value) for name, value in _completed(values).items()}
    w = np.linspace(0.0, float(data.w.max()), LINE)
    model, line = np.split(np.asarray(traction(law, values, np.r_[data.w, w])), [len(data.w)])
    scale = float(np.max(np.abs(data.sigma) * np.sqrt(data.weight)))
    return CurveFit(
        law, data, values, fixed, 1 - float(np.trapezoid(line, w)) / values["GF"], model, (w, line),
        float(np.sqrt(2 * end.loss)), uncertainty(end, parameters, scale),
        end.steps, end.rejected, end.converged,
    )  # fmt: skip


@jax.jit
def _completed(values):
    """n and GF of the damage law, whichever was sought."""
    n = _exponent(values)
    return {
        "n": n,
        "GF": energy.fracture_energy(*(values[key] for key in ("E", "ft", "Ep")), n, values["h"]),
    }


def _parameters(data, law, E, h, fix) -> Parameters:
    """What is to be found, with starts taken from the curve."""
    if law not in LAWS:
        raise SceneError(f"law = {law}: expected one of {', '.join(LAWS)}")
    ft = fix.get("ft", float(data.sigma.max()))
    order = np.argsort(data.w)
    area = float(np.trapezoid(data.sigma[order], data.w[order])) or 1.0
    GF = fix.get("GF", 1.1 * max(area, 1e-3 * ft * (np.ptp(data.w) or 1.0)))
    fixed = dict(fix)
    if law == "damage":
        if E is None or h is None:
            raise SceneError("law = damage: expected E (MPa) and h (mm) with it")
        free = {"ft": Free(ft), "Ep": Free(2 * h * ft**2 / GF), "n": Free(0.13, 0.0, 0.5)}
        fixed |= {"E": float(E), "h": float(h)}
    else:
        free = {"ft": Free(ft), "GF": Free(GF)}
    _check_fixed(fix, free | {"GF": Free(GF)})
    if law == "damage" and "GF" in fix:  # n follows from it
        if "n" in fix:
            raise SceneError(
                f"fix n = {fix['n']:g}: expected n or GF, the one follows from the other"
            )
        del free["n"]
    free = {name: one for name, one in free.items() if name not in fix}
    if not 0 < len(free) <= len(data.w):
        raise SceneError(
            f"{len(free)} parameters to find ({', '.join(free) or 'all are fixed'}): "
            f"expected 1 to {len(data.w)}, the rows of {data.name}"
        )
    return Parameters(free, fixed)


def _check_fixed(fix, free):
    for name, value in fix.items():
        if name not in free:
            near = did_you_mean(name, free)
            hint = f" (did you mean {near}?)" if near else ""
            raise SceneError(f"fix {name} = {value:g}: expected one of {', '.join(free)}{hint}")
        high = free[name].high or np.inf
        if not 0 < value < high:
            limits = "above 0" if high == np.inf else f"between 0 and {high:g}"
            raise SceneError(f"fix {name} = {value:g}: expected a finite number {limits}")
