"""Band laws in scenes: cohesive ones, closing cracks, and a law of one's own from one file."""

import numpy as np
import pytest

from jaxmpm.errors import SceneError
from jaxmpm.laws.cohesive import CURVES
from jaxmpm.run import Simulation
from jaxmpm.scene import Scene, load_scene
from jaxmpm.scene_check import STEEPEST
from jaxmpm.scene_source import bundled

HASTY = True  # see conftest.py

BUNDLED = bundled()

OWN = '''
import jax.numpy as jnp
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.law import law


@law
class LinearBand:
    ft: float
    GF: float
    h: float
    strain = Damage.strain
    onset, effective, stored = Damage.onset, Damage.effective, Damage.stored

    def soften(self, p, bulk):
        value = jnp.maximum(1 - p / 2, 0.0)
        ratio = value + p * bulk.E * self.GF / (self.h * self.ft**2)
        return ratio, value / ratio

    def given_up(self, p, bulk):
        p = jnp.minimum(p, 2.0)
        return self.GF * (p - p * p / 4 - p * (1 - p / 2) / 2)

    def largest_size(self, bulk):
        return bulk.E * self.GF * 2 / self.ft**2
'''


def bar(band, weak=0.95, **changes):
    """The bundled bar with another band law, its weak column a share `weak` as strong."""
    tree = load_scene("bar", ["parameters.cell=5", "output.samples=4"]).to_dict()
    tree["materials"]["concrete"]["band"] = band
    tree["materials"]["weak"]["band"] = band | {"ft": weak * band["ft"]}
    for key, value in changes.items():
        tree[key] = tree.get(key, {}) | value
    return Scene.from_dict(tree)


