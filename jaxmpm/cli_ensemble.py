"""`jaxmpm run SCENE --samples N`: ensembles on the command line."""

import re
from pathlib import Path

MOST = 9999  # samples: as many as seed_0001 … has digits


def add_options(run) -> None:
    """Add the options of an ensemble to the parser of `jaxmpm run`."""
    group = run.add_argument_group("an ensemble: the scene for many seeds")
    group.add_argument("--samples", type=int, metavar="N", help="run N samples, each with a seed of its own")
    group.add_argument("--seed", type=int, metavar="FIRST", help="seed of the first (default: 1)")
    group.add_argument("--jobs", type=int, metavar="J", help="samples at a time, in processes of their own (default: 1)")
    group.add_argument(
        "--vary", metavar="KEY=V1,V2,…", help="an ensemble for each value, e.g. parameters.side=12.5,25,50"
    )


def wanted(options) -> bool:
    """Whether an ensemble is asked for; raises ResultError for its options without --samples."""
    from jaxmpm.results import ResultError

    if options.samples is not None:
        return True
    for name in ("seed", "jobs", "vary"):
        if (value := getattr(options, name)) is not None:
            raise ResultError(f"--{name} = {value}: expected only with --samples")
    return False


def run(options, folder, keep_compiled) -> int:
    """Run what the options ask for; returns 0, or raises RunError where samples failed."""
    from jaxmpm.errors import RunError
    from jaxmpm.scene import load_scene

    seeds = _seeds(options)
    key, values = _varied(options.vary) if options.vary is not None else ("", [])
    scenes = {
        value: load_scene(options.scene, [*options.overrides, *([f"{key}={value}"] if key else [])])
        for value in values or [""]
    }
    directory = folder("--out", options.out or Path("results") / next(iter(scenes.values())).name)
    from jaxmpm.ensemble import run_ensemble
    from jaxmpm.ensemble_sizes import run_sizes

    keep_compiled()
    about = {"resume": options.resume, "jobs": options.jobs or 1, "progress": not options.quiet, "pictures": options.format}
    if key:
        found = run_sizes(key, scenes, seeds, directory, **about)
    else:
        found = {"": run_ensemble(scenes[""], seeds, directory, **about)}
    if not options.quiet:
        for value, one in found.items():
            print((f"{key} = {value}: " if key else "") + report(one))
        print(f"written to {directory}: " + (f"sizes.csv sizes.{options.format} and " if key else "") + f"ensemble.csv ensemble.json ensemble.{options.format}")
    if bad := [text for value, one in found.items() for text in _bad(value, one)]:
        raise RunError(f"{len(bad)} of {len(seeds) * len(found)} samples did not complete: {', '.join(bad)} (why: ensemble.csv)")
    return 0


def report(found: dict) -> str:
    """The peak and the homogenised numbers of an ensemble, a line each."""
    from jaxmpm.ensemble_statistics import with_scatter

    numbers = dict(found["numbers"])
    if "strength" in numbers and numbers["strength"]["mean"] == abs(numbers["peak_load"]["mean"]):
        del numbers["peak_load"], numbers["displacement_at_peak"]  # of a mean stress over its strain: the same
    lines = [f"{found['completed']} of {len(found['seeds'])} samples completed"]
    for name, one in numbers.items():
        text = f"{with_scatter(one['mean'], one['std'])} {one['unit']}".rstrip()
        share = "" if one["cov"] is None else f"{one['cov']:7.1%}  {one['q05']:.4g} to {one['q95']:.4g}"
        lines.append(f"  {name.replace('_', ' '):21} {text:27} {share}".rstrip())
    if len(lines) > 1 and found["completed"] > 1:
        lines[0] += "; mean ± standard deviation, coefficient of variation, 5 to 95 %:"
    return "\n".join(lines)


def _bad(value: str, found: dict) -> list[str]:
    """The samples that did not complete, for a message."""
    seeds = sorted([*map(int, found["failed"]), *found["unfinished"]])
    return [f"seed {seed}" + (f" of {value}" if value else "") for seed in seeds]


def _seeds(options) -> range:
    """The seeds; raises ResultError for numbers that cannot be."""
    from jaxmpm.results import ResultError

    first = 1 if options.seed is None else options.seed
    for name, value, low in (("samples", options.samples, 1), ("seed", first, 0), ("jobs", options.jobs, 1)):
        if value is not None and not low <= value <= MOST:
            raise ResultError(f"--{name} = {value}: expected a whole number from {low} to {MOST}")
    return range(first, first + options.samples)


def _varied(text: str) -> tuple[str, list[str]]:
    """The key and the values of --vary; raises ResultError where they are not what they should be."""
    from jaxmpm.ensemble_sizes import number_of
    from jaxmpm.results import ResultError

    key, equals, listed = text.partition("=")
    key, values = key.strip(), [value.strip() for value in listed.split(",")]
    if not equals or not key or not all(re.fullmatch(r"[\w.+-]+", value) for value in values):
        raise ResultError(f"--vary = {text}: expected KEY=V1,V2,… with numbers or plain words (as in parameters.side=12.5,25)")
    if len(set(map(number_of, values))) < len(values):
        raise ResultError(f"--vary = {text}: expected values that differ")
    if key.endswith(".seed"):
        raise ResultError(f"--vary = {text}: expected another key, seeds are what --samples and --seed give")
    return key, values
