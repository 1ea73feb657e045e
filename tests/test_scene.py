"""Scenes: what is read is what was written."""

import copy
import json
import subprocess
import sys

import pytest

from jaxmpm import scene_source
from jaxmpm.scene import History, Scene, direction_cosines, load_scene, scene_names

NAMES = ["bar", "beam", "brazil", "cantilever", "den", "den_4a", "discs", "opening", "rve"]


@pytest.fixture(scope="module")
def den():
    return load_scene("den").to_dict()


def test_bundled_scenes_have_titles_of_one_line():
    titles = scene_names()
    assert sorted(titles) == NAMES
    assert all(title and "\n" not in title and len(title) <= 100 for title in titles.values())


@pytest.mark.parametrize("name", NAMES)
def test_round_trip_through_json(name):
    scene = load_scene(name)
    again = Scene.from_dict(json.loads(json.dumps(scene.to_dict())))
    assert again == scene
    assert again.name == name


def test_values_of_the_den_plate():
    scene = load_scene("den")
    band = scene.materials["concrete"].band
    assert (band.ft, band.Ep, band.n, band.h) == (3.0, 8.184, 0.128, 0.05)
    assert scene.grid.shape == (80, 80)
    assert scene.displacements[1].history.value == (0.0, -0.06)
    assert scene.bands.normal_window == 5 and scene.bands.release == 1.0
    assert scene.output.samples == 400


def test_a_file_is_named_by_its_stem(tmp_path, den):
    path = tmp_path / "mine.toml"
    path.write_text(scene_source.bundled()["den"].read_text())
    assert load_scene(path).name == "mine"
    assert load_scene(str(path)).to_dict() == {**den, "name": "mine"}


def test_reading_a_scene_imports_no_jax():
    code = "import sys, jaxmpm.scene, jaxmpm.layout; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_from_dict_leaves_its_argument_alone():
    tree = scene_source.read(scene_source.bundled()["opening"])
    before = copy.deepcopy(tree)
    Scene.from_dict(tree)
    assert tree == before


def test_history_knows_its_first_change_and_measures_smooth_start_by_it():
    history = History(time=(0, 3e-3, 8e-3), value=(0, 0, 0.06), smooth_start=4e-3)
    assert history.first_change == 1
    assert History(time=(0, 1), value=(2, 2)).first_change == 0
    with pytest.raises(ValueError, match="less than 0.005"):
        History(time=(0, 3e-3, 8e-3), value=(0, 0, 0.06), smooth_start=5e-3)


def test_direction_cosines_are_exact_on_the_axes():
    assert direction_cosines("x") == (1.0, 0.0) == direction_cosines(360.0)
    assert direction_cosines("y") == (0.0, 1.0) == direction_cosines(90.0)
    assert direction_cosines(-30.0) == pytest.approx((3**0.5 / 2, -0.5))