def loads(sim, pieces):
    """Load at the ends of equal pieces of the run, and the last reading."""
    found = []
    for k in range(1, pieces + 1):
        sim.advance(k * sim.steps // pieces)
        found.append(sim.read())
    return [float(reading.gauges["load"]) for reading in found], found[-1]


LINEAR = {"ft": 3.0, "GF": 0.08, "h": 0.05}


@pytest.fixture(scope="module")
def linear():
    return loads(Simulation.of(bar(LINEAR | {"law": "cohesive", "curve": "linear"})), 20)


def test_bar_with_a_cohesive_band_gives_its_fracture_energy(linear):
    curve, last = linear
    assert float(last.dissipated) == pytest.approx(0.08 * 100.0, rel=0.01)
    assert max(curve) <= 2.85 * 100.0 * 1.01
    assert abs(curve[-1]) < 0.01 * 285.0  # linear: nothing is left


@pytest.fixture
def my_laws(tmp_path):
    (tmp_path / "my_laws.py").write_text(OWN)
    return tmp_path


def own(source="my_laws.py:LinearBand", **changes):
    return LINEAR | {"law": "own", "source": source} | changes


def test_own_law_from_one_file_is_the_same_bar(linear, my_laws, monkeypatch):
    """Isotropic damage and mixed mode all but agree in opening; Poisson's effect tells them apart."""
    monkeypatch.chdir(my_laws)
    curve, last = loads(Simulation.of(bar(own())), 20)
    np.testing.assert_allclose(curve, linear[0], rtol=0, atol=0.03 * 285.0)
    assert float(last.dissipated) == pytest.approx(0.08 * 100.0, rel=0.01)


def test_own_law_is_looked_for_beside_the_scene_and_its_text_is_part_of_it(my_laws):
    text = BUNDLED["bar"].read_text()
    for ft in ("3.0", "2.85"):
        old = f'{{ law = "damage", ft = {ft}, Ep = 8.184, n = 0.128, h = 0.05 }}'
        new = f'{{ law = "own", source = "my_laws.py:LinearBand", ft = {ft}, GF = 0.08, h = 0.05 }}'
        assert old in text
        text = text.replace(old, new)
    (my_laws / "mine.toml").write_text(text)
    first = load_scene(my_laws / "mine.toml")
    assert Simulation.of(first).model.embedding.law.GF.shape == (2,)
    with open(my_laws / "my_laws.py", "a") as file:
        file.write("# changed\n")
    assert load_scene(my_laws / "mine.toml") != first  # so that a run is not resumed with it


def test_closed_crack_carries_compression_in_a_scene():
    """The bar is pulled apart, then pushed together: EA/L again, no interpenetration."""
    history = {"time": [0.0, 6e-3, 9e-3, 12e-3], "value": [0.0, 0.2, 0.0, -0.02], "interpolation": "smooth"}
    tree = bar(LINEAR | {"law": "cohesive", "curve": "linear"}, bands={"closes": True}).to_dict()
    tree["displacements"][0]["history"] = history
    sim = Simulation.of(Scene.from_dict(tree))
    curve, last = loads(sim, 4)
    assert abs(curve[1]) < 3.0  # apart
    assert curve[3] == pytest.approx(-32000.0 * 100.0 * 0.02 / 100.0, rel=0.03)
    _, fields = sim.frame()
    # elastic strain of a band h wide at most, nothing like the 0.02 mm that the bar is short of
    assert fields["opening"].min() > -2 * 0.05 * 3.0 / 32000 - 0.05 * 6.4 / 32000 * 2
    work = float(last.external) - float(last.stored) - float(last.kinetic) - float(last.damping)
    assert work == pytest.approx(float(last.dissipated), rel=0.01)


def test_largest_size_of_cohesive_bands_is_checked_with_the_slopes_of_the_curves():
    for name, curve in CURVES.items():
        assert STEEPEST[name] == pytest.approx(curve.steepest, rel=1e-5)
    with pytest.raises(SceneError, match=r"grid.cell = 5.0: expected at most 1.\d+ mm.*E GF/\(1 ft²\)"):
        bar({"law": "cohesive", "ft": 30.0, "GF": 0.06, "h": 0.01})


FAULTS = {
    "Lacks": "    soften = None\n",
    "Raises": "    def soften(self, p, bulk):\n        return self.Gf\n",
    "NoPair": "    def soften(self, p, bulk):\n        return p\n",
    "Hardens": "    def soften(self, p, bulk):\n        return 1 + p, 1 + p\n",
    "Small": "    def largest_size(self, bulk):\n        return 1.0\n",
}


@pytest.mark.parametrize(
    "band, words",
    [
        ({"law": "cohesive", "ft": 3.0, "h": 0.05}, "materials.concrete.band.GF: absent"),
        (LINEAR | {"law": "cohesive", "curve": "hordik"}, 'did you mean "hordijk"'),
        (own("my_laws"), 'source = "my_laws": expected'),
        (own("no_such:Law"), "No module named 'no_such'"),
        (own("no_such.py:Law"), "no_such.py.*FileNotFoundError"),
        (own("broken.py:Law"), "SyntaxError"),
        (own("my_laws.py:LinearBnd"), "class made with @law in it .did you mean LinearBand"),
        (own("my_laws.py:Lacks"), "expected methods soften too"),
        (own("my_laws.py:Raises"), "expected of Raises methods as .*AttributeError.*Gf"),
        (own("my_laws.py:NoPair"), "expected of NoPair methods as"),
        (own("my_laws.py:Hardens"), "expected of Hardens soften.*falls from 1"),
        (own("my_laws.py:Small"), "grid.cell = 5: expected at most 0.7071 mm.*largest_size = 1 mm"),
        (own(GF=-0.1), "LinearBand.*soften.*GF = -0.1"),
        (own(GF="0.1"), 'materials.concrete.band.GF = "0.1": expected a finite number .write 0.1, without quotes.$'),
        (own(Gf=0.1), "did you mean GF"),
        (own() | {"GF": 0.0001}, "expected at most 0.5.* mm with materials.concrete"),
    ],
)
def test_mistakes_are_named(band, words, my_laws, monkeypatch):
    with open(my_laws / "my_laws.py", "a") as file:
        for name, body in FAULTS.items():
            file.write(f"\n\n@law\nclass {name}(LinearBand):\n{body}")
    (my_laws / "broken.py").write_text("def")
    monkeypatch.chdir(my_laws)
    with pytest.raises(SceneError, match=f"(?m){words}"):
        Simulation.of(bar(band))


def test_one_law_for_all_bands_of_a_scene():
    tree = bar(LINEAR | {"law": "cohesive"}).to_dict()
    tree["materials"]["weak"]["band"]["curve"] = "linear"
    with pytest.raises(SceneError, match='weak.band.curve = "linear": expected "exponential" as'):
        Scene.from_dict(tree)
