"""A volume as one material: closed forms, and a bar whose crack is followed to its end."""

import json

import numpy as np
import pytest
from test_macro import volume

from jaxmpm import results
from jaxmpm.homogenise import RISE, homogenised
from jaxmpm.run import run_scene
from jaxmpm.scene import Scene

E, NU, FT, GF = 32000.0, 0.2, 3.0, 0.005
LENGTH, HEIGHT, THICKNESS = 6.0, 2.0, 3.0


def bar():
    """Cells of 1 mm, a column of them weak, pulled until its linear curve of softening has ended."""
    tree = volume("edges", xx=1.0, damping=0.05).to_dict()
    tree["grid"]["size"] = [LENGTH, HEIGHT]
    for name, ft in (("one", 2 * FT), ("two", FT)):
        tree["materials"][name]["band"] = {"law": "cohesive", "curve": "linear", "ft": ft, "GF": GF, "h": 0.01}
    box = lambda low, high: [{"kind": "rectangle", "min": low, "max": high}]  # noqa: E731
    tree["bodies"] = [
        {"name": "all", "material": "one", "shapes": box([0.0, 0.0], [LENGTH, HEIGHT])},
        {"name": "weak", "material": "two", "shapes": box([3.0, 0.0], [4.0, HEIGHT])},
    ]
    end = 1.2 * 2 * GF / FT / LENGTH  # the crack opens to 1.2 times where its traction ends
    history = {"time": [0.0, 4e-4, 1e-3], "value": [0.0, 1.2e-4, end], "smooth_start": 1e-4}
    tree |= {"macro": tree["macro"] | {"history": history}, "output": {"samples": 200, "frames": 2}}
    tree["bands"] = {"normal_window": 1}
    return Scene.from_dict(tree)


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    directory = tmp_path_factory.mktemp("bar")
    return directory, run_scene(bar(), directory, progress=False)


def test_a_bar_with_one_crack_has_the_numbers_of_its_material(broken):
    _, summary = broken
    found = summary["homogenised"]
    assert found["component"] == "xx"
    assert found["E"] == pytest.approx(E, rel=5e-3) and found["nu"] == pytest.approx(NU, rel=5e-3)
    assert found["strength"] == pytest.approx(FT, rel=1e-2)
    assert found["strain_at_strength"] == pytest.approx(FT / E, rel=3e-2)
    assert found["stress_left"] < 1e-2
    assert found["fracture_energy"] == pytest.approx(GF, rel=1e-2)


def test_fracture_energy_on_the_way_is_what_has_been_spent(broken):
    """σ w / 2 = G_F (1 − s) s, s = σ/f_t, comes back along the secant of an isotropic damage: G_F (1 − s) is spent."""
    directory, _ = broken
    history = results.read_history(directory / "history.csv")
    scene = Scene.from_dict(json.loads((directory / "scene.json").read_text()))
    peak = int(history["stress_xx"].argmax())
    half = peak + int((history["stress_xx"][peak:] < FT / 2).argmax())
    found = homogenised(scene, {name: column[: half + 1] for name, column in history.items()})
    assert 0.4 < found["stress_left"] < 0.55
    assert found["fracture_energy"] == pytest.approx(GF * (1 - found["stress_left"]), rel=2e-2)


def made(drive, stress_state="plane_stress", without=(), **slopes):
    """What is found of a history whose columns rise along these slopes with the factor, then fall by half."""
    tree = volume("periodic", **drive).to_dict()
    tree["grid"]["stress_state"] = stress_state
    for name in without:
        del tree["gauges"][name]
    scene = Scene.from_dict(tree)
    factor = np.linspace(0.0, 1e-3, 41)
    past = factor > 5e-4
    history = {"dissipated_energy": np.linspace(0.0, 7.2, 41)}
    for name in scene.gauges:
        history[name] = slopes.get(name, 0.0) * factor
        if name.startswith("stress"):  # beyond the rise it bends: no part of a stiffness
            history[name] = np.where(history[name] > 0, history[name], 0.0)
            history[name][factor > 2e-4] *= 0.8
            history[name][past] = history[name][past][0] / 2
    return homogenised(scene, history)


def test_plane_strain_is_taken_into_account():
    pull = {"stress_xx": E / (1 - NU**2), "strain_xx": 1.0, "strain_yy": -NU / (1 - NU)}
    found = made({"xx": 1.0}, "plane_strain", **pull)
    assert RISE == 0.3  # below the bend that `made` puts in
    assert found["E"] == pytest.approx(E) and found["nu"] == pytest.approx(NU)
    unknown = made({"xx": 1.0}, "plane_strain", without=("strain_yy",), **pull)
    assert "E" not in unknown and "nu" not in unknown and unknown["strength"] == found["strength"]


def test_section_and_component_follow_the_pull():
    found = made({"yy": 1.0}, stress_yy=E, strain_yy=1.0, strain_xx=-NU)
    assert (found["component"], found["E"], found["nu"]) == ("yy", pytest.approx(E), pytest.approx(NU))
    assert found["fracture_energy"] == pytest.approx(7.2 / (6.0 * 3.0))  # N·mm over the side along x
    assert made({"xx": 1.0}, stress_xx=E, strain_xx=1.0)["fracture_energy"] == pytest.approx(7.2 / (4.0 * 3.0))


def test_compression_has_the_same_numbers():
    found = made({"xx": -1.0}, stress_xx=0.0, strain_xx=-1.0, strain_yy=NU)
    assert found == {"component": "xx", "fracture_energy": found["fracture_energy"]}  # no stress: nothing to say
    scene = volume("edges", xx=-1.0)
    factor = np.linspace(0.0, 1e-3, 11)
    columns = {name: 0 * factor for name in scene.gauges}
    columns |= {"stress_xx": -E * factor, "strain_xx": -factor, "strain_yy": NU * factor, "dissipated_energy": 0 * factor}
    found = homogenised(scene, columns)
    assert found["E"] == pytest.approx(E) and found["nu"] == pytest.approx(NU)
    assert found["strength"] == pytest.approx(E * 1e-3) and found["stress_left"] == 1.0


@pytest.mark.parametrize("drive", [{"xy": 1.0}, {"xx": 0.0, "yy": 0.0, "xy": 1.0}])
def test_shear_gives_its_modulus_alone(drive):
    found = made(drive, stress_xy=E / 2.4, strain_xy=1.0)
    assert found["component"] == "xy" and found["G"] == pytest.approx(E / 2.4)
    assert "E" not in found and "nu" not in found


def test_what_a_drive_does_not_determine_is_left_out():
    both = made({"xx": 1.0, "yy": 1.0}, stress_xx=E, strain_xx=1.0, strain_yy=1.0)
    held = made({"xx": 1.0, "yy": 0.0}, stress_xx=E, strain_xx=1.0)
    assert not {"E", "nu", "G"} & (both.keys() | held.keys()) and held["strength"] > 0
    alone = made({"xx": 1.0}, without=("strain_yy",), stress_xx=E, strain_xx=1.0)
    assert alone["E"] == pytest.approx(E) and "nu" not in alone
