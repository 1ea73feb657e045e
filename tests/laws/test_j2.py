"""Von Mises plasticity against closed forms, and plane stress against three dimensions.

Compiling is what costs time here, so all tests share a few functions over batches of one size.
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmpm import tensor
from jaxmpm.laws.j2 import J2

SIZES = pytest.mark.parametrize("size", [1, 3, 4, 6])
FEW_SIZES = pytest.mark.parametrize("size", [3, 6])
STEEL = J2(210000.0, 0.3, 300.0, 2000.0)
YIELD = 300.0 / 210000.0  # strain
COUNT = 256  # points of a batch
LONGEST = 4001  # strains of a path


def answer(law, strain, history):
    stress, new = law.respond(strain, history)
    return stress, new, law.stored(strain, new)


# what is compiled runs for milliseconds, so that optimising it takes longer than it saves
jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 1})
respond = jit(jax.vmap(answer))
push = jit(jax.vmap(lambda at, along: jax.jvp(answer, at, along)[1]))
pull = jit(jax.vmap(lambda at, back: jax.vjp(answer, *at)[1](back)))


@jit
def follow_all(law, path):
    def step(history, strain):
        stress, history, energy = answer(law, strain, history)
        return history, (stress, history, energy)

    return jax.lax.scan(step, law.initial(path.shape[1]), path)[1]


def follow(law, path):
    """Stresses, histories and stored energies of one point on a path of strains (steps, size)."""
    law = jax.tree.map(np.float64, law)
    padded = np.concatenate([path, np.repeat(path[-1:], LONGEST - len(path), 0)])
    return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(path)], follow_all(law, padded))


def batch(law, count=COUNT):
    return jax.tree.map(lambda leaf: np.full(count, leaf), law)


@partial(jit, static_argnums=1)
def initial(laws, size):
    return jax.vmap(lambda law: law.initial(size))(laws)


@cache
def random_states(size):
    """Laws, strains and histories of random points, some elastic, most yielding, in NumPy."""
    rng = np.random.default_rng(size)
    laws = J2(
        rng.uniform(5e4, 2e5, COUNT),
        rng.uniform(0.0, 0.45, COUNT),
        rng.uniform(100.0, 400.0, COUNT),
        rng.choice([0.0, 500.0, 2e4], COUNT),
    )
    scale = 10 ** rng.uniform(-0.5, 1.5, (COUNT, 1)) * YIELD
    strain = rng.normal(size=(COUNT, size)) * scale
    _, history, _ = respond(laws, strain, initial(laws, size))
    return laws, strain + rng.normal(size=(COUNT, size)) * scale, jax.tree.map(np.asarray, history)


def random_like(tree, rng):
    """A direction of the size of what it changes, so that one step suits all leaves."""
    return jax.tree.map(
        lambda leaf: rng.normal(size=leaf.shape) * (np.abs(leaf).mean() + 1e-6), tree
    )


def by_leaf(tree):
    return [np.asarray(leaf).reshape(COUNT, -1) for leaf in jax.tree.leaves(tree)]


# ---------------------------------------------------------------------------- closed forms


def uniaxial(strain, E, yield_stress, hardening):
    """Stress and plastic strain of a bar on a path of axial strains, by the rate equations."""
    plastic, accumulated, stresses, plastics = 0.0, 0.0, [], []
    for value in strain:
        trial = E * (value - plastic)
        more = max(abs(trial) - yield_stress - hardening * accumulated, 0) / (E + hardening)
        plastic, accumulated = plastic + more * np.sign(trial), accumulated + more
        stresses.append(E * (value - plastic))
        plastics.append(plastic)
    return np.array(stresses), np.array(plastics)


@SIZES
@pytest.mark.parametrize("hardening", [0.0, 2000.0, 50000.0])
def test_bar_is_bilinear(size, hardening):
    law = J2(210000.0, 0.3, 300.0, hardening)
    axial = np.concatenate([np.linspace(0, 6, 61), np.linspace(6, -5, 111)]) * YIELD
    expected, plastic = uniaxial(axial, 210000.0, 300.0, hardening)
    path = np.zeros((len(axial), size))
    path[:, 0] = axial
    lateral = -0.3 * expected / 210000.0 - plastic / 2
    for i in range(1, tensor.NORMALS[size]):
        path[:, i] = lateral
    stress, history, _ = follow(law, path)
    np.testing.assert_allclose(stress[:, 0], expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(stress[:, 1:], 0, atol=1e-9)
    np.testing.assert_allclose(history.plastic_strain[:, 0], plastic, rtol=0, atol=1e-14)
    slope = 210000.0 * hardening / (210000.0 + hardening)
    np.testing.assert_allclose(np.diff(stress[40:61, 0]), slope * np.diff(axial[40:61]), atol=1e-9)


@pytest.mark.parametrize("size", [3, 4, 6])
def test_shear_yields_at_the_strength_over_root_three(size):
    shear = 210000.0 / 2.6
    accumulated = np.r_[0.0, 0.0, np.linspace(0, 0.02, 30)]
    stress = (300.0 + 2000.0 * accumulated) / np.sqrt(3) * np.r_[0.5, 1 - 1e-9, np.ones(30)]
    path = np.zeros((32, size))
    path[:, -1] = stress / shear + np.sqrt(3) * accumulated
    found, history, _ = follow(STEEL, path)
    np.testing.assert_allclose(found[:, -1], stress, rtol=1e-12)
    np.testing.assert_allclose(found[:, :-1], 0, atol=1e-9)
    np.testing.assert_allclose(history.accumulated, accumulated, atol=1e-13)
    assert np.all(history.accumulated[:2] == 0)


def radial_return(strain, plastic, accumulated, E, nu, yield_stress, hardening):
    """3D backward Euler on full tensors (k, 3, 3), in NumPy."""
    shear, bulk = E / (2 * (1 + nu)), E / (3 * (1 - 2 * nu))
    elastic = strain - plastic
    trace = np.trace(elastic, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    trial = 2 * shear[:, None, None] * (elastic - trace / 3)
    size = np.sqrt(np.einsum("kij,kij->k", trial, trial))
    over = np.sqrt(1.5) * size - yield_stress - hardening * accumulated
    more = np.maximum(over, 0) / (3 * shear + hardening)
    flow = np.sqrt(1.5) * trial / size[:, None, None]
    plastic = plastic + more[:, None, None] * flow
    stress = bulk[:, None, None] * trace + trial - (2 * shear * more)[:, None, None] * flow
    return stress, plastic, accumulated + more


def test_plane_stress_is_three_dimensions_without_stress_out_of_plane():
    """The zz strain that makes the zz stress vanish is found by bisection, step after step."""
    laws, target, _ = random_states(3)
    parameters = jax.tree.leaves(laws)
    other = np.random.default_rng(7).normal(size=(COUNT, 3)) * np.abs(target).max(1)[:, None]
    history, plastic, accumulated = initial(laws, 3), np.zeros((COUNT, 3, 3)), np.zeros(COUNT)
    for share, turn in ((0.3, 0.0), (1.0, 0.0), (1.0, 0.5), (0.2, 1.0), (-0.5, 1.0)):
        strain = share * target + turn * other
        full = np.zeros((COUNT, 3, 3))
        full[:, 0, 0], full[:, 1, 1] = strain[:, 0], strain[:, 1]
        full[:, 0, 1] = full[:, 1, 0] = strain[:, 2] / 2
        reach = 20 * np.abs(strain).max(1) + np.abs(plastic[:, 2, 2])
        low, high = -reach, reach
        for _ in range(70):
            full[:, 2, 2] = (low + high) / 2
            stress, *_ = radial_return(full, plastic, accumulated, *parameters)
            zz, tension = full[:, 2, 2].copy(), stress[:, 2, 2] > 0
            low, high = np.where(tension, low, zz), np.where(tension, zz, high)
        stress, plastic, accumulated = radial_return(full, plastic, accumulated, *parameters)
        found, history, _ = respond(laws, strain, history)
        expected = np.stack([stress[:, 0, 0], stress[:, 1, 1], stress[:, 0, 1]], 1)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)
        np.testing.assert_allclose(history.accumulated, accumulated, rtol=1e-9, atol=1e-13)
        in_plane = np.stack([plastic[:, 0, 0], plastic[:, 1, 1], 2 * plastic[:, 0, 1]], 1)
        np.testing.assert_allclose(history.plastic_strain, in_plane, rtol=0, atol=1e-12)
    assert np.mean(accumulated > 1e-4) > 0.5


def test_plane_strain_is_three_dimensions():
    laws, strain, history = random_states(4)
    carried = [0, 1, 2, 5]
    full = np.zeros((COUNT, 6))
    plastic = full.copy()
    full[:, carried], plastic[:, carried] = strain, history.plastic_strain
    other = history._replace(plastic_strain=plastic)
    found, new, _ = respond(laws, strain, history)
    stress, expected, _ = jax.tree.map(np.asarray, respond(laws, full, other))
    np.testing.assert_allclose(found, stress[:, carried], rtol=0, atol=1e-9)
    np.testing.assert_allclose(new.accumulated, expected.accumulated, rtol=1e-12)
    np.testing.assert_array_equal(stress[:, 3:5], 0)


# ---------------------------------------------------------------------------- energy


@SIZES
def test_work_is_stored_or_dissipated(size):
    """On a cyclic path that is not proportional; the error falls with the steps."""
    rng = np.random.default_rng(size)
    amplitude, phase = rng.uniform(1, 4, size) * YIELD, rng.uniform(0, 6, size)
    errors = []
    for steps in (1000, 4000):
        time = np.linspace(0, 3, steps + 1)[:, None]
        path = amplitude * (np.sin(2 * np.pi * time + phase) - np.sin(phase))
        stress, history, energy = follow(STEEL, path)
        work = np.einsum("ti,ti->", (stress[1:] + stress[:-1]) / 2, np.diff(path, axis=0))
        spent = STEEL.dissipated(history)
        assert np.all(np.diff(spent) >= 0) and spent[-1] > 2 * energy[-1]
        errors.append(abs(work - energy[-1] - spent[-1]) / work)
    assert errors[0] < 3e-4 and errors[1] < errors[0] / 8


@SIZES
def test_stored_energy_is_that_of_stress_and_of_hardening(size):
    laws, strain, history = random_states(size)
    stress, new, stored = jax.tree.map(np.asarray, respond(laws, strain, history))
    expected = (stress * (strain - new.plastic_strain)).sum(1) / 2
    expected += laws.hardening * new.accumulated**2 / 2
    np.testing.assert_allclose(stored, expected, rtol=1e-12)


# ---------------------------------------------------------------------------- derivatives


@SIZES
def test_tangent_is_that_of_central_differences(size):
    laws, strain, history = random_states(size)
    step = 1e-6 * np.abs(strain).max(1, keepdims=True)
    still = jax.tree.map(np.zeros_like, (laws, history))
    columns, quotients = [], []
    for unit in np.eye(size):
        along = still[0], np.broadcast_to(unit, strain.shape), still[1]
        columns.append(push((laws, strain, history), along)[0])
        ahead, behind = (respond(laws, strain + s * step * unit, history)[0] for s in (1, -1))
        quotients.append((np.asarray(ahead) - np.asarray(behind)) / (2 * step))
    exact = np.stack(columns, 2)
    error = np.abs(exact - np.stack(quotients, 2)).max((1, 2)) / laws.E
    assert error.max() < 1e-8
    _, new, _ = respond(laws, strain, history)
    yields = np.asarray(new.accumulated) > history.accumulated
    assert 0.3 < yields.mean() < 1
    np.testing.assert_allclose(exact, exact.transpose(0, 2, 1), rtol=0, atol=1e-8 * 2e5)


@FEW_SIZES
def test_derivatives_by_all_inputs_are_those_of_differences_in_both_modes(size):
    at = random_states(size)
    rng = np.random.default_rng(1)
    along, back = random_like(at, rng), random_like(respond(*at), rng)
    forward, reverse = push(at, along), pull(at, back)
    left = sum((a * b).sum(1) for a, b in zip(by_leaf(forward), by_leaf(back), strict=True))
    right = sum((a * b).sum(1) for a, b in zip(by_leaf(along), by_leaf(reverse), strict=True))
    scale = sum(np.abs(a * b).sum(1) for a, b in zip(by_leaf(along), by_leaf(reverse), strict=True))
    assert np.max(np.abs(left - right) / scale) < 1e-12
    step = 1e-6
    one, other = (
        respond(*jax.tree.map(lambda leaf, d, s=s: leaf + s * step * d, at, along)) for s in (1, -1)
    )
    for exact, a, b in zip(*map(by_leaf, (forward, one, other)), strict=True):
        error = np.abs(exact - (a - b) / (2 * step)).max(1) / np.abs(exact).max()
        assert np.sort(error)[-4] < 1e-6


@FEW_SIZES
def test_derivatives_are_finite_without_deviator(size):
    direct = np.r_[np.ones(tensor.NORMALS[size]), np.zeros(size - tensor.NORMALS[size])]
    laws = batch(STEEL)
    strain = np.zeros((COUNT, size))
    strain[1], strain[2], strain[3] = YIELD * direct, 50 * YIELD * direct, -50 * YIELD * direct
    _, history, _ = respond(laws, 5 * YIELD * np.ones((COUNT, size)), initial(laws, size))
    for state in (initial(laws, size), history):
        ones = jax.tree.map(np.ones_like, (laws, strain, state))
        forward = push((laws, strain, state), ones)
        reverse = pull((laws, strain, state), jax.tree.map(np.ones_like, forward))
        for leaf in jax.tree.leaves((respond(laws, strain, state), forward, reverse)):
            assert np.isfinite(leaf).all()
    zero, *_ = respond(laws, strain, initial(laws, size))
    assert np.all(zero[0] == 0)


# ---------------------------------------------------------------------------- limits


@SIZES
def test_steps_of_any_size_return_to_the_yield_surface(size):
    laws, strain, history = random_states(size)
    far = strain * np.geomspace(1, 1e6, COUNT)[:, None]
    stress, new, _ = respond(laws, far, history)
    count, stress = tensor.NORMALS[size], np.asarray(stress)
    deviator = np.pad(stress[:, :count], ((0, 0), (0, 3 - count)))
    deviator -= deviator.mean(1, keepdims=True)
    mises = np.sqrt(1.5 * (deviator**2).sum(1) + 3 * (stress[:, count:] ** 2).sum(1))
    strength = laws.yield_stress + laws.hardening * np.asarray(new.accumulated)
    yields = np.asarray(new.accumulated) > history.accumulated
    noise = 1e-13 * np.abs(stress).max(1) / strength
    assert yields.mean() > 0.9
    assert np.all(np.abs(mises / strength - 1)[yields] < 1e-10 + noise[yields])


@SIZES
def test_what_cannot_be_returned_is_not_a_number(size):
    laws = batch(J2(210000.0, 0.3, 300.0, -2000.0))  # strength used up at a plastic strain of 0.15
    strain = np.zeros((COUNT, size))
    strain[:, -1] = np.r_[0.01, 1.0, np.nan, np.zeros(COUNT - 3)]
    stress, *_ = respond(laws, strain, initial(laws, size))
    assert np.isfinite(stress[0]).all() and np.isfinite(stress[3:]).all()
    assert np.isnan(stress[1:3, -1]).all()


def test_history_has_the_precision_of_the_parameters():
    size = 3
    law = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), STEEL)
    history = law.initial(size)
    stress, new = jit(J2.respond)(law, jnp.full(size, 0.01, jnp.float32), history)
    for leaf in jax.tree.leaves((history, stress, new)):
        assert leaf.dtype == jnp.float32
    assert np.isfinite(stress).all() and new.accumulated > 0
