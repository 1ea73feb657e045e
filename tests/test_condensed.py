"""The elastic structure against the matrix-free operators, and the condensed equations against those of all nodes."""

import jax.numpy as jnp
import numpy as np
import pytest
from static_scenes import bar, plate, without

from jaxmpm import bands_static, grid
from jaxmpm import model as models
from jaxmpm.condensed import GRIP, Condensed
from jaxmpm.equilibria import Equilibria
from jaxmpm.errors import SceneError
from jaxmpm.explicit import intact_stress
from jaxmpm.full_system import Full
from jaxmpm.layout import lay_out
from jaxmpm.stiffness import Structure, amplitudes


def model_of(scene):
    layout = lay_out(scene)
    model = models.from_layout(scene, layout)
    return model, models.first_state(model, layout.velocity)


@pytest.fixture(scope="module")
def made():
    model, state = model_of(plate())
    return model, state, Structure.of(model)


def test_stiffness_is_the_operator_of_the_grid(made):
    model, state, structure = made
    n = model.numerics
    u = np.random.default_rng(1).normal(size=model.free.shape)
    strain = grid.strain(jnp.asarray(u), n.cell)
    stress = intact_stress(models.fields(model), state, strain, n.size)
    force = grid.internal_force(stress._replace(mean=stress.mean[:3]), n.cell, n.thickness)
    ours = structure.stiffness @ u.reshape(-1)
    np.testing.assert_allclose(ours, np.asarray(force).reshape(-1), atol=1e-12 * np.abs(ours).max())
    rows = (structure.strain @ u.reshape(-1)).reshape(*model.material.shape, 5)
    np.testing.assert_allclose(rows, np.moveaxis(np.stack([*strain.mean, *strain.hourglass]), 0, -1), atol=1e-14)


def test_elastic_answer_is_in_balance_and_where_it_is_prescribed(made):
    model, _, structure = made
    a = amplitudes(model, 2e-3)
    u = structure.response @ a
    force = structure.stiffness @ u
    free = np.asarray(structure.moves.sum(1)).reshape(-1) > 0
    assert np.abs(force[free]).max() < 1e-9 * np.abs(force).max()
    for load, amplitude in zip(model.displacements, a, strict=False):
        np.testing.assert_allclose(u[np.asarray(load.dofs)], amplitude * np.asarray(load.weights), rtol=1e-12)


def test_cells_that_are_cut_out_one_after_the_other_are_as_good_as_left_out(made):
    """Cells without stress, in two goes: Woodbury's growth against a structure assembled without them."""
    model, _, structure = made
    a = amplitudes(model, 2e-3)
    cells = np.flatnonzero(np.asarray(model.material).reshape(-1) >= 0)[[45, 200, 46, 120]]
    gauge = np.zeros(model.free.size)
    gauge[np.asarray(model.gauges["left_notch"].dofs)] = model.gauges["left_notch"].weights
    condensed = Condensed(structure, gauge)
    condensed.add(cells[:1])
    condensed.add(cells[1:])
    stress = np.zeros(3 * len(cells))
    start = np.zeros(3 * len(cells))
    change, _ = condensed.step(np.zeros((len(cells), 3, 3)), condensed.residual(start, stress, a))
    u = condensed.displacement(change, stress, a)
    whole = without(structure, cells, GRIP)
    moves = structure.moves
    x = np.linalg.solve((moves.T @ whole @ moves).toarray(), -(moves.T @ (whole @ (structure.prescribed @ a))))
    expected = moves @ x + structure.prescribed @ a
    np.testing.assert_allclose(u, expected, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(change, structure.rows(cells, 3) @ expected, atol=1e-12)
    assert condensed.reading(change, stress, a) == pytest.approx(gauge @ expected, rel=1e-10)
    assert condensed.stable


def test_both_systems_make_the_same_step(made):
    """With tangents of bands that soften, for controls of load, energy and gauge."""
    model, _, structure = made
    rng = np.random.default_rng(3)
    a = amplitudes(model, 2e-3)
    cells = np.flatnonzero(np.asarray(model.material).reshape(-1) >= 0)[[45, 200, 46]]
    gauge = np.zeros(model.free.size)
    gauge[np.asarray(model.gauges["left_notch"].dofs)] = model.gauges["left_notch"].weights
    condensed, full = Condensed(structure, gauge), Full(structure, cells, gauge)
    condensed.add(cells)
    u = structure.response @ a
    strain = structure.rows(cells, 3) @ u
    tangent = rng.normal(size=(3, 3, 3)) * 2e3
    stress = rng.normal(size=9)
    spends = rng.normal(size=9)
    for direction, by in ((None, None), (a, "spent"), (a, "gauge")):
        found = []
        for system in (condensed, full):
            x = system.unknowns(u, a)
            slopes = system.slopes(spends, direction) if by == "spent" else system.reading_slopes(tangent, direction) if by else None
            short = 0.1 - (system.reading(x, stress, a) if by == "gauge" else 0.0)
            change, factor = system.step(tangent, system.residual(x, stress, a), direction, slopes, short)
            after = a if direction is None else a + factor * direction
            found.append((system.strain(x + change, after), factor, system.stable))
        np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-7, atol=1e-12 * np.abs(strain).max())
        assert found[0][1] == pytest.approx(found[1][1], rel=1e-8)
        assert found[0][2] == found[1][2]


