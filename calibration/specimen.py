"""A test and its simulation: load against displacement or crack opening.

The residual of a specimen is the simulated load at the measured displacements less the measured
one, over the peak load, or over half the width of the band that tests lie in. Where the gauge
goes back, the load of the furthest place counts. A run that fails is NaN, and a step rejected.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jax import lax

from calibration import leaves
from jaxmpm.differentiable import WELL, Run
from jaxmpm.differentiable_static import StaticRun
from jaxmpm.errors import SceneError
from jaxmpm.scene import load_scene

SAMPLES, VISCOSITY = 200, 0.1
NARROW = 0.01  # of the peak: bands are taken to be no narrower


@dataclass(frozen=True)
class Source:
    """Where a specimen comes from: a scene, overrides, a CSV file, displacements to look at, a time to average over."""

    scene: str
    overrides: tuple = ()
    data: str | None = None
    window: tuple = (-np.inf, np.inf)  # mm
    smooth: float = 0.0  # s, a period or two of what vibrates


@dataclass(frozen=True)
class Specimen:
    """A scene with its measured curve."""

    name: str
    overrides: tuple  # of the scene, those put in here too
    run: Run | StaticRun
    scene: dict  # `leaves.known` of the run
    at: np.ndarray  # (m,) measured displacements, mm
    load: np.ndarray  # (m,), N
    half: np.ndarray | None  # (m,) half the width of a band, N
    average: int = 1  # samples over which a curve is averaged

    @classmethod
    def of(cls, source: Source, twin: bool = False) -> "Specimen":
        """Load a specimen; with `twin` its curve is still to come (`twin_of`).

        Raises:
            SceneError: no response, no curve, or none of it in the window.
        """
        overrides = list(source.overrides)
        if source.data is not None:
            overrides.append(f"response.reference={json.dumps(str(Path(source.data).absolute()))}")
        scene = load_scene(source.scene, overrides)
        if scene.response is None:
            raise SceneError(f"scene = {source.scene}: response absent, expected the gauges of a curve to fit")
        if scene.solver.kind == "quasistatic":
            if source.smooth:
                raise SceneError(f'smooth = {source.smooth:g}: expected none with solver.kind = "quasistatic": nothing vibrates')
            run, between = StaticRun.of(scene), np.inf
        else:
            overrides += ["solver.damping=0", *([] if scene.solver.viscosity else [f"solver.viscosity={VISCOSITY}"])]
            run = Run.of(load_scene(source.scene, overrides), SAMPLES, leaves.STIFFER)
            scene, between = run.scene, run.dt * run.every
        measured = (np.zeros(0), np.zeros(0), None) if twin else _measured(scene, source)
        average = max(1, round(source.smooth / between))
        if average > SAMPLES // 10:
            limit = SAMPLES // 10 * between
            raise SceneError(f"smooth = {source.smooth:g}: expected a time up to {limit:.3g} s, a tenth of the run")
        return cls(Path(source.scene).stem, tuple(overrides), run, leaves.known(run), *measured, average)

    @property
    def static(self) -> bool:
        """Whether it is followed through equilibria: its curve is then no function to be compiled, and differentiated in reverse."""
        return isinstance(self.run, StaticRun)

    @property
    def scale(self) -> np.ndarray:
        """(m,) N, what residuals are divided by."""
        peak = np.abs(self.load).max()
        return np.maximum(self.half, NARROW * peak) if self.half is not None else np.full(len(self.at), peak)

    def curve(self, values):
        """Displacement and load (samples + 2 - average,), mm and N, from rest; NaN if the run went wrong; pure."""
        names = self.run.scene.response
        history = self.run(self.run.with_values(leaves.leaves(self.run, self.scene, values)))
        if self.static:
            return history.gauges[names.displacement], history.gauges[names.load]
        well = (history.status == WELL).all()
        mean = lambda line: jnp.convolve(line, jnp.full(self.average, 1 / self.average), "valid")
        lines = (mean(history.gauges[name]) for name in (names.displacement, names.load))
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
