"""Charts: what is tried, in what order, within what time; on a scene that is run and on one made up of formulae."""

import csv
import json

import numpy as np
import pytest
from chart_scene import Machine, seconds_by_work, write_scene

from jaxmpm import cli
from jaxmpm.chart import classes, draw_chart, read_chart, table
from jaxmpm.chart import run as charts
from jaxmpm.chart.front import front, judged, percent
from jaxmpm.chart.settings import Source
from jaxmpm.errors import RunError

HASTY = True


@pytest.fixture
def machine(monkeypatch):
    """Without pictures, which take longer than all else here."""
    from jaxmpm.chart import picture

    made = Machine(monkeypatch)
    made.plot = picture.plot_chart
    monkeypatch.setattr(picture, "plot_chart", lambda *_: None)
    return made


def chart(machine, directory, budget=600.0, **more):
    return charts.chart_scene(Source("den"), directory, budget, progress=False, **more)


def test_a_chart_finds_the_front_and_keeps_to_its_budget(machine, tmp_path):
    for budget, finest in ((60.0, 2.5), (200.0, 1.25), (900.0, 0.625)):  # which takes half of it at most
        machine.now = 0.0
        found = chart(machine, tmp_path / f"{budget:g}", budget)
        assert machine.now <= budget
        sizes = [record["cell_size"] for record in found["runs"] if not set(record["setting"]) - {"cell"}]
        first = [size for size in (5.0, 2.5, 1.25, 0.625) if size >= finest]
        assert sizes[: len(first)] == first == [record["cell_size"] for record in found["runs"][: len(first)]]  # coarse to fine
    runs = [record for record in found["runs"] if "seconds" in record]
    assert [record["label"] for record in front(runs)][-1] == "0.625 mm"
    for record in runs:  # nothing that was measured beats a member of the front by more than what counts as better
        for member in front(runs):
            assert not (record["seconds"] < member["seconds"] and record["error"] < 0.9 * member["error"]) or "law" in record["setting"]


def test_choices_that_pay_are_put_together_and_those_that_do_not_are_dropped(machine, tmp_path):
    found = chart(machine, tmp_path, 900.0)
    keys = [record["key"] for record in found["runs"]]
    assert any("speed" in key and "precision=float32" in key for key in keys)
    slow = [key for key in keys if "frame" in key]
    assert len(slow) == 1  # ten times as long and no better: tried once, on the coarsest cells
    assert sum("law=" in key for key in keys) == 2 and not any(record["front"] for record in found["runs"] if "law" in record["setting"])


def test_what_tolerances_build_on_is_run_where_a_chart_left_it_out(machine, tmp_path):
    chart(machine, tmp_path / "den", 200.0)
    counts = [len(read_chart(tmp_path / "den")["runs"])]
    for _ in range(2):
        classes.main([str(tmp_path / "den"), "--out", str(tmp_path / "measured.json")])
        (known,) = json.loads((tmp_path / "measured.json").read_text())["charts"]
        there = [run["setting"] for run in known["runs"]]
        assert all({"cell": 2.5 * ratio} | choice in there for ratio, choice in classes.NEEDED)
        assert len([one for one in there if 1.25 < one["cell"] < 2.5]) == len(classes.BETWEEN)
        counts.append(len(read_chart(tmp_path / "den")["runs"]))
    assert counts[0] < counts[1] == counts[2]  # nothing is left for the second time


def test_only_the_choices_that_are_named_are_tried(machine, tmp_path):
    from jaxmpm.chart.settings import AXES
    from jaxmpm.cli_chart import CHOICES

    found = chart(machine, tmp_path, 400.0, only=("precision",))
    assert {name for record in found["runs"] for name in record["setting"]} == {"cell", "precision"}
    assert CHOICES == tuple(AXES)


