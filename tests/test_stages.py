"""Stages of a response, on a made-up run that cracks all over first and in one column later."""

import csv

import numpy as np
import pytest

from jaxmpm.plot_stages import plot_stages
from jaxmpm.results import History, ResultError, write_summary
from jaxmpm.stages import chosen, final_crack, find_stages
from jaxmpm.vtkhdf import PointCloudWriter

N, FRAMES, CRACK = 10, 21, 4  # cells each way; frames; the column of the final crack
FIELDS = {"displacement": 3, "stress": 3, "damage": 1, "opening": 1, "normal": 3, "material": 1}
COLUMNS = (("step", ""), ("time", "s"), ("stress", "MPa"), ("strain", ""))


def load_at(time):
    """Rises to 2 at time 8 and falls to a tenth of it at 20."""
    return np.interp(time, [0.0, 8.0, 20.0], [0.0, 2.0, 0.2])


def write_run(directory, fields=FIELDS):
    """Every other column cracks alike from frame 4 to 8; from then on the column CRACK alone goes on."""
    i, j = np.indices((N, N)).reshape(2, -1)
    points = np.stack([i + 0.5, j + 0.5, 0.0 * i], axis=1)
    with History.create(directory / "history.csv", COLUMNS) as history:
        for k in range(4 * FRAMES - 3):
            history.append((k, k / 4, load_at(k / 4), 1e-5 * k / 4))
    with PointCloudWriter.create(directory / "result.vtkhdf", fields) as writer:
        for k in range(FRAMES):
            opening = np.where(i % 2 == 0, 1e-4 * np.clip(k - 4, 0, 4), 0.0) + np.where(i == CRACK, 1e-3 * max(k - 8, 0), 0.0)
            data = {name: np.zeros((N * N, size) if size > 1 else N * N) for name, size in fields.items()}
            data |= {"opening": opening, "damage": 1 - np.exp(-1e3 * opening), "material": (i > 6).astype(float)}
            writer.write(float(k), points, data)
    response = {"load": "stress", "displacement": "strain"}
    known = {"scene": "made", "title": "Made up", "cell_size": 1.0, "status": "completed", "response": response}
    write_summary(directory, known | {"load_unit": "MPa"})


def test_increments_spread_before_the_peak_and_gather_after_it(tmp_path):
    write_run(tmp_path)
    stages = find_stages(tmp_path)
    assert [stage.frame for stage in stages] == [7, 8, 12, 17, 20]
    assert [stage.load for stage in stages] == pytest.approx(load_at(np.array([7, 8, 12, 17, 20])))
    before, after = stages[:2], stages[2:]
    assert [s.share_of_opening for s in before] == pytest.approx([0.2, 0.2])  # one of five columns alike
    assert [s.active for s in before] == pytest.approx([50, 50])
    assert [s.share_of_opening for s in after] == pytest.approx([1.0] * 3)
    assert [s.active for s in after] == pytest.approx([10] * 3)
    assert all(s.cracked == 50 for s in stages)
    assert stages[1].share_of_damage == pytest.approx(0.2)


def test_the_final_crack_is_what_has_opened_most():
    assert final_crack(np.array([0.0, 1e-4, 0.011, 0.1])).tolist() == [False, False, True, True]
    assert not final_crack(np.zeros(3)).any()


def test_a_response_without_softening_has_no_stage_behind_its_peak():
    assert chosen(np.linspace(0.0, 1.0, 11)) == [8, 10]
    assert chosen(np.array([0.0, -1.0, -2.0, -1.0])) == [2, 3]


def test_the_picture_numbers_the_stages_and_tells_the_shares(tmp_path, figures):
    write_run(tmp_path)
    path = plot_stages(tmp_path)
    assert path == tmp_path / "stages.png" and path.stat().st_size > 10_000
    import matplotlib.text

    words = [text.get_text() for text in figures[0].findobj(matplotlib.text.Text)]
    assert words.count("20% in the final crack") >= 2 and words.count("100% in the final crack") >= 3
    assert {"1", "2", "3", "4", "5"} <= set(words)
    with open(tmp_path / "stages.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["share_of_opening"] for row in rows] == ["0.2000"] * 2 + ["1.0000"] * 3


def test_points_that_move_have_no_stages(tmp_path):
    write_run(tmp_path, FIELDS | {"side": 1})
    with pytest.raises(ResultError, match="points that move"):
        find_stages(tmp_path)
