"""How the error of a bar whose points cross cells depends on the number of points in a cell."""

import numpy as np

from jaxmpm.plot_style import ACCENT, FAINT, INK
from jaxmpm.shape_functions import Cubic, Gimp, Linear, Quadratic
from jaxmpm.verify_moving import Bar

FUNCTIONS = {
    "linear": lambda each: Linear(),
    "GIMP": lambda each: Gimp(0.5 / each),
    "quadratic B-spline": lambda each: Quadratic(),
    "cubic B-spline": lambda each: Cubic(),
}
COLOURS = (ACCENT, FAINT, INK, "#5ab4e5")


def particles_per_cell(cells=(16, 64), counts=(1, 2, 3, 4, 6, 8), amplitude=0.05) -> dict:
    """Displacement errors over the amplitude, NaN where the run fails: {cells: {function: one a count}}."""
    bar = Bar(amplitude)
    return {
        n: {name: [error_or_nan(bar, n, make(each), each) / amplitude for each in counts] for name, make in FUNCTIONS.items()}
        for n in cells
    }


def error_or_nan(bar, cells, shape, each) -> float:
    """Displacement error of a bar with so many points a cell; NaN where the run fails."""
    try:
        return bar.error(cells, shape, each=each)
    except RuntimeError:  # points have left the bar
        return float("nan")


def plot_particles_per_cell(path, counts=(1, 2, 3, 4, 6, 8), errors=None) -> None:
    """Draw `particles_per_cell`, one panel a grid; a cross where a run fails."""
    from matplotlib.figure import Figure

    errors = particles_per_cell(counts=counts) if errors is None else errors
    figure = Figure(figsize=(4.6 * len(errors), 4.0), layout="constrained")
    panels = figure.subplots(1, len(errors), sharey=True, squeeze=False)[0]
    every = np.concatenate([np.ravel(list(lines.values())) for lines in errors.values()])
    top = np.nanmax(every) * 3
    for axes, (cells, lines) in zip(panels, errors.items(), strict=True):
        for (name, line), colour, marker in zip(lines.items(), COLOURS, "ovsD", strict=True):
            line = np.array(line)
            axes.plot(counts, line, color=colour, marker=marker, markersize=5, label=name)
            failed = np.array(counts)[~np.isfinite(line)]
            for each in failed:
                axes.plot(each, top / 1.5, "x", color=colour, markersize=8)
                axes.annotate("fails", (each, top / 1.5), (8, -3), textcoords="offset points", color=colour, fontsize=9)
        axes.set_yscale("log")
        axes.set_ylim(np.nanmin(every) / 2, top)
        axes.set_xticks(counts)
        axes.set_xlabel("points per cell")
        axes.set_title(f"{cells} cells", fontsize=11)
        axes.grid(alpha=0.3, which="major")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("displacement error / amplitude")
    panels[0].legend(frameon=False, fontsize=9)
    figure.savefig(path, dpi=150)
