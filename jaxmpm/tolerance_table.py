"""Whether tolerances hold and what they save: `python -m jaxmpm.tolerance_table den beam …` prints the table.

Of each scene the finest cells are run as the scene says, then `jaxmpm run SCENE --tolerance` for each share; errors are
those against the former, work counted up to where that one has fallen to half its peak. What has been run is kept, so
that a table can be gone on with, and its parts made side by side.
"""

import argparse
import sys
from pathlib import Path

from jaxmpm.chart.front import percent, seconds
from jaxmpm.chart.measure import run_seconds
from jaxmpm.chart.outcome import fallen, outcome_of
from jaxmpm.chart.reference import numbers_of
from jaxmpm.chart.settings import Source, apply
from jaxmpm.cli_chart import share_of
from jaxmpm.errors import ResultError, RunError, SceneError
from jaxmpm.restart import changed
from jaxmpm.results import read_summary
from jaxmpm.run import run_scene
from jaxmpm.tolerance import HALF, Asked, run_within

SHARES = (0.01, 0.02, 0.05)
HEAD = ("scene", "tolerance", "chosen", "peak off by", "work off by", "quick runs and run, s", "finest cells, s", "times as fast")


def run_finest(source: Source, cell: float, directory: Path) -> dict:
    """The run that errors are relative to, on cells of a size (mm) and all else as the scene says; returns its summary.

    Raises ResultError where the one that is kept there is of another scene.
    """
    scene, kept = apply(source, {"cell": cell}), _kept(directory)
    if kept is None:
        return run_scene(scene, directory, progress=False)
    if other := changed(directory, scene):
        raise ResultError(f"{directory}: the run there is of another scene ({other}); name another folder with --out")
    return kept


def run_tolerance(source: Source, cell: float, share: float, directory: Path) -> dict:
    """`jaxmpm run --tolerance` of peak and work, against cells of a size, mm; returns its summary."""
    return _kept(directory) or run_within(source, Asked(share, finest=cell), directory, progress=False)


def rows(finest: Path, chosen: list[Path]) -> list[dict]:
    """What became of tolerances, from the directories of the runs: a row each.

    `errors`: of peak and work, relative; `seconds`: of quick runs and run together, without compilation; `finest`: of the
    run on the finest cells; `asked`, `setting`: as the run says.
    """
    reference = outcome_of(finest, read_summary(finest))
    until, slow = fallen(reference), run_seconds(read_summary(finest))
    known, found = numbers_of(reference, until), []
    for directory in chosen:
        summary = read_summary(directory)
        said, numbers = summary["tolerance"], numbers_of(outcome_of(directory, summary), until)
        errors = {name: abs(numbers[name] / value - 1) for name, value in known.items()}
        found.append({
            "scene": summary["scene"], "asked": said["asked"], "setting": said["setting"], "errors": errors,
            "seconds": said["seconds_in_all"], "finest": slow,
        })  # fmt: skip
    return found


def table(found: list[dict]) -> list[str]:
    """The rows as lines of Markdown."""
    lines = ["| " + " | ".join(HEAD) + " |", "|---" * len(HEAD) + "|"]
    for row in found:
        cells = [row["scene"], f"{100 * row['asked']:g} %", row["setting"], *map(percent, row["errors"].values())]
        cells += [seconds(row[name]).removesuffix(" s") for name in ("seconds", "finest")]
        lines.append("| " + " | ".join([*cells, f"{row['finest'] / row['seconds']:.1f}"]) + " |")
    return lines


def _kept(directory: Path) -> dict | None:
    """The summary of a run that has come to its end in a directory."""
    if not (directory / "summary.json").exists():
        return None
    summary = read_summary(directory)
    return summary if summary["status"] == "completed" else None


def main(arguments: list[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m jaxmpm.tolerance_table", description=__doc__.splitlines()[0])
    parser.add_argument("scenes", metavar="SCENE", nargs="+", help="bundled names or TOML files with a response")
    parser.add_argument("--finest", type=float, metavar="MM", help="the cells that errors are relative to (default: half each scene's)")
    parser.add_argument("--shares", nargs="+", metavar="SHARE", help="tolerances to ask for, 2%% or 0.02 (default: 1%%, 2%% and 5%%)")
    parser.add_argument("--only", choices=("finest", "tolerances"), help="make these runs and no table yet")
    parser.add_argument("--out", type=Path, default=Path("results/tolerances"), metavar="DIR", help="where to write (default: results/tolerances)")
    options = parser.parse_args(arguments)
    found = []
    try:
        shares = [share_of("--shares", text) for text in options.shares] if options.shares else SHARES
        for name in options.scenes:
            source = Source(name)
            scene = source.scene()
            cell = HALF * scene.grid.cell if options.finest is None else options.finest
            finest, *chosen = (options.out / f"{scene.name}_{cell:.4g}_{part}" for part in ("finest", *(f"{100 * share:g}" for share in shares)))
            if options.only != "tolerances":
                run_finest(source, cell, finest)
            if options.only != "finest":
                for share, directory in zip(shares, chosen, strict=True):
                    run_tolerance(source, cell, share, directory)
            found += [] if options.only else rows(finest, chosen)
    except (SceneError, RunError, ResultError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; runs that came to their end are kept", file=sys.stderr)
        return 130
    print(*(table(found) if found else []), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
