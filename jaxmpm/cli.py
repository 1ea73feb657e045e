"""The command line: `jaxmpm run | scenes | new | phases | plot | calibrate | verify | stability | benchmark` and more."""

import json
import os
import sys
from pathlib import Path

from jaxmpm import __version__, cli_chart, cli_ensemble, cli_scenes, cli_size, cli_stability
from jaxmpm.cli_examples import EXAMPLES
from jaxmpm.cli_parser import Parser
from jaxmpm.errors import ResultError, RunError, SceneError

BAD_INPUT, STOPPED, INTERRUPTED = 2, 1, 130


def main(arguments=None) -> int:
    """Entry point; returns the exit status: 0 done, 1 stopped or failed, 2 bad input."""
    parser = make_parser()
    try:
        options = parser.parse_all(arguments)
        if options.command is None:
            parser.print_help(sys.stderr)
            return BAD_INPUT
        return options.command(options)
    except (SceneError, ResultError) as error:
        for line in error.lines if isinstance(error, SceneError) else [error]:
            print(f"jaxmpm: {line}", file=sys.stderr)
        return BAD_INPUT
    except RunError as error:
        print(f"jaxmpm: stopped: {error}", file=sys.stderr)
        return STOPPED
    except KeyboardInterrupt:
        print("jaxmpm: interrupted; what was computed is on disk, --resume goes on", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return 0
    except OSError as error:  # a disk that is full, a folder that may not be written
        print(f"jaxmpm: {error}", file=sys.stderr)
        return STOPPED


def make_parser() -> Parser:
    """The parser of the whole command line."""
    parser = Parser(
        prog="jaxmpm", description="Differentiable material point method for fracture of quasi-brittle materials."
    )
    parser.add_argument("--version", action="version", version=f"jaxmpm {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    parser.set_defaults(command=None)
    _add_run(commands)
    cli_scenes.add_commands(commands, _folder, _picture)
    cli_chart.add_command(commands, lambda options: cli_chart.chart(options, _folder, _keep_compiled))
    cli_size.add_command(commands, _folder, _keep_compiled)
    cli_stability.add_command(commands, _folder, _keep_compiled)
    _add_pictures(commands)
    _add_calibrate(commands)
    _add_checks(commands)
    parser.show_examples(EXAMPLES[""])
    for name, command in commands.choices.items():
        command.show_examples(EXAMPLES[name])
    return parser


def _add_run(commands) -> None:
    run = commands.add_parser("run", help="run a scene and write its results")
    run.add_argument("scene", metavar="SCENE", help="a bundled name (jaxmpm scenes) or a TOML file")
    run.add_argument("--out", metavar="DIR", help="where to write (default: results/NAME)")
    run.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides",
        help="change the scene, e.g. grid.cell=1.25; may be given again",
    )  # fmt: skip
    run.add_argument("--resume", action="store_true", help="go on with an interrupted run in DIR")
    run.add_argument("--format", choices=("png", "pdf", "svg"), default="png", help="of the pictures: png (default), pdf or svg")
    run.add_argument("--quiet", action="store_true", help="no progress")
    cli_ensemble.add_options(run)
    cli_chart.add_options(run)
    run.set_defaults(command=_run)


def _add_pictures(commands) -> None:
    phases = commands.add_parser("phases", help="draw what a scene is made of, before a run")
    phases.add_argument("scene", metavar="SCENE", help="a bundled name or a TOML file")
    phases.add_argument(
        "--out", metavar="FILE", help="a png, pdf or svg to write (default: NAME_phases.png)"
    )
    phases.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides",
        help="change the scene, e.g. mesostructure.seed=2; may be given again",
    )  # fmt: skip
    phases.set_defaults(command=_phases)

    plot = commands.add_parser("plot", help="draw the pictures of a result again")
    plot.add_argument("directory", metavar="DIR")
    plot.add_argument("--deformed", type=float, metavar="FACTOR", help="exaggerate the displacement")
    plot.add_argument("--frame", type=int, metavar="K", help="which frame (default: the last)")
    plot.add_argument(
        "--field", default="material", metavar="FIELD",
        help="what colours the body: material, stress, speed, displacement, opening or damage "
        "(default: material, with the cracks coloured by their opening)",
    )  # fmt: skip
    plot.add_argument("--animate", action="store_true", help="all frames, as one animation")
    plot.add_argument("--stages", action="store_true", help="the response with stages, and the damage at each")
    plot.add_argument("--fps", type=float, metavar="N", help="of it, frames a second (default: 10)")
    plot.add_argument(
        "--format", choices=("png", "pdf", "svg", "gif", "mp4"),
        help="of pictures png (default), pdf or svg; of an animation gif (default) or mp4",
    )  # fmt: skip
    plot.set_defaults(command=_plot)


def _add_calibrate(commands) -> None:
    calibrate = commands.add_parser(  # whose own options are none of this parser's
        "calibrate", help="parameters of band laws from what was measured", add_help=False,
        prefix_chars="\0",
    )  # fmt: skip
    calibrate.add_argument("arguments", nargs="*")
    calibrate.set_defaults(command=_calibrate)


