"""The elastic-decohesive law against closed forms, and its equations in NumPy.

Compiling is what costs time here, so all tests share a few functions over batches of one size.
"""

import dataclasses
from functools import cache, partial
from itertools import pairwise

import jax
import numpy as np
import pytest

from jaxmpm.laws.decohesive import Decohesive

SIZES = pytest.mark.parametrize("size", [3, 4])
COUNT = 256  # points of a batch
ICE = Decohesive(10000.0, 0.3, 1.0, 1.5, 4.0, 5.0, 0.01, 30.0)
E, NU, TAU_NF, TAU_SF, S_M, F_C, U_0, L = jax.tree.leaves(ICE)
SHEAR = E / (2 * (1 + NU))


def answer(law, strain, history):
    stress, new = law.respond(strain, history)
    return stress, new, law.stored(strain, new)


# what is compiled runs for milliseconds, so that optimising it takes longer than it saves
jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 1})
compiled = jit(jax.vmap(answer))


@jit
@jax.vmap
def derivatives(at, back):
    """Tangent, forward; and by all inputs of what came of them times `back`, in reverse."""

    def step(law, strain, history):
        return law.respond(strain, history)

    law, strain, history = at
    tangent = jax.jacfwd(lambda strain: step(law, strain, history)[0])(strain)
    return tangent, jax.vjp(step, *at)[1](back)


def respond(laws, strain, history):
    return jax.tree.map(np.asarray, compiled(laws, strain, history))


def batch(law):
    return jax.tree.map(lambda leaf: np.full(COUNT, leaf), law)


def initial(size):
    return jax.tree.map(lambda leaf: np.zeros((COUNT, *leaf.shape)), ICE.initial(size))


def follow(laws, path, history=None):
    """Stresses, histories and stored energies along a path (steps, COUNT, size)."""
    history, found = initial(path.shape[2]) if history is None else history, []
    for strain in path:
        found.append(respond(laws, strain, history))
        history = found[-1][1]
    return jax.tree.map(lambda *leaves: np.stack(leaves), *found)


def through(points, steps):
    """Straight lines through points (k, ...) in equal steps, (k − 1) `steps` + 1 of them."""
    share = np.arange(1, steps + 1) / steps
    lines = [points[:1]]
    for a, b in pairwise(points):
        lines.append(a + share.reshape(-1, *[1] * a.ndim) * (b - a))
    return np.concatenate(lines)


# ---------------------------------------------------------------------------- in NumPy


def turned(normal, nn, mm, nm, size):
    """Strain vectors from components along normals (k, 2) and across them."""
    x, y = normal[..., 0], normal[..., 1]
    xx, yy = nn * x * x + mm * y * y - 2 * nm * x * y, nn * y * y + mm * x * x + 2 * nm * x * y
    xy = 2 * ((nn - mm) * x * y + nm * (x * x - y * y))
    return np.stack([xx, yy, xy] if size == 3 else [xx, yy, 0 * xx, xy], -1)


def on_plane(stress, normal):
    """τ_n, τ_t and σ_tt of stress vectors on planes."""
    x, y = normal[..., 0], normal[..., 1]
    xx, yy, xy = stress[..., 0], stress[..., 1], stress[..., -1]
    direct = xx * x * x + yy * y * y + 2 * xy * x * y
    return direct, (yy - xx) * x * y + xy * (x * x - y * y), xx + yy - direct


def decohesion(law, stress, normal, lost):
    """F and its derivatives by τ_n and τ_t."""
    direct, shear, along = on_plane(stress, normal)
    kappa, top = -np.log(1 - 1 / law.s_m**2), law.s_m * law.tau_sf
    measure = direct / law.tau_nf - (1 - lost) * (1 - (np.maximum(-along, 0) / law.f_c) ** 2)
    grown = np.exp(np.minimum(kappa * measure, 300))
    return (shear / top) ** 2 + grown - 1, kappa / law.tau_nf * grown, 2 * shear / top**2


