"""A fitted softening curve in words, as JSON and as a picture."""

import json
from pathlib import Path

from calibration.curve import UNITS, CurveFit
from calibration.plots import plot_fit


def words(fit: CurveFit) -> str:
    """The result in a few lines."""
    known = fit.uncertainty
    lines = [f"{fit.law} fitted to {fit.data.name}, {len(fit.data.w)} points, {_ended(fit)}"]
    for name, deviation in zip(known.names, known.deviation, strict=True):
        lines.append(f"{name:3} = {fit.values[name]:.6g} +- {deviation:.2g} {UNITS[name]}".rstrip())
    lines += [
        f"{name:3} = {fit.values[name]:.6g} {UNITS[name]} fixed".replace("  ", " ")
        for name in fit.fixed
    ]
    follow = [
        name for name in UNITS if name in fit.values and name not in (*known.names, *fit.fixed)
    ]
    lines += [f"{name:3} = {fit.values[name]:.6g} {UNITS[name]} follows" for name in follow]
    lines.append(f"{100 * max(fit.beyond, 0.0):.1f} % of GF lies beyond the last point")
    strength = fit.values["ft"]
    lines.append(f"residual {fit.rms:.3g} MPa rms, {100 * fit.rms / strength:.2g} % of ft")
    return "\n".join([*lines, *known.correlations(), *known.warned(), toml_line(fit)])


def toml_line(fit: CurveFit) -> str:
    """The band as a line of a scene."""
    v = fit.values
    start = (
        f'band = {{ law = "{"damage" if fit.law == "damage" else "cohesive"}", ft = {v["ft"]:.8g}'
    )
    if fit.law == "damage":
        return f"{start}, Ep = {v['Ep']:.8g}, n = {v['n']:.8g}, h = {v['h']:g} }}"
    return f'{start}, GF = {v["GF"]:.8g}, curve = "{fit.law}", h = 0.01 }}'


def write(fit: CurveFit, directory) -> str:
    """Write fit.json and fit.png into a folder; returns a line that says so."""
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "fit.json").write_text(json.dumps(table(fit), indent=1) + "\n")
    draw(fit, directory / "fit.png")
    return f"written to {directory}: fit.json fit.png"


def table(fit: CurveFit) -> dict:
    """All numbers of a fit, for JSON; what is not finite as null."""
    return {
        "law": fit.law, "data": fit.data.name, "points": len(fit.data.w), "parameters": fit.values,
        "fixed": fit.fixed, "energy_beyond_data": fit.beyond, "residual_norm": fit.residual_norm, "rms": fit.rms,
        "converged": fit.converged, "steps": fit.steps, "rejected_steps": fit.rejected,
    } | fit.uncertainty.table()  # fmt: skip


def draw(fit: CurveFit, path) -> Path:
    """Data, fitted curve and residuals."""
    free = ", ".join(f"{name} = {fit.values[name]:.4g}" for name in fit.uncertainty.names)
    labels = ("opening w [mm]", "stress [MPa]", "residual [MPa]")
    title = f"{fit.law} fitted to {fit.data.name}: {free}"
    return plot_fit(path, (fit.data.w, fit.data.sigma), fit.model, labels, title, fit.line)


def _ended(fit):
    return (
        f"converged in {fit.steps} steps"
        if fit.converged
        else f"NOT converged in {fit.steps} steps"
    )
