"""Phases on a grid: the same structure for every cell, and layers thinner than a cell."""

import numpy as np
import pytest
from meso_scene import scene

from jaxmpm.layout import lay_out
from jaxmpm.mesostructure import sampling

MORTAR, STONE, ITZ = range(3)


class Layer:
    """A structure with one straight outline through a point; inclusion on the side of −normal."""

    def __init__(self, at, angle=0.0):
        self.at, self.normal = at, (np.cos(angle), np.sin(angle))

    def distance(self, x, y, most):
        d = (x[:, None] - self.at[0]) * self.normal[0] + (y - self.at[1]) * self.normal[1]
        return np.minimum(d, most)


def layered(monkeypatch, at, angle=0.0, **mesostructure):
    monkeypatch.setattr(sampling, "structure_of", lambda scene: Layer(at, angle))
    return lay_out(scene(mesostructure={"sampling": "mixed", **mesostructure}))


def test_finer_cells_see_the_same_structure():
    coarse = lay_out(scene(cell=0.5))
    fine = lay_out(scene(cell=0.5 / 3))
    assert coarse.materials == fine.materials == ("mortar", "stone", "itz")
    assert (fine.material[1::3, 1::3] == coarse.material).all()  # where their middles coincide
    assert lay_out(scene(cell=0.5, mesostructure={"seed": 5})).material.tolist() != coarse.material.tolist()


def test_shares_converge_to_those_asked_for():
    errors = [abs(lay_out(scene(cell=cell)).shares()["stone"] - 0.4) for cell in (0.5, 0.25, 0.125)]
    assert errors[-1] < 1e-3 and max(errors) < 0.02
    mixed = lay_out(scene(cell=0.5, mesostructure={"sampling": "mixed"}))
    assert mixed.shares()["stone"] == pytest.approx(0.4, abs=1e-3)
    assert mixed.local.shares.sum(axis=0) == pytest.approx(1.0)


def test_the_interface_is_that_thick():
    # Circles well apart: their rings have the area π t (d + t).
    stones = {"fraction": 0.2, "grading": {"kind": "fuller", "smallest": 3.0, "largest": 6.0}, "gap": 1.2}
    one = scene(cell=0.125, mesostructure={"inclusions": stones})
    sizes = sampling.structure_of(one).sizes
    ring = np.pi * 0.5 * (sizes + 0.5).sum() / 24**2
    assert lay_out(one).shares()["itz"] == pytest.approx(ring, rel=0.01)


def test_periodic_phases_are_those_of_a_cell_beyond_the_edge():
    stones = {"fraction": 0.5, "grading": {"kind": "fuller", "smallest": 2.0, "largest": 5.0}, "edges": "periodic"}
    sampler = sampling.Sampler(scene(mesostructure={"inclusions": stones}))
    line = (np.arange(48) + 0.5) * 0.5
    assert (sampler.at(np.array([0.0, 24.0]), line)[0] == sampler.at(np.array([0.0, 24.0]), line)[1]).all()
    assert (sampler.at(line, np.array([0.0, 24.0]))[:, 0] == sampler.at(line, np.array([0.0, 24.0]))[:, 1]).all()


def test_a_body_may_be_a_part_of_the_grid():
    def block(x, name, material):
        shape = {"kind": "rectangle", "min": [x, 0.0], "max": [x + 12.0, 24.0]}
        return {"name": name, "material": material, "shapes": [shape]}

    layout = lay_out(scene(bodies=[block(0.0, "plate", "itz"), block(12.0, "block", "mortar")], cell=0.25))
    assert (layout.material[:48] == ITZ).all()
    right = layout.material[48:]
    assert (right == STONE).mean() == pytest.approx(0.4, abs=0.02)
    assert sampling.box_of(scene().bodies[0], scene().grid) == (0.0, 0.0, 24.0, 24.0)


def test_without_a_mesostructure_nothing_is_local():
    layout = lay_out(scene())
    assert layout.local is None
    assert lay_out(scene(mesostructure={"sampling": "mixed"})).local.strength is None


@pytest.mark.parametrize("thickness", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("at", [6.0, 6.1, 6.25, 6.4])
def test_one_column_of_cells_has_the_bands_of_a_thin_upright_layer(monkeypatch, at, thickness):
    layout = layered(monkeypatch, (at, 0.0), interface_thickness=thickness)
    columns = (layout.material == ITZ).all(axis=1)
    assert columns.sum() == 1 and (layout.material == ITZ).any(axis=1).sum() == 1
    (column,) = np.flatnonzero(columns)
    assert 0.5 * column < at + 0.5 * thickness <= 0.5 * (column + 1)
    share = layout.local.shares[:, column, 3]
    if 0.5 * column <= at and at + thickness <= 0.5 * (column + 1):
        assert share[ITZ] == pytest.approx(thickness / 0.5)
        assert share[STONE] == pytest.approx((at - 0.5 * column) / 0.5)


@pytest.mark.parametrize("angle", [10.0, 30.0, 45.0])
def test_an_inclined_layer_has_the_energy_of_its_length(monkeypatch, angle):
    # A cracked cell has the area c²/H of crack per thickness, H = c (|n_x| + |n_y|): see bands.effective_size.
    angle = np.deg2rad(angle)
    layout = layered(monkeypatch, (12.1, 12.0), angle, interface_thickness=0.1)
    length = 24.0 / np.cos(angle)
    across = 0.5 * (np.cos(angle) + np.sin(angle))
    cells = (layout.material == ITZ).sum()
    assert cells * 0.5**2 / across == pytest.approx(length, rel=0.03)
    assert layout.local.shares[ITZ].sum() * 0.5**2 == pytest.approx(0.1 * length, rel=0.01)
    # and the cells hang together
    rows = [np.flatnonzero(row) for row in (layout.material == ITZ).T]
    assert all(len(row) for row in rows)
    assert all(set(a) & set(b) for a, b in zip(rows, rows[1:], strict=False))
