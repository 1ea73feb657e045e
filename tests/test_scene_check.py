"""Every mistake in a scene gets its own clear line."""

import copy
import tomllib

import pytest

from jaxmpm.errors import SceneError, written
from jaxmpm.scene import Scene, load_scene
from jaxmpm.scene_check import fitting_cells


def lines_of(source, overrides=()):
    with pytest.raises(SceneError) as caught:
        load_scene(source, overrides)
    assert str(caught.value).splitlines() == caught.value.lines
    return caught.value.lines


@pytest.fixture(scope="module")
def den():
    return load_scene("den").to_dict()


BAND = "materials.concrete.band"
BULK = "materials.concrete.bulk"


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (f"{BULK}.E=-1.0", "a finite number > 0 (Young's modulus"),
        (f"{BULK}.E=0", "a finite number > 0"),
        (f"{BULK}.E=nan", "a finite number > 0"),
        (f"{BULK}.E=inf", "a finite number > 0"),
        (f"{BULK}.E=true", "a finite number > 0"),
        (f"{BULK}.E=" + "1" + 320 * "0", "a finite number > 0"),
        (f"{BULK}.nu=0.5", "a finite number > -1 and < 0.5 (Poisson's ratio"),
        (f"{BULK}.nu=-1.0", "a finite number > -1 and < 0.5"),
        (f"{BULK}.law=plastic", '"elastic"'),
        (f"{BAND}.ft=0.0", "a finite number > 0 (tensile strength"),
        (f"{BAND}.Ep=-8.184", "a finite number > 0 (softening modulus"),
        (f"{BAND}.n=0.5", "> 0 and < 0.5"),
        (f"{BAND}.n=0.6", "the dissipation is infinite"),
        (f"{BAND}.n=0", "> 0 and < 0.5"),
        (f"{BAND}.h=2.5", "less than grid.cell = 2.5 mm"),
        ("materials.concrete.density=0.0", "a finite number > 0 (density"),
        ("grid.cell=0", "a finite number > 0 (side of a square cell"),
        ("grid.cell=1e300", "fits a whole number of times into grid.size = [200.0, 200.0]"),
        ("grid.cell=3", "cells near it that fit: 2.98507462687, 3.0303030303"),
        ("grid.size=[200.0]", "a list of 2 finite numbers > 0"),
        ("grid.size=[200.0, 200.0, 50.0]", "a list of 2 finite numbers > 0"),
        ("grid.size=200.0", "a list of 2 finite numbers > 0"),
        ("grid.thickness=-50", "a finite number > 0 (thickness"),
        ("grid.stress_state=plane_stres", 'did you mean "plane_stress"?'),
        ("title=3", "a string in quotes"),
        ("bodies=[]", "a list of at least 1, each a table"),
        ("bodies.0.shapes=[]", "a list of at least 1, each a table"),
        ("bodies.0.shapes.0=3", "a table"),
        ("bodies.0.material=concret", 'one of "concrete" (did you mean "concrete"?)'),
        ("bodies.0.minus.0.max=[25, 90]", "no coordinate below min = [0.0, 97.5]"),
        ("bodies.0.minus.0.kind=rectangel", 'did you mean "rectangle"?'),
        ("bodies.0.minus.0.kind=7", 'one of "circle", "half_plane", "polygon", "rectangle"'),
        ("bodies.0.minus.0.kind=true", 'one of "circle"'),
        ("sets.top.on=bound", '"all" or "boundary"'),
        ("supports.0.set=botom", 'did you mean "bottom"?'),
        ("supports.0.fix.0=z", '"x" or "y"'),
        ("supports.0.fix=[]", "at least 1"),
        ("displacements.0.set=nowhere", "the name of a node set"),
        ("displacements.0.direction=z", '"x" or "y" or a finite number'),
        ("displacements=[]", "nothing happens"),
        ("displacements.0.history.time=[0.0, 0.0]", "times that start at 0 and increase"),
        ("displacements.0.history.time=[1e-3, 2e-3]", "times that start at 0 and increase"),
        ("displacements.0.history.value=[0.0, 1.0, 2.0]", "as many values as there are times, 2"),
        ("displacements.0.history.value=[0.0]", "at least 2"),
        ("displacements.0.history.smooth_start=5e-3", "less than 0.005"),
        ("displacements.0.history.smooth_start=-1", ">= 0"),
        ("gauges.load.set=tip", 'did you mean "top"?'),
        ("gauges.load.kind=reactoin", 'did you mean "reaction"?'),
        ("gauges.left_notch.points=[[0, 0]]", "a list of 2 lists of 2 finite numbers"),
        ("response.load=lod", 'did you mean "load"?'),
        ("response.load=delta", "the name of a reaction gauge"),
        ("response.displacement=shear", "the name of a displacement gauge"),
        ("bands.effective_size=area", '"projected" or "centreline" or "sqrt_area"'),
        ("bands.normal_window=4", "an odd number"),
        ("bands.normal_window=0", ">= 1"),
        ("bands.normal_window=3.0", "a whole number"),
        ("bands.release=-1", ">= 0"),
        ("points.per_side=50", "a whole number >= 1 and <= 8 (points along"),
        ("contact.friction=0.4", "none where bodies stick"),
        ("solver.duration=0", "a finite number > 0 (time to simulate, s)"),
        ("solver.duration='5e-3'", "a finite number > 0"),
        ("solver.time_step_factor=1.0", "> 0 and < 1"),
        ("solver.damping=1", ">= 0 and < 1"),
        ("solver.precision=float16", '"float64" or "float32"'),
        ("solver.kind=implicit", '"explicit"'),
        ("solver.energy_error_limit=0", "> 0"),
        ("solver.gradient_limit=0", "> 0"),
        ("output.samples=1", "a whole number >= 2 (rows of history.csv)"),
        ("output.frames=1", "a whole number >= 2"),
        ("cell=5", "(did you mean grid.cell?)"),
        ("grid.damping=0.1", "(did you mean solver.damping?)"),
        ("bodies.0.shape=[]", "(did you mean shapes?)"),
        ("grid.cell=2,5", "write 2.5, without quotes)"),
        ("grid.cell='5 mm'", "write 5, without quotes or unit)"),
        ("solver.duration=fife", "a finite number > 0 (time to simulate, s)"),
    ],
)
def test_a_bad_value_is_named_with_its_path_and_what_is_expected(change, expected):
    path, _, value = change.partition("=")
    lines = lines_of("den", [change])
    (line,) = lines
    head, _, said = line.partition(": expected ")
    assert head == f"{path} = {shown(value)}"
    assert expected in said
    assert "pydantic" not in line and len(line) < 400


