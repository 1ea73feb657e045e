"""A second band across the first: two cracks in one point, each with its own energy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws.bands_at_random import concrete

from jaxmpm.laws import balance, crossing
from jaxmpm.laws.band import energies, open_band

ONE = jax.tree.map(lambda leaf: np.asarray(leaf)[..., 0], concrete(1, nu=0.0))  # nothing is compiled as tests are collected
FIRST = np.array([1.0, 0.0, 0.0])
ONSET = 3.0 / 32000.0
H = 2.5
both = jax.jit(balance.respond_with_tangent)
open_second = jax.jit(crossing.open_second)


def respond(*args):
    return both(*args)[0]


@pytest.fixture(scope="module")
def crossed():
    """A point pulled along x until it has cracked, then along y to the second onset."""
    band = open_band(ONE, ONSET * FIRST, jnp.array([1.0, 0.0]), jnp.asarray(H))
    strain = jnp.array([0.01, 0.0, 0.0])
    band = respond(ONE, band, strain).band
    # the band, h of H, keeps its strain along the crack: the bulk has the rest of it
    strain = strain.at[1].set(ONSET * (1 - 0.05 / H))
    ratio, normal = jax.jit(crossing.parallel_ratio)(ONE, band, strain)
    np.testing.assert_allclose(np.abs(normal), [0, 1], atol=1e-12)
    assert ratio == pytest.approx(1, rel=1e-9)
    return band, *open_second(ONE, band, strain * jnp.array([1.0, 1 + 1e-9, 1.0]), jnp.asarray(H))


def test_both_cracks_open_and_each_gives_its_fracture_energy(crossed):
    _, outer, second = crossed
    for along, across in ((0.01, 0.002), (0.01, 0.01), (0.05, 0.03), (2.0, 2.0)):
        found = respond(outer, second, jnp.array([along, across, 0.0]))
        assert found.status == balance.LOADS
        second = found.band
    assert float(jnp.abs(found.stress).max()) < 1e-3 * 3.0
    _, dissipated = jax.jit(energies)(outer, second, jnp.array([2.0, 2.0, 0.0]))
    assert float(dissipated) * H == pytest.approx(2 * 0.110036, rel=0.03)


def test_without_pull_along_it_the_second_band_rests_and_hardly_matters(crossed):
    """It keeps its strain at onset, which the rest of the point makes up for: a share h/H."""
    band, outer, second = crossed
    aside = jnp.array([0.02, 0.3 * ONSET, 0.0])
    alone, crossing_too = respond(ONE, band, aside), respond(outer, second, aside)
    np.testing.assert_allclose(crossing_too.stress, alone.stress, rtol=0.05 / H, atol=1e-8)
    assert crossing_too.status == balance.RESTS


@pytest.mark.parametrize(
    "ask",
    [(0.011, 0.002, 0.0), (0.013, 0.004, 2e-4), (0.004, 0.001, 1e-4), (0.02, 0.3 * ONSET, 0.0)],
    ids=["opens", "both load", "both unload", "second rests"],
)
def test_tangent_goes_through_both_bands(ask, crossed):
    """By central differences of fourth order."""
    _, outer, second = crossed
    if ask != (0.011, 0.002, 0.0):
        second = respond(outer, second, jnp.array([0.011, 0.002, 0.0])).band
    found, exact = both(outer, second, jnp.array(ask))
    assert found.status != balance.FAILS
    columns = []
    for k in range(3):
        unit = jnp.zeros(3).at[k].set(1e-6)
        pull = lambda j: np.asarray(respond(outer, second, jnp.array(ask) + j * unit).stress)  # noqa: B023, E731
        columns.append((8 * (pull(1) - pull(-1)) - (pull(2) - pull(-2))) / 12e-6)
    np.testing.assert_allclose(exact, np.stack(columns, 1), rtol=0, atol=1e-6 * 32000)
