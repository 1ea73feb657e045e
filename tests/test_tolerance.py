"""`jaxmpm run SCENE --tolerance`: what is chosen, what is said, what is refused."""

import json

import pytest
from chart_scene import seconds_by_work, write_scene

from jaxmpm import cli, tolerance, tolerance_table
from jaxmpm.chart.classes import Experience
from jaxmpm.results import read_history, read_summary
from jaxmpm.run import run_scene
from jaxmpm.scene import load_scene

HASTY = True


def test_a_share_is_read_as_it_is_written():
    from jaxmpm.cli_chart import share_of

    assert share_of("--tolerance", "2%") == share_of("--tolerance", "0.02") == share_of("--tolerance", " 2 % ") == 0.02


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--tolerance 2", "--tolerance = 2: expected a share such as 2% or 0.02, from 0.01% to 50%"),
        ("--tolerance 0%", "--tolerance = 0%: expected"),
        ("--tolerance -1%", "--tolerance"),
        ("--tolerance two", "--tolerance = two: expected"),
        ("--tolerance 80%", "--tolerance = 80%: expected"),
        ("--tolerance nan%", "--tolerance = nan%: expected"),
        ("--of peak", "--of = peak: expected only with --tolerance"),
        ("--finest 1", "--finest = 1.0: expected only with --tolerance"),
        ("--tolerance 2% --samples 3", "--samples = 3: expected without --tolerance"),
        ("--tolerance 2% --finest 5", "--finest = 5: expected a size of cells up to the scene's own, 2.5 mm"),
        ("--tolerance 2% --finest 1.7", "--finest = 1.7: grid.cell = 1.7"),
        ("--tolerance 2% --to 0", "--to = 0: expected a displacement above zero"),
        ("--tolerance 2% --set grid.cel=1", "grid.cel = 1"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(options, words, tmp_path, capsys):
    try:
        code = cli.main(["run", "den", "--out", str(tmp_path / "none"), *options.split(" ")])
    except SystemExit as error:  # the parser's own refusal of a value that looks like an option
        code = error.code
    assert code == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert words in err and not out and not (tmp_path / "none").exists()


@pytest.fixture(autouse=True)
def by_work(monkeypatch):
    monkeypatch.setattr(tolerance, "run_seconds", seconds_by_work)


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    """The block and what it gives on its finest cells."""
    folder = tmp_path_factory.mktemp("tolerance")
    path = write_scene(folder)
    text = path.read_text().replace("cell = 10.0", "cell = 5.0")
    path.write_text(text)
    return path, run_scene(load_scene(path, ["grid.cell=2.5"]), folder / "fine", progress=False)


def choose(path, out, capsys, *options):
    assert cli.main(["run", str(path), "--out", str(out), *options]) == 0
    return json.loads((out / "summary.json").read_text()), capsys.readouterr()


def test_of_a_kind_that_was_not_charted_two_coarser_runs_tell(block, tmp_path, capsys):
    path, fine = block
    summary, (out, err) = choose(path, tmp_path, capsys, "--tolerance", "10%", "--of", "peak")
    found = summary["tolerance"]
    assert abs(summary["peak_load"] / fine["peak_load"] - 1) <= 0.1
    assert set(found["choices"]) <= {"cell"} and found["quick_runs"] == 2 and found["charts"] == []
    assert 0.0 < found["expected_errors"]["peak"] <= 0.1 and found["against_cells"] == 2.5
    assert f"chosen: {found['setting']}" in out and summary["cell_size"] < 10.0 and "the estimate held" in out and "10 % of peak asked" in out and "quick runs:" in err
    assert (tmp_path / "response.png").exists() and len(read_history(tmp_path / "history.csv")["load"]) == 21
    quick = json.loads((tmp_path / "tolerance.json").read_text())["quick"]["runs"]
    assert [run["cell"] for run in quick] == [20.0, 10.0]
    again, (_, err) = choose(path, tmp_path, capsys, "--tolerance", "10%", "--of", "peak", "--resume")
    assert "taken over from before" in err and "already complete" in err and again["peak_load"] == summary["peak_load"]
    assert cli.main(["run", str(path), "--out", str(tmp_path), "--tolerance", "5%", "--of", "peak", "--resume"]) == cli.BAD_INPUT
    assert "asked.tolerance was 0.1 and is 0.05" in capsys.readouterr().err


def test_a_table_holds_tolerances_against_the_finest_cells(block, tmp_path, capsys, monkeypatch):
    path, fine = block
    monkeypatch.setattr(tolerance_table, "SHARES", (0.001, 0.3))
    monkeypatch.setattr(tolerance_table, "run_seconds", seconds_by_work)
    assert tolerance_table.main([str(path), "--out", str(tmp_path)]) == 0
    (_, _, *lines), _ = (text.splitlines() for text in capsys.readouterr())
    tight, loose = (line.strip("| ").split(" | ") for line in lines)
    assert tight[:3] == ["block", "0.1 %", "2.5 mm"] and tight[3] == "0.0 %" and loose[1] == "30 %" and loose[2] != "2.5 mm"
    chosen = tmp_path / "block_2.5_30"
    (row,) = tolerance_table.rows(tmp_path / "block_2.5_finest", [chosen])
    peak = read_summary(chosen)["peak_load"]
    assert row["errors"]["peak"] == pytest.approx(abs(peak / fine["peak_load"] - 1), rel=1e-4) and 0 < row["errors"]["peak"] <= 0.3
    assert float(loose[-1]) == pytest.approx(row["finest"] / row["seconds"], abs=0.05)
    ran = [file.stat().st_mtime_ns for file in sorted(tmp_path.glob("*/summary.json"))]
    assert tolerance_table.main([str(path), "--out", str(tmp_path)]) == 0
    assert ran == [file.stat().st_mtime_ns for file in sorted(tmp_path.glob("*/summary.json"))]  # nothing was run twice
    other = tmp_path / path.name
    other.write_text(path.read_text().replace("title = ", "title = 'another, ' # "))
    assert tolerance_table.main([str(other), "--out", str(tmp_path)]) == 1
    assert "the run there is of another scene (title was" in capsys.readouterr().err


@pytest.mark.parametrize("share", ["-0.1", "2", "nan", "two"])
def test_a_table_of_what_is_no_share_is_refused_before_anything_runs(share, tmp_path, capsys):
    assert tolerance_table.main(["den", "--shares", "2%", share, "--out", str(tmp_path / "none")]) == 1
    assert f"--shares = {share}: expected a share such as 2%" in capsys.readouterr().err and not (tmp_path / "none").exists()


def test_where_nothing_is_good_enough_the_finest_cells_are_run(block, tmp_path, capsys):
    path, fine = block
    summary, (out, _) = choose(path, tmp_path, capsys, "--tolerance", "0.01%")
    assert summary["peak_load"] == fine["peak_load"] and summary["cell_size"] == 2.5
    assert "errors are relative to this very run" in out


def test_faster_loading_is_chosen_as_charts_of_the_kind_allow_and_given_up_where_it_moves_more(block, tmp_path, capsys, monkeypatch):
    path, fine = block
    runs = [{"setting": {"cell": 5.0} | choice, "seconds": 1.0, "peak": 1.0 + shift, "work": 1.0 + shift}
            for choice, shift in (({}, 0.0), ({"precision": "float32"}, 1e-6), ({"speed": 2.0, "precision": "float32"}, 1e-3),
                                  ({"speed": 4.0, "precision": "float32"}, 5e-3))]  # fmt: skip
    known = Experience("elastic", [{"scene": "another", "kind": "elastic", "cell": 5.0, "runs": runs}])
    monkeypatch.setattr(tolerance, "Experience", lambda kind: known)
    summary, (out, err) = choose(path, tmp_path, capsys, "--tolerance", "20%")
    found = summary["tolerance"]
    assert "4× as fast, float32" in err and found["charts"] == ["another"]
    assert abs(summary["peak_load"] / fine["peak_load"] - 1) <= 0.2
    assert found["tried_before"] or found["choices"].get("speed", 1.0) > 1.0
