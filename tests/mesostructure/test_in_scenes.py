"""What cells made of phases are in a model, in frames, in points that move, and by name."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meso_scene import scene

from jaxmpm import hand_over
from jaxmpm import model as models
from jaxmpm.differentiable import Run
from jaxmpm.errors import SceneError
from jaxmpm.layout import lay_out
from jaxmpm.mesostructure.sampling import Local
from jaxmpm.simulation import Simulation

MIXED = {"sampling": "mixed", "interface_thickness": 0.2}
SCATTER = {"mortar": {"modulus": 8.0, "length": 2.0}, "itz": {"modulus": 5.0, "length": 0.0, "seed": 3}}
E, NU, DENSITY = np.array([25000.0, 60000.0, 15000.0]), np.array([0.2, 0.3, 0.25]), np.array([2.2, 2.7, 2.0]) * 1e-9


def made(**changes):
    one = scene(**changes)
    layout = lay_out(one)
    return layout, models.from_layout(one, layout)


def test_by_their_middle_cells_share_the_numbers_of_three_materials():
    layout, model = made()
    assert model.embedding.bulk.E.tolist() == E.tolist()
    assert (np.asarray(model.material) == layout.material).all()


def test_mixed_cells_have_hills_mean_of_their_layers():
    layout, model = made(mesostructure=MIXED)
    shares = layout.local.shares.reshape(3, -1)
    voigt = (shares * E[:, None]).sum(axis=0)
    reuss = 1 / (shares / E[:, None]).sum(axis=0)
    assert np.asarray(model.embedding.bulk.E) == pytest.approx((voigt + reuss) / 2, rel=1e-12)
    assert np.asarray(model.embedding.bulk.nu) == pytest.approx(NU @ shares, rel=1e-12)
    # mass is that of the phases
    prepared = models.fields(model)
    expected = 24**2 * 10.0 * sum(DENSITY[k] * list(layout.shares().values())[k] for k in range(3))
    assert float(prepared.mass.sum()) == pytest.approx(expected, rel=1e-12)
    # a cell has the band of one phase
    strength = np.array([3.0, np.inf, 1.5])[layout.material.reshape(-1)]
    assert np.asarray(model.embedding.law.ft).tolist() == strength.tolist()


def test_a_layer_of_two_materials_in_closed_form():
    # half mortar, half stone: Voigt 42500, Reuss 35294.1 MPa
    layout, _ = made()
    base = models.by_materials(scene(), layout)
    shares = np.full((3, *layout.shape), [[[0.5]], [[0.5]], [[0.0]]])
    model = models.with_local(base, Local(None, shares))
    assert np.asarray(model.embedding.bulk.E) == pytest.approx((42500 + 2 / (1 / 25e3 + 1 / 60e3)) / 2)


def test_scatter_is_of_the_strength_and_keeps_the_shape_of_softening():
    layout, model = made(scatter=SCATTER)
    factor, material = layout.local.strength, layout.material
    assert (factor[material == 1] == 1).all()
    assert factor[material == 0].std() > 0.05 and factor[material == 2].std() > 0.1
    law = model.embedding.law
    assert np.asarray(law.ft) == pytest.approx((np.array([3.0, np.inf, 1.5])[material] * factor).reshape(-1))
    assert set(np.asarray(law.Ep).tolist()) == {8.0} and set(np.asarray(law.n).tolist()) == {0.15}


def test_scatter_of_a_cohesive_law_keeps_its_characteristic_length():
    one = scene(scatter=SCATTER).to_dict()
    for name in ("mortar", "itz"):
        one["materials"][name]["band"] = {"law": "cohesive", "ft": 2.0, "GF": 0.1, "h": 0.01}
    one = type(scene()).from_dict(one)
    law = models.from_layout(one, lay_out(one)).embedding.law
    cracks = np.isfinite(np.asarray(law.ft))
    length = np.asarray(law.GF)[cracks] / np.asarray(law.ft)[cracks] ** 2
    assert length == pytest.approx(0.1 / 4.0)
    assert np.ptp(np.asarray(law.GF)[cracks]) > 0.02


def test_mixed_cells_too_soft_for_a_band_are_refused():
    # An interface stiffer than what it is mixed with: its own H_max would do, that of the mixture not.
    tables = scene(mesostructure=MIXED).to_dict()
    tables["materials"]["itz"]["band"]["Ep"] = 100.0
    tables["materials"]["itz"]["bulk"]["E"] = 15000.0
    tables["materials"]["mortar"]["bulk"]["E"] = 1000.0
    tables["materials"]["mortar"]["band"]["Ep"] = 5.0
    one = type(scene()).from_dict(tables)
    with pytest.raises(SceneError, match=r'grid.cell = 0.5: expected at most 0\.\d+ mm with mesostructure.sampling = "mixed"'):
        models.from_layout(one, lay_out(one))


def test_frames_tell_phases_and_bodies_start_with_the_mass_of_their_phases():
    sim = Simulation.of(scene(cell=1.0, scatter=SCATTER, mesostructure={"interface_thickness": 1.0}))
    centres, data = sim.frame()
    x, y = (np.floor(centres[:, k]).astype(int) for k in (0, 1))
    assert (data["material"] == sim.layout.material[x, y]).all()
    assert set(data["material"]) == {0.0, 1.0, 2.0}


def test_points_that_move_are_of_the_phase_of_their_cell(monkeypatch):
    monkeypatch.setattr(hand_over, "_settled", lambda model, state: state)  # stresses, which are compiled, are zero
    one = scene(cell=1.0, mesostructure={"interface_thickness": 1.0}, solver={"duration": 1e-4, "frame": "updated"})
    sim = Simulation.of(one)
    _, state = hand_over.to_points(one, sim.layout, sim.model, sim.state, 0.0)
    points = state.points
    used = np.asarray(points.mass) > 0
    x, y = (np.floor(np.asarray(c)[used] + 1e-9).astype(int) for c in points.home)
    expected = sim.layout.material[x, y]
    assert (np.asarray(points.material)[used] == expected).all()
    assert np.asarray(points.mass)[used] == pytest.approx(DENSITY[expected] * 10.0 / 4)


@pytest.mark.parametrize("changes", [{"scatter": SCATTER}, {"mesostructure": MIXED}])
def test_numbers_of_materials_by_name_reach_their_cells(changes):
    one = scene(solver={"duration": 1e-4, "frame": "total", "damping": 0.0, "viscosity": 0.1}, **changes)
    run = Run.of(one)
    assert run.values(["itz.ft", "stone.E"]) == {"itz.ft": 1.5, "stone.E": 60000.0}
    law = lambda model: np.asarray(model.embedding.law.ft).reshape(run.model.material.shape)  # noqa: E731
    changed = run.with_values({"itz.ft": 3.0, "stone.E": 50000.0})
    itz = lay_out(one).material == 2
    assert law(changed)[itz] == pytest.approx(2 * law(run.model)[itz])
    assert (law(changed)[~itz] == law(run.model)[~itz]).all()
    mean = lambda E: run.with_values({"stone.E": E}).embedding.bulk.E.mean()  # noqa: E731
    slope = float(jax.grad(mean)(60000.0))
    assert slope == pytest.approx(float(mean(60600.0) - mean(59400.0)) / 1200.0, rel=1e-4)
    assert jax.tree.structure(run.by_cells().model) == jax.tree.structure(run.model)
    assert all((jnp.asarray(a) == jnp.asarray(b)).all() for a, b in zip(*map(jax.tree.leaves, (run.by_cells().model, run.model)), strict=True))
