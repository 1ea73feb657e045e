"""Factors of a zone and of all that lies outside it, against dense matrices."""

import numpy as np
import pytest
from static_scenes import plate, without
from test_condensed import model_of

from jaxmpm.condensed import GRIP
from jaxmpm.stiffness import Structure, block_diagonal
from jaxmpm.zoned_factors import FEW, SMALLER, ZonedFactors


@pytest.fixture(scope="module")
def made():
    model, _ = model_of(plate())
    structure = Structure.of(model)
    filled = np.flatnonzero(np.asarray(model.material).reshape(-1) >= 0)
    return structure, np.concatenate([filled[42:45], np.random.default_rng(0).permutation(filled[45:])[:37]])


def dense(structure, cells, tangent):
    rows = structure.rows(cells, 3)
    whole = without(structure, cells, GRIP) + structure.volume * (rows.T @ block_diagonal(tangent) @ rows)
    return (structure.moves.T @ whole @ structure.moves).toarray()


def at_rest(structure, cells):
    """Secants of bands at rest, and of three that soften, one of them not symmetric."""
    rng = np.random.default_rng(1)
    tangent = structure.elastic[cells] * rng.uniform(0.1, 0.9, (len(cells), 1, 1))
    tangent[:3] *= -0.02
    tangent[1, 0, 2] += 300.0
    return tangent


def test_solutions_are_those_of_a_dense_matrix_wherever_the_zone_is(made):
    structure, cells = made
    factors, tangent = ZonedFactors(structure), at_rest(structure, cells)
    right = np.random.default_rng(2).normal(size=(structure.moves.shape[1], 2))
    grip = GRIP * structure.hourglass[cells]

    def is_exact(count=len(cells)):
        matrix = dense(structure, cells[:count], tangent[:count])
        assert np.linalg.norm(matrix @ factors.solve(right) - right, axis=0).max() < 2e-4 * np.linalg.norm(right, axis=0).max()
        factors.sharpen()
        for found, expected in ((factors.solve(right), np.linalg.solve(matrix, right)),
                                (factors.solve_transposed(right[:, 0]), np.linalg.solve(matrix.T, right[:, 0]))):  # fmt: skip
            np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
        assert factors.positive == (np.linalg.slogdet(matrix)[0] > 0)

    factors.take(cells, tangent, grip)
    assert factors.alike and factors.near.any() and not factors.near.all()
    assert (0 < len(factors.part.gone)) and (0 < len(factors.part.edge) < len(factors.part.own))
    is_exact()
    first = factors.near.copy()
    tangent[0] *= -3  # in the zone
    factors.take(cells, tangent, grip)
    assert factors.alike and (factors.near == first).all()
    is_exact()
    outside = np.flatnonzero(~first[cells])
    assert len(outside) > FEW
    tangent[outside[0]] *= 0.5  # one outside: only near by, until it is asked for
    factors.take(cells, tangent, grip)
    assert not factors.alike
    pull = structure.moves.T @ (structure.stiffness @ structure.prescribed[:, :1])
    error = np.linalg.norm(dense(structure, cells, tangent) @ factors.solve(pull) - pull) / np.linalg.norm(pull)
    assert not factors.alike and 1e-9 < error < 2e-4
    factors.sharpen()
    is_exact()
    tangent[outside[1 : FEW + 2]] *= 0.5  # too many: the zone moves
    factors.take(cells, tangent, grip)
    assert factors.alike and factors.near[cells[outside[1]]]
    is_exact()
    tangent[2] = 0.3 * structure.elastic[cells[2]]
    wide = factors.near.sum()
    for _ in range(SMALLER[0] + 2):  # all but two at rest for long: the zone shrinks
        factors.take(cells, tangent, grip)
    assert factors.near.sum() < wide
    is_exact()
    assert not factors.near[cells[30:]].all()
    factors.take(cells[:30], tangent[:30], grip[:30])  # the last ones are whole again, also those outside the zone
    is_exact(30)


def test_a_sign_of_the_determinant_is_seen_outside_and_in(made):
    """Softening so steep that the structure is unstable: an odd number of negative eigenvalues."""
    structure, cells = made
    tangent = at_rest(structure, cells)
    for steep in (-0.02, -0.3, -0.6, -0.9):
        tangent[0] = steep * structure.elastic[cells[0]]
        factors = ZonedFactors(structure)
        factors.take(cells, tangent, GRIP * structure.hourglass[cells])
        assert factors.positive == (np.linalg.slogdet(dense(structure, cells, tangent))[0] > 0)
