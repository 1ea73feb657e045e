"""E_p and n found in both ways and put into words: what `jaxmpm calibrate energy` says and writes."""

import json
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from calibration import descent, energy
from calibration.energy import Centroid, Given, InitialSlope
from calibration.parameters import Free, Parameters
from calibration.refusals import crossings, refusal
from calibration.width import fit_width
from jaxmpm.compilation import compiled
from jaxmpm.errors import SceneError

AGREED = 1e-6  # relative difference of closed form and descent beyond which it is said


@dataclass(frozen=True)
class Calibrated:
    """Parameters of a damage band, and how they were checked."""

    E: float  # MPa
    ft: float  # MPa
    GF: float  # N/mm, asked for
    h: float  # mm
    Ep: float  # MPa
    n: float
    k: float  # MPa: σ(w) starts with the slope −k/h
    H_max: float  # mm
    h_gF: float  # N/mm, h ∫ F dD of what was found
    descent_Ep: float  # MPa, of the descent
    descent_n: float
    notes: tuple[str, ...] = ()

    @property
    def disagreement(self) -> float:
        """Of closed form and descent, relative."""
        return max(abs(self.descent_Ep / self.Ep - 1), abs(self.descent_n / self.n - 1))


def calibrate_energy(E, ft, GF, h=None, condition=InitialSlope()) -> Calibrated:
    """E_p and n (and h, where None) in closed form, checked by descent.

    Raises:
        SceneError: there are none; says why.
    """
    E, ft, GF = map(float, (E, ft, GF))
    asked = (E, ft, GF, condition) if h is None else (E, ft, GF, float(h), condition)
    *found, status = _program(fit_width if h is None else energy.fit_energy, type(condition))(
        *asked
    )
    if int(status) != energy.FOUND:
        raise SceneError(refusal(int(status), E, ft, GF, h, condition))
    *width, Ep, n = map(float, found)
    notes = _notes(E, ft, GF, h, condition)
    h = width[0] if h is None else float(h)
    other_Ep, other_n = descend(E, ft, GF, h, condition)
    k = Ep / (1 + Ep / E)
    return Calibrated(
        E, ft, GF, h, Ep, n, k, h * E / k, float(jax.jit(energy.fracture_energy)(E, ft, Ep, n, h)),
        other_Ep, other_n, notes,
    )  # fmt: skip


@cache
def _program(fit, kind):
    """A fit compiled for one kind of condition."""
    blank = kind(**{name: 1.0 for name in kind.__dataclass_fields__})
    return compiled(jax.jit(fit).lower(*[1.0] * (3 if fit is fit_width else 4), blank))


def descend(E, ft, GF, h, condition=InitialSlope()) -> tuple[float, float]:
    """E_p, MPa, and n by gradient descent: optax's Adam, then its L-BFGS, on ln E_p and logit n."""
    top = 1 / 3 if isinstance(condition, Centroid) else 0.5
    parameters = Parameters({"Ep": Free(2 * h * ft**2 / GF), "n": Free(0.3 * top, 0.0, top)})
    residual = partial(
        _missed, Given(*(jnp.asarray(float(x)) for x in (E, ft, GF, h))), condition, parameters
    )
    evaluate = jax.jit(descent.with_slope(residual))
    theta, _ = descent.adam(evaluate, parameters.start(), steps=150)
    theta, _ = descent.lbfgs(lambda theta: (residual(theta) ** 2).sum() / 2, theta)
    values = parameters.values(theta)
    return float(values["Ep"]), float(values["n"])


def _missed(given, condition, parameters, theta):
    """By how much, as logarithms, (2,), a curve misses the energy and the condition."""
    values = parameters.values(theta)
    e, n = values["Ep"] / given.E, values["n"]
    energy_missed = jnp.log(given.gamma * energy.curve.energy(e, n))
    return jnp.stack([energy_missed, condition.residual(e, n, given)])


def _notes(E, ft, GF, h, condition):
    notes = []
    if h is not None and crossings(E, ft, GF, h, condition) > 1:
        notes.append("a second curve, with a larger n, meets the condition as well")
    if h is None:
        log_h = lambda w: jnp.log(fit_width(E, ft, GF, _at(condition, w)).h)  # noqa: E731
        change = jax.jit(jax.jacfwd(log_h))(condition.w)
        notes.append(
            f"h is sensitive: 1 % in w changes it by {abs(float(change)) * condition.w:.0f} %"
        )
    return tuple(notes)


def _at(condition, w):
    return type(condition)(**(vars(condition) | {"w": w}))


def words(result: Calibrated) -> str:
    """The result in a few lines, the last ready to paste into a scene."""
    r = result
    return "\n".join(
        [
            f"Ep     {r.Ep:.6g} MPa",
            f"n      {r.n:.6g}",
            f"h      {r.h:.6g} mm",
            f"k      {r.k:.6g} MPa      sigma(w) starts with the slope -k/h = {-r.k / r.h:.6g} MPa/mm",
            f"H_max  {r.H_max:.6g} mm      larger cells snap back",
            f"h gF   {r.h_gF:.10g} N/mm      GF = {r.GF:g} asked for, off by {abs(r.h_gF / r.GF - 1):.1e}",
            f"descent: Ep {r.descent_Ep:.6g}, n {r.descent_n:.6g}, within {r.disagreement:.1e}",
            *(f"note: {note}" for note in r.notes),
            *(["warning: descent ended elsewhere"] if not r.disagreement < AGREED else []),
            toml_line(r),
        ]
    )


def toml_line(result: Calibrated) -> str:
    """The band as a line of a scene."""
    r = result
    return (
        f'band = {{ law = "damage", ft = {r.ft:g}, Ep = {r.Ep:.8g}, n = {r.n:.8g}, h = {r.h:.8g} }}'
    )


def write_json(result: Calibrated, path) -> None:
    """All numbers of a result, and the band as a table."""
    band = {"law": "damage", "ft": result.ft, "Ep": result.Ep, "n": result.n, "h": result.h}
    table = vars(result) | {"disagreement": result.disagreement, "band": band}
    Path(path).write_text(json.dumps(table, indent=1) + "\n")


def curve_of(result: Calibrated, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Opening w, mm, and stress, MPa, (count,) each, down to 1 % of the strength or so."""
    e, n = jnp.asarray(result.Ep / result.E), jnp.asarray(result.n)
    p = jnp.concatenate([jnp.zeros(1), jnp.geomspace(1e-3, 60.0, 4 * count)])
    stress = np.asarray(energy.curve.stress(p, e, n)) * result.ft
    opening = np.asarray(energy.curve.opening(p, e, n)) * result.h * result.ft / result.E
    last = (
        opening[np.argmax(stress < 0.02 * result.ft)]
        if (stress < 0.02 * result.ft).any()
        else opening[-1]
    )
    w = np.linspace(0.0, last, count)
    return w, np.interp(w, opening, stress)


def draw(result: Calibrated, path, point=None) -> Path:
    """The softening curve, and a point (w, mm; σ, MPa) that it was asked to pass."""
    from calibration.plots import plot_softening

    r = result
    title = f"ft = {r.ft:.4g} MPa, Ep = {r.Ep:.4g} MPa, n = {r.n:.4g}, h = {r.h:.4g} mm"
    return plot_softening(path, *curve_of(r), r.ft, r.GF, -r.k / r.h, title, point)
