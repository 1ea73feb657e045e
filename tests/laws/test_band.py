"""Bands in a bulk: tangents and derivatives by parameters, equilibrium, unloading, the secant."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws.bands_at_random import COUNT, REGIMES, embedded, respond, states_of
from test_tensor import full

from jaxmpm.laws import balance
from jaxmpm.laws.band import at_rest, secant

CASES = pytest.mark.parametrize(
    "kind, size",
    [
        ("damage", 4), ("released", 3), ("closing", 3), ("viscous", 3), ("hordijk", 3),
    ],
)  # fmt: skip
NAMES = ("E", "ft", "Ep", "n", "h")


def stress_of(kind, variables, nu, drag, band):
    """Stress as a function of strain and ln of E, ft, Ep (or GF), n, h, all in one."""
    size = len(band.onset_strain)
    values = dict(zip(NAMES, jnp.exp(variables[size:]), strict=True))
    embedding = embedded(kind, nu=nu, **values)
    if drag is not None:
        embedding = type(embedding)(embedding.bulk, embedding.law, embedding.release, drag)
    return balance.stress_at(variables[:size], embedding, band)


@cache
def directional(kind):
    """Value and derivative in one direction, of one program: compiling is what costs time."""
    both = jax.jit(lambda v, t, *rest: jax.jvp(lambda v: stress_of(kind, v, *rest), (v,), (t,)))
    value = lambda v, *rest: both(v, jnp.zeros_like(v), *rest)[0]  # noqa: E731
    forward = lambda *args: both(*args)[1]  # noqa: E731
    return value, forward


def arguments(kind, size, regime):
    embedding, band, ask = states_of(kind, size, regime)
    law, bulk = embedding.law, embedding.bulk
    rng = np.random.default_rng(0)
    # cohesive laws of the tests take their energy from a damage law: any will do
    Ep = law.Ep if hasattr(law, "Ep") else jnp.asarray(rng.uniform(5.0, 20.0, COUNT))
    n = law.n if hasattr(law, "n") else jnp.full(COUNT, 0.15)
    logs = jnp.log(jnp.stack([bulk.E, law.ft, Ep, n, law.h]))
    return jnp.concatenate([ask, logs]), bulk.nu, embedding.drag, band


WEIGHTS = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}  # central difference of fourth order
STEPS = (1e-3, 1e-4, 1e-5)


@CASES
def test_derivatives_are_those_of_central_differences(kind, size):
    """By every strain and parameter, below 1e-6 of the largest or of round-off in the quotient.

    Left out are states next to a kink (the begin of loading, closing, a principal value that
    changes sign), where a quotient sees both sides.
    """
    value, forward = directional(kind)
    for regime in REGIMES:
        variables, *rest = arguments(kind, size, regime)
        scale = jnp.ones_like(variables).at[:size].set(jnp.abs(variables[:size]).max(0))
        exact, errors = [], []
        for k in range(size + len(NAMES)):
            unit = jnp.zeros_like(variables).at[k].set(scale[k])
            slope = forward(variables, unit, *rest)
            best = np.inf
            for step in STEPS:
                quotient = sum(
                    w * value(variables + j * step * unit, *rest) for j, w in WEIGHTS.items()
                )
                best = np.minimum(best, np.abs(quotient / step - slope).max(0))
            exact.append(np.abs(slope).max(0))
            errors.append(best)
        exact, errors = np.array(exact), np.array(errors)
        assert np.isfinite(exact).all()
        E, ft = np.exp(variables[size]), np.exp(variables[size + 1])
        noise = (3e-13 * E * np.asarray(scale[0]) + 2e-11 * ft) / max(STEPS)
        relative = errors / (1e-6 * exact.max(0) + noise)
        # by strain relative to the stiffness, by a parameter to the largest of all
        assert np.mean(relative.max(0) < 1) > 0.97, (regime, np.sort(relative.max(0))[-20:])
        assert np.median(errors / exact.max(0)) < 1e-8, regime


@pytest.mark.parametrize("kind, size", [("damage", 4), ("hordijk", 3)])
def test_reverse_differentiation_says_the_same(kind, size):
    _, forward = directional(kind)
    # hardly optimised: should that ever make it wrong (see conftest.py), the other mode, which is, says so
    total = jax.jit(
        jax.grad(lambda v, w, *rest: (w * stress_of(kind, v, *rest)).sum()),
        compiler_options={"xla_backend_optimization_level": 0},
    )
    rng = np.random.default_rng(1)
    for regime in ("loading", "unloading", "damaged"):
        variables, *rest = arguments(kind, size, regime)
        weight, way = rng.normal(size=(size, COUNT)), rng.normal(size=variables.shape)
        way[:size] *= np.abs(variables[:size]).max(0)
        one = (weight * forward(variables, jnp.asarray(way), *rest)).sum(0)
        other = (total(variables, weight, *rest) * way).sum(0)
        np.testing.assert_allclose(other, one, rtol=1e-8, atol=1e-9 * np.abs(one).max())


# ------------------------------------------------------------------ balance


@pytest.mark.parametrize("size", [3, 4, 6])
def test_traction_is_continuous_and_the_strains_add_up(size):
    """Eqs. 2, 3, 6 written with full tensors in NumPy, from the answered jump and softening."""
    embedding, band, ask = states_of("damage", size, "sheared")
    found = respond(embedding, band, ask, 1e-11)
    E, nu, h = (np.asarray(a)[:, None, None] for a in (embedding.bulk.E, embedding.bulk.nu, embedding.law.h))

    def hooke(strain):
        if size == 3:  # the strain out of plane that leaves no stress there
            strain = strain.copy()
            strain[:, 2, 2] = -nu[:, 0, 0] / (1 - nu[:, 0, 0]) * (strain[:, 0, 0] + strain[:, 1, 1])
        trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
        return E * nu / ((1 + nu) * (1 - 2 * nu)) * trace * np.eye(3) + E / (1 + nu) * strain

    three = lambda v: np.pad(np.asarray(v).T, ((0, 0), (0, 3 - len(v))))  # noqa: E731
    n, w = three(band.normal), three(found.band.jump)
    dyad = np.einsum("ki,kj->kij", n, w)
    tensors = lambda v, shear: full(np.asarray(v).T, shear)  # noqa: E731
    inside = tensors(band.onset_strain, 0.5) + (dyad + dyad.transpose(0, 2, 1)) / 2 / h
    integrity = np.exp(-np.asarray(found.band.softening))[:, None, None]
    carried = np.einsum("kij,kj->ki", integrity * hooke(inside), n)
    stress = tensors(found.stress, 1.0)
    np.testing.assert_allclose(np.einsum("kij,kj->ki", stress, n), carried, rtol=0, atol=1e-9)
    f = h / np.asarray(band.size)[:, None, None]
    outside = hooke((tensors(ask, 0.5) - f * inside) / (1 - f))
    np.testing.assert_allclose(stress, outside, rtol=0, atol=1e-8)


@pytest.mark.parametrize("kind, size", [("damage", 3), ("damage", 6), ("released", 4)])
def test_secant_answers_as_the_solver_does_or_says_that_the_band_loads(kind, size):
    for regime in ("unloading", "loading"):
        embedding, band, ask = states_of(kind, size, regime)
        found = respond(embedding, band, ask, 1e-11)
        jump, stress, loads = at_rest(secant(embedding, band), embedding, band, ask)
        np.testing.assert_array_equal(loads, np.asarray(found.status) != balance.RESTS)
        still = ~np.asarray(loads)
        assert still.mean() > 0.9 if regime == "unloading" else still.mean() < 0.1
        near = lambda a, b, atol: np.testing.assert_allclose(  # noqa: E731
            np.asarray(a)[:, still], np.asarray(b)[:, still], rtol=0, atol=atol
        )
        near(stress, found.stress, 1e-9)
        near(jump, found.band.jump, 1e-11)


def test_unloading_and_reloading_keep_to_the_secant():
    embedding, band, top = states_of("damage", 3, "loading")
    loaded = respond(embedding, band, top, 1e-11)
    state, stresses = loaded.band, []
    for share in (0.5, 0.0, 0.5, 1.0):
        found = respond(embedding, state, share * top, 1e-11)
        assert (np.asarray(found.status) == balance.RESTS).mean() > 0.9
        stresses.append(np.asarray(found.stress))
        state = found.band
    rests = np.asarray(found.band.softening == loaded.band.softening)
    half, none, again, back = (s[:, rests] for s in stresses)
    np.testing.assert_allclose(half, (back + none) / 2, rtol=0, atol=1e-9)
    np.testing.assert_allclose(again, half, rtol=0, atol=1e-9)
    np.testing.assert_allclose(back, np.asarray(loaded.stress)[:, rests], rtol=0, atol=1e-9)
