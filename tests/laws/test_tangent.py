"""Consistent tangents against central differences: every law, stress state and regime."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws.bands_at_random import REGIMES, states_of

from jaxmpm.laws import balance
from jaxmpm.laws.cohesive import CURVES
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.law import tangent
from jaxmpm.laws.smeared import DIRECTIONS, Smeared

with_tangent = jax.jit(balance.respond_with_tangent, static_argnums=3)


def respond(*args):
    """The answer alone, of the same program: compiling is what costs time."""
    return with_tangent(*args)[0]


WEIGHTS = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}  # central difference of fourth order

BANDS = [("damage", size) for size in (3, 4, 6)]
BANDS += [(curve, 3 if curve == "hordijk" else 1) for curve in CURVES]  # a curve is of one variable: in one dimension it is all there
BANDS += [("released", 3), ("closing", 3), ("viscous", 3)]
BANDS += [("plastic", 4)]


def columns_by_difference(stress, strain, step):
    """dσ/dε (size, size, many) of `stress(strain)`."""
    columns = []
    for k in range(len(strain)):
        unit = jnp.zeros_like(strain).at[k].set(step)
        columns.append(sum(w * stress(strain + j * unit) for j, w in WEIGHTS.items()) / step)
    return np.stack(columns, 1)


def relative_error(exact, stress, strain, E, noise):
    """Error over the stiffness of every point, of the best of a few steps, less round-off in it."""
    errors = []
    for step in np.abs(strain).max(0) * np.array([[1e-3], [1e-4], [1e-5]]):
        error = np.abs(exact - columns_by_difference(stress, strain, step)).max((0, 1))
        errors.append((error - noise / step) / E)
    return np.min(errors, 0)


@pytest.mark.parametrize("kind, size", BANDS)
def test_band(kind, size):
    """Left out are states next to a kink (the begin of loading, yielding, closing, a kink of the
    curve, a principal value that changes sign), where a quotient sees both sides.
    """
    for regime in REGIMES:
        embedding, band, ask = states_of(kind, size, regime, respond)
        found, exact = with_tangent(embedding, band, ask, 1e-11)
        stress = lambda strain: np.asarray(respond(embedding, band, strain, 1e-11).stress)  # noqa: B023, E731
        E, ft = np.asarray(embedding.bulk.E), np.asarray(embedding.law.ft)
        error = relative_error(np.asarray(exact), stress, ask, E, 4e-11 * ft)
        assert np.mean(error < 1e-6) > 0.97, (regime, np.sort(error)[-20:])
        assert np.median(error) < 1e-8, regime


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("size", [1, 3, 4, 6])
def test_smeared_crack(direction, size):
    """First loading of any kind, further loading with turning axes, and unloading."""
    rng = np.random.default_rng(size)
    count = 512
    damage = Damage(jnp.full(count, 3.0), 8.184, 0.128, 0.05)
    law = Smeared.of(damage, Elastic(32000.0, 0.2), jnp.asarray(rng.uniform(0.5, 50, count)), direction)
    step = jax.jit(lambda strain, history: law.respond(strain, history))
    exact_of = jax.jit(
        lambda strain, history: jax.vmap(
            lambda law, strain, history: tangent(lambda e: law.respond(e, history)[0], strain), -1, -1
        )(law, strain, history)
    )
    onset = 3.0 / 32000.0
    first = onset * rng.normal(size=(size, count)) * 10 ** rng.uniform(-0.3, 1, count)
    _, cracked = step(first, law.initial(size))
    assert 0.2 < np.mean(cracked.softening > 0) < 0.95
    for strain, history in (
        (first, law.initial(size)),
        (1.5 * first + 0.3 * onset * rng.normal(size=first.shape), cracked),
        (0.6 * first, cracked),
    ):
        strain = np.asarray(strain)
        stress = lambda e: np.asarray(step(e, history)[0])  # noqa: B023, E731
        error = relative_error(np.asarray(exact_of(strain, history)), stress, strain, 32000.0, 1e-12)
        assert np.mean(error < 1e-6) > 0.97, np.sort(error)[-20:]
        assert np.median(error) < 1e-9
