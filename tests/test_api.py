"""The public names of the package: what README shows of them works, and nothing is imported too early."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxmpm
from jaxmpm import scene_source

HASTY = True
README = (Path(__file__).parents[1] / "README.md").read_text()
EXAMPLE = re.search(r"### From Python\n\n```python\n(.*?)```", README, re.DOTALL)[1]


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """What README's example leaves."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("readme"))
        names = {}
        exec(compile(EXAMPLE, "README.md", "exec"), names)
        names["result"].directory = names["result"].directory.absolute()
    return names


@pytest.mark.parametrize(
    ("code", "modules"),
    [
        ("import jaxmpm", "jax numpy scipy matplotlib pydantic h5py jaxmpm.scene"),
        ("import jaxmpm; jaxmpm.load_scene('rve')", "jax scipy matplotlib h5py"),
        ("import jaxmpm.layout as l; from jaxmpm import load_scene; l.lay_out(load_scene('den'))", "jax scipy matplotlib"),
        ("from jaxmpm import load_result", "jax scipy matplotlib"),
        ("import jaxmpm.run", "matplotlib"),
    ],
)
def test_only_what_is_needed_is_imported(code, modules):
    check = f"import sys; {code}; sys.exit(' '.join(m for m in {modules.split()} if m in sys.modules) or None)"
    subprocess.run([sys.executable, "-c", check], check=True)


def test_public_names_are_listed_documented_and_in_readme():
    assert set(jaxmpm.__all__) <= set(dir(jaxmpm)) and "os" not in dir(jaxmpm)
    for name in jaxmpm.__all__:
        assert inspect.getdoc(getattr(jaxmpm, name)), name
        assert re.search(rf"\b{name}\b", README), name
    with pytest.raises(AttributeError, match="did you mean load_scene"):
        _ = jaxmpm.load_scen


def test_the_example_runs(example):
    result = example["result"]
    assert result["peak_load"] == pytest.approx(17.4e3, rel=0.01)
    assert {path.name for path in result.directory.glob("*.png")} == {"response.png", "cracks.png", "deformed.png"}
    assert example["opening"].shape == (401,)
    again = jaxmpm.load_result(result.directory)
    assert again.scene == example["scene"] and again["peak_load"] == result["peak_load"]
    assert np.array_equal(again.history["left_notch"], example["opening"]) and again.history.units["left_notch"] == "mm"
    assert again.frame()["opening"].max() > 0.01
    assert "peak 17.4" in repr(again) and "cracks.png" in repr(again)


def test_changes_are_texts_or_values_by_key():
    texts = jaxmpm.load_scene("bar", ["parameters.cell=5", "gravity=[0.0, -9810.0]"])
    values = {"parameters.cell": np.float64(5.0), "gravity": np.array([0.0, -9810.0])}
    assert jaxmpm.load_scene("bar", values) == texts
    for wrong, said in (("grid.cell=5", "expected a list"), ({"grid.cell": "x"}, 'grid.cell = "x"'), ({"parameters.cel": 5}, "did you mean cell")):
        with pytest.raises(jaxmpm.SceneError, match=said):
            jaxmpm.load_scene("bar", wrong)
    with pytest.raises(jaxmpm.SceneError, match='scene = "bar": expected a Scene'):
        jaxmpm.run_scene("bar", "nowhere")
    with pytest.raises(jaxmpm.ResultError, match="format = jpg: expected png, pdf or svg"):
        jaxmpm.run_scene(texts, "nowhere", pictures="jpg")
    tree, value = {}, {"a": [1]}
    scene_source.override(tree, {"table": value})["table"]["a"].append(2)
    assert tree == {} and value == {"a": [1]}