def _add_checks(commands) -> None:
    verify = commands.add_parser("verify", help="check the program against known answers")
    verify.add_argument("checks", nargs="*", metavar="CHECK", help="which (default: all)")
    verify.add_argument("--angle", type=float, help="of the opening test, degrees")
    verify.add_argument("--cell", type=float, help="cell of the opening test, mm")
    verify.add_argument("--json", metavar="FILE", help="write the table as JSON")
    verify.set_defaults(command=_verify)

    bench = commands.add_parser("benchmark", help="time a scene over cell sizes, or points alone")
    bench.add_argument(
        "scene", nargs="?", default="den", metavar="SCENE",
        help='a scene, or "points" for the update of cracked points alone',
    )  # fmt: skip
    bench.add_argument(
        "--cells", type=float, nargs="+", metavar="MM", help="of a scene (default: 5 2.5 1.25)"
    )
    bench.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides")
    bench.add_argument("--json", metavar="FILE", help="write the table as JSON")
    bench.set_defaults(command=_benchmark)


def _keep_compiled():
    from jaxmpm.compilation import keep_compiled

    keep_compiled()


def _run(options) -> int:
    from jaxmpm.scene import load_scene

    if cli_chart.wanted(options):
        return cli_chart.run(options, _folder, _keep_compiled)
    if cli_ensemble.wanted(options):
        return cli_ensemble.run(options, _folder, _keep_compiled)
    scene = load_scene(options.scene, options.overrides)
    directory = _folder("--out", options.out or Path("results") / scene.name)
    from jaxmpm.run import run_scene

    _keep_compiled()
    if options.resume and not (directory / "restart.h5").exists():
        print(f"jaxmpm: nothing to resume in {directory}: the run begins anew", file=sys.stderr)
    result = run_scene(scene, directory, options.resume, not options.quiet, options.format)
    if not options.quiet:
        print(result)
    return 0


def _folder(option: str, name) -> Path:
    """A folder to write to, which need not exist yet; raises ResultError where that cannot be."""
    directory = Path(name)
    there = next((p for p in (directory, *directory.absolute().parents) if p.exists()), directory)
    if not there.is_dir():
        raise ResultError(f"{option} = {name}: expected a folder to write to, but {there} is a file")
    if not os.access(there, os.W_OK | os.X_OK):
        raise ResultError(f"{option} = {name}: expected a folder to write to, but {there} may not be written")
    return directory


def _json(name) -> Path | None:
    """A file to write at the end, if any; raises ResultError where that cannot be, before anything is computed."""
    return name and _folder("--json", Path(name).parent) / Path(name).name


def _write_json(file: Path | None, rows: list) -> None:
    if file:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(rows, indent=1))


def _picture(option: str, name) -> Path:
    """A name of a picture; raises ResultError for another kind of file."""
    path = Path(name)
    if path.suffix not in (".png", ".pdf", ".svg"):
        raise ResultError(f"{option} = {path}: expected a file whose name ends in .png, .pdf or .svg")
    return path


def _phases(options) -> int:
    from jaxmpm.scene import load_scene

    scene = load_scene(options.scene, options.overrides)
    target = _picture("--out", options.out or f"{scene.name}_phases.png")
    from jaxmpm.plot_phases import plot_phases

    _folder("--out", target.parent)
    target.parent.mkdir(parents=True, exist_ok=True)
    print(plot_phases(scene, target))
    return 0


def _plot(options) -> int:
    from jaxmpm import plot

    suffix = f".{_picture_format(options)}"
    directory, look = Path(options.directory), {"field": options.field, "deformed": options.deformed}
    if options.animate:
        from jaxmpm.animate import animate

        target = directory / f"{plot.picture_name(**look)}{suffix}"
        print(animate(directory, target, fps=options.fps, **look))
        return 0
    if options.stages:
        from jaxmpm.plot_stages import plot_stages

        print(plot_stages(directory, directory / f"stages{suffix}"))
        return 0
    frame = -1 if options.frame is None else options.frame
    print(*plot.plot_run(directory, suffix, frame=frame, **look), sep="\n")
    return 0


def _picture_format(options) -> str:
    """Of `jaxmpm plot`; raises ResultError for options that do not go together."""
    if options.animate and options.frame is not None:
        raise ResultError(f"--frame = {options.frame}: expected none with --animate, all are shown")
    looks = (("--animate", options.animate or None), ("--frame", options.frame), ("--deformed", options.deformed))
    for name, value in (*looks, ("--field", None if options.field == "material" else options.field)):
        if options.stages and value is not None:
            given = "" if value is True else f" = {value}"
            raise ResultError(f"{name}{given}: expected none with --stages, a picture of its own")
    if not options.animate and options.fps is not None:
        raise ResultError(f"--fps = {options.fps:g}: expected only with --animate")
    kinds = ("gif", "mp4") if options.animate else ("png", "pdf", "svg")
    kind = options.format or kinds[0]
    if kind not in kinds:
        expected = "gif or mp4 with" if options.animate else "png, pdf or svg without"
        raise ResultError(f"--format = {kind}: expected {expected} --animate")
    return kind


def _calibrate(options) -> int:
    from calibration.cli import main as calibrate

    return calibrate(options.arguments)


def _verify(options) -> int:
    file = _json(options.json)
    _keep_compiled()
    from jaxmpm import verify

    checks = verify.run(options.checks, angle=options.angle, cell=options.cell, show=print)
    _write_json(file, checks)
    return 0 if all(check["passed"] for check in checks) else STOPPED


def _benchmark(options) -> int:
    file = _json(options.json)
    from jaxmpm import benchmark
    if options.scene == "points":
        for option, value in (("--cells", options.cells), ("--set", options.overrides)):
            if value:
                given = " ".join(map(str, value))
                raise ResultError(f"{option} = {given}: expected only with a scene, points are none")
        rows = benchmark.points(show=print)
    else:
        rows = benchmark.run(options.scene, options.cells or [5.0, 2.5, 1.25], options.overrides, show=print)
    _write_json(file, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
