"""The pool: bands stay in their places, and solving many is solving each."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import bands, tensor
from jaxmpm.laws import balance
from jaxmpm.laws import band as band_law
from jaxmpm.laws.band import Band, Embedding
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic

SIZE = 3
BLOCK = bands.BLOCK
# two materials
EMBEDDING = Embedding(
    Elastic(jnp.array([32000.0, 20000.0]), jnp.array([0.2, 0.3])),
    Damage(
        ft=jnp.array([3.0, 1.5]),
        Ep=jnp.array([8.0, 15.0]),
        n=jnp.array([0.13, 0.18]),
        h=jnp.array([0.05, 0.01]),
    ),
    jnp.array([3.0, 0.0]),
)


def numbered(first, count):
    """Records of bands whose every number tells which one it is."""
    number = first + np.arange(count, dtype=float)
    lines = lambda k: np.stack([number + 0.1 * i for i in range(k)])  # noqa: E731
    band = Band(lines(2), number, lines(SIZE), lines(2), number, (), number, number)
    return bands.unsolved(jax.tree.map(jnp.asarray, band), SIZE)


def holds(pool, expected):
    """The pool holds bands of these numbers in its first places, in order."""
    assert int(pool.count) == len(expected)
    for leaf in jax.tree.leaves(bands.bands_of(pool, SIZE)):
        rows = np.atleast_2d(np.asarray(leaf))[:, : len(expected)]
        for i, row in enumerate(rows):
            np.testing.assert_allclose(row, np.asarray(expected) + 0.1 * i, rtol=1e-15)
    np.testing.assert_array_equal(np.asarray(pool.cell)[: len(expected)], np.asarray(expected) * 2)


def same(a, b):
    jax.tree.map(np.testing.assert_array_equal, a, b)


def test_empty_pool_has_room_in_whole_blocks_and_no_bands():
    for asked, capacity in ((1, BLOCK), (BLOCK, BLOCK), (BLOCK + 1, 2 * BLOCK)):
        pool = bands.empty_pool(asked, SIZE, jnp.float32)
        assert pool.cell.shape == (capacity,) and int(pool.count) == 0
        assert pool.records.dtype == pool.stress.dtype == jnp.float32
        assert len(pool.records) == capacity
        spare = bands.bands_of(pool, SIZE)
        np.testing.assert_array_equal(np.hypot(*spare.normal), 1)
        np.testing.assert_array_equal(spare.jump, 0)


@pytest.mark.parametrize("size", [3, 4])
def test_records_go_in_and_out(size):
    rng = np.random.default_rng(size)
    row = lambda *shape: jnp.asarray(rng.normal(size=(*shape, 7)))  # noqa: E731
    band = Band(row(2), row(), row(size), row(2), row(), (), row(), row())
    secant = band_law.Secant(row(2, 4), row(3, 4), row())
    records = bands.packed(band, secant)
    assert records.shape == (7, bands.empty_pool(1, size, float).records.shape[1])
    same(bands.unpacked(records, size), (band, secant))


def test_add_puts_only_the_new_ones_behind_the_others_in_order():
    rng = np.random.default_rng(0)
    pool, expected, first = bands.empty_pool(BLOCK, SIZE, jnp.float64), [], 1
    add = jax.jit(bands.add)
    while len(expected) < BLOCK - 76:
        new = rng.random(64) < 0.4
        cells = jnp.asarray(2 * (first + np.arange(64)))
        before = pool
        pool, place = add(pool, numbered(first, 64), cells, jnp.asarray(new), jnp.ones((3, 64)))
        np.testing.assert_array_equal(np.asarray(place)[~new], BLOCK)
        np.testing.assert_array_equal(np.asarray(place)[new], len(expected) + np.arange(new.sum()))
        expected += list(first + np.flatnonzero(new))
        holds(pool, expected)
        same(pool.records[len(expected) :], before.records[len(expected) :])
        first += 64
    same(add(pool, numbered(first, 64), cells, jnp.zeros(64, bool), jnp.ones((3, 64)))[0], pool)
    # to the last place
    room = BLOCK - len(expected)
    cells = 2 * (first + jnp.arange(room))
    pool, _ = bands.add(pool, numbered(first, room), cells, jnp.ones(room, bool), jnp.zeros((3, room)))
    holds(pool, [*expected, *(first + np.arange(room))])


def test_joined_keeps_every_band_and_adds_room():
    pool = bands.empty_pool(BLOCK, SIZE, jnp.float64)
    pool, _ = bands.add(pool, numbered(1, 200), 2 * jnp.arange(1, 201), jnp.ones(200, bool), jnp.zeros((3, 200)))
    spare = bands.empty_pool(2 * BLOCK, SIZE, jnp.float64)
    grown = bands.joined(pool, spare)
    assert grown.cell.shape == (3 * BLOCK,)
    holds(grown, np.arange(1, 201))
    same(grown.records[BLOCK:], spare.records)
    cells = 2 * jnp.arange(201, 201 + BLOCK)
    more, _ = bands.add(grown, numbered(201, BLOCK), cells, jnp.ones(BLOCK, bool), jnp.zeros((3, BLOCK)))
    holds(more, np.arange(1, 201 + BLOCK))


# ------------------------------------------------------------------ solve

BANDS = 2 * BLOCK + 88
CELLS = BANDS + 300
PRECISION = 1e-9
solve = jax.jit(partial(bands.solve, size=SIZE, precision=PRECISION))  # (pool, failed)
respond_alone = jax.jit(partial(balance.respond, precision=PRECISION))
current = jax.jit(partial(bands.current, size=SIZE))


@pytest.fixture(scope="module")
def cracked():
    """A pool of more bands than two blocks, in cells of two materials, and the strain to come.

    Every third band has opened before and goes back, every third goes on, the others are new.
    """
    rng = np.random.default_rng(1)
    material = jnp.asarray(rng.integers(0, 2, CELLS), jnp.int32)
    cells = jnp.asarray(rng.permutation(CELLS)[:BANDS])
    laws = bands.at(EMBEDDING, material[cells])
    angle = rng.uniform(-np.pi / 2, np.pi / 2, BANDS)
    normal = jnp.asarray(np.stack([np.cos(angle), np.sin(angle)]))
    unit = laws.law.ft / laws.bulk.E * 1.1 * tensor.along(normal, SIZE)
    H = jnp.asarray(rng.uniform(0.5, 4.0, BANDS))
    states = jax.jit(band_law.open_band)(laws, unit, normal, H)
    kind = jnp.arange(BANDS) % 3
    opened = respond_alone(laws, states, unit * 3)
    states = jax.tree.map(lambda a, b: jnp.where(kind < 2, a, b), opened.band, states)
    shear = jnp.asarray(1e-6 * rng.normal(size=(SIZE, BANDS)))
    strain = unit * jnp.array([1.5, 5.0, 2.0])[kind] + shear
    mean = tuple(jnp.asarray(rng.normal(size=(3, CELLS)) * 1e-4).at[:, cells].set(strain))
    pool = bands.empty_pool(BANDS, SIZE, jnp.float64)
    records = bands.packed(states, bands.in_plane_secant(laws, states, SIZE))
    pool, _ = bands.add(pool, records, cells, jnp.ones(BANDS, bool), jnp.zeros((3, BANDS)))
    return pool, material, mean, (laws, states, cells, strain)


def test_solving_many_is_solving_each(cracked):
    pool, material, mean, (laws, states, _, strain) = cracked
    after, failed = solve(pool, EMBEDDING, material, mean)
    alone = respond_alone(laws, states, strain)
    assert np.all(alone.status != balance.FAILS) and int(failed) == -1
    loads = np.asarray(alone.band.softening > states.softening)
    assert not loads[0::3].any() and loads[1::3].all() and loads[2::3].all()
    np.testing.assert_array_equal(alone.status == balance.RESTS, ~loads)
    np.testing.assert_allclose(np.asarray(after.stress)[:, :BANDS], alone.stress, rtol=0, atol=1e-7)
    check = partial(np.testing.assert_allclose, rtol=1e-7, atol=1e-11)
    first = jax.tree.map(lambda leaf: np.asarray(leaf)[..., :BANDS], bands.bands_of(after, SIZE))
    for name in ("softening", "jump", "spent", "released"):
        found, expected = (np.asarray(getattr(b, name))[..., loads] for b in (first, alone.band))
        check(found, expected)
    np.testing.assert_array_equal(first.released[~loads], np.asarray(states.released)[~loads])
    # bands at rest keep the jump they were solved with; `current` has what it is now
    now = current(after, EMBEDDING, material, mean)
    check(np.asarray(now.jump)[:, :BANDS][:, ~loads], np.asarray(alone.band.jump)[:, ~loads])
    same(after.records[BANDS:], pool.records[BANDS:])
    same((after.cell, after.count), (pool.cell, pool.count))


def test_solving_again_at_the_same_strain_changes_nothing(cracked):
    """What loaded has come to rest: by its secant it answers as it was solved.

    But for the release along the crack, which takes the cohesion of the last step.
    """
    pool, material, mean, (laws, *_) = cracked
    once, _ = solve(pool, EMBEDDING, material, mean)
    twice, _ = solve(once, EMBEDDING, material, mean)
    keeps = np.asarray(laws.release == 0)
    one, two = (np.asarray(p.stress)[:, :BANDS][:, keeps] for p in (once, twice))
    assert keeps.sum() > BANDS / 3
    np.testing.assert_allclose(two, one, rtol=0, atol=3e-8)


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK])
def test_only_bands_in_use_are_solved(cracked, count):
    """The first `count` bands answer as before; those behind are not touched."""
    pool, material, mean, _ = cracked
    full, _ = solve(pool, EMBEDDING, material, mean)
    fewer = pool._replace(count=jnp.asarray(count, pool.count.dtype))
    after, failed = solve(fewer, EMBEDDING, material, mean)
    check = partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9)
    check(after.stress[:, :count], full.stress[:, :count])
    check(after.records[:count], full.records[:count])
    same(after.records[count:], pool.records[count:])
    assert int(failed) == -1


def test_a_band_that_does_not_balance_is_named(cracked):
    pool, material, mean, (*_, cells, _) = cracked
    for place in (0, BLOCK + 44, BANDS - 1):
        spoilt = (mean[0].at[cells[place]].set(jnp.nan), *mean[1:])
        _, failed = solve(pool, EMBEDDING, material, spoilt)
        assert int(failed) == place


# ------------------------------------------------------------------ effective size


def chords(normal, cell, count=20001):
    """Lengths of the cuts through a square by lines of this normal, evenly spaced over it."""
    n, t = normal, np.array([-normal[1], normal[0]])
    width = cell * (abs(n[0]) + abs(n[1]))
    offsets = ((np.arange(count) + 0.5) / count - 0.5) * width
    low, high = np.full(count, -np.inf), np.full(count, np.inf)
    for k in (0, 1):
        if abs(t[k]) > 1e-12:
            ends = np.sort([(s * cell / 2 - offsets * n[k]) / t[k] for s in (-1, 1)], axis=0)
            low, high = np.maximum(low, ends[0]), np.minimum(high, ends[1])
    return np.maximum(high - low, 0)


@pytest.mark.parametrize("angle", [0.0, 10.0, 30.0, 45.0, 77.0, 90.0, 120.0, -45.0, 200.0])
def test_effective_size_is_the_area_over_the_cut(angle):
    cell = 2.5
    normal = np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    lengths = chords(normal, cell)
    size = partial(bands.effective_size, normal=jnp.asarray(normal), cell=cell)
    assert float(size("projected")) == pytest.approx(cell**2 / lengths.mean(), rel=1e-4)
    assert float(size("centreline")) == pytest.approx(
        cell**2 / lengths[len(lengths) // 2], rel=1e-9
    )
    assert float(size("sqrt_area")) == cell


def test_effective_size_of_many_normals_at_once():
    normals = jnp.array([[1.0, 0.6, 0.0], [0.0, -0.8, 1.0]])
    found = bands.effective_size("projected", normals, 2.0)
    np.testing.assert_allclose(found, [2.0, 2.8, 2.0], rtol=1e-15)
