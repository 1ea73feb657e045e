"""Pictures: a fit with its residuals below, and a softening curve with what it obeys."""

from pathlib import Path

import numpy as np

from jaxmpm import plot_style
from jaxmpm.plot_style import ACCENT, FAINT, INK, styled_figure


def plot_fit(path, measured, model, labels, title="", smooth=None, half=None) -> Path:
    """Data and model over the same abscissa, and below them model minus data.

    Args:
        path: where to save; its end says how.
        measured: (x (m,), y (m,)).
        model: y (m,) of the model.
        labels: of x, y and the residual.
        title: above it.
        smooth: (x, y) of the model drawn as a line, else through its points.
        half: (m,) half the width of a band that the data are the middle of.
    """
    x, y = (np.asarray(values) for values in measured)
    order = np.argsort(x)
    line = smooth or (x[order], np.asarray(model)[order])
    with styled_figure() as figure:
        figure.set_size_inches(6.0, 4.8)
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        figure.subplots_adjust(hspace=0.08)
        if half is not None:
            for axes, middle in ((above, y), (below, 0.0)):
                axes.fill_between(x, middle - half, middle + half, color=FAINT, alpha=0.3, lw=0)
        above.plot(x, y, "o", ms=4, mfc="none", mec=FAINT, mew=1.1, label="data")
        above.plot(*line, color=INK, lw=1.6, label="fit")
        above.set_ylabel(labels[1])
        above.legend(frameon=False)
        above.set_title(title, loc="left", fontsize=9, fontweight="bold")
        below.axhline(0.0, color=FAINT, lw=0.7)
        below.vlines(x, 0.0, np.asarray(model) - y, color=ACCENT, lw=1.0)
        below.plot(x, np.asarray(model) - y, "o", ms=2.5, color=ACCENT)
        below.set(xlabel=labels[0], ylabel=labels[2])
        for axes in (above, below):
            axes.spines[["top", "right"]].set_visible(False)
        figure.align_ylabels((above, below))
        return plot_style.save(figure, Path(path))


def plot_softening(path, w, stress, ft, GF, slope, title="", point=None) -> Path:
    """A curve σ(w), its area G_F, its initial slope, MPa/mm, and a point (w, σ) that it passes."""
    with styled_figure() as figure:
        figure.set_size_inches(5.6, 3.7)
        axes = figure.add_subplot()
        area = rf"area $G_F$ = {GF:.4g} N/mm"
        axes.fill_between(w, stress, color=INK, alpha=0.08, lw=0, label=area)
        axes.plot(w, stress, color=INK, lw=1.8)
        start = f"initial slope −{-slope:.4g} MPa/mm"
        axes.plot([0.0, -ft / slope], [ft, 0.0], color=ACCENT, lw=1.0, ls=(0, (5, 3)), label=start)
        if point:
            where = f"point {point[0]:.4g} mm, {point[1]:.4g} MPa"
            axes.plot(*point, "o", ms=6, mfc="white", mec=ACCENT, mew=1.4, label=where)
        axes.legend(frameon=False)
        axes.set(
            xlim=(0, w[-1]), ylim=(0, 1.06 * ft), xlabel="opening w [mm]", ylabel="stress [MPa]"
        )
        axes.set_title(title, loc="left", fontsize=10, fontweight="bold")
        axes.spines[["top", "right"]].set_visible(False)
        return plot_style.save(figure, Path(path))
