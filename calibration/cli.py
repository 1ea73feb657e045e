"""`jaxmpm calibrate energy | curve | specimen`: options in, words, files and pictures out."""

from pathlib import Path

from calibration import specimen_cli
from calibration.options import named, positive, share, width
from jaxmpm.cli_examples import EXAMPLES
from jaxmpm.cli_parser import Parser
from jaxmpm.errors import SceneError

CONDITIONS = ("initial_slope", "point", "centroid", "modulus")
CURVES = ("linear", "bilinear", "exponential", "hordijk")


def main(arguments=None) -> int:
    """Do what the words after `jaxmpm calibrate` ask for; raises SceneError for bad input."""
    options = make_parser().parse_all(arguments)
    return options.command(options)


def make_parser() -> Parser:
    """The parser of `jaxmpm calibrate`."""
    parser = Parser(
        prog="jaxmpm calibrate",
        description="Parameters of materials from fracture energy, a softening curve or whole tests.",
        allow_abbrev=False,
    )
    what = parser.add_subparsers(title="what", required=True, metavar="WHAT", dest="what")
    for add, command in ((_add_energy, _energy), (_add_curve, _curve)):
        part = add(what)
        part.set_defaults(command=command)
    specimen_cli.add(what)
    parser.show_examples(EXAMPLES["calibrate"])
    for name, part in what.choices.items():
        part.show_examples(EXAMPLES[f"calibrate {name}"])
    return parser


def _add_energy(what):
    part = what.add_parser("energy", help="Ep and n of the damage law from GF", allow_abbrev=False)
    part.add_argument("--E", type=positive, required=True, metavar="MPA", help="Young's modulus")
    part.add_argument("--ft", type=positive, required=True, metavar="MPA", help="tensile strength")
    part.add_argument("--GF", type=positive, required=True, metavar="N/MM", help="fracture energy")
    part.add_argument(
        "--h", type=width, required=True, metavar="MM", help='width of the band, or "fit"'
    )
    part.add_argument(
        "--condition", choices=CONDITIONS, default=CONDITIONS[0],
        help="what the curve obeys besides (default: initial_slope)",
    )  # fmt: skip
    part.add_argument(
        "--slope-factor", type=positive, help="initial slope over -ft²/GF (default: 2)"
    )
    part.add_argument("--w", type=positive, metavar="MM", help="opening of the point or centroid")
    part.add_argument(
        "--ratio", type=share, help="of the point, stress over strength (default: 0.5)"
    )
    part.add_argument("--Ep", type=positive, metavar="MPA", help="of the condition modulus")
    part.add_argument("--json", metavar="FILE", help="write all numbers")
    part.add_argument("--plot", metavar="FILE", help="draw the softening curve (png, pdf, svg)")
    return part


def _add_curve(what):
    part = what.add_parser("curve", help="a band law from a softening curve", allow_abbrev=False)
    part.add_argument(
        "file", nargs="?", metavar="FILE", help="CSV with w [mm], sigma [MPa], or a bundled name"
    )
    part.add_argument(
        "--law", default="damage", choices=("damage", *CURVES), help="default: damage"
    )
    part.add_argument(
        "--E", type=positive, metavar="MPA", help="Young's modulus, of the damage law"
    )
    part.add_argument(
        "--h", type=positive, metavar="MM", help="width of the band, of the damage law"
    )
    part.add_argument(
        "--fix", action="append", default=[], metavar="KEY=VALUE", help="a parameter that is known"
    )
    part.add_argument(
        "--to", choices=CURVES, help="fit to this law instead of a file, with --ft and --GF"
    )
    part.add_argument("--ft", type=positive, metavar="MPA", help="of --to")
    part.add_argument("--GF", type=positive, metavar="N/MM", help="of --to")
    part.add_argument("--out", metavar="DIR", help="write fit.json and fit.png")
    part.add_argument("--quiet", action="store_true", help="no progress")
    return part


def _energy(options) -> int:
    _check_condition(options)
    _check_file(options.json), _check_picture(options.plot)
    from calibration import energy_report
    from jaxmpm.compilation import keep_compiled

    keep_compiled()
    condition = _condition(options)
    result = energy_report.calibrate_energy(options.E, options.ft, options.GF, options.h, condition)
    print(energy_report.words(result))
    if options.json:
        energy_report.write_json(result, options.json)
    if options.plot:
        point = (
            (condition.w, condition.ratio * options.ft) if options.condition == "point" else None
        )
        print(energy_report.draw(result, options.plot, point))
    return 0


def _check_condition(options):
    """Each condition has its own options, and no others."""
    belongs = {
        "slope_factor": ("initial_slope",),
        "w": ("point", "centroid"),
        "ratio": ("point",),
        "Ep": ("modulus",),
    }
    for name, conditions in belongs.items():
        given, flag = getattr(options, name), f"--{name.replace('_', '-')}"
        if given is not None and options.condition not in conditions:
            raise SceneError(
                f"{flag} = {given:g}: expected only with --condition {' or '.join(conditions)}"
            )
        if given is None and options.condition in conditions and name in ("w", "Ep"):
            raise SceneError(f"{flag}: absent, expected with --condition {options.condition}")
    if options.h is None and options.condition not in ("point", "centroid"):
        raise SceneError(
            "--h = fit: expected with --condition point or centroid, and the initial slope"
        )


def _condition(options):
    from calibration.energy import Centroid, InitialSlope, Modulus, Point

    if options.condition == "point":
        return Point(options.w, 0.5 if options.ratio is None else options.ratio)
    if options.condition == "centroid":
        return Centroid(options.w)
    if options.condition == "modulus":
        return Modulus(options.Ep)
    return InitialSlope(2.0 if options.slope_factor is None else options.slope_factor)


def _check_file(name):
    if name and not Path(name).absolute().parent.is_dir():
        raise SceneError(f"{name}: expected a file in a folder that exists")


def _check_picture(name):
    _check_file(name)
    if name and Path(name).suffix not in (".png", ".pdf", ".svg"):
        raise SceneError(f"--plot = {name}: expected a name that ends in .png, .pdf or .svg")


def _curve(options) -> int:
    fix = named(options.fix, "--fix", "KEY=VALUE such as ft=3")
    if (options.file is None) == (options.to is None):
        raise SceneError("calibrate curve: expected FILE.csv or --to LAW, one of them")
    if options.to and None in (options.ft, options.GF):
        raise SceneError(f"--to = {options.to}: expected --ft (MPa) and --GF (N/mm) with it")
    if not options.to and (options.ft or options.GF):
        raise SceneError("--ft, --GF: expected only with --to (a known parameter is --fix ft=3)")
    if options.law == "damage" and None in (options.E, options.h):
        raise SceneError("--law = damage: expected --E (MPa) and --h (mm) with it")
    from calibration.tables import read_curve

    data = read_curve(options.file) if options.file else None
    from calibration import curve, curve_report
    from jaxmpm.compilation import keep_compiled

    keep_compiled()
    data = data or curve.sampled(options.to, options.ft, options.GF)
    show = None if options.quiet else print
    fit = curve.fit_curve(data, options.law, options.E, options.h, fix, show)
    print(curve_report.words(fit))
    if options.out:
        print(curve_report.write(fit, options.out))
    return 0
