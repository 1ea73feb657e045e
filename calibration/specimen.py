"""Whole simulations fitted to what was measured: load against displacement or crack opening.

The residual of a specimen is the simulated load at the measured displacements less the measured
one, over the peak load, or over half the width of the band that tests lie in. Where the gauge
goes back, the load of the furthest place counts. A run that fails is NaN, and a step rejected.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from calibration import descent, leaves
from calibration.descent import Descent
from calibration.parameters import Parameters
from jaxmpm.differentiable import WELL, Run
from jaxmpm.errors import RunError, SceneError
from jaxmpm.scene import load_scene

SAMPLES, VISCOSITY = 200, 0.1
NARROW = 0.01  # of the peak: bands are taken to be no narrower
SECANT = 0.02  # of a secant's two ends from the middle, in ln(parameter)
NEAR = 1e-3  # relative change of the loss, or step, at which a descent is done: runs have kinks


@dataclass(frozen=True)
class Source:
    """Where a specimen comes from: a scene, overrides, a CSV file, displacements to look at."""

    scene: str
    overrides: tuple = ()
    data: str | None = None
    window: tuple = (-np.inf, np.inf)  # mm


@dataclass(frozen=True)
class Specimen:
    """A scene with its measured curve."""

    name: str
    overrides: tuple  # of the scene, those put in here too
    run: Run
    scene: dict  # `leaves.known` of the run
    at: np.ndarray  # (m,) measured displacements, mm
    load: np.ndarray  # (m,), N
    half: np.ndarray | None  # (m,) half the width of a band, N

    @classmethod
    def of(cls, source: Source, twin: bool = False) -> "Specimen":
        """Load a specimen; with `twin` its curve is still to come (`twin_of`).

        Raises:
            SceneError: no response, no curve, or none of it in the window.
        """
        overrides = [*source.overrides, "solver.damping=0"]
        if source.data is not None:
            overrides.append(f"response.reference={json.dumps(str(Path(source.data).absolute()))}")
        scene = load_scene(source.scene, overrides)
        if not scene.solver.viscosity:
            overrides.append(f"solver.viscosity={VISCOSITY}")
            scene = load_scene(source.scene, overrides)
        if scene.response is None:
            raise SceneError(f"scene = {source.scene}: response absent, expected the gauges of a curve to fit")
        run = Run.of(scene, SAMPLES, leaves.STIFFER)
        name, scene_values = Path(source.scene).stem, leaves.known(run)
        if twin:
            return cls(name, tuple(overrides), run, scene_values, *(np.zeros(0),) * 2, None)
        return cls(name, tuple(overrides), run, scene_values, *_measured(scene, source))

    @property
    def scale(self) -> np.ndarray:
        """(m,) N, what residuals are divided by."""
        peak = np.abs(self.load).max()
        return np.maximum(self.half, NARROW * peak) if self.half is not None else np.full(len(self.at), peak)

    def curve(self, values):
        """Displacement and load (samples + 1,), mm and N, from rest; NaN where the run went wrong; pure."""
        history = self.run(self.run.with_values(leaves.leaves(self.run, self.scene, values)))
        names, well = self.run.scene.response, (history.status == WELL).all()
        lines = (history.gauges[name] for name in (names.displacement, names.load))
        return tuple(jnp.where(well, jnp.concatenate([jnp.zeros(1), line]), jnp.nan) for line in lines)

    def residual(self, curve, work=0.0):
        """(m,) of a curve; one more, of the work between the first and last point, with a weight above 0; pure."""
        displacement, load = curve
        furthest = lax.cummax(displacement)
        error = (jnp.interp(self.at, furthest, load) - self.load) / self.scale
        if work:
            area = jnp.trapezoid(error, self.at) / np.ptp(self.at)
            error = jnp.append(error, work * np.sqrt(len(self.at)) * area)
        return jnp.where(furthest[-1] >= self.at[-1], error, jnp.nan)


def _measured(scene, source):
    """Displacements, loads and half widths of a reference within the window."""
    reference, (low, high) = scene.response.reference, source.window
    if reference is None:
        raise SceneError(f"scene = {source.scene}: response.reference absent, expected it or --data FILE.csv")
    at, loads = np.array(reference.displacement), np.array(reference.loads)
    inside = (at >= low) & (at <= high)
    if inside.sum() < 2:
        raise SceneError(
            f"window = {low:g} {high:g}: expected 2 points or more of {reference.file} in it "
            f"({at[0]:g} to {at[-1]:g} mm)"
        )
    at, loads = at[inside], loads[:, inside]
    return at, loads.mean(0), (loads[-1] - loads[0]) / 2 if reference.is_band else None


@dataclass
class Problem:
    """Specimens and the parameters that they share, compiled when first called."""

    specimens: list[Specimen]
    parameters: Parameters
    work: float = 0.0
    jacobian: str = "tangent"
    runs: int = 0  # so far, and
    tangents: int = 0
    _programs: dict = field(default_factory=dict)
    _last: tuple = (None, None)

    def curves(self, theta):
        """(displacement, load) of all specimens; the last are kept."""
        if self._last[0] is None or not np.array_equal(self._last[0], theta):
            self.runs += 1
            self._last = theta, self._all("value", theta)
        return self._last[1]

    def value(self, theta):
        """r (m,) of all specimens."""
        return self._residual(self.curves(theta))

    def evaluate(self, theta):
        """(r (m,), dr/dtheta (m, k)); by tangents of the runs, or by secants, which smooth over kinks."""
        value = self.value(theta)
        if not np.isfinite(value).all():
            return value, jnp.full((len(value), len(theta)), jnp.nan)
        slope = self._tangent if self.jacobian == "tangent" else self._secant
        return value, jnp.stack([slope(theta, direction) for direction in jnp.eye(len(theta))], 1)

    def _tangent(self, theta, direction):
        self.tangents += 1
        curves = self.curves(theta)
        return jax.jvp(self._residual, (curves,), (self._all("tangent", theta, direction),))[1]

    def _secant(self, theta, direction):
        self.runs += 2
        step = SECANT * direction / self.parameters.relative(theta)
        ahead, back = (self._residual(self._all("value", theta + s * step)) for s in (1, -1))
        return (ahead - back) / (2 * step.sum())

    def _residual(self, curves):
        pairs = zip(self.specimens, curves, strict=True)
        return jnp.concatenate([one.residual(curve, self.work) for one, curve in pairs])

    def _all(self, what, *args):
        """What a program of every specimen says, compiled when first called."""
        for k, one in enumerate(self.specimens):
            if (k, what) not in self._programs:
                value = lambda theta, one=one: one.curve(self.parameters.values(theta))  # noqa: E731
                tangent = lambda theta, way, f=value: jax.jvp(f, (theta,), (way,))[1]
                program = {"value": value, "tangent": tangent}[what]
                self._programs[k, what] = one.run.compiled(program, *args)
        return [self._programs[k, what](*args) for k in range(len(self.specimens))]


@dataclass(frozen=True)
class SpecimenFit:
    """Parameters fitted to the curves of specimens."""

    problem: Problem
    end: Descent  # the best of all starts
    start: np.ndarray  # (k,) theta from where it came
    all: list  # of all starts: (theta (k,), Descent)
    curves: list  # of all specimens: displacement and load (samples + 1,)
    seconds: float

    @property
    def values(self) -> dict[str, float]:
        """Parameters, free and fixed."""
        return {k: float(v) for k, v in self.problem.parameters.values(self.end.theta).items()}


def twin_of(problem: Problem, noise: float, points: int = 100, seed: int = 0) -> Problem:
    """The same with curves of the starts in place of measured ones, and noise, a share of the peak, on them."""
    curves = problem.curves(problem.parameters.start())
    random, found = np.random.default_rng(seed), []
    for one, (displacement, load) in zip(problem.specimens, curves, strict=True):
        furthest, load = np.maximum.accumulate(displacement), np.asarray(load)
        at = np.linspace(0.0, 0.95 * furthest[-1], points + 1)[1:]
        load = np.interp(at, furthest, load) + noise * float(np.max(load)) * random.standard_normal(points)
        found.append(replace(one, at=at, load=load))
    return replace(problem, specimens=found)


def check_reach(problem: Problem) -> None:
    """Raise SceneError where a run from the start fails, or ends before the measured curve does."""
    start = problem.parameters.start()
    for one, (displacement, load) in zip(problem.specimens, problem.curves(start), strict=True):
        if not np.isfinite(load).all():
            said = problem.parameters.show(start)
            raise SceneError(f"start {said}: expected values with which {one.name} can be run (E_p and n that exist)")
        if one.at.size and max(displacement) < one.at[-1]:
            name = one.run.scene.response.displacement
            raise SceneError(
                f"data of {one.name} = {one.at[-1]:g} mm: expected {name} within what is simulated, up to "
                f"{max(displacement):.4g} mm; a window or a longer solver.duration helps"
            )


def fit_specimens(problem: Problem, starts=None, method="gauss_newton", steps=20, show: Callable | None = None):
    """Descend from each of some starts (s, k); the best end is the result.

    Args:
        problem: what is fitted to what.
        starts: theta (s, k); only that of the parameters if None.
        method: "gauss_newton", or "adam" before it.
        steps: at most, of each.
        show: takes lines of progress.

    Returns:
        SpecimenFit.

    Raises:
        RunError: no start can be run.
    """
    clock, name = time.perf_counter(), problem.parameters.show
    found = []
    for theta in problem.parameters.start()[None] if starts is None else starts:
        first = theta
        if method == "adam":
            slope = lambda t: (lambda r, J: (r @ r / 2, r @ J))(*problem.evaluate(t))  # noqa: E731
            theta, _ = descent.adam(slope, theta, 3 * steps, show=show, name=name)
        end = descent.gauss_newton(problem.evaluate, theta, steps, NEAR, show, name, NEAR, problem.value)
        found.append((np.asarray(first), end))
    well = [pair for pair in found if np.isfinite(pair[1].residual).all()]
    if not well:
        raise RunError(f"none of {len(found)} starts could be run: try others")
    start, end = min(well, key=lambda pair: pair[1].loss)
    curves = [[np.asarray(line) for line in curve] for curve in problem.curves(jnp.asarray(end.theta))]
    return SpecimenFit(problem, end, start, found, curves, time.perf_counter() - clock)