def test_what_tolerances_build_on_is_made_of_charts_by_one_command(machine, tmp_path):
    from jaxmpm.chart import classes
    from jaxmpm.results import ResultError

    chart(machine, tmp_path / "den", 900.0)
    classes.main([str(tmp_path / "den"), "--out", str(tmp_path / "measured.json")])
    known = json.loads((tmp_path / "measured.json").read_text())["charts"]
    assert [one["scene"] for one in known] == ["den"] and known[0]["made_on"]["cores"] >= 1
    experience = classes.Experience("specimen", known)
    for speed in (2.0, 4.0):
        shifts = [machine.top({"cell": cell, "speed": speed}) / machine.top({"cell": cell}) - 1 for cell in (2.5, 0.625)]
        assert min(shifts) <= experience.shift("peak", False, speed=speed) <= max(shifts) + 1e-6
    with pytest.raises(ResultError, match="chart.json"):
        classes.main([str(tmp_path)])
    with pytest.raises(ResultError, match="--out = .*expected a file in a folder"):
        classes.main([str(tmp_path / "den"), "--out", str(tmp_path / "no" / "measured.json")])
    machine.fails = lambda setting: True
    with pytest.raises(RunError):
        chart(machine, tmp_path / "none", 60.0)
    with pytest.raises(ResultError, match="no run came to its end"):
        classes.main([str(tmp_path / "none"), "--out", str(tmp_path / "measured.json")])


def test_a_run_that_fails_is_recorded_with_its_reason_and_the_chart_goes_on(machine, tmp_path):
    machine.fails = lambda setting: setting.get("speed") == 4.0
    found = chart(machine, tmp_path, 300.0)
    failed = [record for record in found["runs"] if "seconds" not in record]
    assert failed and all(record["status"] == "stopped: too fast" for record in failed)
    assert front(found["runs"]) and table(found)[-1]["status"] == "stopped: too fast"
    machine.fails = lambda setting: True
    with pytest.raises(RunError, match="no setting came to its end: 5 mm: stopped: too fast"):
        chart(machine, tmp_path / "none", 300.0)


def test_going_on_runs_nothing_twice_and_reaches_finer_cells(machine, tmp_path):
    first = chart(machine, tmp_path, 100.0)
    ran, machine.ran = machine.ran, []
    more = chart(machine, tmp_path, 2000.0, resume=True)
    assert not {record["key"] for record in first["runs"]} & set(machine.ran) and len(set(ran)) == len(first["runs"])
    assert min(record["cell_size"] for record in more["runs"] if "seconds" in record) == 0.625
    assert "cells of 0.625 mm" in more["says"]
    from jaxmpm.results import ResultError

    with pytest.raises(ResultError, match="grid.cell was 2.5 and is 1.25"):
        charts.chart_scene(Source("den", ("grid.cell=1.25",)), tmp_path, 10.0, resume=True, progress=False)


def test_timings_count_as_the_machine_was(machine, tmp_path):
    machine.slows = lambda now: 1.0 if now < 100.0 else 2.5  # others come and go
    found = chart(machine, tmp_path, 600.0)
    usual = np.array([record["seconds"] / machine.seconds(record["setting"]) for record in found["runs"]])
    assert (np.abs(usual / np.median(usual) - 1) < 1e-9).mean() > 0.9 and np.ptp(usual) > 0  # but for the one in between
    low, high = (np.array([record[name] for record in found["runs"]]) for name in ("low", "high"))
    assert (low <= high).all()


def test_the_front_is_what_nothing_beats_and_a_changed_model_is_none_of_it():
    make = lambda seconds, error, **setting: {  # noqa: E731
        "setting": setting, "seconds": seconds, "errors": {"peak": -error, "work": 0.0}, "label": f"{seconds:g}",
    }  # fmt: skip
    records = [make(1, 0.08), make(2, 0.02), make(3, 0.03), make(4, 0.0199), make(5, 0.004), make(0.5, 0.001, law="hordijk"), {"setting": {}}]
    assert [one["seconds"] for one in front(judged(records, ["peak", "work"], given=False))] == [1, 2, 5]
    assert [one["seconds"] for one in front(judged(records, ["peak", "work"], given=True))] == [0.5]


def test_the_sentence_names_the_cheapest_for_each_error(machine, tmp_path):
    found = chart(machine, tmp_path, 900.0)
    members = front(found["runs"])
    for level in (0.05, 0.02):
        cheapest = next(one for one in members if one["error"] <= level)
        assert cheapest["label"] in found["says"]
    assert found["says"].startswith("Within 5 % of cells of 0.625 mm (peak and work): ")
    assert percent(0.0213) == "2.1 %" and percent(0.00047) == "0.047 %" and percent(0.123) == "12 %"


