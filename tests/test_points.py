"""Points in bins: nothing lost, nothing doubled, and transfers as in plain NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import transfer
from jaxmpm.points import in_bins, listed, slots_of
from jaxmpm.rebinning import rebin
from jaxmpm.shape_functions import Cubic, Gimp, Linear, Quadratic

SHAPES = [Linear(), Gimp(0.25), Quadratic(), Cubic()]
ORIGIN, CELL = (1.0, -2.0, 0.5), 0.5


def scattered(shape, dimension=2, count=300, dtype=float, seed=0, **room):
    """Random points in a box of 10 cells a side, each known by its mass."""
    rng = np.random.default_rng(seed)
    origin = np.array(ORIGIN[:dimension])
    x = origin[:, None] + CELL * rng.uniform(1, 9, (dimension, count))
    size = dimension * (dimension + 1) // 2
    fields = {
        "velocity": rng.normal(size=(dimension, count)).astype(dtype),
        "gradient": rng.normal(size=(dimension, dimension, count)).astype(dtype),
        "stress": rng.normal(size=(size, count)).astype(dtype),
        "mass": (1.0 + np.arange(count)).astype(dtype), "volume": rng.uniform(1, 2, count).astype(dtype),
        "material": np.zeros(count, int), "home": x.astype(dtype), "band": 1 + np.arange(count),
    }  # fmt: skip
    bins = (10 + shape.centred,) * dimension
    return x, fields, in_bins(x, fields, origin, CELL, shape.centred, bins=bins, window=(0,) * dimension, **room)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_points_come_back_as_they_were(shape, dimension):
    x, fields, points = scattered(shape, dimension)
    found, other = listed(points, ORIGIN[:dimension], CELL, shape.centred)
    order = np.argsort(other["mass"])
    np.testing.assert_allclose(found[:, order], x, rtol=0, atol=1e-13)
    for name, value in fields.items():
        np.testing.assert_array_equal(other[name][..., order], value)


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_points_that_wander_are_neither_lost_nor_doubled(dimension):
    """Fifty steps of random motion; with each point go all its numbers."""
    shape = Quadratic()
    x, fields, points = scattered(shape, dimension, slots=120 if dimension == 1 else 20)
    move = jax.jit(rebin)
    address = jnp.zeros(len(x[0]), jnp.int32)
    rng = np.random.default_rng(1)
    of = np.asarray(points.mass) > 0
    for _ in range(50):
        mass = np.asarray(points.mass)
        step = np.zeros((dimension, *mass.shape))
        shift = 0.15 * rng.normal(size=(dimension, len(x[0]))) * (rng.uniform(size=len(x[0])) < 0.5)
        inside = (x + CELL * shift > np.array(ORIGIN[:dimension])[:, None] + CELL) & (
            x + CELL * shift < np.array(ORIGIN[:dimension])[:, None] + 9 * CELL
        )
        shift = np.where(inside, shift, 0.0)
        x = x + CELL * shift
        which = np.where(mass > 0, mass - 1, 0).astype(int)
        for a in range(dimension):
            step[a] = np.where(mass > 0, shift[a][which], 0.0)
        points, address, room = move(points._replace(place=points.place + step), address)
        assert not bool(room.slots) and not bool(room.window)
        used = np.asarray(points.mass) > 0
        places = np.asarray(points.place)[:, used]
        assert (places >= 0).all() and (places < 1).all()
    assert used.sum() == of.sum()
    found, other = listed(points, ORIGIN[:dimension], CELL, shape.centred)
    order = np.argsort(other["mass"])
    np.testing.assert_allclose(found[:, order], x, rtol=0, atol=1e-12)
    for name, value in fields.items():
        np.testing.assert_array_equal(other[name][..., order], value)
    # the band of each point knows where it is, once it has moved
    there = np.asarray(points.band).reshape(-1)[np.asarray(address)]
    moved = np.asarray(address) > 0
    assert moved.sum() > 200
    np.testing.assert_array_equal(there[moved], 1 + np.flatnonzero(moved))
    # a slot that has been left has no volume either: its stress would pull as a ghost's
    assert (np.asarray(points.volume)[~used] == 0).all()


def test_a_point_without_room_stays_and_says_so():
    x, fields, points = scattered(Linear(), 1, count=200)
    full = np.asarray((points.mass > 0).all(0))
    assert full.any() and not full.all()
    # everything one bin to the right, into bins that are full too
    points, _, room = jax.jit(rebin)(points._replace(place=jnp.where(points.mass > 0, points.place + 1, 0.0)))
    assert bool(room.slots) and not bool(room.window)
    assert float(points.mass.sum()) == fields["mass"].sum()
    more = in_bins(*listed(points, ORIGIN[:1], CELL, False), ORIGIN[:1], CELL, False, slots=3 * slots_of(points))
    assert float(more.mass.sum()) == fields["mass"].sum()
    np.testing.assert_allclose(np.sort(listed(more, ORIGIN[:1], CELL, False)[0]), np.sort(x) + CELL, atol=1e-12)
    # and out of the window
    away = points._replace(place=jnp.where(points.mass > 0, points.place - 20.0, 0.0))
    away, _, room = jax.jit(rebin)(away)
    assert bool(room.window) and float(away.mass.sum()) == fields["mass"].sum()


def dense(shape, x, dimension):
    """Weights (nodes, count) and slopes (d, nodes, count) of every node, in NumPy."""
    count = 10 + 1 + 2 * shape.lead
    origin = np.array(ORIGIN[:dimension])
    values, slopes = [], []
    for a in range(dimension):
        y = (x[a] - origin[a]) / CELL + (0.5 if shape.centred else 0.0)
        bin_of = np.floor(y).astype(int)
        v, s = (np.asarray(jnp.stack(part)) for part in shape.weights(jnp.asarray(y - bin_of)))
        value, slope = np.zeros((2, count, x.shape[1]))
        for k in range(shape.count):
            value[bin_of + k, np.arange(x.shape[1])] = v[k]
            slope[bin_of + k, np.arange(x.shape[1])] = s[k] / CELL
        values.append(value)
        slopes.append(slope)
    letters = "abc"[:dimension]
    spec = ",".join(f"{i}p" for i in letters) + f"->{letters}p"
    whole = np.einsum(spec, *values)
    by = [np.einsum(spec, *[slopes[b] if b == a else values[b] for b in range(dimension)]) for a in range(dimension)]
    return whole, np.stack(by)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("dimension, dtype", [(1, float), (2, float), (2, np.float32), (3, float)])
def test_transfers_are_those_of_plain_sums(shape, dimension, dtype):
    """Both ways, values and gradients, in both precisions."""
    x, fields, points = scattered(shape, dimension, dtype=dtype)
    _, other = listed(points, ORIGIN[:dimension], CELL, shape.centred)
    order = np.argsort(other["mass"])
    value, slope = dense(shape, x, dimension)
    tight = dict(rtol=0, atol=(1e-11 if dtype is float else 2e-3) * fields["mass"].max())
    w = transfer.weights(shape, points.place, CELL)

    def there(points):
        share = lambda node: transfer.value_at(w, node) * points.mass * points.velocity  # noqa: E731
        return transfer.to_nodes(shape, share, dimension)

    nodal = np.asarray(jax.jit(there)(points))
    expected = np.einsum("...p,ap->a...", value, fields["mass"] * fields["velocity"])
    cut = tuple(slice(0, n) for n in nodal.shape[1:])
    np.testing.assert_allclose(nodal, expected[(slice(None), *cut)], **tight)
    field = np.random.default_rng(3).normal(size=nodal.shape)
    padded = np.zeros(expected.shape)
    padded[(slice(None), *cut)] = field
    back, gradient = jax.jit(lambda p, f: (
        transfer.to_points(shape, transfer.weights(shape, p.place, CELL), f),
        transfer.gradient(shape, transfer.weights(shape, p.place, CELL), f),
    ))(points, jnp.asarray(field, dtype))  # fmt: skip
    used = np.asarray(points.mass) > 0
    close = dict(rtol=0, atol=1e-12 if dtype is float else 1e-4)
    nodes = "ijk"[:dimension]
    at = np.einsum(f"{nodes}p,a{nodes}->ap", value, padded)
    np.testing.assert_allclose(np.asarray(jnp.array(back))[:, used][:, order], at, **close)
    by = np.einsum(f"b{nodes}p,a{nodes}->abp", slope, padded)
    np.testing.assert_allclose(np.asarray(jnp.array(gradient))[..., used][..., order], by, rtol=0, atol=close["atol"] * 20)
