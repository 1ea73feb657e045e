"""What was measured, behind a response: read with the scene, drawn, and counted in the summary."""

import json

import numpy as np
import pytest
from test_plot import words, write_run

from jaxmpm import plot, results, scene_source
from jaxmpm.errors import SceneError
from jaxmpm.reference import Reference
from jaxmpm.run import run_scene
from jaxmpm.scene import Scene, load_scene

BAND = "# tests\ncmod_mm,low_N,high_N\n0.0,0.0,10.0\n\n0.1,90.0,110.0\n"
COARSE = ["grid.cell=5", "parameters.half=2.5", "output.samples=150", "output.frames=2"]


@pytest.fixture
def scene_with(tmp_path):
    """A copy of the beam, beside a reference file of the text given."""
    text = scene_source.bundled()["beam"].read_text().replace("beam_tests.csv", "mine.csv")

    def make(csv, *overrides):
        (tmp_path / "beam.toml").write_text(text)
        (tmp_path / "mine.csv").write_bytes(csv if isinstance(csv, bytes) else csv.encode())
        return load_scene(tmp_path / "beam.toml", overrides)

    return make


def test_a_band_travels_with_the_scene(scene_with, tmp_path):
    scene = scene_with(BAND)
    (tmp_path / "mine.csv").unlink()
    again = Scene.from_dict(json.loads(json.dumps(scene.to_dict())))
    assert again == scene and again.response.reference.file == "mine.csv"
    assert scene.response.reference.loads == ((0.0, 90.0), (10.0, 110.0))


def test_one_load_makes_a_curve_and_an_empty_name_none(scene_with):
    reference = scene_with("cmod_mm, load_N\n0, 0\n1e-1, 5\n").response.reference
    assert not reference.is_band and reference.at([0.05]) == pytest.approx(np.array([[2.5]]))
    changes = ["response.reference=", "response.displacement=deflection"]
    assert scene_with(BAND, *changes).response.reference is None


@pytest.mark.parametrize(
    ("csv", "said"),
    [
        ("", "begins with the line cmod_mm,load_N or cmod_mm,low_N,high_N, as .* (it is empty)"),
        ("cmod_mm,high_N\n0,1\n", 'or cmod_mm,low_N,high_N, as .* (it is "cmod_mm,high_N")'),
        ("0,1\n1,2\n", '(it is "0,1")'),
        ("cmod_mm,load_N\n0,1\n", "two rows or more"),
        ("cmod_mm,load_N\n0,1\n1,two\n", '2 finite numbers a row (line 3 is "1,two")'),
        ("cmod_mm,load_N\n0,1\n1,nan\n", '2 finite numbers a row (line 3 is "1,nan")'),
        ("cmod_mm,load_N\n0,1\n1\n", '2 finite numbers a row (line 3 is "1")'),
        ("cmod_mm,load_N\n0,1\n0,2\n", "displacements that increase; 0 mm comes after 0 mm"),
        ("cmod_mm,low_N,high_N\n0,1,2\n1,3,2\n", "low load no larger .* at 1 mm they are 3 and 2 N"),
        (b"\xff\n", "a CSV table in UTF-8"),
    ],
)
def test_a_bad_reference_is_named(scene_with, csv, said):
    with pytest.raises(SceneError) as caught:
        scene_with(csv)
    (line,) = caught.value.lines
    assert line.startswith('response.reference = "mine.csv": expected ')
    assert all(part in line for part in said.split(" .* "))


def test_a_missing_reference_and_one_of_another_displacement_are_named(scene_with):
    with pytest.raises(SceneError, match='reference = "no.csv": expected a file beside the scene'):
        scene_with(BAND, "response.reference=no.csv")
    with pytest.raises(SceneError, match="begins with the line deflection_mm,load_N"):
        scene_with(BAND, "response.displacement=deflection")


def test_numbers_given_from_python_are_checked(scene_with):
    tree = scene_with(BAND).to_dict()
    for given, said in (
        ({"displacement": [0, 0], "loads": [[1, 2]]}, "expected displacements that increase"),
        ({"displacement": [0, 1], "loads": [[1, 2], [3]]}, "with a load for each of the 2"),
        ("mine.csv", 'response.reference = "mine.csv": expected a table'),
    ):
        tree["response"]["reference"] = given
        with pytest.raises(SceneError, match=said):
            Scene.from_dict(tree)


def test_share_inside_counts_only_where_the_band_reaches():
    band = Reference(displacement=(1.0, 2.0), loads=((0.0, 2.0), (2.0, 4.0)))
    displacement, load = np.array([0.0, 1.0, 1.5, 2.0, 3.0]), np.array([9.0, 1.0, 0.9, 4.0, 9.0])
    assert band.share_inside(displacement, load) == pytest.approx(2 / 3)
    assert band.share_inside(displacement[:1], load[:1]) is None


@pytest.mark.parametrize("loads", [((0.0, 900.0), (500.0, 2000.0)), ((0.0, 900.0),)])
def test_it_is_drawn_behind_the_curve(tmp_path, figures, loads):
    write_run(tmp_path, summary={"reference": "mine$.csv"})
    reference = Reference(file="mine$.csv", displacement=(0.0, 0.3), loads=loads)
    given = {"response": {"reference": reference.model_dump(mode="json")}}
    (tmp_path / "scene.json").write_text(json.dumps(given))
    plot.plot_response(tmp_path)
    axes = figures[0].axes[0]
    (grey,) = axes.collections if len(loads) == 2 else (axes.lines[0],)
    corners = grey.get_paths()[0].vertices if len(loads) == 2 else grey.get_xydata()
    assert corners.max(axis=0) == pytest.approx([0.3, loads[-1][-1] / 1e3])  # kN, as the curve
    assert grey.get_zorder() < axes.lines[-1].get_zorder()
    assert r"mine\$.csv" in words(figures[0])


def test_a_run_without_its_scene_says_so(tmp_path):
    write_run(tmp_path, summary={"reference": "mine.csv"})
    with pytest.raises(results.ResultError, match="scene.json"):
        plot.plot_response(tmp_path)


def test_the_beam_on_coarse_cells(tmp_path, figures):
    # to just behind the peak: cells of 5 mm let go of the last of the ligament at once
    scene = load_scene("beam", [*COARSE, "solver.duration=12.5e-3"])
    summary = run_scene(scene, tmp_path, progress=False)
    history = results.read_history(tmp_path / "history.csv")
    cmod, load = history["cmod"], history["load"]
    early = cmod < 0.008
    assert 70e3 < np.polyfit(cmod[early], load[early], 1)[0] < 85e3  # N/mm, as in the tests
    # f_t and G_F as published give more than the tests (933 to 1114 N), cells of 5 mm more still
    assert 1300 < summary["peak_load"] < 1500
    assert 0.03 < summary["displacement_at_peak"] < 0.09
    assert summary["final_displacement"] > 0.1 and summary["final_load"] < summary["peak_load"]
    assert 0.05 < summary["reference_inside"] < 0.3 and summary["reference"] == "beam_tests.csv"
    assert summary["largest_energy_error"] < 0.02
    peak = load.argmax()
    assert history["kinetic_energy"][peak] < 0.005 * history["external_work"][peak]
    assert len(figures[0].axes[0].collections) == 1
    again = run_scene(scene, tmp_path, resume=True, progress=False)  # with the band, to the end
    assert again["reference_inside"] == summary["reference_inside"]
