"""A representative volume: mean strain driven by edges or periodic, against closed forms."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import observe, periodic
from jaxmpm.errors import SceneError
from jaxmpm.scene import Scene
from jaxmpm.simulation import Simulation

HASTY = True  # see conftest.py
E, NU, STRAIN = 32000.0, 0.2, 5e-5
SHAPE = (6, 4)
WHOLE = {"kind": "rectangle", "min": [0.0, 0.0], "max": [6.0, 4.0]}


def volume(boundary, nu=NU, damping=0.2, duration=1e-3, ft=1e3, **strain):
    """Cells of 1 mm, two materials of the same numbers, slowly strained."""
    concrete = {
        "density": 2.4e-9, "bulk": {"law": "elastic", "E": E, "nu": nu},
        "band": {"law": "damage", "ft": ft, "Ep": 8.184, "n": 0.128, "h": 0.05},
    }  # fmt: skip
    box = lambda low, high: [{"kind": "rectangle", "min": low, "max": high}]  # noqa: E731
    gauges = {
        f"{kind}_{c}": {"kind": f"mean_{kind}", "component": c} for kind in ("stress", "strain") for c in ("xx", "yy", "xy")
    }
    return Scene.from_dict({
        "title": "volume", "name": "volume",
        "grid": {"size": [6.0, 4.0], "cell": 1.0, "stress_state": "plane_stress", "thickness": 3.0},
        "materials": {"one": concrete, "two": concrete},
        "bodies": [
            {"name": "all", "material": "one", "shapes": box([0.0, 0.0], [6.0, 4.0])},
            {"name": "half", "material": "two", "shapes": box([0.0, 0.0], [3.0, 4.0])},
        ],
        "macro": {
            "boundary": boundary, "strain": strain,
            "history": {"time": [0.0, duration], "value": [0.0, STRAIN], "smooth_start": 0.4 * duration},
        },
        "gauges": gauges, "response": {"load": "stress_xx", "displacement": "strain_xx"},
        "solver": {"duration": duration, "damping": damping}, "output": {"samples": 8},
    })  # fmt: skip


def readings(sim, samples=8):
    """Gauges and energies at the samples."""
    found = []
    for k in range(1, samples + 1):
        sim.advance(sim.step_at(k, samples))
        found.append(sim.read())
    return found


def with_moduli(sim, moduli):
    """A simulation whose materials have these Young's moduli."""
    bulk = dataclasses.replace(sim.model.embedding.bulk, E=jnp.asarray(moduli))
    sim.model = dataclasses.replace(sim.model, embedding=dataclasses.replace(sim.model.embedding, bulk=bulk))
    return sim


CASES = {  # components driven: mean stress and strain of a plate in plane stress, over E ε and ε
    "pull": ({"xx": 1.0}, (1.0, 0.0, 0.0), (1.0, -NU, 0.0)),
    "both": ({"xx": 1.0, "yy": 0.5}, ((1 + NU / 2) / (1 - NU**2), (0.5 + NU) / (1 - NU**2), 0.0), (1.0, 0.5, 0.0)),
    "shear": ({"xx": 0.0, "yy": 0.0, "xy": 1.0}, (0.0, 0.0, 0.5 / (1 + NU)), (0.0, 0.0, 1.0)),
}


@pytest.mark.parametrize("boundary", ["edges", "periodic"])
def test_a_plain_volume_answers_as_its_material_does(boundary):
    for strain, stress, strained in CASES.values():
        gauges = readings(Simulation.of(volume(boundary, **strain)))[-1].gauges
        got = np.array([[gauges[f"{kind}_{c}"] for c in ("xx", "yy", "xy")] for kind in ("stress", "strain")])
        np.testing.assert_allclose(got[0] / (E * STRAIN), stress, atol=4e-3)
        np.testing.assert_allclose(got[1] / STRAIN, strained, atol=4e-3)


def test_layers_have_the_stiffness_of_springs_in_series_and_side_by_side():
    """Without Poisson's effect the bounds of Reuss and Voigt are exact."""
    moduli = np.array([1.0, 0.25]) * E
    for strain, expected in (({"xx": 1.0}, 2 / (1 / moduli).sum()), ({"yy": 1.0}, moduli.mean())):
        (component,) = strain
        sim = with_moduli(Simulation.of(volume("periodic", nu=0.0, **strain)), moduli)
        assert readings(sim)[-1].gauges[f"stress_{component}"] / STRAIN == pytest.approx(expected, rel=4e-3)


