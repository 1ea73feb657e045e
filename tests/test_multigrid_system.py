"""Equilibrium by multigrid: against the sparse system, against the dense one over a whole curve, and when it is chosen."""

import numpy as np
import pytest
from static_scenes import bar, plate
from test_condensed import model_of
from test_zoned_factors import dense

from jaxmpm import elastic_grid, multigrid_system, zoned_factors
from jaxmpm.condensed import Condensed
from jaxmpm.equilibria import Equilibria
from jaxmpm.errors import SceneError
from jaxmpm.factors import Factors
from jaxmpm.follow import Follower
from jaxmpm.full_system import Full
from jaxmpm.multigrid_system import MatrixFree, lowest, positive
from jaxmpm.stiffness import Structure, amplitudes

HASTY = True


@pytest.fixture
def for_all(monkeypatch):
    """Multigrid for structures of any size, and solutions as exact as factors give them."""
    monkeypatch.setattr(elastic_grid, "MANY", 0)
    monkeypatch.setattr(elastic_grid, "LARGE", 0)
    monkeypatch.setattr(multigrid_system, "FORCING", (1e-9, 1e-9))


@pytest.fixture
def both(monkeypatch):
    """The sparse system and the matrix-free one of a plate with some cracked cells, a gauge, and their cells."""
    model, _ = model_of(plate())
    cells = np.flatnonzero(np.asarray(model.material).reshape(-1) >= 0)[[45, 200, 46]]
    gauge = np.zeros(model.free.size)
    gauge[np.asarray(model.gauges["left_notch"].dofs)] = model.gauges["left_notch"].weights
    full = Full(Structure.of(model), cells, gauge)
    monkeypatch.setattr(elastic_grid, "MANY", 0)
    monkeypatch.setattr(elastic_grid, "LARGE", 0)
    monkeypatch.setattr(multigrid_system, "FORCING", (1e-10, 1e-10))
    monkeypatch.setattr(zoned_factors, "FORCING", 1e-12)
    free = MatrixFree(Structure.of(model), cells[:2], gauge)
    free.add(cells[2:])
    return model, full, free


def softening(rng):
    """Tangents of three bands that soften, not symmetric."""
    return rng.normal(size=(3, 3, 3)) * 2e3


def test_it_makes_the_step_of_the_sparse_system(both):
    """For controls of load, energy and gauge; the preconditioner is of the first tangents."""
    model, full, free = both
    np.testing.assert_allclose(free.structure.response, full.structure.response, atol=1e-9 * np.abs(full.structure.response).max())
    rng, a = np.random.default_rng(3), amplitudes(model, 2e-3)
    u = full.structure.response @ a
    stress, spends = rng.normal(size=9), rng.normal(size=9)
    for by in (None, "spent", "gauge"):
        tangent, found = softening(rng), []
        for system in (full, free):
            x = system.unknowns(u, a)
            slopes = system.slopes(spends, a) if by == "spent" else system.reading_slopes(tangent, a) if by else None
            short = 0.1 - (system.reading(x, stress, a) if by == "gauge" else 0.0)
            change, factor = system.step(tangent, system.residual(x, stress, a), None if by is None else a, slopes, short)
            found.append((system.strain(x + change, a if by is None else a + factor * a), factor, system.displacement(x, stress, a)))
        for one, other in zip(*found, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-7 * np.abs(one).max())
    tangent, right = softening(rng), rng.normal(size=(full.structure.moves.shape[1], 2))
    exact = full.adjoint(tangent, right)
    np.testing.assert_allclose(free.adjoint(tangent, right), exact, atol=1e-6 * np.abs(exact).max())
    np.testing.assert_allclose(free.adjoint(tangent, right[:, 0]), exact[:, 0], atol=1e-6 * np.abs(exact).max())
    free.keep(2)
    assert len(free.cells) == 2 and free.counts["solves"] > 3


