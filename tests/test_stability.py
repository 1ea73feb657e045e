"""The stability map: the project's solver holds everywhere, the others fail where theory says."""

import csv
import json
from itertools import pairwise

import numpy as np
import pytest

from jaxmpm import cli, stability


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    """Exit status of the command for a coarse map, and the folder it wrote to."""
    directory = tmp_path_factory.mktemp("stability")
    return cli.main(["stability", "--coarse", "--out", str(directory)]), directory


@pytest.fixture(scope="module")
def rows(coarse):
    with open(coarse[1] / "stability.csv", newline="") as file:
        found = list(csv.DictReader(file))
    for row in found:
        for key in ("size_ratio", "increment", "energy_ratio", "traction_left"):
            row[key] = float(row[key])
        row["enlarged"] = row["enlarged"] == "True"
    return found


def where(rows, method, **limits):
    """Rows of a method; `below` and `above` bound H/H_max, `up_to` and `from_` the increment."""
    limits = {"below": np.inf, "above": 0.0, "up_to": np.inf, "from_": 0.0} | limits
    return [
        row
        for row in rows
        if row["method"] == method
        and limits["above"] < row["size_ratio"] < limits["below"]
        and limits["from_"] <= row["increment"] * 1.001 and row["increment"] <= limits["up_to"] * 1.001
    ]  # fmt: skip


def verdicts(rows):
    return {row["verdict"] for row in rows}


def test_files_and_status(coarse, rows):
    status, directory = coarse
    summary = json.loads((directory / "stability.json").read_text())
    assert status == 0 and summary["passed"] and summary["faults"] == 0
    assert len(rows) == 4 * 2 * 9 * 7 and len(summary["panels"]) == 8
    for panel in summary["panels"]:
        assert sum(panel["shares"].values()) == pytest.approx(1.0, abs=1e-3)
    assert summary["fracture_energy"] == pytest.approx(0.110036, rel=1e-5)  # by quadrature
    assert summary["largest_size"] == pytest.approx(0.05 * (1 + 32000 / 8.184))
    assert (directory / "stability.png").stat().st_size > 20_000


def test_the_project_is_right_whatever_size_and_increment(rows):
    ours = where(rows, "balance")
    assert verdicts(ours) == {"right"}
    # at the end of the path the law has 0.1 % of G_F left, and the crack all but no traction
    assert all(abs(row["energy_ratio"] - 1) < 1.5e-3 for row in ours)
    assert all(row["traction_left"] < 1e-3 for row in ours)


def test_the_project_is_right_in_single_precision_too():
    rows = stability.cells(coarse=True, methods=("balance",), precisions=("float32",))
    assert verdicts(rows) == {"right"}


def test_the_rate_form_drifts_with_the_increment(rows):
    assert verdicts(where(rows, "rate", from_=10.0)) == {"wrong"}
    assert verdicts(where(rows, "rate", above=1.0)) == {"wrong"}
    # first order: a tenth of the increment leaves about a tenth of the error
    column = [
        row for row in where(rows, "rate", above=0.4, below=0.5, up_to=0.1)
        if row["path"] == "uniaxial" and not row["enlarged"]
    ]  # fmt: skip
    errors = [abs(row["energy_ratio"] - 1) for row in column]
    assert len(errors) >= 2
    assert all(0.02 < fine / large < 0.3 for fine, large in pairwise(errors))


def test_plain_newton_fails_beyond_the_largest_size(rows):
    assert verdicts(where(rows, "newton", below=1.0)) == {"right"}
    assert verdicts(where(rows, "newton", above=1.0, up_to=0.1)) == {"not converged"}
    assert verdicts(where(rows, "newton", above=5.0)) == {"not converged"}


def test_the_smeared_crack_fails_where_it_is_brittle(rows):
    brittle = (
        2 * 32000 * 0.110036 / 3.0**2 / (0.05 * (1 + 32000 / 8.184))
    )  # 2 E G_F/f_t² over H_max
    assert verdicts(where(rows, "smeared", below=brittle)) == {"right"}
    beyond = where(rows, "smeared", above=brittle)
    assert beyond and verdicts(beyond) == {"wrong"}
    for row in beyond:  # all the energy stored at onset
        assert row["energy_ratio"] == pytest.approx(row["size_ratio"] / brittle, rel=1e-2)
