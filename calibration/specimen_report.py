"""Parameters fitted to the curves of specimens: in words, as JSON and as pictures."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from calibration import leaves
from calibration.plots import plot_fit
from calibration.specimen_fit import SpecimenFit
from calibration.uncertainty import Uncertainty, finite, uncertainty
from jaxmpm.errors import written


def known(fit: SpecimenFit) -> Uncertainty:
    """Covariance and what the data leave free."""
    scale = max(np.abs(one.load / one.scale).max() for one in fit.problem.specimens)
    return uncertainty(fit.end, fit.problem.parameters, float(scale))


def words(fit: SpecimenFit, truth: dict | None = None) -> str:
    """The result in a few lines; with the true values of a twin, how far they are."""
    end, problem = fit.end, fit.problem
    ended = "converged" if end.converged else "NOT converged"
    count = sum(len(one.at) for one in problem.specimens)
    names = ", ".join(one.name for one in problem.specimens)
    lines = [
        f"{names}: {count} points, {ended} in {end.steps} steps, {problem.runs} runs and "
        f"{problem.tangents} tangents in {fit.seconds:.0f} s"
    ]
    about, start = known(fit), problem.parameters.values(fit.start)
    for name, deviation in zip(about.names, about.deviation, strict=True):
        value, unit = fit.values[name], problem.parameters.free[name].unit
        line = f"{name} = {value:.6g} +- {deviation:.2g} {unit}".rstrip()
        off = f", {100 * (value / truth[name] - 1):+.2f} % off" if truth else ""
        lines.append(f"{line} (start {float(start[name]):.4g}{off})")
    lines += [f"{name} = {value:.6g} fixed" for name, value in problem.parameters.fixed.items()]
    lines += [_judged(one, curve) for one, curve in zip(problem.specimens, fit.curves, strict=True)]
    lines += [*about.correlations(), *starts_in_words(fit, truth), *about.warned()]
    return "\n".join([*lines, *toml_lines(fit)])


def starts_in_words(fit: SpecimenFit, truth: dict | None = None) -> list[str]:
    """A line for each of several starts."""
    parameters, lines = fit.problem.parameters, []
    for start, end in fit.all if len(fit.all) > 1 else []:
        line = f"start {parameters.show(start)} -> {parameters.show(end.theta)}  loss {end.loss:.4g}"
        if truth:
            off = max(abs(float(v) / truth[n] - 1) for n, v in parameters.values(end.theta).items() if n in truth)
            line += f"  {100 * off:.2f} % off"
        lines.append(line + ("" if end.converged else "  NOT converged"))
    return lines


def _model(one, curve):
    """Loads (m,) of a fit at the measured displacements, N."""
    return np.interp(one.at, np.maximum.accumulate(curve[0]), curve[1])


def _judged(one, curve):
    error = _model(one, curve) - one.load
    rms = np.sqrt(np.mean(error**2))
    line = f"{one.name}: residual {rms:.4g} N rms, {100 * rms / np.abs(one.load).max():.2g} % of the peak"
    if one.half is None:
        return line
    outside = one.at[np.abs(error) > one.half]
    line += f", {100 * (1 - len(outside) / len(one.at)):.0f} % of {len(one.at)} points inside the band"
    return line + (f", outside at {' '.join(f'{x:.3g}' for x in outside)} mm" if len(outside) else "")


def toml_lines(fit: SpecimenFit) -> list[str]:
    """Tables of each material whose numbers changed, as lines of a scene."""
    tables = {}
    for one in fit.problem.specimens:
        found = leaves.leaves(one.run, one.scene, {k: jnp.asarray(v) for k, v in fit.values.items()})
        for name, value in found.items():
            material, _, leaf = name.rpartition(".")
            table = tables.setdefault(material, one.run.scene.materials[material].model_dump(exclude_none=True))
            part = next(p for p in (table, table["bulk"], table.get("band", {})) if leaf in p)
            part[leaf] = float(f"{float(value):.8g}")
    return [
        f"[materials.{material}] {key} = {written(table[key], 1000)}"
        for material, table in tables.items() for key in ("density", "bulk", "band") if key in table
    ]  # fmt: skip


def table(fit: SpecimenFit, truth: dict | None = None) -> dict:
    """All numbers of a fit, for JSON; what is not finite as null."""
    end, problem = fit.end, fit.problem
    values = lambda theta: {k: float(v) for k, v in problem.parameters.values(theta).items()}
    return {
        "parameters": fit.values, "start": values(fit.start), "truth": truth,
        "loss": end.loss, "converged": end.converged, "steps": end.steps, "rejected_steps": end.rejected,
        "scene_lines": toml_lines(fit), "jacobian": problem.jacobian,
        "runs": problem.runs, "tangents": problem.tangents, "seconds": fit.seconds,
        "starts": [
            {"start": values(start), "end": values(one.theta), "loss": finite([one.loss])[0], "steps": one.steps,
             "rejected_steps": one.rejected, "converged": one.converged}
            for start, one in fit.all
        ],
        "specimens": [
            {"scene": one.name, "overrides": one.overrides, "displacement": list(one.at), "measured": list(one.load),
             "scale": list(one.scale), "fitted": list(_model(one, curve))}
            for one, curve in zip(problem.specimens, fit.curves, strict=True)
        ],
    } | known(fit).table()  # fmt: skip


def write(fit: SpecimenFit, directory, truth: dict | None = None) -> str:
    """Write fit.json and a picture of each specimen into a folder; returns a line that says so."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "fit.json").write_text(json.dumps(table(fit, truth), indent=1) + "\n")
    names = [draw(fit, k, directory).name for k in range(len(fit.problem.specimens))]
    return f"written to {directory}: fit.json {' '.join(names)}"


def draw(fit: SpecimenFit, which: int, directory: Path) -> Path:
    """Measured curve, fitted curve and residuals of one specimen."""
    one, curve = fit.problem.specimens[which], fit.curves[which]
    free = ", ".join(f"{name} = {fit.values[name]:.4g}" for name in fit.problem.parameters.names)
    displacement, many = one.run.scene.response.displacement, len(fit.curves) > 1
    labels = (f"{displacement} [mm]", "load [N]", "residual [N]")
    line = np.maximum.accumulate(curve[0]), curve[1]
    until = int(np.searchsorted(line[0], one.at[-1])) + 1
    path = directory / (f"fit_{which + 1}_{one.name}.png" if many else "fit.png")
    return plot_fit(
        path, (one.at, one.load), _model(one, curve), labels, f"{one.name}: {free}",
        tuple(part[:until] for part in line), one.half,
    )  # fmt: skip
