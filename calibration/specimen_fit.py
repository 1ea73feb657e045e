"""Materials of whole simulations fitted to the measured curves of specimens that share them.

Runs are linearised by secants over 10 % each way at first, which pass over the kinks where cells
crack in another order, and by narrow secants or tangents at the end. A run that fails is a step
rejected.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from calibration import descent
from calibration.descent import Descent
from calibration.parameters import Parameters
from calibration.specimen import Specimen
from jaxmpm.errors import RunError, SceneError

FAR, CLOSE = 0.1, 0.02  # of a secant's two ends from the middle, in ln(parameter): at first, at the end
NEAR = 1e-3  # relative change of the loss, or step, at which a descent is done: runs have kinks


@dataclass
class Problem:
    """Specimens and the parameters that they share, compiled when first called."""

    specimens: list[Specimen]
    parameters: Parameters
    work: float = 0.0
    jacobian: str = "secant"  # or "tangent"
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

    def evaluate(self, theta, width=None):
        """(r (m,), dr/dtheta (m, k)); by tangents of the runs or, with a width too, by secants."""
        value = self.value(theta)
        if not np.isfinite(value).all():
            return value, jnp.full((len(value), len(theta)), jnp.nan)
        tangent = self.jacobian == "tangent" and width is None
        slope = self._tangent if tangent else partial(self._secant, width=width or CLOSE)
        return value, jnp.stack([slope(theta, direction) for direction in jnp.eye(len(theta))], 1)

    def slope(self, theta):
        """½ rᵀr and its gradient (k,): in reverse through paths of equilibria, by the Jacobian of runs in time."""
        if all(one.static for one in self.specimens):
            self.runs, self.tangents = self.runs + 1, self.tangents + 1
            return jax.value_and_grad(lambda theta: (self._residual(self._all("value", theta)) ** 2).sum() / 2)(theta)
        value, jacobian = self.evaluate(theta)
        return value @ value / 2, value @ jacobian

    def _tangent(self, theta, direction):
        self.tangents += 1
        curves = self.curves(theta)
        return jax.jvp(self._residual, (curves,), (self._all("tangent", theta, direction),))[1]

    def _secant(self, theta, direction, width):
        self.runs += 2
        step = width * direction / self.parameters.relative(theta)
        ahead, back = (self._residual(self._all("value", theta + s * step)) for s in (1, -1))
        return (ahead - back) / (2 * step.sum())

    def _residual(self, curves):
        pairs = zip(self.specimens, curves, strict=True)
        return jnp.concatenate([one.residual(curve, self.work) for one, curve in pairs])

    def _all(self, what, *args):
        """What a program of every specimen says, compiled when first called; a path of equilibria is followed as it is."""
        for k, one in enumerate(self.specimens):
            if (k, what) not in self._programs:
                value = lambda theta, one=one: one.curve(self.parameters.values(theta))  # noqa: E731
                tangent = lambda theta, way, f=value: jax.jvp(f, (theta,), (way,))[1]
                program = {"value": value, "tangent": tangent}[what]
                self._programs[k, what] = program if one.static else one.run.compiled(program, *args)
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
    if problem.jacobian == "tangent" and any(one.static for one in problem.specimens):
        raise SceneError(
            '--jacobian = "tangent": expected "secant" with solver.kind = "quasistatic", whose paths are differentiated in reverse '
            "alone (--method adam does so)"
        )
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


def _descend(problem, theta, steps, show):
    """Gauss-Newton with wide secants, over the kinks of the response, and then with what the problem asks for."""
    count = rejected = 0
    for evaluate in (partial(problem.evaluate, width=FAR), problem.evaluate):
        end = descent.gauss_newton(
            evaluate, theta, steps, NEAR, show, problem.parameters.show, NEAR, problem.value
        )  # fmt: skip
        theta, count, rejected = jnp.asarray(end.theta), count + end.steps, rejected + end.rejected
    return end._replace(steps=count, rejected=rejected)


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
    clock, found = time.perf_counter(), []
    for start in problem.parameters.start()[None] if starts is None else starts:
        theta = start
        if method == "adam":
            theta, _ = descent.adam(problem.slope, start, 3 * steps, show=show, name=problem.parameters.show)
        found.append((np.asarray(start), _descend(problem, theta, steps, show)))
    well = [pair for pair in found if np.isfinite(pair[1].residual).all()]
    if not well:
        raise RunError(f"none of {len(found)} starts could be run: try others")
    start, end = min(well, key=lambda pair: pair[1].loss)
    curves = [[np.asarray(line) for line in curve] for curve in problem.curves(jnp.asarray(end.theta))]
    return SpecimenFit(problem, end, start, found, curves, time.perf_counter() - clock)
