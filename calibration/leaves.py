"""Parameters of whole simulations by name: numbers of a material, and G_F of its damage law.

A name is MATERIAL.LEAF, a leaf as the scene has it (ft, E, density ...). The damage law has two
more, `GF` and `slope_factor`: E_p and n follow from them, f_t, E and h (`calibration.energy`).
"""

import jax.numpy as jnp
import numpy as np

from calibration.energy import InitialSlope, fit_energy, fracture_energy
from calibration.parameters import Free, Parameters
from jaxmpm.errors import SceneError, near_or
from jaxmpm.laws.damage import Damage
from jaxmpm.parameters import names_of

DERIVED = ("GF", "slope_factor")
SLOPE_FACTOR = 2.0  # where nothing else is said: that of the paper's plate
UNITS = {"E": "MPa", "ft": "MPa", "Ep": "MPa", "GF": "N/mm", "h": "mm", "density": "tonne/mm3"}
HALF = {"n": 0.5, "nu": 0.5}  # leaves below 1/2
STIFFER = 1.5  # the time step allows for wave speeds so many times the scene's


def known(run) -> dict[str, float]:
    """All names of a `jaxmpm.differentiable.Run` with the numbers that its scene gives them.

    Without a band there is no strength, and nothing derived. Units: MPa, mm, N/mm, tonne/mm³.
    """
    names = names_of(run.model, run.materials)
    found = {name: float(value) for name, value in run.values(names).items()}
    if isinstance(run.model.embedding.law, Damage):
        for material in run.materials:
            E, ft, Ep, n, h = (found[f"{material}.{leaf}"] for leaf in ("E", "ft", "Ep", "n", "h"))
            if np.isfinite(ft):
                found[f"{material}.GF"] = float(fracture_energy(E, ft, Ep, n, h))
                found[f"{material}.slope_factor"] = SLOPE_FACTOR
    return {name: value for name, value in found.items() if np.isfinite(value)}


def leaves(run, scene, values) -> dict:
    """`values` of some names as values that the model of a run knows; those of other runs are left out.

    Pure and differentiable; `scene` is what `known` says of the run. E_p and n are NaN where `fit_energy` refuses.
    """
    names = names_of(run.model, run.materials)
    found = {name: value for name, value in values.items() if name in names}
    for material in run.materials:
        if f"{material}.slope_factor" in scene and any(f"{material}.{leaf}" in values for leaf in DERIVED):
            value = lambda leaf: values.get(f"{material}.{leaf}", scene[f"{material}.{leaf}"])  # noqa: B023
            condition = InitialSlope(jnp.asarray(value("slope_factor")))
            fit = fit_energy(value("E"), value("ft"), value("GF"), value("h"), condition)
            found |= {f"{material}.Ep": fit.Ep, f"{material}.n": fit.n}
    return found


def parameters(runs, free, start, fix, bounds) -> Parameters:
    """What is to be found, and what is held.

    Args:
        runs: of all specimens.
        free: names to be found.
        start: values to start from by name; else the scene's.
        fix: values to hold by name; else the scene's.
        bounds: (low, high) by name.

    Raises:
        SceneError: an unknown name, a value out of bounds, parameters that contradict each other.
    """
    scene = {name: value for run in reversed(runs) for name, value in known(run).items()}
    for name in (*free, *start, *fix, *bounds):
        if name not in scene:
            raise SceneError(f"{name}: no parameter of the materials ({near_or(name, sorted(scene))})")
    for option, names in (("start", start), ("bounds", bounds)):
        for name in set(names) - set(free):
            raise SceneError(f"{option} {name}: expected a parameter that is free ({', '.join(free)})")
    for name in set(free) & set(fix):
        raise SceneError(f"fix {name} = {fix[name]:g}: expected a parameter that is not free")
    _check_derived({*free, *fix})
    for name, value in fix.items():
        _admissible("fix", name, Free(value, *_limits(name, scene, {})))
    found = {n: Free(start.get(n, scene[n]), *_limits(n, scene, bounds), UNITS.get(n.rpartition(".")[2], "")) for n in free}
    for name, one in found.items():
        _admissible("start", name, one)
    return Parameters(found, fix)


def _check_derived(names):
    for name in names:
        material, _, leaf = name.rpartition(".")
        rivals = [f"{material}.{rival}" for rival in DERIVED if f"{material}.{rival}" in names]
        if leaf in ("Ep", "n") and rivals:
            raise SceneError(f"{name}: expected Ep and n, or GF and slope_factor, not both ({', '.join(rivals)})")


def _limits(name, scene, bounds):
    """(low, high) of a parameter, high None where there is none."""
    leaf = name.rpartition(".")[2]
    if name in bounds:
        return bounds[name]
    if leaf == "E":
        return 0.0, STIFFER**2 * scene[name]
    if leaf == "density":
        return scene[name] / STIFFER**2, None
    return 0.0, HALF.get(leaf)


def _admissible(what, name, one):
    high = np.inf if one.high is None else one.high
    if not one.low < one.start < high:
        limits = f"above {one.low:g}" if one.high is None else f"between {one.low:g} and {high:g}"
        raise SceneError(f"{what} {name} = {one.start:g}: expected a finite number {limits}")


def about(parameters, count: int, seed: int = 0, with_start: bool = True):
    """Starts (count, k), each value 0.5 to 1.5 times that of the start, log-uniform; the first that itself if asked.

    Those of bounded parameters stay inside.
    """
    random, rows = np.random.default_rng(seed + 1), []
    for k in range(count):
        factors = np.exp(random.uniform(np.log(0.5), np.log(1.5), len(parameters.names)))
        values = {}
        for factor, (name, one) in zip(factors, parameters.free.items(), strict=True):
            low, high = (one.low, one.high) if one.high else (one.low, np.inf)
            middle = one.start if k == 0 and with_start else factor * one.start
            values[name] = np.clip(middle, low + 0.02 * (one.start - low), high - 0.02 * (min(high, 1e300) - one.start))
        rows.append(parameters.theta(values))
    return jnp.stack(rows)
