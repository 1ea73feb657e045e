"""What a chart changes in a scene."""

import numpy as np
import pytest

from jaxmpm.chart.picture import BY_AXIS, FAMILIES
from jaxmpm.chart.settings import AXES, Source, apply, cells, choices, key, label
from jaxmpm.layout import lay_out


def test_faster_loading_shortens_every_history_and_changes_no_value():
    slow, fast = (apply(Source("den_4a"), setting) for setting in ({}, {"speed": 2.0}))
    assert fast.solver.duration == slow.solver.duration / 2
    for one, other in zip((*slow.forces, *slow.displacements), (*fast.forces, *fast.displacements), strict=True):
        assert other.history.value == one.history.value
        np.testing.assert_allclose(np.array(other.history.time) * 2, one.history.time)
        assert other.history.smooth_start == one.history.smooth_start / 2
    volume = apply(Source("rve"), {"speed": 4.0})
    assert volume.macro.history.time[-1] == pytest.approx(0.25e-3)


def test_cells_change_by_the_parameter_that_other_numbers_follow():
    scene = apply(Source("bar"), {"cell": 5.0})
    weak = lay_out(scene).owner == 1
    assert weak.any(axis=1).sum() == 1  # still one column


def test_cells_that_would_lose_a_notch_are_refused_and_the_finest_is_kept():
    sizes, refused = cells(Source("beam", ("parameters.half=1.5",)), finest=1.25)
    assert sizes == [2.5, 1.25] and "at least a cell wide" in refused["5 mm"]
    assert cells(Source("beam"), finest=1.25)[0] == [5.0, 2.5, 1.25]  # there the notch is a cell wide


def test_another_law_has_the_strength_and_the_fracture_energy_of_the_first():
    band = apply(Source("den"), {"law": "hordijk"}).materials["concrete"].band
    assert (band.law, band.ft) == ("cohesive", 3.0)
    assert band.GF == pytest.approx(0.110036, rel=1e-5)


def test_equilibrium_leaves_out_what_only_motion_needs():
    found, refused = choices(Source("rve"), moved=False)
    scene = apply(Source("rve"), {"solver": "time", "speed": 1.0})
    assert scene.solver.kind == "quasistatic" and scene.solver.damping == 0.02
    assert "time" in found["solver"] and not any("equilibrium" == name for name in refused)


@pytest.mark.parametrize("name", ["discs", "brazil"])
def test_where_the_motion_is_the_matter_it_is_not_made_faster(name):
    assert "speed" not in choices(Source(name), moved=True)[0]


def test_points_in_cells_are_a_choice_only_where_points_move():
    of_discs, of_plate = choices(Source("discs"), moved=True)[0], choices(Source("den"), moved=False)[0]
    assert of_discs["per_side"] == [1, 3] and of_discs["transfer"] == ["flip", "apic", "xpic"]
    assert apply(Source("discs"), {"transfer": "apic"}).points.transfer == "apic"
    assert not {"per_side", "shape", "transfer"} & set(of_plate)


def test_every_choice_has_a_colour_on_the_chart():
    assert set(BY_AXIS) == set(AXES) and set(BY_AXIS.values()) <= set(FAMILIES)


def test_half_is_a_choice_of_what_is_symmetric_and_stays_in_the_total_frame():
    found = choices(Source("beam"), moved=False)[0]
    assert found["half"] == ["x"] and "half" not in choices(Source("beam"), moved=True)[0]
    assert "half" not in choices(Source("den"), moved=False)[0]
    half = apply(Source("beam"), {"half": "x", "cell": 1.25})
    assert lay_out(half).shape == (70, 40) and label({"half": "x"}, 2.5) == "2.5 mm, half along x"


def test_a_setting_is_named_in_words_and_told_from_others():
    setting = {"precision": "float32", "speed": 2.0, "cell": 5.0}
    assert label(setting, 2.5) == "5 mm, twice as fast, float32"
    assert label({}, 2.5) == "2.5 mm"
    assert key(setting) == key(dict(reversed(setting.items()))) != key({"cell": 5.0})
