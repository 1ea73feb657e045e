"""Half of a symmetric scene against the whole, a crack on the plane of symmetry against its closed form, and what is refused."""

import jax.numpy as jnp
import numpy as np
import pytest
from test_layout import box, load, plate
from test_quasistatic import opening

from jaxmpm import explicit, results
from jaxmpm.errors import SceneError
from jaxmpm.layout import lay_out
from jaxmpm.layout_half import offer, symmetries
from jaxmpm.quasistatic import QuasiStatic
from jaxmpm.run import Recorder, run_scene
from jaxmpm.scene import load_scene
from jaxmpm.simulation import Simulation
from jaxmpm.vtkhdf import read_frame


def beam(half, **solver):
    """An elastic beam of 12 x 4 cells of 10 mm on two supports, pressed down and pulled sideways at both ends."""
    tree = {
        "grid": {"size": [120, 40], "cell": 10, "stress_state": "plane_strain", "thickness": 2.0} | ({"half": "x"} if half else {}),
        "bodies": [{"name": "all", "material": "light", "shapes": [box(0, 0, 120, 40)], "minus": [box(50, 0, 70, 10)]}],
        "sets": {
            "left": {"inside": [box(10, 0, 20, 0)]}, "right": {"inside": [box(100, 0, 110, 0)]},
            "inner": {"inside": [box(30, 20, 30, 20)]}, "top": {"inside": [box(50, 40, 70, 40)]},
            "west": {"inside": [box(0, 0, 0, 40)]}, "east": {"inside": [box(120, 0, 120, 40)]},
            "roof": {"inside": [box(0, 40, 120, 40)]},
        },
        "supports": [{"set": name, "fix": ["y"]} for name in ("left", "right")] + [{"set": "inner", "fix": ["x"]}],
        "displacements": [{"set": "top", "direction": "y", "history": {"time": [0, 1], "value": [0, -1]}}], "gravity": [0.0, -1e4],
        "forces": [load("east", "x", "traction"), load("west", 180.0, "traction")],
        "gauges": {
            "pressed": {"kind": "reaction", "set": "top", "direction": -90.0}, "borne": {"kind": "reaction", "set": "left", "direction": "y"},
            "mouth": {"kind": "relative_displacement", "points": [[50, 0], [70, 0]], "direction": "x"},
            "aslant": {"kind": "relative_displacement", "points": [[0, 40], [90, 10]], "direction": 30.0},
            "east": {"kind": "displacement", "set": "east", "direction": "x"}, "west": {"kind": "displacement", "set": "west", "direction": "x"},
        },
        "solver": {"duration": 1.0} | solver,
    }  # fmt: skip
    return plate(**tree)


def same_readings(whole, half):
    np.testing.assert_allclose(half.energies(), whole.energies(), rtol=1e-9, atol=1e-12)
    scale = max(abs(float(value)) for name, value in whole.gauges.items())
    for name, value in whole.gauges.items():
        assert half.gauges[name] == pytest.approx(float(value), rel=1e-9, abs=1e-12 * scale), name


def test_half_moves_as_the_whole_does():
    """All that acts in mirror images: gauges, energies and the frame, to round-off, after a few oscillations."""
    sims = []
    for half in (False, True):
        scene = beam(half, duration=1e-3, damping=0.0)
        held = {"supports": scene.supports[:2]}  # in motion a node held sideways would push at the whole
        sims.append(Simulation.of(scene.model_copy(update=held)))
    for sim in sims:
        sim.advance(150)
    whole, half = (sim.read() for sim in sims)
    assert whole.kinetic > 0 and abs(float(whole.gauges["aslant"])) > 0
    same_readings(whole, half)
    frames = []
    for points, data in (sim.frame() for sim in sims):
        order = np.lexsort(np.round(points, 3).T)
        frames.append([points[order], *(data[name][order] for name in ("displacement", "stress"))])
    for one, other in zip(*frames, strict=True):
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-9 * np.abs(one).max())


def test_half_in_equilibrium_as_the_whole():
    """A single node that holds the whole sideways is told from a support: displacements are relative to it."""
    readings = []
    for half in (False, True):
        path = QuasiStatic.of(beam(half, kind="quasistatic"))
        path.at_rest()
        path.advance(path.steps)
        readings.append(path.read())
    assert abs(float(readings[0].gauges["east"]) - float(readings[0].gauges["west"])) > 1e-6
    same_readings(*readings)


def pulled_bar(half):
    """The bar of the closed form with two weak columns beside the middle, pulled at both ends."""
    middle = [50.0, 0.0]
    ends = [{"set": name, "direction": "x", "history": {"time": [0.0, 12e-3], "value": [0.0, end]}} for name, end in (("right", 0.1), ("left", -0.1))]
    return load_scene("bar", {
        "solver.kind": "quasistatic", "parameters.cell": 5, "output.samples": 40, "bodies.1.shapes.0.min": [45.0, 0.0],
        "materials.weak.bulk.nu": 0.0, "materials.concrete.bulk.nu": 0.0,
        "sets.corner.inside.0": {"kind": "rectangle", "min": middle, "max": middle}, "supports": [{"set": "corner", "fix": ["y"]}],
        "displacements": ends,
        "gauges.delta": {"kind": "relative_displacement", "points": [[0.0, 5.0], [100.0, 5.0]], "direction": "x"},
        **({"grid.half": "x"} if half else {}),
    })  # fmt: skip


