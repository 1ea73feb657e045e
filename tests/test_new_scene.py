"""A scene of one's own: what is written runs, editors know it, and shells complete the commands."""

import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib

import jsonschema
import pytest

from calibration.cli import make_parser as calibrate_parser
from jaxmpm import cli, completion
from jaxmpm.cli_examples import EXAMPLES
from jaxmpm.layout import lay_out
from jaxmpm.new_scene import kinds, write_scene
from jaxmpm.results import read_summary
from jaxmpm.scene import load_scene
from jaxmpm.schema import scene_schema

HASTY = True


def run(*arguments):
    return cli.main([str(argument) for argument in arguments])


def test_a_new_scene_runs_as_it_is_and_breaks(tmp_path, capsys):
    path = tmp_path / "in" / "my.toml"
    assert run("new", path) == 0
    assert f"jaxmpm run {path}" in capsys.readouterr().out
    settings = ["grid.cell=10", "parameters.time=4e-3", "output.samples=50", "output.frames=2"]
    options = [word for setting in settings for word in ("--set", setting)]
    assert run("run", path, "--out", tmp_path / "out", "--format", "svg", "--quiet", *options) == 0
    found = read_summary(tmp_path / "out")
    strongest = 3.0 * 120 * 50  # strength × ligament
    assert 0.8 * strongest < found["peak_load"] < strongest and found["final_load"] < 0.2 * found["peak_load"]
    names = {file.name for file in (tmp_path / "out").iterdir()}
    assert {"response.svg", "cracks.svg"} <= names and not any(name.endswith(".png") for name in names)
    assert "opening [mm]" in (tmp_path / "out" / "response.svg").read_text()  # as text


@pytest.mark.parametrize("line", ['kind = "quasistatic"', 'frame = "auto"'])
def test_what_is_commented_out_is_right_too(line, tmp_path):
    text = kinds()["plate"].read_text()
    assert f"# {line}" in text
    path = tmp_path / "one.toml"
    path.write_text(text.replace(f"# {line}", line))
    lay_out(load_scene(path))
    text = re.sub(r"minus = .*", "", text)
    for shape in re.findall(r"^# .*?(\{ kind = .*)$", text, re.MULTILINE):
        for table in re.findall(r"\{[^{}]*\}", shape):
            path.write_text(text.replace("shapes = [", f"shapes = [{table}, ", 1))
            lay_out(load_scene(path))


def test_a_copy_comes_with_what_it_refers_to_and_nothing_is_overwritten(tmp_path, capsys):
    paths = write_scene(tmp_path / "mine.toml", "beam", with_schema=False)
    assert [path.name for path in paths] == ["mine.toml", "beam_tests.csv"]
    assert load_scene(paths[0]).response == load_scene("beam").response
    before = paths[0].read_text()
    for arguments, words in (
        (["new", paths[0]], "nothing is overwritten"),
        (["new", tmp_path / "other.toml", "--like", "beam"], "beam_tests.csv: expected a file that is not there yet"),
        (["new", tmp_path / "other"], "did you mean other.toml?"),
        (["new", tmp_path / "other.toml", "--like", "baem"], "did you mean beam?"),
        (["new", paths[0] / "other.toml"], "is a file"),
    ):
        assert run(*arguments) == cli.BAD_INPUT and words in capsys.readouterr().err
    assert paths[0].read_text() == before and {path.name for path in tmp_path.iterdir()} == {"mine.toml", "beam_tests.csv"}


@pytest.fixture(scope="module")
def schema():
    tree = scene_schema()
    jsonschema.Draft7Validator.check_schema(tree)
    return jsonschema.Draft7Validator(tree)


@pytest.mark.parametrize("name", kinds())
def test_the_schema_takes_every_scene(name, schema):
    schema.validate(tomllib.loads(kinds()[name].read_text()))


