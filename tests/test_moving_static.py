"""Equilibrium of points that move: exact tangents, closed forms, the total frame, and what must stop a run."""

import json

import numpy as np
import pytest
from moving_scenes import block, scene
from static_scenes import bar

from jaxmpm import moving_tangent, results, verify_equilibrium
from jaxmpm.errors import RunError, SceneError
from jaxmpm.moving_equilibrium import Newton
from jaxmpm.moving_static import MovingStatic
from jaxmpm.run import run_scene
from jaxmpm.scene import load_scene

HASTY = True  # see conftest.py
E, FT, EP, N, H = 32000.0, 2.85, 8.184, 0.128, 0.05  # of the weak column of the bar


def weak_bar(*more):
    """A bar of 20 by 2 cells that breaks at one column of them, ν = 0."""
    one_dimensional = [f"materials.{name}.bulk.nu=0.0" for name in ("weak", "concrete")]
    return bar(100, 'solver.frame="updated"', "solver.largest_increment=0.05", "output.samples=12", *one_dimensional, *more)


@pytest.fixture(scope="module")
def broken(tmp_path_factory):
    directory = tmp_path_factory.mktemp("bar")
    return directory, run_scene(weak_bar(), directory, progress=False)


def opening(load):
    """Opening w (mm) of the weak column at a share of its strength, theory §2, by bisection on s."""
    e, low, high = EP / E, 1e-12, 1.0
    for _ in range(200):
        s = (low + high) / 2
        low, high = (s, high) if s * (1 + e * s**N) / (s + e * s**N) < load else (low, s)
    return H * (load * FT / (s * E) - load * FT / E)


def test_a_bar_breaks_as_the_closed_form_says(broken):
    """As in the total frame, whose test this is too: elongation is that of the bar and of the opening."""
    directory, summary = broken
    assert summary["status"] == "completed" and summary["frame"] == "updated" and summary["cracked"] == 2
    history = results.read_history(directory / "history.csv")
    load, delta, cracked = (history[name] for name in ("load", "delta", "cracked"))
    # the gauge is of points that begin a quarter of a cell from the end
    delta = delta + load / 100 / E * 1.25
    behind = (cracked > 0) & (load < 0.95 * FT * 100) & (load > 2)
    assert behind.sum() > 5
    stress = load[behind] / 100
    expected = stress / E * 100 + np.array([opening(s / FT) for s in stress])
    np.testing.assert_allclose(delta[behind], expected, rtol=5e-3)
    assert summary["external_work"] == pytest.approx(9.93, rel=0.005)
    assert summary["largest_energy_error"] < 3e-3 and summary["quasistatic"]["leaps"] == 0


def test_a_restart_goes_on_where_it_was(broken, tmp_path, monkeypatch):
    advance = MovingStatic.advance

    def stops(self, until):
        if until == 8:
            raise KeyboardInterrupt
        return advance(self, until)

    with monkeypatch.context() as patch:
        patch.setattr(MovingStatic, "advance", stops)
        with pytest.raises(KeyboardInterrupt):
            run_scene(weak_bar(), tmp_path, progress=False)
    again = run_scene(weak_bar(), tmp_path, resume=True, progress=False)
    for key in ("final_load", "external_work", "dissipated_energy"):
        assert again[key] == pytest.approx(broken[1][key], rel=1e-6)


def test_more_force_than_a_bar_bears_stops_with_all_on_disk(tmp_path):
    tree = weak_bar().to_dict()
    (load,) = tree.pop("displacements")
    tree["forces"] = [load | {"kind": "force", "history": {"time": [0.0, 12e-3], "value": [0.0, 600.0]}}]
    tree["gauges"]["load"]["set"] = "left"
    tree["solver"]["smallest_increment"] = 1e-3
    with pytest.raises(RunError, match="no equilibrium"):
        run_scene(type(weak_bar()).from_dict(tree), tmp_path, progress=False)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["status"].startswith("stopped: no equilibrium")
    load = np.abs(results.read_history(tmp_path / "history.csv")["load"])
    assert 260 < load.max() < 1.02 * FT * 100 and load[-1] == load.max()  # the last equilibrium is there


def slopes(sim, lists, rate, step):
    """∂S/∂G as it is given, and by central differences."""
    ask = lambda rate: sim.path.call(moving_tangent.respond, sim.model, lists.points, lists.pool, rate)  # noqa: E731
    answer = ask(rate)
    columns = []
    for k in range(4):
        unit = np.zeros_like(rate)
        unit[k] = step
        ahead, behind = (ask(rate + sign * unit).pull for sign in (1, -1))
        columns.append((ahead - behind) / (2 * step))
    return answer, np.asarray(answer.slope), np.stack(columns, 1)


def test_tangents_are_exact_far_from_where_points_began():
    """Neo-Hookean points that are strained much, and strained further."""
    sim = verify_equilibrium.settled(4, 10)
    _, lists = sim.path.increment(sim.state, sim.amplitude, sim.amplitude)
    rate = np.random.default_rng(0).normal(size=(4, lists.points.mass.size)) * 0.1
    answer, given, expected = slopes(sim, lists, rate, 1e-5)
    assert not answer.wrong and np.abs(given).max() > 0
    np.testing.assert_allclose(given, expected, atol=1e-8 * np.abs(given).max())
    np.testing.assert_allclose(given, given.swapaxes(0, 1), atol=1e-12 * np.abs(given).max())  # there is an energy
    rate[:, 0] = -2.0, 0.0, 0.0, 0.0
    assert sim.path.call(moving_tangent.respond, sim.model, lists.points, lists.pool, rate).wrong  # turned inside out


