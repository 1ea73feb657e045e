"""`jaxmpm calibrate`: what it prints and writes, and one line for bad input."""

import json
import subprocess
import sys

import pytest

from jaxmpm import cli

ENERGY = "energy --E 32000 --ft 3 --GF 0.11 --h 0.05"


def run(words, *more):
    return cli.main(["calibrate", *words.split(), *map(str, more)])


def test_energy_prints_writes_and_draws(tmp_path, capsys, figures):
    assert run(ENERGY, "--json", tmp_path / "e.json", "--plot", tmp_path / "e.png") == 0
    out = capsys.readouterr().out
    assert "Ep     8.18391 MPa" in out and "n      0.127974" in out and "H_max  195.556 mm" in out
    assert 'band = { law = "damage", ft = 3, Ep = 8.1839107, n = 0.12797352, h = 0.05 }' in out
    written = json.loads((tmp_path / "e.json").read_text())
    assert written["band"]["Ep"] == pytest.approx(8.183911) and written["disagreement"] < 1e-9
    assert (tmp_path / "e.png").stat().st_size > 5000 and len(figures) == 1


def test_curve_of_a_bundled_file(tmp_path, capsys):
    assert run("curve hordijk_1991 --law hordijk --out", tmp_path / "fit") == 0
    out = capsys.readouterr().out
    assert "Adam" in out and "Gauss-Newton" in out and "GF  = 0.1099" in out
    assert json.loads((tmp_path / "fit" / "fit.json").read_text())["converged"]
    assert (tmp_path / "fit" / "fit.png").stat().st_size > 5000


def test_a_refusal_of_the_fit_is_status_2(capsys):
    assert run(ENERGY.replace("--h 0.05", "--h 200")) == cli.BAD_INPUT
    assert "h = 200: expected below" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words, parts",
    [
        ("", ["WHAT"]),
        ("enrgy", ["enrgy", "energy"]),
        ("energy --E -3 --ft 3 --GF 0.11 --h 0.05", ["--E", "-3", "above 0"]),
        ("energy --E 32000 --ft 3 --GF nan --h 0.05", ["--GF", "nan", "finite"]),
        ("energy --E 32000 --ft 3 --GF 0.11 --h 0", ["--h", "0", "above 0"]),
        ("energy --E 32000 --ft x --GF 0.11 --h 0.05", ["--ft", "x", "finite"]),
        ("energy --E 32000 --ft 3 --GF 0.11", ["--h"]),
        (ENERGY + " --slope-facto 2", ["--slope-facto", "--slope-factor"]),
        (ENERGY + " --w 0.03", ["--w = 0.03", "point or centroid"]),
        (ENERGY + " --condition point", ["--w", "absent"]),
        (ENERGY + " --condition point --w 0.03 --ratio 1.5", ["--ratio", "1.5", "between 0 and 1"]),
        (ENERGY + " --condition pont", ["pont", "point"]),
        (ENERGY + " --plot x.txt", ["x.txt", ".png"]),
        (ENERGY + " --json nowhere/x.json", ["nowhere/x.json", "folder"]),
        ("energy --E 32000 --ft 3 --GF 0.11 --h fit", ["--h = fit", "point or centroid"]),
        ("curve", ["FILE.csv"]),
        ("curve nothing.csv --E 32000 --h 0.05", ["nothing.csv", "no such file"]),
        ("curve hordijk_1990 --E 32000 --h 0.05", ["hordijk_1990", "did you mean hordijk_1991"]),
        ("curve hordijk_1991", ["--E", "--h"]),
        ("curve hordijk_1991 --E 32000 --h -1", ["--h", "-1"]),
        ("curve hordijk_1991 --law hordijk --fix GFF=3", ["GFF", "did you mean GF"]),
        ("curve hordijk_1991 --law hordijk --fix ft", ["--fix ft", "KEY=VALUE"]),
        ("curve hordijk_1991 --law hordijk --fix ft=-3", ["ft = -3", "above 0"]),
        ("curve --to hordijk --E 32000 --h 0.05", ["--to = hordijk", "--ft", "--GF"]),
    ],
)
def test_bad_input_is_one_line_and_status_2(words, parts, capsys):
    assert run(words) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert not out and err.count("\n") == 1 and all(part in err for part in parts), err


def test_help_and_bad_input_need_no_jax():
    code = (
        "import sys; from jaxmpm import cli\n"
        "try: cli.main(['calibrate', 'energy', '--help'])\nexcept SystemExit: pass\n"
        "assert cli.main(['calibrate', 'curve', 'x.csv', '--E', '1', '--h', '1']) == 2\n"
        "assert 'jax' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_the_package_is_a_command_too():
    call = [sys.executable, "-m", "calibration", "energy", "--E", "0"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == cli.BAD_INPUT and done.stderr.startswith("jaxmpm: ")