def test_energy_is_kept_where_a_free_periodic_volume_rings():
    """Suddenly stretched, without damping: fluctuation and mean strain swing, and nothing is lost."""
    sim = Simulation.of(volume("periodic", damping=0.0, duration=4e-6, xx=1.0))
    sim = with_moduli(sim, np.array([1.0, 0.25]) * E)
    for reading in readings(sim):
        external, stored, kinetic, *_ = reading.energies()
        assert external == pytest.approx(stored + kinetic, rel=2e-4)
    assert kinetic > 1e-3 * external
    motion = periodic.split(sim.state.velocity, 1.0)
    np.testing.assert_allclose(motion.own[:, 0], motion.own[:, -1], atol=1e-12 * np.abs(motion.own).max())
    np.testing.assert_allclose(motion.own[..., 0], motion.own[..., -1], atol=1e-12 * np.abs(motion.own).max())


def test_a_periodic_volume_does_not_know_where_it_begins():
    """Two phases moved along by some cells answer alike, cracks through the edges and all.

    Without damping, whose sign is that of round-off where nothing fluctuates.
    """
    answers = []
    for shift in (0, 2):
        sim = Simulation.of(volume("periodic", damping=0.0, ft=1.2, duration=2e-4, xx=1.0))
        weak = np.zeros(SHAPE, int)
        weak[:2, :3] = 1
        sim.model = dataclasses.replace(sim.model, material=jnp.asarray(np.roll(weak, (shift, shift), (0, 1)), jnp.int32))
        assert sim.model.numerics.normal_window > 1  # wider than a cell: it reaches across the edges
        sim = with_moduli(sim, np.array([1.0, 0.6]) * E)
        answers.append([(r.gauges["stress_xx"], r.gauges["strain_yy"], r.cracked) for r in readings(sim)])
    np.testing.assert_allclose(*answers, rtol=1e-7, atol=1e-12)
    assert answers[0][-1][2] > 0


def test_mean_stress_is_the_mean_of_the_cells_stress():
    sim = with_moduli(Simulation.of(volume("edges", xx=1.0)), np.array([1.0, 0.4]) * E)
    gauges = readings(sim)[-1].gauges
    stress = np.asarray(observe.frame(sim.model, sim.state, jnp.asarray(sim.dt))["stress"])
    for k, c in enumerate(("xx", "yy", "xy")):
        assert gauges[f"stress_{c}"] == pytest.approx(stress[k].mean(), abs=1e-9 * np.abs(stress).max())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"macro": {"boundary": "edges", "strain": {"xy": 1.0}}}, "macro.strain.*xx and yy too"),
        ({"macro": {"boundary": "edges", "strain": {}}}, "at least one of xx, yy, xy"),
        ({"supports": [{"set": "left", "fix": ["x"]}]}, "supports.*none with \\[macro\\]"),
        ({"gravity": [0.0, -9810.0]}, "gravity.*none with \\[macro\\]"),
        ({"bodies": [{"name": "all", "material": "one", "velocity": [9.0, 0.0], "shapes": [WHOLE]}]}, "bodies.0.velocity.*none"),
        ({"gravity": 9.81}, "gravity = 9.81: expected a list of 2"),
        ({"solver": {"duration": 1e-3, "frame": "updated"}}, 'solver.frame = "updated".*with \\[macro\\]'),
        ({"macro": None}, "gauges.stress_xx.kind.*a table \\[macro\\]"),
        ({"response": {"load": "strain_xx", "displacement": "strain_xx"}}, "response.load = .strain_xx"),
    ],
)
def test_what_does_not_go_with_a_mean_strain_is_refused(change, message):
    tree = volume("edges", xx=1.0).to_dict()
    if change.get("macro"):
        change = {"macro": tree["macro"] | change["macro"]}
    tree |= change | {"sets": {"left": {"inside": [{"kind": "rectangle", "min": [0.0, 0.0], "max": [0.0, 4.0]}]}}}
    with pytest.raises(SceneError, match=message):
        Scene.from_dict({key: value for key, value in tree.items() if value is not None})


def test_a_volume_with_holes_is_refused():
    tree = volume("edges", xx=1.0).to_dict()
    tree["bodies"] = [tree["bodies"][1]]
    with pytest.raises(SceneError, match="macro.boundary.*fill the grid"):
        Simulation.of(Scene.from_dict(tree))
