"""`jaxmpm scenes | new | schema | completion`: to begin with."""

import json
from pathlib import Path


def add_commands(commands, folder, picture) -> None:
    """Add the commands; `folder` checks where something is to be written, `picture` the name of one."""
    scenes = commands.add_parser("scenes", help="list the bundled scenes")
    scenes.add_argument("--sheet", metavar="FILE", help="draw all of them, small, into a png, pdf or svg")
    scenes.set_defaults(command=lambda options: _scenes(options, folder, picture))

    new = commands.add_parser("new", help="begin a scene of your own: a commented file that runs")
    new.add_argument("file", metavar="FILE", help="what to write; its name ends in .toml")
    new.add_argument("--like", metavar="NAME", default="plate", help="plate (default), or a bundled scene to copy")
    new.add_argument("--no-schema", action="store_true", help="no schema beside it, by which editors complete and check it")
    new.set_defaults(command=lambda options: _new(options, folder))

    schema = commands.add_parser("schema", help="print a JSON schema of scene files, for editors")
    schema.set_defaults(command=_schema)

    completion = commands.add_parser("completion", help="print a script by which a shell completes commands")
    completion.add_argument("shell", choices=("bash", "zsh", "fish"), metavar="SHELL", help="bash, zsh or fish")
    completion.set_defaults(command=_completion)


def _scenes(options, folder, picture) -> int:
    from jaxmpm.scene import scene_names

    if options.sheet:
        target = picture("--sheet", options.sheet)
        folder("--sheet", target.parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        from jaxmpm.plot_scene import plot_sheet

        print(plot_sheet(target))
        return 0
    names = scene_names()
    width = max(map(len, names))
    for name, title in names.items():
        print(f"{name:{width}}  {title}")
    return 0


def _new(options, folder) -> int:
    from jaxmpm.new_scene import write_scene

    folder(options.file, Path(options.file).parent)
    written = write_scene(options.file, options.like, not options.no_schema)
    print(f"written: {' '.join(map(str, written))}")
    print(f"look at it: jaxmpm phases {written[0]}\nrun it:     jaxmpm run {written[0]}")
    return 0


def _schema(options) -> int:
    from jaxmpm.schema import scene_schema

    print(json.dumps(scene_schema(), indent=1, ensure_ascii=False))
    return 0


def _completion(options) -> int:
    from calibration.cli import make_parser as calibrate_parser
    from jaxmpm import completion
    from jaxmpm.cli import make_parser
    from jaxmpm.scene_source import bundled

    found = completion.commands(make_parser(), list(bundled()))
    below = completion.commands(calibrate_parser(), list(bundled()))
    found |= {f"calibrate {path}".strip(): one for path, one in below.items()}  # whose options are none of ours
    print(completion.script(options.shell, found), end="")
    return 0
