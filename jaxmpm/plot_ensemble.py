"""Pictures of ensembles: all curves with their mean and scatter, and statistics of the peak against what was varied."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmpm import plot_style
from jaxmpm.ensemble_statistics import HIGH, LOW, common_axis, with_scatter
from jaxmpm.plot import load_scale, label, response
from jaxmpm.plot_style import ACCENT, FAINT, INK, styled_figure, title
from jaxmpm.results import read_summary, read_units

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MANY = 20  # samples from which on quantiles say more than a standard deviation
SAMPLE, SHADE = "#9fb3c8", "#d6e0ea"  # one curve, and the band of scatter


def plot_ensemble(directory: str | os.PathLike, path: str | os.PathLike | None = None) -> Path:
    """Draw the curves of all completed samples, their mean, scatter and peaks; returns the picture's path.

    `directory`: of an ensemble with at least one completed sample; `path`: of the picture (.png, .pdf,
    .svg), ensemble.png in the directory if None. Raises ResultError where a sample's results are missing.
    """
    directory = Path(directory)
    found = json.loads((directory / "ensemble.json").read_text())
    at = [directory / f"seed_{seed:04d}" for seed in found["seeds"]]
    at = [one for one in at if (one / "summary.json").exists() and read_summary(one)["status"] == "completed"]
    curves = [response(one, read_summary(one))[::-1] for one in at]
    names, units = found["response"], read_units(at[0] / "history.csv")
    factor, load_unit = load_scale(np.concatenate([load for _, load in curves]), units[names["load"]])

    with styled_figure() as figure:
        figure.set_size_inches(6.4, 4.4)
        axes = figure.add_axes((0.11, 0.12, 0.86, 0.78))
        _draw_curves(axes, [(x, load * factor) for x, load in curves])
        _draw_peaks(axes, found["numbers"], [read_summary(one) for one in at], factor, load_unit)
        axes.set_xlabel(label(names["displacement"], units[names["displacement"]]))
        axes.set_ylabel(label(names["load"], load_unit))
        _tidy(axes)
        axes.margins(x=0.02, y=0.08)
        axes.ticklabel_format(axis="x", scilimits=(-3, 4), useMathText=True)
        axes.legend(loc="upper right", frameon=False)
        title(axes, found, [_about(found)])
        return plot_style.save(figure, Path(path or directory / "ensemble.png"))


def _about(found: dict) -> str:
    count = found["completed"]
    text = f"{count} sample{'s' if count > 1 else ''}"
    return text + (f", {len(found['failed'])} failed" if found["failed"] else "")


def _draw_curves(axes: Axes, curves: list) -> None:
    """Every curve thin, the scatter as a band behind them, the mean bold."""
    thin = np.interp(len(curves), (5, 60), (0.8, 0.35))
    for k, (x, load) in enumerate(curves):
        axes.plot(x, load, color=SAMPLE, lw=thin, zorder=2, label=None if k else "samples")
    axis, loads = common_axis(curves)
    mean = loads.mean(axis=0)
    if len(curves) >= MANY:
        low, high, what = *np.percentile(loads, (LOW, HIGH), axis=0), f"{LOW}–{HIGH} % of the samples"
    else:
        std = loads.std(axis=0, ddof=1) if len(curves) > 1 else 0.0
        low, high, what = mean - std, mean + std, "mean ± standard deviation"
    if len(curves) > 1:
        axes.fill_between(axis, low, high, color=SHADE, lw=0, zorder=1, label=what)
        axes.plot(axis, mean, color=INK, lw=2.0, zorder=3, label="mean")


def _draw_peaks(axes: Axes, numbers: dict, summaries: list[dict], factor: float, unit: str) -> None:
    """A dot at the peak of every sample, and their mean with its standard deviations, named."""
    peak, place = (numbers[name] for name in ("peak_load", "displacement_at_peak"))
    points = np.array([(s["displacement_at_peak"], s["peak_load"] * factor) for s in summaries])
    axes.plot(*points.T, ".", color=ACCENT, ms=3, alpha=0.6, zorder=4, mew=0)
    x, y = place["mean"], peak["mean"] * factor
    if peak["std"] is None:
        return
    bars = {"xerr": place["std"], "yerr": peak["std"] * factor}
    text = f"peak {with_scatter(y, bars['yerr'])} {unit} (CoV {100 * (peak['cov'] or 0):.2g} %)"
    axes.errorbar(x, y, **bars, color=ACCENT, lw=1.3, capsize=2.5, fmt="o", ms=4, zorder=5, label=text)


def plot_sizes(
    key: str, values: list, ensembles: list[dict], peaks: list[list[float]], path: str | os.PathLike
) -> Path:
    """Draw the peak of each ensemble against the value that was varied; returns the picture's path.

    `key`: what was varied; `values`: numbers, or words, which are spaced evenly; `ensembles`: what
    ensemble.json says of each; `peaks`: of the completed samples of each; `path`: of the picture.
    """
    numeric = all(isinstance(value, float | int) for value in values)
    x = np.array(values if numeric else range(len(values)), float)
    found = [one["numbers"].get("peak_load") for one in ensembles]
    there = [k for k, one in enumerate(found) if one]
    factor, unit = load_scale(np.array([found[k]["mean"] for k in there]), found[there[0]]["unit"])
    with styled_figure() as figure:
        figure.set_size_inches(7.2, 3.3)
        left, right = (figure.add_axes((start, 0.15, 0.385, 0.72)) for start in (0.08, 0.58))
        _draw_means(left, x[there], [found[k] for k in there], [peaks[k] for k in there], factor)
        left.set_ylabel(f"peak, mean ± standard deviation [{unit}]")
        _draw_variation(right, x[there], [found[k] for k in there])
        right.set_ylabel("coefficient of variation ± its error [%]")
        for axes in (left, right):
            _tidy(axes)
            axes.margins(x=0.1)
            axes.set_xlabel(label(key.rpartition(".")[2], ""))
            axes.set_xticks(x, [f"{value:g}" if numeric else value for value in values])
        whole = figure.add_axes((0.08, 0.15, 0.885, 0.72))
        whole.set_axis_off()
        title(whole, {"title": ensembles[0]["title"]}, [_counts([len(one) for one in peaks])])
        return plot_style.save(figure, Path(path))


def _counts(counts: list[int]) -> str:
    low, high = min(counts), max(counts)
    return f"{high} samples each" if low == high else f"{low} to {high} samples each"


def _draw_means(axes: Axes, x: np.ndarray, found: list[dict], peaks: list[list[float]], factor: float) -> None:
    """Means with their standard deviations, the samples as dots beside them."""
    mean, std = (factor * np.array([one[name] or 0.0 for one in found]) for name in ("mean", "std"))
    beside = 0.03 * (np.ptp(x) or 1.0)
    for place, each in zip(x, peaks, strict=True):
        axes.plot(np.full(len(each), place + beside), factor * np.array(each), ".", color=SAMPLE, ms=6, mew=0)
    axes.errorbar(x, mean, std, color=INK, lw=1.6, capsize=3, fmt="o-", ms=4)


def _draw_variation(axes: Axes, x: np.ndarray, found: list[dict]) -> None:
    """Coefficients of variation v with their standard error v √((1/2 + v²)/n), of normally distributed samples."""
    v, n = (np.array([one[name] or 0.0 for one in found]) for name in ("cov", "count"))
    axes.errorbar(x, 100 * v, 100 * v * np.sqrt((0.5 + v**2) / n), color=ACCENT, lw=1.6, capsize=3, fmt="o-", ms=4)
    axes.set_ylim(bottom=0.0)


def _tidy(axes: Axes) -> None:
    axes.grid(color=FAINT, alpha=0.3, lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