def test_the_schema_refuses_what_the_program_refuses(schema):
    wrong = {"grid.cel": 5.0, "grid.size": [1.0], "solver.damping": "much", "materials.concrete.band.law": "cohesiv", "bodies": []}
    for key, value in wrong.items():
        tree = tomllib.loads(kinds()["plate"].read_text())
        node = tree
        *path, last = key.split(".")
        for part in path:
            node = node[part]
        node[last] = value
        (error,) = schema.iter_errors(tree)
        assert error.json_path.removeprefix("$.") in key


def test_the_schema_explains_every_key_and_is_named_in_the_scene(tmp_path, capsys, schema):
    tables = {name: table.get("properties", {}) for name, table in schema.schema["definitions"].items()}
    assert not [(name, key) for name, keys in tables.items() for key, node in keys.items() if "description" not in node and key != "kind"]
    scene, _ = write_scene(tmp_path / "a.toml")
    line = scene.read_text().splitlines()[0]
    beside = tmp_path / line.removeprefix("#:schema ./")
    assert json.loads(beside.read_text()) == schema.schema
    assert run("schema") == 0 and json.loads(capsys.readouterr().out) == schema.schema


def test_the_sheet_is_drawn(tmp_path, capsys):
    assert run("scenes", "--sheet", tmp_path / "scenes.png") == 0
    assert 20_000 < (tmp_path / "scenes.png").stat().st_size < 250_000
    assert run("scenes", "--sheet", tmp_path / "scenes.jpg") == cli.BAD_INPUT


# ---- help and completion


def parsers():
    """Every command's parser by the words that lead to it."""
    found = {}
    for top, parser in (("", cli.make_parser()), ("calibrate", calibrate_parser())):
        found[top] = parser
        for action in parser._actions:
            if action.dest in ("what",) or action.metavar == "COMMAND":
                found |= {f"{top} {name}".strip(): below for name, below in action.choices.items() if name != "calibrate"}
    return found


def test_every_command_ends_its_help_with_examples_that_are_right():
    assert parsers().keys() == EXAMPLES.keys()
    for name, parser in parsers().items():
        shown = parser.format_help().partition("examples:\n")[2]
        for line, what in EXAMPLES[name]:
            assert line in shown and what in shown
            words = shlex.split(line.partition(" > ")[0].removeprefix('eval "$(').removesuffix(')"'))
            assert words[0] == "jaxmpm"
            if "--help" in words:
                continue
            options = cli.make_parser().parse_all(words[1:])
            if words[1] == "calibrate":
                calibrate_parser().parse_all(options.arguments)


@pytest.fixture(scope="module")
def scripts():
    done = {shell: subprocess.run([sys.executable, "-m", "jaxmpm", "completion", shell], capture_output=True, text=True, check=True).stdout
            for shell in completion.SHELLS}  # fmt: skip
    return done


@pytest.mark.parametrize("shell", completion.SHELLS)
def test_a_script_knows_every_command_and_option(shell, scripts):
    for name, parser in parsers().items():
        for word in (*name.split(), *(option for option in parser.option_strings() if option.startswith("--"))):
            assert re.search(rf"\b{word.lstrip('-')}\b", scripts[shell]), word
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=scripts[shell], text=True, check=True)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("ru", {"run"}),
        ("run den_", {"den_4a"}),
        ("run my", {"my.toml"}),
        ("run den --re", {"--resume"}),
        ("run den --format ", {"png", "pdf", "svg"}),
        ("calibrate ", {"energy", "curve", "specimen", "--help"}),
        ("calibrate energy --condition p", {"point"}),
        ("run den --out ", {"folder"}),
    ],
)
def test_bash_completes(line, expected, scripts, tmp_path):
    (tmp_path / "my.toml").write_text("")
    (tmp_path / "folder").mkdir()
    words = ["jaxmpm", *line.split(), *([""] if line.endswith(" ") else [])]
    ask = f"COMP_WORDS=({' '.join(map(shlex.quote, words))}); COMP_CWORD={len(words) - 1}; _jaxmpm; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    done = subprocess.run(["bash", "-c", f"{scripts['bash']}\n{ask}"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == expected
