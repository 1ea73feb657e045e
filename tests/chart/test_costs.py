"""Predictions of what a run takes, against machines whose law is known."""

import pytest

from jaxmpm.chart.costs import Costs


def machine(setting, power=3.0):
    """Seconds of a setting of a scene with cells of 2 mm."""
    return (
        5.0 * (2.0 / setting.get("cell", 2.0)) ** power / setting.get("speed", 1.0)
        * {"float32": 0.6}.get(setting.get("precision"), 1.0)
    )  # fmt: skip


def timed(*settings, **law):
    return Costs([(setting, machine(setting, **law), 4.0) for setting in settings], cell=2.0, step=0.9)


def test_finer_cells_go_by_the_slope_of_those_that_were_run():
    costs = timed({"cell": 8.0}, {"cell": 4.0}, power=2.6)
    assert costs.seconds({}) == pytest.approx(machine({}, power=2.6))
    assert costs.seconds({"cell": 6.0}) == pytest.approx(machine({"cell": 6.0}, power=2.6))
    assert timed({"cell": 8.0}).seconds({"cell": 4.0}) == pytest.approx(8 * machine({"cell": 8.0}))
    assert timed({"cell": 8.0}, {"cell": 4.0}, power=6.0).seconds({}) < machine({}, power=6.0)  # not believed


def test_choices_are_factors_that_are_measured_where_they_were_and_carried_over():
    costs = timed({"cell": 4.0}, {}, {"cell": 4.0, "precision": "float32"}, {"cell": 4.0, "speed": 2.0})
    assert costs.seconds({"cell": 1.0, "precision": "float32"}) == pytest.approx(machine({"cell": 1.0, "precision": "float32"}))
    both = {"speed": 2.0, "precision": "float32"}
    assert costs.seconds(both) == pytest.approx(machine(both))
    assert costs.seconds({"speed": 4.0}) == pytest.approx(machine({"speed": 4.0}))  # before it was tried
    assert costs.seconds({"step": 0.45}) == pytest.approx(2 * machine({}))


def test_equilibrium_grows_faster_with_finer_cells():
    costs = timed({"cell": 4.0}, {}, {"cell": 4.0, "solver": "time"})
    assert costs.seconds({"solver": "time"}) > machine({})
    assert costs.seconds({"cell": 4.0, "solver": "time"}) == pytest.approx(machine({"cell": 4.0}))


def test_compilation_and_files_are_what_they_were():
    assert timed({}).overhead() == 4.0