def test_the_picture_has_a_mark_for_every_setting_and_numbers_the_front(machine, tmp_path, figures):
    found = chart(machine, tmp_path, 300.0)
    machine.plot(found, tmp_path / "chart.svg")
    main, *small = figures[0].axes[:5]
    numbers = [text.get_text() for text in main.texts if text.get_text().isdigit()]
    assert numbers == [str(k + 1) for k in range(len(front(found["runs"])))]
    marks = {tuple(np.ravel(line.get_xydata())) for line in main.lines}
    for record in found["runs"]:
        if record["error"] > 1e-5:
            assert (record["seconds"], record["error"]) in marks
    assert [axes.get_title(loc="left") for axes in small][0] == "peak load"
    assert "mm" in small[1].get_title(loc="left")


def test_a_scene_is_charted_by_the_command_and_drawn_on_axes_of_ones_own(tmp_path, monkeypatch, capsys):
    from matplotlib.figure import Figure

    monkeypatch.setattr(charts, "choices", lambda *_: ({"precision": ["float32"]}, {}))
    monkeypatch.setattr(charts, "cells", lambda _: ([10.0, 5.0], {}))
    monkeypatch.setattr("jaxmpm.chart.measure.REPEATS", ((3.0, 2),))
    monkeypatch.setattr("jaxmpm.chart.measure.run_seconds", seconds_by_work)
    arguments = ["chart", str(write_scene(tmp_path)), "--out", str(tmp_path / "chart"), "--budget", "10m"]
    assert cli.main(arguments) == 0
    out, err = capsys.readouterr()
    assert "on the front" in out and "Within" in out and "foreseen" in err
    assert {path.name for path in (tmp_path / "chart").iterdir()} == {"chart.png", "chart.pdf", "chart.csv", "chart.json"}
    found = read_chart(tmp_path / "chart")
    assert [record["label"] for record in found["runs"]] == ["10 mm", "5 mm", "10 mm, float32", "5 mm, float32"]
    coarse, fine, single, _ = found["runs"]
    assert 0.001 < coarse["error"] < 0.3 and fine["error"] == 0.0
    assert abs(single["errors"]["work"] - coarse["errors"]["work"]) < 1e-4  # digits of float32
    assert coarse["compile_seconds"] > 0 and len(coarse["timings"]) == 2
    with open(tmp_path / "chart" / "chart.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["seconds [s]"]) for row in rows] == sorted(record["seconds"] for record in found["runs"])
    axes = Figure().add_subplot()
    draw_chart(axes, found, "work", numbered=False)
    assert axes.get_xscale() == axes.get_yscale() == "log" and axes.get_xlabel() == "time of the run [s]"
    before = json.loads((tmp_path / "chart" / "chart.json").read_text())["runs"]
    monkeypatch.setattr("jaxmpm.chart.picture.plot_chart", lambda *_: None)
    assert cli.main([*arguments, "--resume", "--quiet"]) == 0
    assert [record["timings"] for record in read_chart(tmp_path / "chart")["runs"]] == [record["timings"] for record in before]


def test_a_run_that_takes_too_long_is_given_up(tmp_path):
    from jaxmpm.chart.measure import run_setting

    with pytest.raises(RunError, match="longer than the 0 s that it was given"):
        run_setting(Source(str(write_scene(tmp_path))), {}, 0.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--budget 10", None),
        ("--budget ten", "--budget = ten: expected a time such as 90s, 10m or 1h"),
        ("--budget 0s", "--budget = 0s: expected"),
        ("--to -1", "--to = -1: expected a displacement above zero"),
        ("--reference none.csv", "none.csv"),
        ("--choices speed,precison", "precison is none (did you mean precision?)"),
        ("--set grid.cel=1", "grid.cel = 1"),
    ],
)
def test_options_of_a_chart_are_refused_by_name(options, words, tmp_path, capsys, monkeypatch):
    from jaxmpm import chart as room

    if words is None:  # seconds without a unit
        monkeypatch.setattr(room, "chart_scene", lambda source, directory, budget, *_, **__: (_ for _ in ()).throw(RunError(f"{budget}")))
        assert cli.main(["chart", "bar", "--out", str(tmp_path / "none"), *options.split()]) == cli.STOPPED
        assert "10.0" in capsys.readouterr().err
        return
    assert cli.main(["chart", "bar", "--out", str(tmp_path / "none"), *options.split()]) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert words in err and not out and not (tmp_path / "none").exists()
