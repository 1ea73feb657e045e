"""The command line: exit status, messages, what it writes."""

import json
import subprocess
import sys

import pytest

from jaxmpm import benchmark, cli, verify

HASTY = True  # see conftest.py


def run(*arguments):
    return cli.main([str(argument) for argument in arguments])


def test_run_writes_and_reports(tmp_path, capsys):
    words = "run", "bar", "--out", tmp_path, "--set", "parameters.cell=5", "--set", "output.samples=20", "--set", "output.frames=2"
    code = run(*words)
    assert code == 0
    out, err = capsys.readouterr()
    assert "peak 0.2" in out and "cells cracked" in out
    assert "of the stable" in err  # the time step is shown with its factor
    summary = json.loads((tmp_path / "summary.json").read_text())
    # the weak column carries 0.95 f_t × 100 mm², and a little more: it cannot contract freely
    assert 265.0 < summary["peak_load"] < 292.0  # coarse samples may miss the tip
    assert run(*words, "--resume") == 0
    assert "is already complete" in capsys.readouterr().err
    assert run("plot", tmp_path, "--deformed", 50) == 0
    assert (tmp_path / "deformed.png").stat().st_size > 500


def test_points_are_timed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(benchmark, "STATES", {"plane_stress": 3})
    monkeypatch.setattr(benchmark, "POINTS", 512)
    assert run("benchmark", "points", "--json", tmp_path / "points.json") == 0
    rows = json.loads((tmp_path / "points.json").read_text())
    assert [row["increment"] for row in rows] == list(benchmark.INCREMENTS)
    assert all(row["update"] > 0 and row["tangent"] > 0 for row in rows)
    assert "plane_stress" in capsys.readouterr().out


def test_bad_input_is_one_line_and_status_2(capsys):
    assert run("run", "den", "--set", "grid.cel=2.5") == cli.BAD_INPUT
    error = capsys.readouterr().err
    assert "grid.cel = 2.5" in error and "cell" in error and "Traceback" not in error
    assert run("run", "dne") == cli.BAD_INPUT
    assert "den" in capsys.readouterr().err
    assert run("plot", "no-such-directory") == cli.BAD_INPUT


def test_a_stopped_run_is_status_1(tmp_path, capsys):
    code = run("run", "bar", "--out", tmp_path, "--set", "parameters.cell=5", "--set", "solver.gradient_limit=1e-9", "--quiet")
    assert code == cli.STOPPED
    assert "gradient_limit" in capsys.readouterr().err


def test_scenes_are_listed(capsys):
    assert run("scenes") == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in ("den", "den_4a", "bar", "opening"))


def test_verify_table_and_json(tmp_path, capsys):
    file = tmp_path / "v.json"
    assert run("verify", "uniaxial", "fracture_energy", "tangent", "patch", "--json", file) == 0
    rows = json.loads(file.read_text())
    assert len(rows) == 10
    assert all({"check", "value", "expected", "error", "limit", "passed"} == set(row) for row in rows)
    assert "uniaxial law" in capsys.readouterr().out
    assert run("verify", "uniaxal") == cli.BAD_INPUT


def test_verify_one_opening(tmp_path):
    file = tmp_path / "v.json"
    assert run("verify", "opening", "--angle", 22.5, "--cell", 5, "--json", file) == 0
    work, left = json.loads(file.read_text())
    assert work["check"] == "opening 22.5" and abs(work["value"] - 1) < 0.05
    assert left["value"] < 0.01


@pytest.mark.parametrize(
    "arguments, words",
    [
        ("benchmark points --cells 5", "--cells = 5.0: expected only with a scene"),
        ("benchmark points --set grid.cell=5", "--set = grid.cell=5: expected only with a scene"),
        ("verify patch --angle 10", "--angle = 10: expected only with the check opening"),
        ("benchmark dne", 'did you mean "den"?'),
        ("rnu den", "rnu: did you mean run?"),
        ("den", "did you mean jaxmpm run den?"),
        ("run", "the following arguments are required: SCENE (see jaxmpm run --help)"),
        ("run den --ste grid.cell=5", "run: unknown --ste (did you mean --set?)"),
        ("run den --set grid.cell=5 solver.damping=0", "did you mean --set solver.damping=0?"),
        ("run den more", "run: unknown more (see jaxmpm run --help)"),
        ("run den --format jpeg", "run: --format: jpeg: expected one of png, pdf, svg"),
        ("run den --samples few", "run: --samples: invalid int value: 'few'"),
        ("verify patch --json FILE/v.json", "--json = FILE: expected a folder to write to, but FILE is a file"),
        ("completion tcsh", "expected one of bash, zsh, fish"),
        ("calibrate enrgy", "calibrate: enrgy: did you mean energy?"),
        ("run bar --out FILE", "--out = FILE: expected a folder to write to, but FILE is a file"),
        ("run bar --out FILE/in", "but FILE is a file"),
        ("plot DIR --stages --animate", "--animate: expected none with --stages"),
        ("plot DIR --stages --frame 3", "--frame = 3: expected none with --stages"),
        ("plot DIR --stages --field stress", "--field = stress: expected none with --stages"),
    ],
)
def test_options_that_do_not_go_together_are_named(arguments, words, tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("")
    assert run(*arguments.replace("FILE", str(file)).split()) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert not out and words.replace("FILE", str(file)) in err


def test_no_command_shows_what_there_is(capsys):
    assert run() == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert not out and "commands:" in err and "examples:" in err


def test_results_elsewhere_are_found(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results" / "den").mkdir(parents=True)
    (tmp_path / "results" / "den" / "history.csv").write_text("time [s]\n")
    (tmp_path / "mine.toml").write_text("a 1\n")
    for arguments, words in (
        ("plot results/den", "the run there has not ended: go on with it by --resume"),
        ("plot den", "has the scene been run?"),
        ("run min.toml", 'No such file; did you mean "mine.toml"?'),
        ("run den.toml", 'did you mean "den"?'),
        ("run other.toml", "jaxmpm new other.toml writes one"),
        ("run results/den", "it is a folder"),
        ("run mine.toml", "at line 1, column 3): a 1)"),
    ):
        assert run(*arguments.split()) == cli.BAD_INPUT and words in capsys.readouterr().err
    (tmp_path / "results" / "den" / "summary.json").write_text("{}")
    for arguments, words in (("plot den", "did you mean results/den?"), ("run results/den", "jaxmpm plot results/den draws them")):
        assert run(*arguments.split()) == cli.BAD_INPUT and words in capsys.readouterr().err


def test_a_row_with_one_side_says_which(monkeypatch, capsys):
    rows = [verify._row("a", 0.05, 0.4, 0.2, side="≤"), verify._row("b", 0.9, 1.0, 0.05, side="≥")]
    monkeypatch.setitem(verify.CHECKS, "sides", lambda: rows)
    assert run("verify", "sides") == cli.STOPPED
    out = capsys.readouterr().out
    assert "≤ 0.4" in out and "≥ 1" in out and "pass" in out and "FAIL" in out


def test_help_needs_no_jax():
    code = (
        "import sys; from jaxmpm import cli\n"
        "try: cli.main(['--help'])\nexcept SystemExit: pass\n"
        "assert 'jax' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