def test_softest_mode_and_stability(both):
    """A column of cells so soft that the plate loses its stability: against all eigenvalues; the mode found has negative energy."""
    model, first, second = both
    cells = np.flatnonzero(np.asarray(model.material)[:, 5] >= 0) * model.material.shape[1] + 5
    full, free = Full(first.structure, cells), MatrixFree(second.structure, cells)
    for share, stable in ((-0.002, True), (-0.08, False)):
        tangent = share * free.structure.elastic[cells]
        direct, found = full.softest(tangent), free.softest(tangent)
        matrix = dense(full.structure, cells, tangent)
        assert (np.linalg.eigvalsh(matrix)[0] > 0) == stable
        assert direct[1] == found[1] == stable
        assert (found[0] @ matrix @ found[0] > 0) == stable
        assert np.abs(free.by_unknowns @ found[0]).max() == pytest.approx(1.0)
    free.step(tangent, np.ones(len(matrix)))
    assert free.stable is False


def test_whole_curve_is_that_of_the_dense_system(monkeypatch):
    """The plate from rest to well behind its peak, with the forcing that runs have; the same increments."""
    curves = []
    for many in (10**9, 0):
        for limit in ("MANY", "LARGE"):
            monkeypatch.setattr(elastic_grid, limit, many)
        eq = Equilibria(*model_of(plate()), 1e-6)
        follower, loads = Follower(eq, 5e-3, "time", 5e-5, 1e-8, 1e-4), []
        top = np.asarray(eq.model.displacements[0].dofs)
        follower.begin()
        for time in np.linspace(0.0, 2.5e-3, 11)[1:]:
            while follower.time < (1 - 1e-9) * time:
                follower.increment(time)
            loads.append(eq.now.force[top].sum())
        assert isinstance(eq.system, MatrixFree if many == 0 else Condensed)
        curves.append((np.array(loads), len(eq.system.cells), eq.counts.increments))
    assert curves[0][1:] == curves[1][1:]
    np.testing.assert_allclose(curves[0][0], curves[1][0], atol=1e-5 * curves[0][0].max())


def test_it_is_chosen_by_size(monkeypatch):
    """Where many cells crack from a middle size on, everywhere from a larger one on."""
    monkeypatch.setattr(elastic_grid, "MANY", 600)
    eq = Equilibria(*model_of(plate()), 1e-6)
    assert isinstance(eq.system, Condensed) and isinstance(eq.structure.factors, Factors)
    assert isinstance(eq._of_all_nodes([]), MatrixFree)
    monkeypatch.setattr(elastic_grid, "LARGE", 700)
    assert isinstance(Equilibria(*model_of(plate()), 1e-6).system, MatrixFree)
    short = Equilibria(*model_of(bar(100)), 1e-6)
    assert isinstance(short.system, Condensed) and isinstance(short._of_all_nodes([]), Full)


def test_a_body_that_can_slide_is_refused(for_all):
    with pytest.raises(SceneError, match="supports that hold every body"):
        Structure.of(model_of(bar(100, 'supports.1.fix=["x"]'))[0])


def test_tangents_made_positive_are_near():
    """Of all positive ones the nearest to their symmetric part, and that itself where it is positive."""
    rng = np.random.default_rng(0)
    tangent = softening(rng)
    elastic = np.tile(np.eye(3) * 3e4, (3, 1, 1))
    found, symmetric = positive(tangent, elastic), (tangent + tangent.swapaxes(1, 2)) / 2
    own = np.linalg.eigvalsh(symmetric)
    np.testing.assert_allclose(np.linalg.eigvalsh(found), np.maximum(own, 0.03), rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found - symmetric, axis=(1, 2)), np.linalg.norm(np.minimum(own, 0.0), axis=1), rtol=1e-4)
    np.testing.assert_allclose(positive(elastic, elastic), elastic)
    np.testing.assert_allclose(np.abs(lowest(np.diag([3.0, -1.0, 2.0]))), [0.0, 1.0, 0.0])