def test_crack_on_the_plane_is_one_crack(tmp_path, capsys):
    """Not two: closed form of load against elongation, and G_F times area."""
    whole = Recorder(pulled_bar(False), tmp_path / "whole", resume=False, progress=False, suffix=".png")
    whole.history.close(), whole.cloud.close()
    assert whole.offer == "the scene is symmetric about x = 50 mm and y = 5 mm: half of it will do, --set grid.half=x"
    summary = run_scene(pulled_bar(True), tmp_path)
    assert '20 cells of 5 mm' in (said := capsys.readouterr().err) and 'half of the scene (grid.half = "x")' in said
    assert summary["status"] == "completed" and (summary["half"], summary["cells"]) == ("x", 20)
    history = results.read_history(tmp_path / "history.csv")
    load, delta = history["load"], history["delta"]
    behind = (history["cracked"] > 0) & (load < 0.95 * 285) & (load > 2)
    assert behind.sum() > 8
    expected = load[behind] / 32000.0 + np.array([opening(share) for share in load[behind] / 285])
    np.testing.assert_allclose(delta[behind], expected, rtol=2e-3)
    assert history["external_work"][-1] == pytest.approx(9.93, rel=0.01)
    frame = read_frame(tmp_path / "result.vtkhdf", -1)
    row = np.isclose(frame["points"][:, 1], 2.5)
    assert frame["opening"][row].sum() == pytest.approx(delta[-1] - load[-1] / 32000.0, rel=1e-3)
    assert frame["points"][:, 0].min() < 50 < frame["points"][:, 0].max() and len(frame["points"]) == 40


def test_stress_near_the_plane_is_averaged_with_its_image():
    rng = np.random.default_rng(3)
    half = rng.normal(size=(3, 5, 4))
    image = np.flip(half, axis=1) * np.array([1.0, 1.0, -1.0])[:, None, None]
    whole = np.concatenate([image, half], axis=1)
    cells = np.arange(20)
    there = explicit.averaged([jnp.asarray(c) for c in whole], jnp.asarray(cells + 20), 5)
    here = explicit.averaged([jnp.asarray(c) for c in half], jnp.asarray(cells), 5, half=0)
    pairs = there.at[2, :4].set(0.0)  # at the plane
    np.testing.assert_allclose(here, pairs, rtol=1e-12, atol=1e-12)


def test_only_what_is_symmetric_is_offered():
    scenes = {name: load_scene(name) for name in ("beam", "bar", "den", "brazil", "discs", "rve")}
    found = {name: symmetries(scene, lay_out(scene)) for name, scene in scenes.items()}
    assert found == {"beam": ["x"], "bar": ["y"], "den": [], "brazil": [], "discs": [], "rve": []}
    said = offer(scenes["beam"], lay_out(scenes["beam"]))
    assert said == "the scene is symmetric about x = 87.5 mm: half of it will do, --set grid.half=x"
    half = load_scene("beam", {"grid.half": "x"})
    assert offer(half, lay_out(half)) == ""


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"gravity": [1.0, 0.0]}, "gravity pulls along x"),
        ({"supports": [{"set": "left", "fix": ["x", "y"]}]}, "what holds or moves the node at (10, 0) mm along x has no mirror image"),
        ({"forces": [load("east", "x")]}, "what pulls the node at (0, 0) mm along x has no mirror image"),
        ({"forces": [load("east", "x"), load("west", "x")]}, "what pulls the node at (0, 0) mm along x has no mirror image"),
        ({"solver": {"duration": 1.0, "frame": "updated"}}, 'solver.frame = "updated": a half stays in the total frame'),
        ({"bodies": [{"name": "all", "material": "light", "shapes": [box(0, 0, 110, 40)]}]},
         "the materials of the cells at (5, 5) and (115, 5) mm differ"),
        ({"bodies": [{"name": "all", "material": "light", "shapes": [box(0, 0, 120, 40)], "velocity": [1.0, 0.0]}]},
         "bodies are thrown along x, or at different speeds"),
    ],
)  # fmt: skip
def test_what_is_not_symmetric_is_refused(change, why):
    scene = beam(True)
    tree = scene.to_dict() | change
    if "bodies" in change and change["bodies"][0]["shapes"][0]["max"][0] < 120:
        tree |= {"forces": [], "gauges": {}, "sets": {k: v for k, v in tree["sets"].items() if k != "east"}}
    with pytest.raises(SceneError) as caught:
        lay_out(type(scene).from_dict(tree))
    assert caught.value.lines == [f'grid.half = "x": expected a scene that is symmetric about x = 60 mm ({why})']


def test_an_odd_number_of_cells_is_refused_with_cells_that_fit():
    with pytest.raises(SceneError, match=r"there are 35 cells along x, expected an even number, as with cells of 4.16666666667, 6.25 mm"):
        lay_out(load_scene("beam", {"parameters.cell": 5, "grid.half": "x"}))
