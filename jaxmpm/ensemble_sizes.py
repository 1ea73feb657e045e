"""An ensemble for each of several values of one thing in a scene: how mean and scatter depend on it, on size above all."""

from collections.abc import Sequence
from pathlib import Path

from jaxmpm import results
from jaxmpm.ensemble import read_sample, run_ensemble, with_seed
from jaxmpm.layout import lay_out
from jaxmpm.scene import Scene

STATISTICS = ("count", "mean", "std", "cov", "standard_error", "q05", "q95")


def run_sizes(key: str, scenes: dict[str, Scene], seeds: Sequence[int], directory, **about) -> dict[str, dict]:
    """Run an ensemble for each scene and write what changes from one to the next; returns that of each.

    `key`: of what was varied, as parameters.side; `scenes`: by its value; `seeds`: the same for each;
    `directory`: gets side_12.5/ … as of `run_ensemble`, sizes.csv (a row a value and number) and sizes.png;
    `about`: goes on to `run_ensemble`. Raises what that raises, with both files of what there is.
    """
    directory, found = Path(directory), {}
    for scene in scenes.values():
        lay_out(with_seed(scene, seeds[0]))  # refuses what draws nothing or has no room, before anything runs
    try:
        for value, scene in scenes.items():
            found[value] = run_ensemble(scene, seeds, directory / f"{key.rpartition('.')[2]}_{value}", **about)
    finally:
        write_sizes(key, found, directory, about.get("pictures", "png"))
    return found


def write_sizes(key: str, found: dict[str, dict], directory: Path, pictures: str = "png") -> None:
    """Write sizes.csv and, where a sample has a peak, sizes.png, of what `run_ensemble` returned by value."""
    rows = [
        [value, name, one["unit"], *("" if one[what] is None else one[what] for what in STATISTICS)]
        for value, ensemble in found.items()
        for name, one in ensemble["numbers"].items()
    ]
    if not rows:
        return
    results.write_table(directory / "sizes.csv", [key, "number", "unit", *STATISTICS], rows)
    peaks = [_peaks(directory / f"{key.rpartition('.')[2]}_{value}", one["seeds"]) for value, one in found.items()]
    if any(peaks):
        from jaxmpm.plot_ensemble import plot_sizes

        plot_sizes(key, [number_of(value) for value in found], list(found.values()), peaks, directory / f"sizes.{pictures}")


def _peaks(directory: Path, seeds) -> list[float]:
    """Peaks of the completed samples."""
    summaries = [read_sample(directory, seed) for seed in seeds]
    return [one["peak_load"] for one in summaries if one["status"] == "completed" and "peak_load" in one]


def number_of(value: str) -> float | str:
    """A number where that is what a text is."""
    try:
        return float(value)
    except ValueError:
        return value
