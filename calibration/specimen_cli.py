"""`jaxmpm calibrate specimen`: options in, words, files and pictures out."""

import math
import tomllib
from pathlib import Path

from calibration.options import count, named, positive, weight
from jaxmpm.errors import SceneError, did_you_mean

KEYS = {"scene", "set", "data", "window", "smooth"}  # of a specimen in a file of specimens


def add(what):
    """The options, to the parser of `jaxmpm calibrate`."""
    part = what.add_parser(
        "specimen", help="materials of whole simulations from load-displacement curves", allow_abbrev=False
    )
    part.add_argument("scene", nargs="?", metavar="SCENE", help="a bundled name or a TOML file")
    part.add_argument(
        "--free", action="append", default=[], metavar="NAME",
        help="a parameter to find: MATERIAL.LEAF as in concrete.ft; of the damage law GF and slope_factor too",
    )  # fmt: skip
    for name, text in (("start", "where to start (default: the scene's)"), ("fix", "a parameter that is known")):
        part.add_argument(f"--{name}", action="append", default=[], metavar="NAME=VALUE", help=text)
    part.add_argument("--bounds", action="append", default=[], metavar="NAME=LOW:HIGH", help="of a free parameter")
    part.add_argument("--data", metavar="FILE", help="CSV of the measured curve (default: the scene's reference)")
    part.add_argument(
        "--window", type=float, nargs=2, metavar="MM", default=(-math.inf, math.inf),
        help="displacements between which the curve is fitted",
    )  # fmt: skip
    part.add_argument(
        "--smooth", type=weight, default=0.0, metavar="S",
        help="time over which simulated curves are averaged, a period or two of what vibrates",
    )  # fmt: skip
    part.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides", help="change the scene")
    part.add_argument("--specimens", metavar="FILE", help="several, tables [[specimens]] of a TOML file")
    part.add_argument("--work", type=weight, default=0.0, metavar="W", help="weight of the area under the curve")
    part.add_argument("--method", choices=("gauss_newton", "adam"), default="gauss_newton", help="default: gauss_newton")
    part.add_argument(
        "--jacobian", choices=("secant", "tangent"), default="secant",
        help="at the end: secants over 2 %% each way (default), or the tangents of the runs",
    )  # fmt: skip
    part.add_argument("--steps", type=count, default=20, metavar="N", help="at most (default: 20)")
    part.add_argument("--starts", type=count, default=1, metavar="K", help="the given one and others, 50 %% about it")
    part.add_argument("--twin", type=positive, metavar="NOISE", help="fit the start's own curve, with noise (0.02) on it")
    part.add_argument("--seed", type=int, default=0, help="of starts and noise")
    part.add_argument("--out", metavar="DIR", help="write fit.json and pictures")
    part.add_argument("--quiet", action="store_true", help="no progress")
    part.set_defaults(command=command)
    return part


def command(options) -> int:
    """Do what the options ask for; raises SceneError for bad input."""
    if (options.scene is None) == (options.specimens is None):
        raise SceneError("calibrate specimen: expected SCENE or --specimens FILE.toml, one of them")
    if not options.free:
        raise SceneError("--free: absent, expected a parameter to find such as --free concrete.ft")
    if options.twin and options.data:
        raise SceneError(f"--twin = {options.twin:g}: expected without --data")
    start, fix = (named(pairs, f"--{name}", "NAME=VALUE such as concrete.ft=3") for name, pairs in (("start", options.start), ("fix", options.fix)))
    bounds, several = _bounds(options.bounds), _several(options)
    from calibration import leaves, specimen, specimen_fit, specimen_report
    from jaxmpm.compilation import keep_compiled

    keep_compiled()
    specimens = [specimen.Specimen.of(specimen.Source(**one), bool(options.twin)) for one in several]
    parameters = leaves.parameters([one.run for one in specimens], options.free, start, fix, bounds)
    problem = specimen_fit.Problem(specimens, parameters, options.work, options.jacobian)
    specimen_fit.check_reach(problem)
    truth = {name: one.start for name, one in parameters.free.items()} if options.twin else None
    problem = specimen_fit.twin_of(problem, options.twin, seed=options.seed) if truth else problem
    show = None if options.quiet else lambda line: print(line, flush=True)
    starts = leaves.about(parameters, options.starts, options.seed, with_start=not truth)
    fit = specimen_fit.fit_specimens(problem, starts, options.method, options.steps, show)
    print(specimen_report.words(fit, truth))
    if options.out:
        print(specimen_report.write(fit, options.out, truth))
    return 0


def _several(options) -> list[dict]:
    """What each specimen is made of."""
    if options.specimens is None:
        return [_one(options.scene, options.overrides, options.data, options.window, options.smooth)]
    path = Path(options.specimens)
    try:
        tree = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SceneError(f"--specimens = {path}: expected a TOML file ({error})") from None
    tables = tree.get("specimens")
    if not isinstance(tables, list) or not tables or not all(isinstance(one, dict) for one in tables):
        raise SceneError(f"{path}: specimens: expected tables [[specimens]] with scene, set, data, window, smooth")
    return [_table(path, k, one, options) for k, one in enumerate(tables)]


def _table(path, k, one, options):
    for key in one:
        if key not in KEYS:
            hint = did_you_mean(key, KEYS) or ", ".join(sorted(KEYS))
            raise SceneError(f"{path}: specimens.{k}.{key}: unknown, expected {hint}")
    beside = lambda name: str(path.parent / name) if (path.parent / name).is_file() else name
    if not isinstance(one.get("scene"), str):
        raise SceneError(f"{path}: specimens.{k}.scene = {one.get('scene')}: expected a scene")
    data, window = one.get("data"), one.get("window", (-math.inf, math.inf))
    if not (data is None or isinstance(data, str)):
        raise SceneError(f"{path}: specimens.{k}.data = {data}: expected a CSV file")
    numbers = isinstance(window, list | tuple) and len(window) == 2 and all(isinstance(x, int | float) for x in window)
    if not numbers:
        raise SceneError(f"{path}: specimens.{k}.window = {window}: expected two displacements, mm")
    overrides, smooth = [*one.get("set", []), *options.overrides], one.get("smooth", options.smooth)
    if not (isinstance(smooth, int | float) and 0 <= smooth < math.inf):
        raise SceneError(f"{path}: specimens.{k}.smooth = {smooth}: expected a time, s")
    return _one(beside(one["scene"]), overrides, beside(data) if data else None, window, smooth)


def _one(scene, overrides, data, window, smooth):
    low, high = window
    if not low < high:
        raise SceneError(f"window = {low:g} {high:g}: expected two displacements, mm, the lower one first")
    return {"scene": scene, "overrides": tuple(overrides), "data": data, "window": (low, high), "smooth": smooth}


def _bounds(pairs) -> dict[str, tuple[float, float]]:
    found = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        try:
            low, high = map(float, text.split(":"))
        except ValueError:
            low, high = math.nan, math.nan
        if not 0 <= low < high < math.inf:
            raise SceneError(f"--bounds {pair}: expected NAME=LOW:HIGH such as concrete.ft=2:5")
        found[name] = low, high
    return found
