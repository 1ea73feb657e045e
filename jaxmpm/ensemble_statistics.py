"""Statistics of an ensemble: of each number of its samples, and of their curves on a common axis. NumPy only."""

import numpy as np

from jaxmpm.homogenise import UNITS

LOW, HIGH = 5, 95  # per cent: the quantiles
AXIS = 400  # places of the common axis
OF_RUN = ("energy_error", "kinetic_share_at_peak")


def numbers_of(summary: dict) -> dict[str, float]:
    """The numbers by which samples are compared, of one summary: peak and homogenised ones, as far as it has them."""
    found = {name: summary.get(name) for name in ("peak_load", "displacement_at_peak")}
    found |= {name: value for name, value in summary.get("homogenised", {}).items() if name != "component"}
    return {name: value for name, value in found.items() if value is not None}


def units_of(summary: dict) -> dict[str, str]:
    """Units of those numbers."""
    given = {"peak_load": summary.get("load_unit", ""), "displacement_at_peak": summary.get("displacement_unit", "")}
    return UNITS | given


def spread(values) -> dict[str, float | int | None]:
    """Statistics of one number over (n,) samples, n ≥ 1.

    `count`, `mean`, `std` (of a sample, n − 1), `cov` = std/|mean|, `standard_error` = std/√n, and the 5 %
    and 95 % quantiles `q05` and `q95` (linear between samples). Of one sample std and what follows are None.
    """
    values = np.asarray(values, float)
    mean, n = float(values.mean()), len(values)
    std = float(values.std(ddof=1)) if n > 1 else None
    low, high = (float(q) for q in np.percentile(values, (LOW, HIGH)))
    return {
        "count": n, "mean": mean, "std": std, "cov": std / abs(mean) if std is not None and mean else None,
        "standard_error": std and std / n**0.5, "q05": low, "q95": high,
    }  # fmt: skip


def with_scatter(mean: float, std: float | None) -> str:
    """A mean and its standard deviation as they are printed, to two digits of the second: 1.510 ± 0.074."""
    if not std:
        return f"{mean:.5g}"
    power = int(np.floor(np.log10(max(abs(mean), std))))
    power = 0 if -4 < power < 6 else power
    mean, std = mean / 10.0**power, std / 10.0**power
    digits = max(0, 1 - int(np.floor(np.log10(std))))
    text = f"{mean:.{digits}f} ± {std:.{digits}f}"
    return f"({text})e{power}" if power else text


def statistics(summaries: dict[int, dict]) -> dict:
    """What ensemble.json says of the samples, their summaries by seed; see `ensemble.run_ensemble`.

    Numbers are those of completed samples; a sample that lacks one is not counted in it.
    """
    completed = [summary for summary in summaries.values() if summary["status"] == "completed"]
    failed = {seed: s["status"] for seed, s in summaries.items() if s["status"].startswith(("stopped", "refused", "failed"))}
    unfinished = [seed for seed, s in summaries.items() if s["status"] in ("unfinished", "interrupted")]
    first = completed[0] if completed else {}
    values: dict[str, list[float]] = {}
    for summary in completed:
        for name, value in numbers_of(summary).items():
            values.setdefault(name, []).append(value)
    units = units_of(first)
    return {
        "seeds": list(summaries), "completed": len(completed), "failed": failed, "unfinished": unfinished,
        "response": first.get("response"), "component": first.get("homogenised", {}).get("component"),
        "numbers": {name: {"unit": units[name]} | spread(found) for name, found in values.items()},
    }  # fmt: skip


def table_of(summaries: dict[int, dict]) -> tuple[list[str], list[list]]:
    """Header and rows of ensemble.csv: seed, status, numbers with their units, wall time; "" for what a sample lacks."""
    numbers = {seed: numbers_of(summary) for seed, summary in summaries.items()}
    names = list(dict.fromkeys(name for found in numbers.values() for name in found))
    more = [name for name in OF_RUN if any(name in summary for summary in summaries.values())]
    units = units_of(next((s for s in summaries.values() if "load_unit" in s), {}))
    header = ["seed", "status", *(f"{n} [{units[n]}]" if units[n] else n for n in names), *more, "wall_seconds [s]"]
    rows = [
        [seed, summary["status"], *(numbers[seed].get(name, "") for name in names),
         *(summary.get(name, "") for name in (*more, "wall_seconds"))]
        for seed, summary in summaries.items()
    ]  # fmt: skip
    return header, rows


def common_axis(curves: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Curves, each displacements and loads (rows,), on one axis of displacement.

    Returns the axis (AXIS,), from where all have begun to where the first ends and dense where the samples
    are, and the loads on it (curves, AXIS), straight between samples. Where a displacement goes back the
    curve is passed over until it is larger again.
    """
    ahead = [onward(*curve) for curve in curves]
    low, high = max(x[0] for x, _ in ahead), min(x[-1] for x, _ in ahead)
    places = np.concatenate([[low, high], *(x[(x > low) & (x < high)] for x, _ in ahead)])
    axis = np.quantile(places, np.linspace(0.0, 1.0, AXIS))
    sign = np.sign(sum(x[np.abs(x).argmax()] for x, _ in curves)) or 1.0
    return sign * axis, np.stack([np.interp(axis, *curve) for curve in ahead])


def onward(displacement: np.ndarray, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rows at which the displacement, along the way that it goes, is larger than ever before."""
    along = displacement * (np.sign(displacement[np.abs(displacement).argmax()]) or 1.0)
    new = np.concatenate([[True], along[1:] > np.maximum.accumulate(along)[:-1]])
    return along[new], load[new]
