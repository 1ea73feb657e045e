"""Files, overrides and parameters: what they do, and what is said of bad ones."""

import pytest

from jaxmpm.errors import SceneError
from jaxmpm.scene import load_scene
from jaxmpm.scene_source import evaluate


def lines_of(source, overrides=()):
    with pytest.raises(SceneError) as caught:
        load_scene(source, overrides)
    assert str(caught.value).splitlines() == caught.value.lines
    return caught.value.lines


def test_overrides_take_toml_values_bare_strings_items_and_new_keys():
    scene = load_scene(
        "den",
        [
            "grid.cell=5",
            "solver.precision=float32",
            "displacements.0.history.value=[0, 0.1]",
            "bands.release=0",
            "output.frames = 7",
            "bodies.0.minus.1.min.0=150.0",
            'title="a = b"',
        ],
    )
    assert scene.grid.cell == 5.0
    assert scene.solver.precision == "float32"
    assert scene.displacements[0].history.value == (0.0, 0.1)
    assert scene.displacements[1].history.value == (0.0, -0.06)
    assert scene.bands.release == 0.0
    assert scene.output.frames == 7
    assert scene.bodies[0].minus[1].min == (150.0, 97.5)
    assert scene.title == "a = b"


def test_an_override_one_past_the_end_appends():
    load = "{set='top', direction='x', kind='force', history={time=[0,1], value=[0,1]}}"
    assert load_scene("den", [f"forces=[{load}]"]).forces == load_scene(
        "den", ["forces=[]", f"forces.0={load}"]
    ).forces
    assert len(load_scene("den", ["supports.2={set='top', fix=['x']}"]).supports) == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("grid.cell", "expected key.path=value"),
        ("=3", "expected key.path=value"),
        ("grid..cell=3", "expected key.path=value"),
        ("grid.cell.x=3", "expected grid.cell to be a table or a list, it is 2.5"),
        ("supports.9.set=top", "expected an item number 0 to 2 after supports"),
        ("parameters.sid=3", "expected a parameter of the scene"),
        ("supports.first.set=top", "expected an item number 0 to 2 after supports"),
    ],
)
def test_a_bad_override_is_named(text, said):
    (line,) = lines_of("den", [text])
    assert f'override "{text}"' in line and said in line


def test_parameters_reach_every_place_and_derive_from_each_other():
    scene = load_scene("opening", ["parameters.angle=22.5"])
    assert scene.parameters == {"angle": 22.5, "normal": 112.5, "opposite": -67.5}
    assert scene.displacements[0].direction == 112.5
    assert scene.sets["lower"].inside[0].angle == -67.5
    assert scene.gauges["load"].direction == 112.5


def test_a_minus_before_a_parameter_gives_its_negative():
    scene = load_scene("den", ["parameters.d=0.04", "displacements.1.history.value=[0, '-$d']"])
    assert scene.displacements[1].history.value == (0.0, -0.04)


@pytest.mark.parametrize(
    ("text", "value"), [("2 * (a - 1) / 4 + -b", -1.0), ("+a", 5.0), ("1e-3", 1e-3), (" a ", 5.0), ("max(b, a / 2) + min(a, b, 1)", 4.0)]
)
def test_expressions(text, value):
    assert evaluate(text, {"a": 5.0, "b": 3.0}) == value


@pytest.mark.parametrize(
    "text",
    ["__import__('os')", "a ** 2", "a.real", "[1]", "1 if a else 2", "a(1)", "max(a)", "max(a, key=a)", "abs(a)", "", "1+", "True"],
)
def test_expressions_hold_arithmetic_only(text):
    with pytest.raises(ValueError):
        evaluate(text, {"a": 5.0})


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("'angel + 90'", 'did you mean "angle"?'),
        ("'opposite + 180'", '"opposite" is no earlier parameter'),
        ("'1 / 0'", "divides by zero"),
        ("'2 ** 3'", "+ - * / ( )"),
        ("true", "expected a finite number"),
        ("nan", "expected a finite number"),
    ],
)
def test_a_bad_parameter_is_reported_once(value, said):
    (line,) = lines_of("opening", [f"parameters.normal={value}"])
    assert line.startswith("parameters.normal = ") and value.strip("'") in line and said in line


def test_an_unknown_parameter_gets_a_suggestion():
    (line,) = lines_of("opening", ["displacements.0.direction=$normul"])
    assert line.startswith('displacements.0.direction = "$normul": expected a parameter')
    assert 'did you mean "$normal"?' in line


def test_a_parameter_out_of_range_shows_what_was_written_and_its_value():
    (line,) = lines_of("bar", ["parameters.cell=-2.5", "parameters.weak_end=52.5"])
    assert line.startswith('grid.cell = "$cell" (= -2.5): expected a finite number > 0')


def test_an_unknown_scene_gets_a_suggestion():
    (line,) = lines_of("den_4")
    assert line.startswith('scene = "den_4": expected a TOML file or one of bar, beam, brazil, cantilever, den, den_4a, discs, open')
    assert 'did you mean "den_4a"?' in line


def test_unreadable_files_are_scene_errors(tmp_path):
    absent = tmp_path / "absent.toml"
    (line,) = lines_of(absent)
    assert str(absent) in line and "No such file" in line
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"title = '\xff'")
    assert "expected UTF-8 text" in lines_of(binary)[0]
    folder = tmp_path / "folder.toml"
    folder.mkdir()
    assert "it is a folder" in lines_of(folder)[0]


@pytest.mark.parametrize("text", ["title = 'a'\ncell == 3\n", "a = 1\na = 2\n"])
def test_a_syntax_error_is_told_with_its_line(tmp_path, text):
    path = tmp_path / "broken.toml"
    path.write_text(text)
    (line,) = lines_of(path)
    assert "expected TOML" in line and "line 2" in line


@pytest.mark.parametrize("text", ["", "grid = 3\nbodies = 4\nsets = 5\nmaterials = []\ngauges = 1"])
def test_a_hopeless_file_is_told_what_is_needed(tmp_path, text):
    path = tmp_path / "empty.toml"
    path.write_text(text)
    lines = lines_of(path)
    for key in ("title", "grid", "materials", "bodies", "solver"):
        assert sum(line.startswith(key) for line in lines) == 1
    assert all("expected" in line for line in lines)


def test_a_parameter_that_nothing_asks_for_is_refused():
    (line,) = lines_of("rve", ["parameters.sid=12.5"])
    assert "did you mean side?" in line
    added = load_scene("bar", ["parameters.wide=30.0", "grid.thickness=$wide"])
    assert added.grid.thickness == 30.0
