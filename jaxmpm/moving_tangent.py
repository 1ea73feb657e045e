"""What points answer to an increment of deformation: internal force and its derivative, whatever the law.

In an increment from positions x_n the nodes move by Δu, G = ∂Δu/∂x_n at a point and F = (1 + G) F_n. Its share of the
force on node i and of the tangent stiffness between nodes i and j are

    f_i = S(G) · ∇N_i,   S = V τ(F) (1 + G)⁻ᵀ,       K_ij = ∇N_i · ∂S/∂G · ∇N_j

V the undeformed volume and ∇N the gradient at x_n, so that (1 + G)⁻ᵀ ∇N is that at the end. ∂S/∂G comes from forward
differentiation of S as it stands, the law in it: it holds the material tangent and the geometric (initial stress)
stiffness, and misses nothing. Where the law has an energy S is its derivative by G, and K is symmetric.
(Charlton, Coombs, Augarde 2017; Coombs, Augarde 2020.)

Points are plain lists here: `Points` whose arrays end in (count,), bands' addresses places in the list.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from jaxmpm import bands, cracks, moving, tensor
from jaxmpm.bands import Pool
from jaxmpm.bands_static import LANES, PRECISION
from jaxmpm.laws import balance
from jaxmpm.laws.finite import inverse, plus_one, strain_in, times, turned_stress, volume_change
from jaxmpm.laws.law import jacobian
from jaxmpm.tensor import Matrix


class Answer(NamedTuple):
    """What points answer to G."""

    pull: jax.Array  # S_xx, S_xy, S_yx, S_yy (4, count), N mm
    slope: jax.Array  # ∂S/∂G (4, 4, count), N mm
    stress: jax.Array  # Kirchhoff stress τ (3, count), MPa
    gradient: jax.Array  # H = F − 1 (2, 2, count)
    energy: jax.Array  # stored and dissipated by all points, N·mm
    pool: Pool | None  # bands as they would be
    wrong: jax.Array  # a band does not converge or a point is turned inside out


@jax.jit
def respond(model, points, pool, rate) -> Answer:
    """`Answer` to G_xx, G_xy, G_yx, G_yy, `rate` (4, count); `pool` is None without bands."""
    law, old = moving.law_of(model, points), Matrix(points.gradient)
    slope, pull, stress = jacobian(lambda x: _pulled(x, points.volume, old, law.kirchhoff), rate)
    found, failed = (pull, slope, stress), jnp.zeros((), bool)
    if pool is not None:
        found, pool, failed = _banded(model, points, pool, rate, found)
    used = points.volume > 0
    pull, slope, stress = (jnp.where(used, part, 0.0) for part in found)
    whole = deformed(_matrix(rate), old)
    gradient = jnp.where(used, jnp.stack([jnp.stack(row) for row in whole]), 0.0)
    inside_out = (used & ~(1 + volume_change(_matrix(rate)) > 0)).any()
    _, stored, dissipated = moving.energies(model, points._replace(gradient=gradient), pool)
    return Answer(pull, slope, stress, gradient, stored + dissipated, pool, failed | inside_out)


def deformed(rate, old):
    """H after F = (1 + G) F_n, from G and H_n."""
    return jax.tree.map(lambda h, g, c: h + (g + c), old, rate, times(rate, old))


def _pulled(x, volume, old, stress_of):
    """S (4, ...) and τ (3, ...) for G, `x` (4, ...); `stress_of` gives τ for H."""
    rate = _matrix(x)
    xx, yy, xy = stress_of(deformed(rate, old))
    back, tau = inverse(plus_one(rate)), ((xx, xy), (xy, yy))
    pull = [volume * (tau[a][0] * back[c, 0] + tau[a][1] * back[c, 1]) for a in range(2) for c in range(2)]
    return jnp.stack(pull), jnp.stack([xx, yy, xy])


def _matrix(x):
    return Matrix([[x[0], x[1]], [x[2], x[3]]])


def _banded(model, points, pool, rate, found):
    """`found` with what points answer that have a band, the pool as it would be, and whether a band failed."""
    count = points.volume.shape[0]

    def block(k, carry):
        found, records, stress, failed = carry
        start = k * LANES
        used = start + jnp.arange(LANES) < pool.count
        address = lax.dynamic_slice_in_dim(pool.cell, start, LANES)
        used &= address >= 0
        at = jnp.maximum(address, 0)
        old = lax.dynamic_slice_in_dim(records, start, LANES)
        own = rate[:, at], points.gradient[..., at], points.volume[at], points.material[at]
        *parts, rows, borne, wrong = _lanes(model, old, used, *own)
        target = jnp.where(used, address, count)
        found = [all.at[..., target].set(part, mode="drop") for all, part in zip(found, parts, strict=True)]
        records = lax.dynamic_update_slice_in_dim(records, jnp.where(used[:, None], rows, old), start, 0)
        stress = lax.dynamic_update_slice_in_dim(stress, borne, start, 1)
        return tuple(found), records, stress, failed | wrong

    start = found, pool.records, pool.stress, jnp.zeros((), bool)
    found, records, stress, failed = lax.fori_loop(0, (pool.count + LANES - 1) // LANES, block, start)
    return found, pool._replace(records=records, stress=stress), failed


def _lanes(model, rows, used, rate, gradient, volume, material):
    """S, ∂S/∂G and τ of some bands' points, their rows, their stress in the frames of their faces, whether one failed."""
    size, old = model.cracking.size, Matrix(gradient)
    laws = bands.laws_of(cracks.embedding(model), material, jnp.arange(LANES))
    band = bands.unpacked(rows, size)[0]

    def strained(whole):
        turn = cracks.frames(band.normal, whole)
        return turn, jnp.where(used, tensor.from_plane(strain_in(turn, whole), size), 0.0)

    _, strain = strained(deformed(_matrix(rate), old))
    solved = balance.solve(laws, band, strain, PRECISION)
    rows, borne, status = bands.answered(laws, band, strain, solved, size)
    tangent = balance.slopes(laws, band, strain, solved)[0][jnp.array([0, 1, size - 1])]

    def stress_of(whole):  # to first order about what has been solved
        turn, now = strained(whole)
        return turned_stress(turn, borne + jnp.einsum("ijk,jk->ik", tangent, now - strain), whole)

    slope, pull, stress = jacobian(lambda x: _pulled(x, volume, old, stress_of), rate)
    return pull, slope, stress, rows, borne, (used & (status == balance.FAILS)).any()
