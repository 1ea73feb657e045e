"""Shape functions: partition of unity, linear fields, derivatives, and their forms at the edge."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import transfer
from jaxmpm.shape_functions import Cubic, Gimp, Linear, Quadratic

SHAPES = pytest.mark.parametrize("shape", [Linear(), Gimp(0.25), Gimp(0.5), Quadratic(), Cubic()], ids=str)
Y = np.linspace(0, 1, 41, endpoint=False)


def nodes_from_place(shape, y):
    """Distance in cells from a place to each node of its bin, (count, many)."""
    middle = 0.5 if shape.centred else 0.0
    return np.array([k - shape.lead + middle - y for k in range(shape.count)])


@SHAPES
def test_sum_is_one_and_linear_fields_are_exact(shape):
    value, slope = (np.array(a) for a in shape.weights(jnp.asarray(Y)))
    x = nodes_from_place(shape, Y)
    np.testing.assert_allclose(value.sum(0), 1, atol=1e-14)
    np.testing.assert_allclose((value * x).sum(0), 0, atol=1e-14)
    np.testing.assert_allclose(slope.sum(0), 0, atol=1e-13)
    np.testing.assert_allclose((slope * x).sum(0), 1, atol=1e-13)
    assert (value >= 0).all()


@SHAPES
def test_slopes_are_those_of_differences_and_functions_join_up(shape):
    y = Y[1:] + 1e-3
    step = 1e-6
    ahead, behind = (np.array(shape.weights(jnp.asarray(y + s * step))[0]) for s in (1, -1))
    slope = np.array(shape.weights(jnp.asarray(y))[1])
    np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), atol=1e-5)
    # a node is the next one of the next bin
    end, begin = (np.array(shape.weights(jnp.asarray([v]))[0])[:, 0] for v in (1 - 1e-12, 0.0))
    np.testing.assert_allclose(np.r_[end, 0], np.r_[0, begin], atol=1e-11)


@pytest.mark.parametrize("shape", [Gimp(0.25), Quadratic(), Cubic()], ids=str)
def test_edge_has_the_value_of_its_node_and_linear_fields_are_exact_up_to_it(shape):
    cells, rng = (6,), np.random.default_rng(0)
    bins = 7 if shape.centred else 6
    window = jnp.zeros(1, jnp.int32)
    nodes = bins + shape.count - 1
    number = np.arange(nodes) - shape.lead
    inside = (number >= 0) & (number <= 6)
    field = jnp.asarray(np.where(inside, rng.normal(size=nodes), 0.0))
    whole = transfer.unfold(shape, field, window, cells)
    place = jnp.full((1, 1, bins), 0.5 if shape.centred else 0.0)
    w = transfer.weights(shape, place, 1.0)
    at_edge = transfer.to_points(shape, w, [whole])[0][0, 0]
    if not isinstance(shape, Gimp):  # whose points have a width, and reach over the edge
        assert float(at_edge) == pytest.approx(float(field[shape.lead]), abs=1e-14)
    line = transfer.unfold(shape, jnp.asarray(np.where(inside, 2.0 + 3 * number, 0.0)), window, cells)
    np.testing.assert_allclose(line[: 6 + 2 * shape.lead + 1], (2.0 + 3 * number)[: 6 + 2 * shape.lead + 1], atol=1e-12)
    # what is handed on by `fold` is what `unfold` takes, the one the transpose of the other
    other = jnp.asarray(rng.normal(size=nodes))
    folded = transfer.fold(shape, other, window, cells)
    assert float(folded @ field) == pytest.approx(float(other @ whole), abs=1e-12)
    assert float(folded.sum()) == pytest.approx(float(other[: 7 + 2 * shape.lead].sum() + other[7 + 2 * shape.lead :].sum()), abs=1e-12)
