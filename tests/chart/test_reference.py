"""Outcomes of runs and how far they are from a reference, against shapes whose answer is known."""

import numpy as np
import pytest

from jaxmpm.chart import outcome, reference
from jaxmpm.errors import SceneError
from jaxmpm.results import History
from jaxmpm.scene import load_scene


def triangle(top=10.0, at=1.0, end=3.0, sign=1.0, crack=()):
    """Up to a load at a displacement, down to none at the end."""
    x = np.linspace(0.0, end, 301)
    load = np.interp(x, [0.0, at, end], [0.0, top, 0.0])
    return {"displacement": list(sign * x), "load": list(sign * load), "motion": False, "crack": [list(cell) for cell in crack]}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_peak_work_and_fall_of_a_triangle(sign):
    one = triangle(sign=sign)
    assert outcome.peak(one) == pytest.approx(10.0)
    assert outcome.fallen(one) == pytest.approx(2.0)
    assert outcome.work(one, 3.0) == pytest.approx(15.0)
    assert outcome.work(one, 2.003) == pytest.approx(15.0 - 5 / 2 * 0.997**2)  # between two rows


def test_where_the_displacement_goes_back_the_work_is_of_the_curve_ahead():
    one = triangle()
    one["displacement"][200:200] = [1.5, 1.0]
    one["load"][200:200] = [90.0, 90.0]
    assert outcome.work(one, 3.0) == pytest.approx(15.0)


def test_a_curve_twice_as_high_is_one_away():
    assert outcome.curve_distance(triangle(top=20.0), triangle()) == pytest.approx(1.0)
    assert outcome.curve_distance(triangle(), triangle()) == 0.0


def test_cracks_are_apart_by_the_distance_of_their_open_cells():
    x = np.linspace(0.0, 50.0, 21)
    line = lambda y, opening: [(a, y, opening) for a in x]  # noqa: E731
    one, other = triangle(crack=line(10.0, 0.1)), triangle(crack=line(12.0, 0.3))
    assert outcome.path_distance(one, other) == pytest.approx(2.0)
    beside = triangle(crack=[*line(12.0, 0.3), *line(40.0, 1e-9)])  # has hardly opened
    assert outcome.path_distance(one, beside) == pytest.approx(2.0, rel=1e-6)
    half = triangle(crack=line(10.0, 0.1)[:11])
    assert outcome.path_distance(one, half) > 1.0  # what one lacks counts
    assert outcome.path_distance(one, triangle()) is None


def ladder(value, sizes):
    return [(size, triangle(top=value(size))) for size in sizes]


def test_numbers_that_converge_steadily_are_taken_to_their_limit():
    found = reference.of_runs(ladder(lambda h: 10.0 + 0.3 * h**1.5, (8.0, 4.0, 2.0, 1.0)), extrapolate=True)
    assert found.numbers["peak"] == pytest.approx(10.0) and "order 1.50" in found.how["peak"]
    finest = reference.of_runs(ladder(lambda h: 10.0 + 0.3 * h**1.5, (8.0, 4.0, 2.0, 1.0)), extrapolate=False)
    assert finest.numbers["peak"] == pytest.approx(10.3)
    assert finest.floor["peak"] == pytest.approx(0.3 * (2**1.5 - 1) / 10.3)


@pytest.mark.parametrize(
    ("value", "sizes"),
    [
        (lambda h: 10.0 + 0.3 * h, (4.0, 2.0, 1.0)),  # too few to know
        (lambda h: 10.0 + 0.3 * np.log2(h), (8.0, 4.0, 2.0, 1.0)),  # goes on growing
        (lambda h: 10.0 + 0.3 * (-1) ** np.log2(h), (8.0, 4.0, 2.0, 1.0)),  # goes back and forth
        (lambda h: 10.0 + 0.3 * h, (8.0, 6.0, 3.5, 1.0)),  # cells that are not halved
    ],
)
def test_others_are_taken_from_the_finest_run(value, sizes):
    found = reference.of_runs(ladder(value, sizes), extrapolate=True)
    assert found.numbers["peak"] == pytest.approx(value(sizes[-1])) and found.how["peak"] == "1 mm"


def test_errors_have_a_sign_and_count_the_work_up_to_where_the_reference_has_fallen():
    found = reference.of_runs([(1.0, triangle())], extrapolate=True)
    assert found.until == pytest.approx(2.0)
    errors = reference.errors_of(triangle(top=9.0), found)
    assert errors["peak"] == pytest.approx(-0.1) and errors["work"] == pytest.approx(-0.1)
    assert errors["curve"] == pytest.approx(0.1) and errors["path"] is None
    assert reference.worst(errors, ["peak", "work"]) == pytest.approx(0.1)


def test_of_bodies_that_move_the_kinetic_energy_kept_is_compared_and_all_energy_with_none_lost():
    moving = lambda end, lost: {"displacement": [0.0, 1.0, 2.0], "load": [8.0, 2.0, end], "motion": True, "balance": lost, "crack": []}  # noqa: E731
    found = reference.of_runs([(2.0, moving(5.0, 0.1)), (1.0, moving(7.0, 0.05))], extrapolate=True)
    assert found.names == ["end", "balance"] and found.numbers["end"] == pytest.approx(7 / 8)
    errors = reference.errors_of(moving(6.0, -0.02), found)
    assert errors["end"] == pytest.approx(-1 / 8) and errors["balance"] == pytest.approx(-0.02)
    assert reference.errors_of(moving(7.0, 0.05), found)["balance"] == pytest.approx(0.05)  # known: the finest run is off as well
    assert found.floor["balance"] == 0.0 and found.floor["end"] == pytest.approx(2 / 7)


def test_a_band_of_tests_is_its_middle_and_half_its_width_is_left_open(tmp_path):
    scene = load_scene("beam")
    file = tmp_path / "tests.csv"
    file.write_text("cmod_mm,low_N,high_N\n0,0,0\n0.02,900,1100\n0.1,400,600\n0.2,100,300\n")
    found = reference.of_file(file, scene)
    assert found.given and found.numbers["peak"] == pytest.approx(1000.0) and found.floor["peak"] == pytest.approx(0.1)
    with pytest.raises(SceneError, match="expected a CSV table that begins with the line cmod_mm"):
        reference.of_file(__file__, scene)
    with pytest.raises(SceneError, match="response: absent"):
        reference.of_file(file, load_scene("discs"))


def test_the_history_of_another_run_is_a_reference_too(tmp_path):
    one = triangle()
    with History.create(tmp_path / "history.csv", [("step", ""), ("cmod", "mm"), ("load", "N")]) as history:
        for step, row in enumerate(zip(one["displacement"], one["load"], strict=True)):
            history.append([step, *row])
    found = reference.of_file(tmp_path / "history.csv", load_scene("beam"))
    assert found.numbers["peak"] == pytest.approx(10.0) and found.floor["peak"] == 0.0
