"""One scene, two frames: what the total frame hands over goes on in points that move."""

import jax.numpy as jnp
import numpy as np
import pytest
from moving_scenes import interrupted, notched

from jaxmpm import cracks, results, vtkhdf
from jaxmpm.fragments import fragments
from jaxmpm.hand_over import turned_gradient
from jaxmpm.laws.finite import rotation, strain_in
from jaxmpm.run import run_scene
from jaxmpm.verify_scenes import turned

HASTY = True  # see conftest.py


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The notched plate in each frame: summaries and histories."""
    found = {}
    for name, solver in (
        ("total", {"frame": "total"}),
        ("updated", {"frame": "updated"}),
        ("auto", {"frame": "auto", "hand_over_displacement": 0.009}),
    ):
        directory = tmp_path_factory.mktemp(name)
        found[name] = run_scene(notched(**solver), directory, progress=False), directory
    return found


def test_all_frames_give_the_same_response(runs):
    total, updated, auto = (runs[name][0] for name in ("total", "updated", "auto"))
    assert [each["frame"] for each in (total, updated, auto)] == ["total", "updated", "total, then updated"]
    assert updated["peak_load"] == pytest.approx(total["peak_load"], rel=0.01)
    assert auto["peak_load"] == pytest.approx(total["peak_load"], rel=1e-3)
    assert total["cracked"] > 15 and total["final_load"] < 0.5 * total["peak_load"]
    for other in (updated, auto):
        assert other["external_work"] == pytest.approx(total["external_work"], rel=0.03)
        assert other["dissipated_energy"] == pytest.approx(total["dissipated_energy"], rel=0.03)


def test_energy_is_kept_across_the_hand_over(runs):
    for name, limit in (("total", 1e-4), ("updated", 2e-3), ("auto", 2e-3)):
        assert runs[name][0]["largest_energy_error"] < limit
    message = runs["auto"][0]["messages"][0]
    assert "a node has moved by" in message and "more than 0.009 mm" in message
    history = results.read_history(runs["auto"][1] / "history.csv")
    k = int(np.searchsorted(history["time"], runs["auto"][0]["hand_over_time"]))
    assert 5 < k < 35  # cracked already, not yet through
    assert history["step"][-1] == runs["auto"][0]["steps"] and (np.diff(history["step"]) > 0).all()
    steps = np.diff(history["step"])  # those of points are half as long
    assert steps[k + 1 :].max() < 2.5 * steps[: k - 1].min() and steps[k - 1 : k + 1].max() <= steps.max()
    # what gauges read goes on
    for name in ("load", "delta"):
        step = np.abs(np.diff(history[name]))
        assert step[k - 1] < 3 * step[k - 4 : k + 4].max() and step[k] < 3 * np.delete(step, k)[k - 4 : k + 4].max()


def test_frames_of_both_kinds_are_in_one_file(runs):
    path = runs["auto"][1] / "result.vtkhdf"
    first, last = vtkhdf.read_frame(path, 0), vtkhdf.read_frame(path, -1)
    assert len(first["points"]) < len(last["points"])
    for frame in (first, last):
        area = (np.asarray(frame["side"], float) ** 2).sum()
        assert area == pytest.approx(30 * 40 - 25, rel=1e-6)
    assert last["opening"].max() > 1e-3


def test_a_run_of_moving_points_goes_on_after_a_stop(tmp_path, runs, monkeypatch):
    scene = notched(frame="auto", hand_over_displacement=0.009)
    with interrupted(monkeypatch, 8):
        run_scene(scene, tmp_path, progress=False)
    again = run_scene(scene, tmp_path, resume=True, progress=False)
    assert again["frame"] == "total, then updated" and again["status"] == "completed"
    whole = results.read_history(runs["auto"][1] / "history.csv")
    parts = results.read_history(tmp_path / "history.csv")
    for name in whole:
        np.testing.assert_array_equal(parts[name], whole[name])


def test_small_strains_survive_the_hand_over_exactly():
    rng = np.random.default_rng(0)
    gradient, angle = 0.1 * rng.normal(size=(2, 2, 50)), rng.uniform(0, 6, 50)
    normal = np.stack([np.cos(angle), np.sin(angle)])
    strain = np.stack([gradient[0, 0], gradient[1, 1], gradient[0, 1] + gradient[1, 0]])
    turned = jnp.asarray(turned_gradient(gradient, normal))
    found = strain_in(cracks.frames(jnp.asarray(normal), turned), turned)
    np.testing.assert_allclose(found, strain, atol=1e-14)
    whole = jnp.asarray(turned_gradient(gradient, 0 * normal))
    np.testing.assert_allclose(strain_in(rotation(whole), whole), strain, atol=1e-14)


def test_fragments_are_what_hangs_together():
    owner, cohesion = np.zeros((12, 6), int), np.ones((12, 6))
    owner[:, 0] = 1  # a platen
    owner[10:, 5] = -1
    cohesion[5, 1:] = 1e-3  # broken
    cohesion[8, 1:4] = 0.5  # cracked, but holds
    cohesion[1, 1:3], cohesion[0, 3] = 1e-4, 1e-4  # round two cells in a corner
    number, crumbs = fragments(owner, cohesion)
    assert len(np.unique(number[owner >= 0])) == 4 and crumbs == 0
    assert number[0, 1] == number[0, 2] != number[2, 2]
    assert number[2, 3] != number[9, 3] and number[6, 3] == number[9, 3]
    assert len(np.unique(number[:, 0])) == 1 and number[3, 0] not in (number[2, 3], number[9, 3])


def test_each_body_has_a_field_of_its_own_however_small():
    owner = np.zeros((40, 40), int)
    owner[0, 0] = 1
    number, _ = fragments(owner, np.ones(owner.shape))
    assert number[0, 0] != number[5, 5] and len(np.unique(number)) == 2


def test_a_cracked_body_that_is_turned_changes_nothing_but_its_direction():
    rows = list(turned(notched(), 0.6))
    assert len(rows) == 6 and all(row["passed"] for row in rows)