def test_a_parameter_without_its_sign_is_recognised():
    (line,) = lines_of("bar", ['grid.cell="cel"'])
    assert line.endswith('did you mean "$cell"?)')


def shown(value):
    try:
        return written(tomllib.loads(f"v = {value}")["v"])
    except tomllib.TOMLDecodeError:
        return f'"{value}"'


def test_a_bad_value_shows_deeper_where_only_an_item_is_wrong():
    (line,) = lines_of("den", ["bodies.0.velocity=[0, nan]"])
    assert line.startswith("bodies.0.velocity.1 = nan: expected a finite number (initial velocity")


def test_a_smooth_start_does_not_go_with_smooth_interpolation():
    (line,) = lines_of("den", ["displacements.0.history.interpolation=smooth"])
    assert line.startswith("displacements.0.history.smooth_start = 0.0005: expected 0 with")


def test_a_grid_too_fine_for_any_machine_is_refused():
    lines = lines_of("den", ["grid.cell=1e-300"])
    assert lines[0].startswith("grid.cell = 1e-300: expected a size that makes no more than 1e8")


def test_no_material_at_all():
    lines = lines_of("den", ["materials={}"])
    assert lines[0].startswith("materials = {}: expected a table of at least 1 (materials by name)")
    assert lines[1].startswith('bodies.0.material = "concrete": expected the name of a material')


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ("grid.cel=2.5", "grid.cel = 2.5: expected one of the keys size, origin, cell,"),
        ("solver.dampning=0.1", "solver.dampning = 0.1: expected one of the keys kind,"),
        ("bodies.0.minus.0.mins=[0, 0]", "bodies.0.minus.0.mins = [0, 0]: expected one of"),
        ("grids.cell=3", "grids = {cell = 3}: expected one of the keys name, title,"),
    ],
)
def test_an_unknown_key_gets_a_suggestion(change, line):
    (found,) = lines_of("den", [change])
    assert found.startswith(line)
    right = {"cel": "cell", "dampning": "damping", "mins": "min", "grids": "grid"}
    key = change.partition("=")[0].split(".")[-1]
    assert f"did you mean {right.get(key, 'grid')}?" in found


