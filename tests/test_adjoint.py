"""Derivatives of paths of equilibria in reverse: against differences of whole paths, and part by part."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from static_scenes import bar, plate, without

from jaxmpm import adjoint, equilibria, follow
from jaxmpm.adjoint import Tape, WayBack
from jaxmpm.condensed import Condensed
from jaxmpm.differentiable_static import StaticRun
from jaxmpm.errors import RunError, SceneError
from jaxmpm.full_system import Full
from jaxmpm.layout import lay_out
from jaxmpm.model import from_layout
from jaxmpm.quasistatic import QuasiStatic
from jaxmpm.stiffness import Structure

HASTY = True  # see conftest.py
STEP = 1e-4  # of a parameter, each way


def loads_at(run, values, xp, times):
    """Loads at some times of samples and at the end: there is an equilibrium at each, at which no cell is about to crack."""
    curve = run(run.with_values(values))
    load = curve.gauges[run.scene.response.load]
    return xp.append(xp.interp(xp.asarray(times), xp.asarray(curve.time), xp.asarray(load)), load[-1])


def both(run, values, answers):
    """Derivatives (parameters, answers) by the logarithms of the parameters: in reverse, and by differences of whole paths.

    Those need no derivatives, and are as many increments long as it takes: what JAX would compile anew for each, NumPy does.
    """
    found, back = jax.vjp(lambda values: answers(run, values, jnp), values)
    ours = [back(row)[0] for row in jnp.eye(len(found))]
    ours = np.array([[float(slopes[name]) * value for slopes in ours] for name, value in values.items()])
    differences = []
    for name, value in values.items():
        ahead, behind = (answers(run, values | {name: value * (1 + s * STEP)}, np) for s in (1, -1))
        differences.append((ahead - behind) / (2 * STEP))
    return ours, np.array(differences)


def values_of(run, *names):
    return {name: float(value) for name, value in run.values(sorted(names)).items()}


def test_bar_agrees_with_differences_of_whole_paths(monkeypatch):
    monkeypatch.setattr(equilibria, "CLOSE", 1e-4)
    run = StaticRun.of(bar(105, "output.samples=25"))
    ours, expected = both(run, values_of(run, "weak.E", "weak.Ep", "weak.n", "weak.ft"), lambda *of: loads_at(*of, run.scene.solver.duration * np.array([15, 17, 20]) / 25))
    np.testing.assert_allclose(ours, expected, rtol=2e-3, atol=1e-4 * np.abs(expected).max())


def test_a_snap_back_followed_by_energy_agrees_too(monkeypatch):
    """A bar four times as long as H_max: the last load, and the elongation at which the load has come back to 200 N."""
    monkeypatch.setattr(equilibria, "CLOSE", 1e-4)
    monkeypatch.setattr(follow, "ENERGY", (0.02, 1e-5, 0.03))
    more = 'solver.control="dissipation"', "displacements.0.history.value=[0.0, 0.06, 0.2]", "output.samples=40"
    run = StaticRun.of(bar(800, *more))

    def answers(run, values, xp):
        gauges = run(run.with_values(values)).gauges
        load, delta = xp.asarray(gauges["load"]), xp.asarray(gauges["delta"])
        peak = int(xp.argmax(load))
        return xp.stack([load[-1], xp.interp(200.0, load[peak:][::-1], delta[peak:][::-1])])

    ours, expected = both(run, values_of(run, "weak.Ep", "weak.ft"), answers)
    np.testing.assert_allclose(ours, expected, rtol=0.01)


def test_plate_agrees_where_cracks_begin_at_given_loads(monkeypatch):
    """Increments that end at samples whatever cracks on the way: so do derivatives that leave cracks at their loads."""
    monkeypatch.setattr(equilibria, "CLOSE", 1.0)
    monkeypatch.setattr(adjoint, "FOLLOWS", False)
    run = StaticRun.of(plate("solver.duration=0.0022", "output.samples=44", "solver.largest_increment=0.05"))
    times = run.scene.solver.duration * np.array([28, 36]) / 44
    ours, expected = both(run, values_of(run, "concrete.E", "concrete.n", "concrete.ft"), lambda *of: loads_at(*of, times))
    np.testing.assert_allclose(ours, expected, rtol=5e-3, atol=1e-4 * np.abs(expected).max())


def test_field_of_strength_sums_up_to_the_strength():
    """Every cell a material of its own: what each would do for the peak, in one way back."""
    run = StaticRun.of(plate("solver.duration=0.0022", "output.samples=8"))
    own = run.by_cells()

    def peak(run):
        def of(ft):
            embedding = run.model.embedding
            changed = replace(embedding, law=replace(embedding.law, ft=ft))
            return run(replace(run.model, embedding=changed)).gauges["load"].max()

        return of

    whole = jax.grad(peak(run))(run.model.embedding.law.ft)
    field = np.asarray(jax.grad(peak(own))(own.model.embedding.law.ft))
    assert field.sum() == pytest.approx(float(whole.sum()), rel=1e-6)
    where = np.argwhere(np.abs(field.reshape(own.model.material.shape)) > 0.02 * np.abs(field).max())
    assert np.ptp(where[:, 1]) < 10  # rows of cells around the notches, of 20


def test_both_systems_solve_with_the_transposed_stiffness():
    """Against a dense matrix, with tangents that are not symmetric, before and behind cells that are forgotten again."""
    model = from_layout(plate(), lay_out(plate()))
    structure = Structure.of(model)
    rng = np.random.default_rng(5)
    cells = np.flatnonzero(np.asarray(model.material).reshape(-1) >= 0)[[45, 200, 46, 120]]
    tangent = rng.normal(size=(4, 3, 3)) * 3e3
    right = rng.normal(size=structure.moves.shape[1])
    condensed, full = Condensed(structure), Full(structure, cells)
    condensed.add(cells)
    condensed.renew(np.zeros(12), np.zeros(12), np.stack([2e3 * np.eye(3)] * 4), np.ones(4, bool))
    condensed._rebase(np.arange(4), structure.volume * np.stack([2e3 * np.eye(3)] * 4), np.zeros((4, 3)))
    for count in (4, 2):
        condensed.keep(count)
        full.keep(count)
        whole = structure.moves.T @ without(structure, cells[:count], 1e-6) @ structure.moves
        rows = structure.rows(cells[:count], 3) @ structure.moves
        dense = whole.toarray()
        for k in range(count):
            own = rows[3 * k : 3 * k + 3].toarray()
            dense += own.T @ (structure.volume * tangent[k]) @ own
        expected = np.linalg.solve(dense.T, right)
        for system in (condensed, full):
            np.testing.assert_allclose(system.adjoint(tangent[:count], right), expected, atol=1e-8 * np.abs(expected).max())


def test_what_has_no_such_derivative_is_refused():
    with pytest.raises(SceneError, match='solver.kind = "explicit": expected "quasistatic"'):
        from jaxmpm.scene import load_scene

        StaticRun.of(load_scene("den"))
    run = StaticRun.of(bar(105, "output.samples=10"))
    with pytest.raises(SceneError, match="inside jax.jit"):
        jax.jit(lambda ft: run(run.with_values({"weak.ft": ft})).gauges["load"].max())(2.85)


def test_a_path_over_a_bridge_is_refused():
    """What is restarted from a state that moved there has no derivative."""
    tape = Tape()
    sim = QuasiStatic.of(bar(105, "output.samples=10"), tape=tape)
    sim.at_rest()
    for sample in range(1, 11):
        sim.advance(sample)
    WayBack(tape)
    equilibria = sim.follower.equilibria
    equilibria.restart(equilibria.state, equilibria.now.amplitude)
    with pytest.raises(RunError, match="dynamic bridge"):
        WayBack(tape)