def test_tangents_of_bands_that_load_are_exact():
    sim = MovingStatic.of(weak_bar())
    sim.at_rest()
    sim.advance(6)
    assert sim.cracked() == 2
    _, lists = sim.path.increment(sim.state, sim.amplitude, sim.amplitude)
    place = np.asarray(lists.pool.cell)[:2]
    rate = np.zeros((4, lists.points.mass.size))
    rate[:, place] = np.array([3e-4, 1e-4, -1e-4, -1e-5])[:, None]
    answer, given, expected = slopes(sim, lists, rate, 1e-9)
    before, after = (np.asarray(pool.records)[:2] for pool in (lists.pool, answer.pool))
    assert not answer.wrong and (np.abs(after - before).max(1) > 1e-6).all()  # both load
    np.testing.assert_allclose(given[..., place], expected[..., place], atol=1e-5 * np.abs(given[..., place]).max())


def test_newton_converges_quadratically():
    """A column whose weight is doubled at once: every error is about the square of the one before."""
    errors = verify_equilibrium.convergence(verify_equilibrium.settled(4, 10), 2.0)
    assert len(errors) <= 6 and errors[-1] < 1e-11
    assert errors[-2] < errors[-3] ** 1.8 < errors[-3] < errors[-4] ** 1.5
    assert verify_equilibrium.rate(errors) > 1.8


def test_a_column_under_its_own_weight_is_of_second_order():
    (far, _), (near, stress) = (verify_equilibrium.column_errors(verify_equilibrium.settled(cells, 20)) for cells in (8, 16))
    assert near < far / 4 and near < 4e-5 and stress < 4e-3


def test_a_cantilever_bends_as_the_elastica():
    exact = verify_equilibrium.elastica(25.0)
    assert exact == pytest.approx((60.325, 25.442), rel=0.01)  # Mattiasson 1981, no stretch and no shear
    errors = []
    for cell in (5.0, 2.5):
        sim = verify_equilibrium.bent(cell, 0.1)
        reading = sim.read()
        errors.append(abs(reading.gauges["deflection"] / exact[0] - 1))
        assert reading.gauges["shortening"] == pytest.approx(exact[1], rel=0.03)
        assert reading.gauges["load"] == pytest.approx(25.0, rel=1e-5)  # the reaction
        external, *parts = map(float, reading.energies())
        assert sum(parts) == pytest.approx(external, rel=0.02)
    assert errors[1] < 0.6 * errors[0] and errors[1] < 0.015


def test_nothing_is_done_where_loads_stay():
    """A fresh grid alone moves points a little: under constant loads no equilibrium is found anew."""
    sim = verify_equilibrium.bent(5.0, 0.1, "forces.0.history.time=[0.0, 0.05]")
    assert float(sim.state.step) < 20 and sim.now == pytest.approx(0.12)
    before = sim.state.points.place
    sim._follow(0.13)
    assert sim.state.points.place is before


@pytest.mark.parametrize("angle", [20.0, 180.0])
def test_a_body_that_is_turned_is_not_strained(angle):
    """An increment of rigid motion, prescribed at all of its nodes: G is that of the rotation, and nothing pulls."""
    sim = MovingStatic.of(held_block())
    asked, lists = sim.path.increment(sim.state, sim.amplitude, sim.amplitude)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    at = np.stack(np.indices(asked.nodes.shape)) * 5.0
    u = np.einsum("ij,jxy->ixy", np.array([[c - 1, -s], [s, c - 1]]), at)
    answer = asked.respond(asked.nodes.rate(u.reshape(-1)))
    assert np.abs(np.asarray(answer.pull)).max() < 1e-9 * 10.0 * 25.0
    assert np.abs(asked.nodes.ghosts @ u.reshape(-1)).max() < 1e-9


def held_block(**more):
    inside = {"inside": [{"kind": "rectangle", "min": [20.0, 20.0], "max": [35.0, 20.0]}]}
    return scene(
        [block((20, 20), (35, 35))], sets={"bottom": inside}, supports=[{"set": "bottom", "fix": more.pop("fix", ["x", "y"])}],
        gravity=[0.0, -1e6], solver={"kind": "quasistatic", "duration": 1.0, "damping": 0.02, **more},
    )  # fmt: skip


def test_a_body_that_can_slide_is_refused():
    with pytest.raises(SceneError, match="one can move without strain"):
        MovingStatic.of(held_block(fix=["y"]))


@pytest.mark.parametrize(
    ("set_", "says"),
    [
        ('points.transfer="flip"', "points.transfer"),
        ("points.fmpm_order=2", "points have no velocities"),
        ('solver.control="dissipation"', '"time" with solver.frame = "updated"'),
        ("bodies.0.velocity=[1.0, 0.0]", "bodies.0.velocity"),
        ('contact={kind="friction"}', "contact.kind"),
    ],
)
def test_what_does_nothing_is_refused(set_, says):
    with pytest.raises(SceneError) as error:
        load_scene("cantilever", [*verify_equilibrium.STATIC, set_])
    assert says in str(error.value)


def test_unconverged_is_no_equilibrium():
    """Newton's method says that it has found none, and nothing is accepted."""
    sim = verify_equilibrium.settled(4, 10)
    asked, _ = sim.path.increment(sim.state, sim.amplitude, sim.amplitude)
    asked.after[:] = np.nan
    assert not Newton(asked).solve(1e-6).converged
    assert sim.path.attempt(sim.state, sim.amplitude, 1e9 * sim.amplitude) is None