def test_bands_that_are_all_at_rest_leave_no_system_to_solve(made):
    """Unloading: every band answers as the base says, and only what is out of balance is left, whatever is controlled."""
    model, _, structure = made
    cells = np.flatnonzero(np.asarray(model.material).reshape(-1) >= 0)[[45, 200, 46]]
    gauge = np.zeros(model.free.size)
    gauge[np.asarray(model.gauges["left_notch"].dofs)] = model.gauges["left_notch"].weights
    condensed, full = Condensed(structure, gauge), Full(structure, cells, gauge)
    condensed.add(cells)
    secant, a = np.stack([0.3 * structure.elastic[cells[0]]] * 3), amplitudes(model, 2e-3)
    condensed._rebase(np.arange(3), structure.volume * secant, np.zeros((3, 3)))
    u = structure.response @ a
    own = structure.rows(cells, 3) @ u
    stress = np.einsum("kij,kj->ki", secant, own.reshape(3, 3)).reshape(-1)
    for direction in (None, a):
        found = []
        for system in (condensed, full):
            x = system.unknowns(u, a)
            slopes = None if direction is None else system.reading_slopes(secant, direction)
            short = 0.1 - system.reading(x, stress, a)
            change, factor = system.step(secant, system.residual(x, stress, a), direction, slopes, short)
            found.append((system.strain(x + change, a if direction is None else a + factor * direction), factor, system.stable))
        assert not len(condensed.active)
        np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-7)
        assert found[0][1] == pytest.approx(found[1][1], rel=1e-8)
        assert found[0][2] == found[1][2]
    assert condensed.softest(secant)[1]
    right = np.random.default_rng(6).normal(size=(structure.moves.shape[1], 2))
    ours, expected = (system.adjoint(secant, right) for system in (condensed, full))
    np.testing.assert_allclose(ours, expected, atol=1e-8 * np.abs(expected).max())


def test_whole_curve_is_the_same_by_either_system(monkeypatch):
    """The plate to a little behind its peak, dense and sparse."""
    from jaxmpm import equilibria
    from jaxmpm.follow import Follower

    found = []
    for dense in (1e3, 0.0):
        monkeypatch.setattr(equilibria, "DENSE", dense)
        eq = Equilibria(*model_of(plate()), 1e-8)
        follower = Follower(eq, 5e-3, "time", 5e-5, 1e-8, 1e-4)
        follower.begin()
        while follower.time < 2e-3:
            follower.increment(2e-3)
        assert isinstance(eq.system, Condensed if dense else Full)
        found.append((eq.now.displacement, len(eq.system.cells)))
    assert found[0][1] == found[1][1] > 20
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-6 * np.abs(found[0][0]).max())


def test_a_body_that_can_slide_is_refused():
    with pytest.raises(SceneError, match="supports that hold every body"):
        Structure.of(model_of(bar(100, 'supports.1.fix=["x"]'))[0])


def test_answers_agree_with_the_bands_of_the_explicit_step():
    """Stress, and the tangent by finite differences."""
    model, state = model_of(plate())
    cells = np.flatnonzero(np.asarray(model.material).reshape(-1) >= 0)[[45, 200]]
    n = model.numerics
    mean = [np.zeros(model.material.shape) for _ in range(3)]
    for k, cell in enumerate(cells):
        for part, value in zip(mean, (1e-5, 1.0e-4 + 1e-6 * k, 2e-5), strict=True):
            part.reshape(-1)[cell] = value
    strain = grid.CellStrain(tuple(map(jnp.asarray, mean)), (jnp.zeros(model.material.shape),) * 2)
    listed, new = np.pad(cells, (0, 14), mode="edge"), np.arange(16) < 2
    state = bands_static.opened(model, models.fields(model), state, strain, listed, new)
    at = np.array([[1e-5, 2e-4, 1e-5], [1e-5, 1.5e-4, -1e-5]])

    def ask(strains):
        return bands_static.answers(model, state.pool, bands_static.strains_of(state.pool, strains.reshape(-1)))

    found = ask(at)
    assert (np.asarray(found.status)[:2] == 1).all()
    for k in range(3):
        step = np.zeros_like(at)
        step[:, k] = 1e-9
        by = (np.asarray(ask(at + step).stress) - np.asarray(ask(at - step).stress))[:2] / 2e-9
        np.testing.assert_allclose(np.asarray(found.tangent)[:2, :, k], by, rtol=1e-4, atol=2.0)
        spent = (np.asarray(ask(at + step).spent) - np.asarray(ask(at - step).spent))[:2] / 2e-9
        np.testing.assert_allclose(np.asarray(found.spends)[:2, k], spent, rtol=1e-4, atol=1e-3 * np.abs(found.spends).max())
    assert n.cracks


def test_equations_that_have_lost_their_precision_are_made_anew():
    """Flexibilities off by a per cent: what they take for an equilibrium is none at the nodes."""
    from jaxmpm.follow import Follower

    eq = Equilibria(*model_of(plate()), 1e-8)
    follower = Follower(eq, 5e-3, "time", 5e-5, 1e-8, 1e-4)
    follower.begin()
    while len(eq.system.cells) < 4:
        follower.increment(2e-3)
    eq.system.flexibility *= 1.01
    broken = eq.system
    for _ in range(2):
        follower.increment(2e-3)
    assert eq.system is not broken
    assert 0 < eq.counts.residual < 1e-6
