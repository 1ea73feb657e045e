"""Phases from a picture: where its pixels go, what travels with the scene, what is refused."""

import json

import numpy as np
import pytest
import tomllib
from meso_scene import scene, tree
from PIL import Image

from jaxmpm.errors import SceneError
from jaxmpm.layout import lay_out
from jaxmpm.mesostructure import sampling
from jaxmpm.mesostructure.image import find_image
from jaxmpm.scene import Scene

LABELS = {"0": "mortar", "128": "itz", "255": "stone"}
MORTAR, STONE, ITZ = range(3)


def table(file, **changes):
    nothing = dict.fromkeys(("inclusion", "interface", "interface_thickness", "inclusions"))
    return nothing | {"image": {"file": file, "labels": LABELS}} | changes


def from_image(folder, file, **changes):
    """The scene with an image, found as beside a scene's file."""
    found = tree(mesostructure=table(file, **changes.pop("mesostructure", {})), **changes)
    find_image(found, folder)
    return Scene.from_dict(found)


@pytest.fixture
def stones():
    """Grey values (48, 48) of the phases of placed stones, the first row at the top."""
    material = lay_out(scene()).material
    return material, np.array([0, 255, 128], np.uint8)[material].T[::-1]


@pytest.mark.parametrize("file", ["slice.npy", "slice.png", "slice.PNG", "colour.png", "alpha.png", "wide.png", "deep.npy"])
def test_placed_phases_come_back_from_their_image(stones, tmp_path, file):
    material, grey = stones
    if file.endswith(".npy"):
        np.save(tmp_path / file, grey if file == "slice.npy" else grey.astype(float))
    else:
        kinds = {"colour.png": "RGB", "alpha.png": "LA"}
        picture = Image.fromarray(grey.astype(np.uint16)) if file == "wide.png" else Image.fromarray(grey)
        picture.convert(kinds.get(file, picture.mode)).save(tmp_path / file)
    layout = lay_out(from_image(tmp_path, file))
    assert layout.materials == ("mortar", "stone", "itz")
    assert (layout.material == material).all()
    finer = lay_out(from_image(tmp_path, file, cell=0.25)).material
    assert (finer == material.repeat(2, 0).repeat(2, 1)).all()


def test_a_palette_keeps_its_numbers(tmp_path):
    picture = Image.fromarray(np.array([[0, 128], [255, 0]], np.uint8), mode=None)
    picture.putpalette(np.random.default_rng(0).integers(0, 255, 768, dtype=np.uint8).tobytes())
    picture.save(tmp_path / "p.png")
    material = lay_out(from_image(tmp_path, "p.png", cell=12.0, materials=thick())).material
    assert material.tolist() == [[STONE, MORTAR], [MORTAR, ITZ]]  # [x][y], y upwards


def thick():
    """Materials that may be in large cells: without bands."""
    return {name: {k: v for k, v in one.items() if k != "band"} for name, one in tree()["materials"].items()}


def test_shares_of_pixels_are_mixed(tmp_path):
    # columns of 1 mm: mortar, interface, stone, stone ...; cells of 4 mm
    columns = np.array([0, 128, 255, 255] * 6)
    np.save(tmp_path / "s.npy", np.tile(columns, (3, 1)))
    one = from_image(tmp_path, "s.npy", cell=4.0, materials=thick(), mesostructure={"sampling": "mixed"})
    layout = lay_out(one)
    assert layout.local.shares.reshape(3, -1).T == pytest.approx(np.tile([0.25, 0.5, 0.25], (36, 1)))
    assert (layout.material == STONE).all()  # at the middle


def test_a_scene_knows_its_image_again(stones, tmp_path):
    np.save(tmp_path / "s.npy", stones[1])
    one = from_image(tmp_path, "s.npy")
    again = Scene.from_dict(json.loads(json.dumps(one.to_dict())))
    assert again == one and (lay_out(again).material == stones[0]).all()
    np.save(tmp_path / "s.npy", np.zeros_like(stones[1]))
    with pytest.raises(SceneError, match="expected the file as it was when this scene was written"):
        lay_out(again)
    with pytest.raises(SceneError, match="remove the digest"):
        find_image(one.to_dict(), tmp_path)


def test_a_body_cuts_its_image(tmp_path):
    np.save(tmp_path / "s.npy", np.full((4, 4), 255))
    block = {"name": "block", "material": "mortar", "shapes": [{"kind": "circle", "center": [12.0, 12.0], "radius": 12.0}]}
    layout = lay_out(from_image(tmp_path, "s.npy", bodies=[block]))
    assert layout.materials == ("stone",) and (layout.material >= 0).mean() == pytest.approx(np.pi / 4, abs=0.01)
    assert sampling.box_of(Scene.from_dict(tree(bodies=[block])).bodies[0], scene().grid) == (0.0, 0.0, 24.0, 24.0)


def lines_of(folder, file, **changes):
    with pytest.raises(SceneError) as caught:
        lay_out(from_image(folder, file, **changes))
    return caught.value.lines


def test_bad_images_are_named(tmp_path):
    (line,) = lines_of(tmp_path, "none.png")
    assert line.startswith('mesostructure.image.file = "none.png": expected a file beside the scene to read (No such file')
    (tmp_path / "broken.png").write_bytes(b"\x89PNG nonsense")
    (line,) = lines_of(tmp_path, "broken.png")
    assert "expected an image that can be read" in line
    np.save(tmp_path / "grey.npy", np.array([[0, 7], [255, 9]]))
    (line,) = lines_of(tmp_path, "grey.npy")
    assert "mesostructure.image.labels = " in line and "a material for each value of grey.npy (none for 7, 9)" in line
    np.save(tmp_path / "many.npy", np.arange(256).reshape(16, 16))
    assert "not segmented" in lines_of(tmp_path, "many.npy")[0]
    np.save(tmp_path / "cube.npy", np.zeros((2, 3, 4), int))
    assert "rows and columns of grey values (it is 2 by 3 by 4 int64)" in lines_of(tmp_path, "cube.npy")[0]
    np.save(tmp_path / "half.npy", np.full((2, 2), 0.5))
    assert "whole numbers" in lines_of(tmp_path, "half.npy")[0]
    Image.fromarray(np.arange(12, dtype=np.uint8).reshape(2, 2, 3)).save(tmp_path / "rgb.png")
    assert "save it in grey" in lines_of(tmp_path, "rgb.png")[0]


def test_a_name_that_is_no_image():
    found = tree(mesostructure=table("slice.jpg"))
    with pytest.raises(SceneError, match=r'image.file = "slice.jpg"'):
        Scene.from_dict(found)
    labels = tomllib.loads('x = { "grey" = "mortar" }')["x"]
    found = tree(mesostructure={**table("slice.png"), "image": {"file": "slice.png", "labels": labels}})
    with pytest.raises(SceneError, match="mesostructure.image.labels"):
        Scene.from_dict(found)
