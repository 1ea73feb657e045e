"""`jaxmpm chart SCENE` and `jaxmpm run SCENE --tolerance 2%` on the command line."""

import re
from pathlib import Path

UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
LONGEST = 7 * 86400.0  # s
CHOICES = ("solver", "speed", "step", "rise", "precision", "frame", "shape", "per_side", "transfer", "size", "window", "law", "half")


def add_command(commands, run) -> None:
    """Add the command `chart`; `run`: what it calls with its options."""
    chart = commands.add_parser(
        "chart", help="speed against accuracy of a scene over its choices, as one picture",
        description="Runs a scene over cell sizes, loading rates, precisions, solvers and rules, times each, and draws error "
        "against time with the best ones named.",
        epilog="example: jaxmpm chart den --budget 10m --out results/den_chart",
    )  # fmt: skip
    chart.add_argument("scene", metavar="SCENE", help="a bundled name (jaxmpm scenes) or a TOML file")
    chart.add_argument("--budget", default="10m", metavar="TIME", help="wall time to spend: 90s, 10m, 1h (default: 10m)")
    chart.add_argument("--out", metavar="DIR", help="where to write (default: results/NAME_chart)")
    chart.add_argument("--resume", action="store_true", help="keep what has been measured in DIR and go on")
    chart.add_argument(
        "--reference", default="auto", metavar="FILE",
        help="what errors are relative to: auto (what finer and finer cells tend to, where they do, else the finest run; "
        "the default), finest, a CSV file as of response.reference, or history.csv of another run",
    )  # fmt: skip
    chart.add_argument(
        "--choices", metavar="A,B,…", help=f"which choices to try besides cells, of {', '.join(CHOICES)} (default: all)"
    )
    chart.add_argument("--to", type=float, metavar="U", help="count the work up to this displacement (default: half the peak is left)")
    chart.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides",
        help="change the scene first, e.g. grid.cell=1.25; may be given again",
    )  # fmt: skip
    chart.add_argument("--quiet", action="store_true", help="no progress")
    chart.set_defaults(command=run)


def chart(options, folder, keep_compiled) -> int:
    """Make a chart; raises ResultError for options that cannot be."""
    from jaxmpm.chart import Source

    budget = seconds_of("--budget", options.budget)
    source = Source(options.scene, tuple(options.overrides))
    directory = folder("--out", options.out or Path("results") / f"{source.scene().name}_chart")
    until, only = _until(options.to), _choices(options.choices)
    from jaxmpm.chart import chart_scene

    keep_compiled()
    found = chart_scene(source, directory, budget, options.resume, options.reference, until, only, progress=not options.quiet)
    if not options.quiet:
        print(report(found, directory))
    return 0


def report(found: dict, directory) -> str:
    """The end of a chart in a few lines."""
    from jaxmpm.chart.front import front, seconds

    lines = [f"{len(found['runs'])} settings in {seconds(found['wall_seconds'])}; on the front:"]
    for number, record in enumerate(front(found["runs"]), 1):
        lines.append(f"{number:3}  {record['label']:44}  {seconds(record['seconds']):>7}  {record['error']:7.2%}")
    return "\n".join([*lines, found["says"], f"written to {directory}: chart.png chart.pdf chart.csv chart.json"])


def seconds_of(option: str, text: str) -> float:
    """Seconds of 90, 90s, 10m or 1.5h; raises ResultError for anything else."""
    from jaxmpm.results import ResultError

    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(s|m|min|h)?", text.strip())
    value = float(match[1]) * UNITS[match[2] or ""] if match else 0.0
    if not 0.0 < value <= LONGEST:
        raise ResultError(f"{option} = {text}: expected a time such as 90s, 10m or 1h, up to a week")
    return value


def _choices(text: str | None) -> tuple[str, ...]:
    """The choices that are named; raises ResultError for a name that is none."""
    from jaxmpm.errors import near_or
    from jaxmpm.results import ResultError

    names = CHOICES if text is None else tuple(name.strip() for name in text.split(","))
    for name in names:
        if name not in CHOICES:
            raise ResultError(f"--choices = {text}: expected names of choices, {name or 'an empty one'} is none ({near_or(name, CHOICES)})")
    return names


def _until(value: float | None) -> float | None:
    from jaxmpm.results import ResultError

    if value is not None and not 0.0 < value < float("inf"):
        raise ResultError(f"--to = {value:g}: expected a displacement above zero, in the unit of the response's")
    return value


# -- run --tolerance ----------------------------------------------------------------------------------

SMALLEST, LARGEST = 1e-4, 0.5  # tolerances
NUMBERS = {"both": ("peak", "work"), "peak": ("peak",), "work": ("work",)}


def add_options(run) -> None:
    """Add the options of a tolerance to the parser of `jaxmpm run`."""
    group = run.add_argument_group("a tolerance: the cheapest setting that is good enough is chosen, and why is said")
    group.add_argument("--tolerance", metavar="SHARE", help="largest error of peak and work, such as 2%%")
    group.add_argument("--of", choices=tuple(NUMBERS), help="what it holds for (default: both)")
    group.add_argument("--finest", type=float, metavar="MM", help="the cells that errors are relative to (default: half the scene's)")
    group.add_argument("--to", type=float, metavar="U", help="count the work up to this displacement (default: half the peak is left)")


def wanted(options) -> bool:
    """Whether a tolerance is asked for; raises ResultError for its options without it, and for what does not go with it."""
    from jaxmpm.results import ResultError

    if options.tolerance is None:
        for name in ("of", "finest", "to"):
            if (value := getattr(options, name)) is not None:
                raise ResultError(f"--{name} = {value}: expected only with --tolerance")
        return False
    if options.samples is not None:
        raise ResultError(f"--samples = {options.samples}: expected without --tolerance; choose a setting by one sample first")
    return True


def run(options, folder, keep_compiled) -> int:
    """Run within a tolerance; raises ResultError for options that cannot be."""
    from jaxmpm.chart import Source

    share = share_of("--tolerance", options.tolerance)
    source = Source(options.scene, tuple(options.overrides))
    directory = folder("--out", options.out or Path("results") / source.scene().name)
    until = _until(options.to)
    from jaxmpm.run_result import report as report_run
    from jaxmpm.tolerance import Asked, report as report_choice, run_within

    keep_compiled()
    asked = Asked(share, NUMBERS[options.of or "both"], options.finest, until)
    summary = run_within(source, asked, directory, options.resume, progress=not options.quiet)
    if not options.quiet:
        print(*report_run(summary, directory), sep="\n")
        print(report_choice(summary))
    return 0


def share_of(option: str, text: str) -> float:
    """A share of 2% or 0.02; raises ResultError for anything else."""
    from jaxmpm.results import ResultError

    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*(%?)", text.strip())
    value = float(match[1]) / (100 if match[2] else 1) if match else 0.0
    if not SMALLEST <= value <= LARGEST:
        raise ResultError(f"{option} = {text}: expected a share such as 2% or 0.02, from {SMALLEST:.2%} to {LARGEST:.0%}")
    return value