def largest(law, stress, count=1441):
    """Largest F of intact planes, by trying many."""
    angles = np.linspace(0, np.pi, count)
    planes = np.stack([np.cos(angles), np.sin(angles)], 1)[None]
    laws = jax.tree.map(lambda leaf: np.asarray(leaf)[:, None], law)
    return decohesion(laws, stress[:, None], planes, 0.0)[0].max(1)


@cache
def random_laws():
    rng = np.random.default_rng(0)
    u, strength = partial(rng.uniform, size=COUNT), 10 ** rng.uniform(-1, 1, COUNT)
    modulus, opening = 10 ** u(3, 5), 10 ** u(-3, 1)
    size = modulus * opening / strength * 10 ** u(-2, -0.1)
    shear, crushing = strength * 10 ** u(-0.5, 0.7), strength * 10 ** u(0.3, 1.2)
    return Decohesive(
        modulus, u(0.0, 0.4), strength, shear, u(1.05, 8), crushing, opening, size
    )  # fmt: skip


def random_strain(rng, size, factor):
    laws = random_laws()
    strain = rng.normal(size=(COUNT, size)) * (factor * laws.tau_nf / laws.E)[:, None]
    if size == 4:
        strain[:, 2] = 0
    return strain


@cache
def random_walk(size):
    """Histories and strains before a step, and what came of it, for a few random steps."""
    rng = np.random.default_rng(size)
    history, states = initial(size), []
    for _ in range(5):
        strain = random_strain(rng, size, 10 ** rng.uniform(-0.2, 1, COUNT))
        states.append((history, strain, respond(random_laws(), strain, history)))
        history = states[-1][2][1]
    return states


# ---------------------------------------------------------------------------- closed forms


