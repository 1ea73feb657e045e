"""Every mistake in a mesostructure or a scatter gets its own clear line."""

import pytest
from meso_scene import STONES, tree

from jaxmpm.errors import SceneError
from jaxmpm.scene import Scene

FULLER = STONES["grading"]
SIEVE = {"kind": "sieve", "size": [2.0, 4.0], "passing": [0.0, 1.0]}
POLYGON = {"kind": "polygon"}


def lines_of(**changes):
    with pytest.raises(SceneError) as caught:
        Scene.from_dict(tree(**changes))
    assert str(caught.value).splitlines() == caught.value.lines
    return caught.value.lines


def inclusions(**changes):
    return {"inclusions": STONES | changes}


@pytest.mark.parametrize(
    ("change", "start"),
    [
        ({"body": "blok"}, 'mesostructure.body = "blok": expected the name of a body, one of "block" (did you mean "block"?)'),
        ({"inclusion": "ston"}, 'mesostructure.inclusion = "ston": expected the name of a material'),
        ({"interface": "izt"}, 'mesostructure.interface = "izt": expected the name of a material'),
        ({"inclusion": None}, "mesostructure.inclusion: absent, expected the name of a material"),
        ({"inclusions": None}, "mesostructure.inclusions: absent, expected a table of inclusions (or mesostructure.image"),
        ({"interface_thickness": None}, "mesostructure.interface_thickness: absent, expected a finite number > 0"),
        ({"interface": None}, "mesostructure.interface: absent, expected the name of a material"),
        ({"interface_thickness": 0.2}, "mesostructure.interface_thickness = 0.2: expected at least a cell, 0.5 mm, "
            'where cells are what their middle is (or mesostructure.sampling = "mixed"'),
        ({"interface_thickness": -1.0}, "mesostructure.interface_thickness = -1.0: expected a finite number > 0"),
        ({"sampling": "mix"}, 'mesostructure.sampling = "mix": expected "centre" or "mixed"'),
        ({"seed": 1.5}, "mesostructure.seed = 1.5: expected a whole number >= 0"),
        ({"sed": 1}, "mesostructure.sed = 1: expected one of the keys"),
        (inclusions(fraction=0.0), "mesostructure.inclusions.fraction = 0.0: expected a finite number > 0 and <= 0.8"),
        (inclusions(fraction=37), "mesostructure.inclusions.fraction = 37: expected a finite number > 0 and <= 0.8"),
        (inclusions(gap=-0.1), "mesostructure.inclusions.gap = -0.1: expected a finite number >= 0"),
        (inclusions(edges="cut"), 'mesostructure.inclusions.edges = "cut": expected "inside" or "periodic"'),
        (inclusions(grading=FULLER | {"largest": 1.0}), "mesostructure.inclusions.grading.largest = 1.0: expected no less than "
            "smallest = 2 mm (largest size"),
        (inclusions(grading=FULLER | {"exponent": 0}), "mesostructure.inclusions.grading.exponent = 0: expected a finite number > 0"),
        (inclusions(grading=FULLER | {"smallest": 0.3}), "mesostructure.inclusions.grading.smallest = 0.3: expected inclusions of "
            "at least a cell, 0.5 mm"),
        (inclusions(grading={"kind": "fuler"}), 'mesostructure.inclusions.grading.kind = "fuler": expected one of "fuller", "sieve"'),
        (inclusions(grading=SIEVE | {"size": [4.0, 2.0]}), "mesostructure.inclusions.grading.size = [4.0, 2.0]: expected sizes"),
        (inclusions(grading=SIEVE | {"size": [0.1, 2.0]}), "mesostructure.inclusions.grading.size = [0.1, 2.0]: expected inclusions"),
        (inclusions(grading=SIEVE | {"passing": [0.0, 0.9]}), "mesostructure.inclusions.grading.passing = [0.0, 0.9]: expected shares "
            "that rise from 0 to 1"),
        (inclusions(grading=SIEVE | {"passing": [0.0, 0.5, 1.0]}), "mesostructure.inclusions.grading.passing = [0.0, 0.5, 1.0]: "
            "expected as many shares as there are sizes, 2"),
        (inclusions(shape={"kind": "square"}), 'mesostructure.inclusions.shape.kind = "square": expected one of'),
        (inclusions(shape={"kind": "ellipse", "aspect": 0.5}), "mesostructure.inclusions.shape.aspect = 0.5: expected a finite number >= 1"),
        (inclusions(shape=POLYGON | {"corners": [9, 5]}), "mesostructure.inclusions.shape.corners = [9, 5]: expected the fewest"),
        (inclusions(shape=POLYGON | {"corners": [2, 5]}), "mesostructure.inclusions.shape.corners.0 = 2: expected a whole number >= 3"),
        ({"image": {"file": "a.png", "labels": {"0": "mortar"}}, "inclusion": None, "interface": None,
            "interface_thickness": None}, "mesostructure.inclusions = {"),
        ({"image": {"file": "a.png", "labels": {"0": "morta"}}, "inclusion": None, "interface": None,
            "interface_thickness": None, "inclusions": None}, 'mesostructure.image.labels.0 = "morta": expected the name of a material'),
    ],
)  # fmt: skip
def test_a_bad_value_is_named(change, start):
    (line,) = lines_of(mesostructure=change)
    assert line.startswith(start)


@pytest.mark.parametrize("frame", ["auto", "updated"])
def test_what_differs_from_cell_to_cell_is_for_the_total_frame(frame):
    scatter = {"itz": {"modulus": 8.0, "length": 0.0}}
    lines = lines_of(mesostructure={"sampling": "mixed"}, scatter=scatter, solver={"duration": 1.0, "frame": frame})
    assert lines[0].startswith("materials.itz.scatter = {modulus = 8.0, length = 0.0}: expected none with solver.frame")
    assert lines[1].startswith('mesostructure.sampling = "mixed": expected "centre" with solver.frame')


def test_bad_scatter():
    (line,) = lines_of(scatter={"stone": {"modulus": 8.0, "length": 1.0}})
    assert line.startswith("materials.stone.scatter = ") and "none in a material that never cracks" in line
    (line,) = lines_of(scatter={"itz": {"modulus": 0.5, "length": 1.0}})
    assert line.startswith("materials.itz.scatter.modulus = 0.5: expected a finite number >= 1 (Weibull modulus")
    (line,) = lines_of(scatter={"itz": {"modulus": 5.0, "length": -1.0}})
    assert line.startswith("materials.itz.scatter.length = -1.0: expected a finite number >= 0")


def test_several_mistakes_at_once():
    wrong = {"body": "b", "interface": "izt", "inclusions": STONES | {"gap": -1, "fraction": 2}}
    assert len(lines_of(mesostructure=wrong)) == 4


def test_two_bodies_of_one_name():
    bodies = 2 * tree()["bodies"]
    (line,) = lines_of(bodies=bodies)
    assert line == 'mesostructure.body = "block": expected the name of one body, not of 2'


def test_a_scene_comes_back_from_its_tables():
    one = Scene.from_dict(tree(scatter={"itz": {"modulus": 8.0, "length": 1.0}}))
    assert Scene.from_dict(one.to_dict()) == one