def test_a_misspelt_key_is_one_mistake(den):
    tree = copy.deepcopy(den)
    tree["grid"]["cel"] = tree["grid"].pop("cell")
    with pytest.raises(SceneError) as caught:
        Scene.from_dict(tree)
    (line,) = caught.value.lines
    assert line.startswith("grid.cel = 2.5") and "did you mean cell?" in line


@pytest.mark.parametrize(
    ("path", "what"),
    [
        ("grid.cell", "side of a square cell, mm"),
        ("grid", "a table (the grid)"),
        ("title", "a string in quotes"),
        ("materials.concrete.bulk.E", "Young's modulus, MPa"),
        ("bodies.0.shapes.0.max", "upper right corner"),
        ("displacements.1.history", "displacement against time"),
        ("gauges.load.direction", "an angle from the x axis"),
        ("solver.duration", "time to simulate, s"),
    ],
)
def test_an_absent_key_is_named_and_explained(den, path, what):
    tree = copy.deepcopy(den)
    *parents, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    node = tree
    for part in parents:
        node = node[part]
    del node[last]
    with pytest.raises(SceneError) as caught:
        Scene.from_dict(tree)
    (line,) = caught.value.lines
    assert line.startswith(f"{path}: absent, expected ") and what in line


def test_an_absent_kind_lists_the_kinds(den):
    tree = copy.deepcopy(den)
    del tree["bodies"][0]["minus"][1]["kind"]
    with pytest.raises(SceneError) as caught:
        Scene.from_dict(tree)
    (line,) = caught.value.lines
    assert line.startswith('bodies.0.minus.1.kind: absent, expected one of "circle", "half_plane"')


def test_all_mistakes_come_together():
    changes = [f"{BULK}.E=-1", f"{BAND}.h=9", "bodies.0.material=wood", "grid.cell=7", "output.x=1"]
    lines = lines_of("den", changes)
    starts = (f"{BULK}.E", f"{BAND}.h", "bodies.0.material", "grid.cell", "output.x")
    assert len(lines) == 5
    assert all(any(line.startswith(start) for line in lines) for start in starts)


@pytest.mark.parametrize(
    ("size", "largest"), [("projected", 82.9662), ("centreline", 82.9662), ("sqrt_area", 117.3317)]
)
def test_a_cell_in_which_bands_snap_back_is_refused(size, largest):
    # H_max = h (1 + E/Ep) = 0.03 (1 + 32000 / 8.184)
    changes = [f"{BAND}.h=0.03", f"bands.effective_size={size}"]
    (line,) = lines_of("den", [*changes, "grid.cell=200.0"])
    assert line.startswith(f"grid.cell = 200.0: expected at most {largest:g} mm")
    assert "H_max = h (1 + E/Ep) = 117.33 mm" in line
    assert load_scene("den", [*changes, "grid.cell=50.0"]).grid.cell == 50.0


def test_a_moving_body_is_something_that_happens():
    tree = load_scene("den").to_dict()
    for key in ("displacements", "gauges", "response"):
        del tree[key]
    with pytest.raises(SceneError, match="nothing happens"):
        Scene.from_dict(tree)
    tree["bodies"][0]["velocity"] = [0.0, 1.0]
    scene = Scene.from_dict(tree)
    assert scene.response is None and scene.bodies[0].velocity == (0.0, 1.0)


def test_fitting_cells_are_the_nearest_that_divide_both_sides():
    assert fitting_cells((200.0, 100.0), 3.0) == pytest.approx([100 / 34, 100 / 33])
    assert fitting_cells((10.0, 4.0), 1.5) == pytest.approx([1.0, 2.0])
    assert fitting_cells((1.0, 1.0), 5.0) == [1.0]


@pytest.mark.parametrize(
    ("points", "path", "said"),
    [
        ([[0, 0], [1, 0]], "points", "at least 3"),
        ([[0, 0], [1, 1], [2, 2]], "points", "corners that do not all lie on one line"),
        ([[0, 0], [1, 1], [2]], "points.2", "a list of 2 finite numbers"),
    ],
)
def test_bad_polygons(points, path, said):
    (line,) = lines_of("den", [f"bodies.0.minus.0={{kind='polygon', points={points}}}"])
    assert line.startswith(f"bodies.0.minus.0.{path} = ") and said in line