@SIZES
def test_bar_softens_linearly_and_dissipates_half_the_strength_times_the_opening(size):
    """In uniaxial stress, at all inclinations."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, COUNT)
    normal = np.stack([np.cos(angle), np.sin(angle)], 1)
    modulus, ratio = (E, NU) if size == 3 else (E / (1 - NU**2), NU / (1 - NU))
    jump = np.r_[np.zeros(5), np.linspace(0, 1, 101)[1:], 1.5, 3.0] * U_0
    stress = np.r_[np.linspace(0, 1, 5), 1 - jump[5:105] / U_0, 0, 0] * TAU_NF
    stress[4] *= 1 - 1e-12  # just before onset
    along = (stress / modulus + jump / L)[:, None]
    path = turned(normal, along, -ratio * stress[:, None] / modulus, 0.0, size)
    found, history, stored = follow(batch(ICE), path)
    direct, shear, across = on_plane(found, normal)
    np.testing.assert_allclose(direct, np.broadcast_to(stress[:, None], direct.shape), atol=1e-10)
    np.testing.assert_allclose(shear, 0, atol=1e-10)
    np.testing.assert_allclose(across, 0, atol=1e-10)
    opening = (history.jump * normal).sum(2)
    np.testing.assert_allclose(opening, np.broadcast_to(jump[:, None], opening.shape), atol=1e-13)
    np.testing.assert_allclose(history.gap, opening, atol=1e-13)
    np.testing.assert_allclose(history.dissipated[-1] * L, TAU_NF * U_0 / 2, rtol=1e-3)
    assert np.all(history.lost[-2:] == 1)
    assert np.all(np.abs(found[-2:]) < 1e-10) and np.all(stored[-2:] < 1e-20)


@SIZES
def test_plane_without_normal_traction_has_the_shear_strength(size):
    """With any traction along the surface F = 0 under compression too."""
    rng = np.random.default_rng(1)
    angle, history = rng.uniform(0, 2 * np.pi, COUNT), initial(size)
    normal = np.stack([np.cos(angle), np.sin(angle)], 1)
    history = history._replace(normal=normal)
    pressure = np.where(np.arange(COUNT) % 2, 0.0, rng.uniform(0, 20, COUNT))
    kappa = -np.log(1 - 1 / S_M**2)
    strength = S_M * TAU_SF * np.sqrt(1 - np.exp(-kappa * (pressure / TAU_NF + 1)))
    np.testing.assert_allclose(strength[1::2], TAU_SF, rtol=1e-12)
    modulus, ratio = (E, NU) if size == 3 else (E / (1 - NU**2), NU / (1 - NU))
    for factor, opens in ((1 - 1e-9, False), (1 + 1e-9, True)):
        shear = factor * strength / (2 * SHEAR)
        strain = turned(normal, -pressure / modulus, ratio * pressure / modulus, shear, size)
        _, new, _ = respond(batch(ICE), strain, history)
        assert np.all((new.lost > 0) == opens)


def test_plane_is_that_with_the_largest_decohesion(size=3):
    laws, rng = random_laws(), np.random.default_rng(2)
    strain = random_strain(rng, size, 10 ** rng.uniform(0, 1.5, COUNT))
    elastic = respond(laws, strain * 1e-6, initial(size))[0] * 1e6
    _, new, _ = respond(laws, strain, initial(size))
    cracked = np.abs(new.normal).max(1) > 0
    assert cracked.mean() > 0.6
    found, _, _ = decohesion(laws, elastic, new.normal, 0.0)
    most = largest(laws, elastic)
    assert np.all((found >= most - 1e-9 * (1 + np.abs(found)))[cracked])
    assert np.all(most[~cracked] <= 1e-9)
    np.testing.assert_allclose((new.normal**2).sum(1)[cracked], 1, rtol=1e-14)


@SIZES
def test_cracks_where_the_largest_decohesion_passes_zero(size):
    laws, rng = random_laws(), np.random.default_rng(3)
    strain = random_strain(rng, size, 1.0)
    stress, *_ = respond(laws, strain * 1e-3, initial(size))  # elastic, so that it scales
    low, high = np.zeros(COUNT), np.full(COUNT, 1e6)
    for _ in range(60):
        middle = (low + high) / 2
        over = largest(laws, middle[:, None] * stress, 181) > 0
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    for factor, cracks in ((1 - 1e-3, False), (1 + 1e-9, True)):
        _, new, _ = respond(laws, strain * (1e-3 * factor * low)[:, None], initial(size))
        assert np.all((np.abs(new.normal).max(1) > 0) == cracks)


# ---------------------------------------------------------------------------- the return


@SIZES
def test_steps_end_on_the_surface_by_the_associated_rule(size):
    """Steps of any size."""
    laws, flowed = random_laws(), 0
    for history, strain, (stress, new, _) in random_walk(size):
        assert np.isfinite(stress).all()
        cracked = np.abs(new.normal).max(1) > 0
        value, by_direct, by_shear = decohesion(laws, stress, new.normal, new.lost)
        assert np.all(value[cracked] < 1e-11)
        opens = (new.lost > history.lost) & (new.lost < 1)
        np.testing.assert_allclose(value[opens], 0, atol=1e-11)
        more = new.jump - history.jump
        x, y = new.normal.T
        normal_part, shear_part = more[:, 0] * x + more[:, 1] * y, more[:, 1] * x - more[:, 0] * y
        np.testing.assert_allclose(
            (normal_part * by_shear)[opens], (shear_part * by_direct)[opens],
            atol=1e-10 * np.abs(normal_part * by_shear)[opens].max(),
        )  # fmt: skip
        lost = (history.lost + normal_part / laws.u_0)[opens]
        np.testing.assert_allclose(new.lost[opens], lost, rtol=1e-10)
        kept = cracked & (np.abs(history.normal).max(1) > 0)
        np.testing.assert_array_equal(new.normal[kept], history.normal[kept])
        direct, _, _ = on_plane(stress, new.normal)
        apart = (new.lost == 1) & cracked
        assert np.all(direct[apart] < 1e-9 * laws.tau_nf[apart])
        assert np.all((new.jump * new.normal).sum(1) > -1e-9 * laws.u_0)
        assert np.all(new.dissipated >= history.dissipated)
        flowed += opens.sum()
    assert flowed > 100


def test_plane_strain_is_plane_stress_with_other_constants():
    """E/(1 − ν²) and ν/(1 − ν); what holds of the derivatives of one holds of the other's."""
    laws = random_laws()
    modulus, ratio = laws.E / (1 - laws.nu**2), laws.nu / (1 - laws.nu)
    other, history = dataclasses.replace(laws, E=modulus, nu=ratio), initial(3)
    for _, strain, (stress, new, _) in random_walk(4):
        in_plane, history, _ = respond(other, strain[:, [0, 1, 3]], history)
        scale = laws.E[:, None] * np.abs(strain).max(1, keepdims=True)
        np.testing.assert_allclose(stress[:, [0, 1, 3]] / scale, in_plane / scale, atol=1e-10)
        out = laws.nu * (stress[:, 0] + stress[:, 1])
        np.testing.assert_allclose(stress[:, 2] / scale[:, 0], out / scale[:, 0], atol=1e-10)
        np.testing.assert_allclose(new.lost, history.lost, atol=1e-9)


