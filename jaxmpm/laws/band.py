"""The heart of the project: any band law embedded in any bulk law (Nguyen, Eqs. 1-10).

A cracked volume of effective size H holds a band of width h and normal n, f = h/H:

    ε_L = ε_c + (n ⊗ [u])^s / h                    strain in the band            (3)
    ε_b = (ε − f ε_L) / (1 − f)                    strain in the bulk            (2)
    σ   = σ_b(ε_b)                                 macroscopic stress            (4)
    r([u]; ε) = σ_b(ε_b) · n − t_L([u], p) = 0     continuity of traction        (6)

The equations are solved in this total form for the jump [u] since onset, together with the
softening p of the band where it loads (`balance.py`); the rate form of the paper has the same
tangent but drifts. Every derivative comes from forward differentiation.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import tensor
from jaxmpm.laws.elastic import released_stress
from jaxmpm.laws.law import Inside, jacobian


class Band(NamedTuple):
    """State of one localisation band and of the bulk around it."""

    normal: jax.Array  # unit normal n (dimension,), fixed at onset
    size: jax.Array  # effective size H, mm
    onset_strain: jax.Array  # ε_c, its elastic part (size,)
    jump: jax.Array  # displacement jump [u] since onset (dimension,), mm
    softening: jax.Array  # p, 0 at onset
    bulk: Any  # history of the bulk law
    spent: jax.Array  # energy given up besides what the softening curve says, N/mm of its area
    released: jax.Array  # energy given up otherwise per volume of the cell, N/mm²
    flowed: Any = None  # strain that a bulk with history had flowed at onset (size,)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Embedding:
    """The two laws of a cracked point, and what is asked of them beyond the paper."""

    bulk: Any  # a point law
    law: Any  # a band law
    release: Any = None  # exponent p of the release of crack-parallel stress; None: no release
    drag: Any = None  # viscous resistance of the band over the step, η/Δt, MPa/mm; None: none
    closes: bool = field(default=False, metadata={"static": True})  # a closed crack is stiff


class Pulls(NamedTuple):
    """What pulls at the faces of a band at a trial jump: r = outside − s · cohesive."""

    outside: jax.Array  # traction of the bulk, less what the band carries whatever its integrity
    cohesive: jax.Array  # traction of the band that its integrity s scales, both (dimension,), MPa
    drive: jax.Array  # r̂ that drives softening
    stress: jax.Array  # of the bulk (size,), MPa
    bulk: Any  # new history of the bulk


class Answer(NamedTuple):
    """What a band says at a trial jump and softening."""

    stress: jax.Array  # macroscopic (size,), MPa
    bulk_stress: jax.Array  # the same without the band's word on the traction
    out_of_balance: jax.Array  # r (dimension,), MPa
    gap: jax.Array  # ln of what drives softening over what resists it; the band loads where > 0
    bulk: Any  # new history of the bulk


def open_band(embedding, strain, normal, size, history=()):
    """A band at onset: the strain is scaled back to where the strength ratio is exactly 1.

    Args:
        embedding: the laws.
        strain: macroscopic strain (size,) that has reached onset, or (size, many).
        normal: unit normal of the crack (dimension,), or (dimension, many).
        size: effective size H, mm, one or one for each.
        history: of the bulk law before this strain.
    """
    strain = jnp.asarray(strain)
    strain = strain.astype(jnp.promote_types(strain.dtype, jnp.float32))
    many = strain.shape[1:]
    normal, size = jnp.asarray(normal, strain.dtype), jnp.asarray(size, strain.dtype)
    normal = jnp.broadcast_to(normal.reshape(*normal.shape, *[1] * (1 + len(many) - normal.ndim)), (len(normal), *many))
    size = jnp.broadcast_to(size, many)
    bulk = embedding.bulk
    if bulk is bulk.elastic:
        elastic, new, flowed = strain, history, None
    else:
        stress, new = bulk.respond(strain, history)
        elastic = bulk.elastic.strain(stress)
        flowed = strain - elastic
    ratio = embedding.law.onset(bulk.elastic.stress(elastic), bulk.elastic)
    band = begun(normal, size, elastic / ratio, new, flowed)
    if flowed is None:
        return band
    return continued(embedding, band, strain, bulk.stored(strain, new) + bulk.dissipated(new))


def begun(normal, size, onset_strain, history=(), flowed=None):
    """A band without a jump yet."""
    zero = jnp.zeros_like(size)
    return Band(normal, size, onset_strain, jnp.zeros_like(normal), zero, history, zero, zero, flowed)


def continued(embedding, band, strain, energy):
    """The band with as much energy booked as the point had before it, N/mm².

    The share of the cell that becomes the band has dissipated energy in the bulk until then.
    """
    return band._replace(released=energy - sum(energies(embedding, band, strain)))


def inside(band, jump):
    """Deformation of the band at a trial jump, as its law sees it."""
    return Inside(jump, band.onset_strain, band.normal)


def bulk_strain(embedding, band, strain, jump):
    """Strain in the bulk, Eq. 2, (size,)."""
    fraction = embedding.law.h / band.size
    opening = tensor.symmetric_product(band.normal, jump, len(strain))
    return (strain - fraction * _onset(band) - opening / band.size) / (1 - fraction)


def _onset(band):
    """Strain of the whole band at onset (size,)."""
    return band.onset_strain if band.flowed is None else band.onset_strain + band.flowed


def kept(embedding, band):
    """Share ψᵖ, with the cohesion ψ = s r̂ of the band, of what the release has not let go of."""
    ratio, integrity = embedding.law.soften(band.softening, embedding.bulk.elastic)
    cohesion = integrity * ratio
    return jnp.maximum(cohesion, jnp.finfo(cohesion.dtype).tiny) ** embedding.release


def bulk_stress(embedding, band, strain):
    """Stress of the bulk (size,), MPa, its crack-parallel part released, and its history."""
    if embedding.release is None:
        return embedding.bulk.respond(strain, band.bulk)
    keep = kept(embedding, band)
    return released_stress(embedding.bulk, strain, band.normal, keep), band.bulk


def pulls(embedding, band, strain, jump, closed=None):
    """Both laws at a trial jump (dimension,): `Pulls`.

    Whether the faces of a closing band are `closed` can be said; else it follows from the jump.
    """
    stress, history = bulk_stress(embedding, band, bulk_strain(embedding, band, strain, jump))
    cohesive, drive = embedding.law.effective(inside(band, jump), embedding.bulk.elastic)
    outside = tensor.traction(stress, band.normal)
    if embedding.closes:
        direct = tensor.dot(cohesive, band.normal)
        pressed = jnp.where(direct < 0 if closed is None else closed, direct, 0.0) * band.normal
        outside, cohesive = outside - pressed, cohesive - pressed
    if embedding.drag is not None:
        outside -= embedding.drag * (jump - band.jump)
    return Pulls(outside, cohesive, drive, stress, history)


def gap(drive, ratio):
    """ln of a driving r̂ over a resisting one; −1 less where nothing drives."""
    none = drive <= 0
    return jnp.where(none, -1.0, jnp.log(jnp.where(none, 1.0, drive))) - jnp.log(ratio)


def answer(embedding, band, strain, jump, softening, closed=None):
    """Both laws at a trial jump (dimension,) and softening: `Answer`; `closed` as in `pulls`.

    The macroscopic stress is that of the bulk with the traction of the band. The two agree but
    for round-off; next to nothing in the traction of a nearly broken band it is much in the
    stress of the bulk, where it is what large terms leave over.
    """
    pull = pulls(embedding, band, strain, jump, closed)
    ratio, integrity = embedding.law.soften(softening, embedding.bulk.elastic)
    rest = pull.outside - integrity * pull.cohesive
    carried = tensor.traction(pull.stress, band.normal) - rest
    stress = tensor.with_traction(pull.stress, band.normal, carried)
    return Answer(stress, pull.stress, rest, gap(pull.drive, ratio), pull.bulk)


def energies(embedding, band, strain):
    """Stored and dissipated energy of a cracked point per volume of the cell, N/mm²."""
    fraction = embedding.law.h / band.size
    outside = bulk_strain(embedding, band, strain, band.jump)
    elastic = embedding.bulk.elastic
    if embedding.release is None:
        stored = embedding.bulk.stored(outside, band.bulk)
    else:
        stored = tensor.dot(outside, bulk_stress(embedding, band, outside)[0]) / 2
    _, integrity = embedding.law.soften(band.softening, elastic)
    in_band = embedding.law.stored(inside(band, band.jump), integrity, embedding.closes, elastic)
    dissipated = (1 - fraction) * embedding.bulk.dissipated(band.bulk) + band.released
    spent = embedding.law.given_up(band.softening, elastic) + band.spent
    return (1 - fraction) * stored + in_band / band.size, dissipated + spent / band.size


class Secant(NamedTuple):
    """Affine answer of a band whose softening stays, to in-plane or full strains (k,)."""

    jump: jax.Array  # (dimension, k + 1): by each strain component, and the constant
    stress: jax.Array  # (size, k + 1), MPa
    ratio: jax.Array  # r̂ beyond which the band loads


def secant(embedding, band, basis=None):
    """The `Secant` of a band (an open one, if it closes) in an elastic bulk, without drag.

    Args:
        embedding, band: as ever.
        basis: strains (k, size) that the k components stand for; the unit strains if None.
    """
    size, count = len(band.onset_strain), len(band.normal)
    rows = np.eye(size) if basis is None else np.asarray(basis)

    def pull(x):
        strain = jnp.stack([_weighted(row, x[count:]) for row in rows.T])
        found = pulls(embedding, band, strain, x[:count], closed=False)
        return jnp.concatenate([found.outside, found.cohesive, found.stress]), None

    zero = jnp.stack([0 * band.softening] * (count + len(rows)))
    matrix, constant, _ = jacobian(pull, zero)
    table = jnp.concatenate([matrix, constant[:, None]], axis=1)
    by_jump, by_strain = table[:, :count], table[:, count:]  # the constant behind the strains
    outside, cohesive, stress = slice(0, count), slice(count, 2 * count), slice(2 * count, None)
    ratio, integrity = embedding.law.soften(band.softening, embedding.bulk.elastic)
    stiffness = integrity * by_jump[cohesive] - by_jump[outside]
    columns = range(len(rows) + 1)
    pull = by_strain[outside] - integrity * by_strain[cohesive]
    jump = jnp.stack([tensor.solve(stiffness, pull[:, k]) for k in columns], axis=1)
    along = lambda part, k: by_strain[part][:, k] + _product(by_jump[part], jump[:, k])  # noqa: E731
    whole = [
        tensor.with_traction(along(stress, k), band.normal, integrity * along(cohesive, k))
        for k in columns
    ]
    return Secant(jump, jnp.stack(whole, axis=1), ratio)


def _product(matrix, vector):
    return sum(matrix[:, k] * vector[k] for k in range(len(vector)))


def _weighted(row, components):
    """Sum of row[i] components[i] for plain numbers, most of them zero."""
    parts = [float(r) * c for r, c in zip(row, components, strict=True) if r != 0]
    return sum(parts) if parts else jnp.zeros_like(components[0])


def at_rest(operator, embedding, band, components):
    """Jump, stress and whether the band loads or closes, at strain components, by its `Secant`.

    Where it does the solver has the answer. So it has where numbers are not finite: it fails.
    """
    jump = affine(operator.jump, components)
    traction, drive = embedding.law.effective(inside(band, jump), embedding.bulk.elastic)
    rests = drive <= operator.ratio
    if embedding.closes:
        rests &= tensor.dot(traction, band.normal) >= 0
    return jump, affine(operator.stress, components), ~rests


def affine(table, components):
    """table[:, :k] · components + table[:, k]."""
    total = table[:, len(components)]
    for k in range(len(components)):
        total = total + table[:, k] * components[k]
    return total
