"""What the README shows can be done as it stands."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from meso_scene import tree

from jaxmpm.layout import lay_out
from jaxmpm.mesostructure.image import find_image
from jaxmpm.scene import Scene, load_scene

README = (Path(__file__).parents[1] / "README.md").read_text()


def blocks(kind):
    return re.findall(rf"```{kind}\n(.*?)```", README, re.DOTALL)


def test_the_beam_and_the_settings_of_points_are_a_scene(tmp_path):
    path = tmp_path / "my_beam.toml"
    beam, moving, *_ = blocks("toml")
    path.write_text(beam)
    assert load_scene(path).bands.normal_window == 1
    parts = dict(re.findall(r"^\[(\w+)\][^\n]*\n((?:\w[^\n]*\n)+)", moving, re.MULTILINE))
    for name, lines in parts.items():  # into the table of the beam, or one more
        beam, found = re.subn(rf"^\[{name}\].*\n", lambda head: head[0] + lines, beam, flags=re.MULTILINE)  # noqa: B023
        beam += "" if found else f"\n[{name}]\n{lines}"
    path.write_text(beam)
    scene = load_scene(path)
    assert scene.grid.walls.bottom == "slip" and scene.points.fill == "cells" and scene.contact.friction == 0.3


def test_the_mesostructure_and_the_image_are_tables_of_a_scene(tmp_path):
    placed, image = (tomllib.loads(block) for block in blocks("toml")[2:4])
    whole = tree(cell=0.25)
    whole["materials"] = {"matrix": whole["materials"].pop("mortar"), **whole["materials"]}
    whole["bodies"][0] |= {"name": "specimen", "material": "matrix"}
    whole["materials"]["matrix"] |= placed["materials"]["matrix"]
    shares = lay_out(Scene.from_dict(whole | {"mesostructure": placed["mesostructure"]})).shares()
    assert shares["stone"] == pytest.approx(0.37, abs=0.01)
    np.save(tmp_path / "slice.npy", np.array([[0, 128], [255, 255]]))
    image["mesostructure"]["image"]["file"] = "slice.npy"
    find_image(whole | image, tmp_path)
    assert lay_out(Scene.from_dict(whole | image)).shares() == {"matrix": 0.25, "stone": 0.5, "itz": 0.25}


def test_the_point_by_itself_runs(tmp_path, monkeypatch, capsys):
    _, law, point, *_ = blocks("python")
    (tmp_path / "my_laws.py").write_text(law)
    monkeypatch.syspath_prepend(tmp_path)
    exec(compile(point, "README.md", "exec"), {})
    assert capsys.readouterr().out.count(" 1 ") == 3  # the band loads in every step


@pytest.mark.parametrize("word", ["neo_hookean", "fill =", "flip =", "fmpm_order ="])
def test_settings_are_listed(word):
    assert word in README