@SIZES
def test_same_strain_again_changes_nothing(size):
    for _, strain, (stress, new, _) in random_walk(size):
        again, same, _ = respond(random_laws(), strain, new)
        scale = np.abs(strain).max(1, keepdims=True) * random_laws().E[:, None]
        np.testing.assert_allclose(again / scale, stress / scale, atol=1e-11)
        np.testing.assert_allclose(same.lost, new.lost, atol=1e-10)


@SIZES
def test_parted_faces_close_freely_and_then_carry_compression(size):
    normal = np.tile([0.6, 0.8], (COUNT, 1))
    opened = np.array([0.0, 3 * U_0, 0.5 * U_0, 0.0, -0.5 * U_0, 0.2 * U_0]) / L
    path = turned(normal, through(opened[:, None], 20), 0.0, 0.0, size)
    stress, history, _ = follow(batch(ICE), path)
    direct, shear, _ = on_plane(stress, normal)
    direct, opening = direct[20::20, 0], (history.jump * normal).sum(2)[20::20, 0]
    stiff = E / (1 - NU**2) if size == 3 else E * (1 - NU) / (1 + NU) / (1 - 2 * NU)
    np.testing.assert_allclose(direct, np.minimum(opened[1:], 0) * stiff, atol=1e-9)
    np.testing.assert_allclose(opening, np.maximum(opened[1:], 0) * L, atol=1e-12)
    np.testing.assert_allclose(shear, 0, atol=1e-9)
    # sliding of open faces meets nothing, of pressed ones the friction on F = 0
    pressed = turned(normal, -0.5 * U_0 / L, 0.0, 5e-2, size)
    free = turned(normal, 0.5 * U_0 / L, 0.0, 5e-2, size)
    last = jax.tree.map(lambda leaf: leaf[-1], history)
    loose, *_ = respond(batch(ICE), free, last)
    np.testing.assert_allclose(np.stack(on_plane(loose, normal)[:2]), 0, atol=1e-10)
    rubbing, new, _ = respond(batch(ICE), pressed, last)
    np.testing.assert_allclose(decohesion(ICE, rubbing, normal, 1.0)[0], 0, atol=1e-12)
    np.testing.assert_allclose(on_plane(rubbing, normal)[0], direct[-2], rtol=1e-12)
    np.testing.assert_allclose((new.jump * normal).sum(1), 0, atol=1e-12)


@SIZES
def test_work_is_stored_or_dissipated_and_steps_do_not_matter(size):
    """Tension, shear, compression and back, on the way of COUNT different points."""
    rng = np.random.default_rng(5)
    corners = rng.normal(size=(5, COUNT, size)) * 3e-4
    if size == 4:
        corners[..., 2] = 0
    corners[0] = 0
    errors, spent = [], []
    for steps in (25, 100):
        path = through(corners, steps)
        stress, history, stored = follow(batch(ICE), path)
        work = np.einsum("tpi,tpi->p", (stress[1:] + stress[:-1]) / 2, np.diff(path, axis=0))
        assert np.all(np.diff(history.dissipated, axis=0) >= 0)
        scale = stored.max(0) + history.dissipated[-1]
        errors.append(np.abs(work - stored[-1] - history.dissipated[-1]) / scale)
        spent.append(history.dissipated[-1].mean())
    assert np.mean(history.lost[-1] > 0) > 0.9
    assert errors[0].mean() < 5e-4 and errors[1].mean() < errors[0].mean() / 8
    assert spent[0] == pytest.approx(spent[1], rel=2e-3)


# ---------------------------------------------------------------------------- derivatives


def product(one, other):
    """Inner product of each point."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return sum((np.asarray(a) * b).reshape(COUNT, -1).sum(1) for a, b in pairs)


@SIZES
def test_tangent_is_that_of_central_differences(size):
    laws = random_laws()
    step = 1e-6 * (laws.tau_nf / laws.E)[:, None]
    for history, strain, (*out, _) in random_walk(size):
        columns = []
        for unit in np.eye(size):
            ahead, behind = (respond(laws, strain + s * step * unit, history)[0] for s in (1, -1))
            columns.append((ahead - behind) / (2 * step))
        tangent, _ = derivatives((laws, strain, history), tuple(out))
        error = np.abs(tangent - np.stack(columns, 2)).max((1, 2)) / laws.E
        assert error.max() < 1e-6


def test_derivatives_by_all_inputs_are_those_of_differences_and_of_the_tangent(size=3):
    laws, rng = random_laws(), np.random.default_rng(4)
    for history, strain, (*out, _) in random_walk(size):
        at = laws, strain, history
        along = jax.tree.map(lambda leaf: rng.normal(size=leaf.shape) * np.abs(leaf), at)
        along[2].lost[history.lost == 1] = 0  # parted for good
        back = tuple(out)
        back = jax.tree.map(lambda leaf: rng.normal(size=leaf.shape) / np.abs(leaf).max(), back)
        tangent, reverse = derivatives(at, back)
        sides = (jax.tree.map(lambda leaf, d, s=s: leaf + s * 1e-7 * d, at, along) for s in (1, -1))
        ahead, behind = (respond(*side)[:2] for side in sides)
        quotient = jax.tree.map(lambda a, b: (a - b) / 2e-7, ahead, behind)
        scale = product(*(jax.tree.map(np.abs, tree) for tree in (along, reverse)))
        error = np.abs(product(along, reverse) - product(back, quotient)) / scale
        assert np.sort(error)[-3] < 1e-6
        none = jax.tree.map(np.zeros_like, back[1])
        by_strain = derivatives(at, (back[0], none))[1][1]
        forward = np.einsum("pij,pi->pj", tangent, back[0])
        most = np.abs(forward).max()
        np.testing.assert_allclose(by_strain, forward, rtol=1e-9, atol=1e-12 * most)


def test_derivatives_are_finite_where_all_planes_are_alike(size=3):
    """No strain, equal strains in the plane, uniaxial and shear strain; intact and cracked."""
    laws, special = batch(ICE), np.zeros((COUNT, size))
    special[1, :2], special[2, :2], special[3, 0], special[4, -1] = 1e-3, -1e-2, 1e-4, 1e-3
    states = [initial(size)]
    states.append(respond(laws, np.tile(special[3] * 2, (COUNT, 1)), states[0])[1])
    states.append(respond(laws, np.tile(special[3] * 20, (COUNT, 1)), states[0])[1])
    for history in states:
        at = laws, special, history
        out = respond(*at)
        ones = partial(jax.tree.map, np.ones_like)
        for leaf in jax.tree.leaves((out, derivatives(at, ones(out[:2])))):
            assert np.isfinite(leaf).all()
    assert np.all(respond(laws, special, states[0])[0][0] == 0)


@SIZES
def test_what_is_not_a_number_stays_so(size):
    strain = np.zeros((COUNT, size))
    strain[0] = np.nan
    for history in (initial(size), random_walk(size)[-1][2][1]):
        stress, *_ = respond(batch(ICE), strain, history)
        assert np.isnan(stress[0]).all() and np.isfinite(stress[1:]).all()
