"""Random cracked points, and laws to embed in them, shared by the tests of bands.

Points lie along the last axis of every array; compiling is what costs time here, so every test
asks for batches of one size.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import tensor
from jaxmpm.laws import balance
from jaxmpm.laws.band import Embedding, open_band
from jaxmpm.laws.cohesive import Cohesive
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.j2 import J2

COUNT = 512
CONCRETE = {"E": 32000.0, "nu": 0.2, "ft": 3.0, "Ep": 8.184, "n": 0.128, "h": 0.05}
LAWS = ["damage", "released", "closing", "viscous", "plastic", "hordijk"]  # and other curves
REGIMES = ["onset", "loading", "unloading", "sheared", "damaged"]

respond = jax.jit(balance.respond, static_argnums=3)


def concrete(count=COUNT, kind="damage", dtype=float, **changes):
    """The paper's concrete, `count` times, embedded in one of the ways of `LAWS`."""
    values = CONCRETE | changes
    fill = {k: jnp.asarray(np.broadcast_to(v, (count,)), dtype) for k, v in values.items()}
    return embedded(kind, **fill)


def embedded(kind, E, nu, ft, Ep, n, h):
    """An embedding of one of the kinds of `LAWS` from arrays of parameters."""
    bulk = Elastic(E, nu)
    damage = Damage(ft, Ep, n, h)
    if kind == "plastic":  # yields at half to three times the strength, and hardens more or less
        return Embedding(J2(E, nu, (25 * n - 2) * ft, 1e-4 * Ep * E), damage)
    if kind in ("damage", "released", "closing", "viscous"):
        return Embedding(
            bulk,
            damage,
            release=jnp.ones_like(E) if kind == "released" else None,
            drag=0.02 * E / h if kind == "viscous" else None,
            closes=kind == "closing",
        )
    energy = damage.given_up(400 + 0 * E, bulk)
    return Embedding(bulk, Cohesive(ft, energy, 0.8 + 0 * E, h, kind), closes=True)


def random_points(rng, size, kind="damage", tilt=0.0, largest=20.0, share=0.5, nu=(0.0, 0.35)):
    """Embedding and freshly opened bands of random materials, directions and sizes.

    The normal is up to `tilt` (rad) off the first principal direction; H is at most a `share`
    of the largest at which a point does not snap back.
    """
    count = COUNT
    parameters = {
        "E": rng.uniform(20000, 45000, count), "nu": rng.uniform(*nu, count),
        "ft": rng.uniform(1.5, 4.0, count), "Ep": rng.uniform(5.0, 20.0, count),
        "n": rng.uniform(0.1, 0.2, count), "h": 10 ** rng.uniform(-2.3, -1.3, count),
    }  # fmt: skip
    embedding = embedded(kind, **{k: jnp.asarray(v) for k, v in parameters.items()})
    stress = rng.normal(size=(size, count))
    stress[0] = np.abs(stress[0]) + 0.3  # some tension everywhere
    for k in range(1, tensor.NORMALS[size]):
        stress[k] = np.maximum(stress[k], -stress[0])
    bulk = embedding.bulk.elastic
    ratio = embedding.law.onset(jnp.asarray(stress), bulk)
    strain = bulk.strain(jnp.asarray(stress) / ratio)
    normal = np.asarray(tensor.first_principal_direction(bulk.stress(strain)))
    if tilt:
        normal = normal + np.tan(tilt) * rng.uniform(-1, 1, normal.shape)
        normal /= np.linalg.norm(normal, axis=0)
    H = np.exp(rng.uniform(np.log(0.25), np.log(largest), count))
    most = np.asarray(embedding.law.largest_size(bulk)) * share
    H = np.maximum(np.minimum(H, most), 1.001 * parameters["h"])
    history = embedding.bulk.initial(size)
    band = open_band(embedding, strain, jnp.asarray(normal), jnp.asarray(H), history)
    return embedding, band


def opened(band, opening, spare=0.0):
    """Macroscopic strain of points whose cracks open by `opening`, the rest 1 + spare at onset."""
    size = len(band.onset_strain)
    return (1 + spare) * band.onset_strain + tensor.symmetric_product(
        band.normal, opening, size
    ) / band.size


def follow(embedding, band, path, precision=1e-11, respond=respond):
    """Take a batch along a path of strains: the last state and all answers."""
    answers = []
    for strain in path:
        answers.append(respond(embedding, band, strain, precision))
        band = answers[-1].band
    return band, answers


@cache
def states_of(kind, size, regime, respond=respond):
    """Random states of a regime: embedding, state before and strain asked for."""
    rng = np.random.default_rng([size, REGIMES.index(regime)])
    embedding, band = random_points(rng, size, kind, largest=5.0)
    law = embedding.law
    # an opening that takes a good part of the strength
    unit = law.h * law.ft / law.Ep if hasattr(law, "Ep") else law.GF / law.ft / 3
    across = tensor.in_the_plane_of(band.normal)
    side = across[0] if across else 0 * band.normal
    ask = lambda a, b, spare: opened(band, unit * (a * band.normal + b * side), spare)  # noqa: E731
    if regime == "onset":
        return embedding, band, ask(rng.uniform(0.003, 0.03, COUNT), 0.0, 0.02)
    last = {"damaged": 10 ** rng.uniform(0.7, 0.9, COUNT)}.get(regime, 10 ** rng.uniform(-1.3, 0.4, COUNT))
    turn = rng.uniform(0.05, 0.4, COUNT) * last if regime == "sheared" else 0.01 * last
    path = [ask(k * last, 0.0, 0.0) for k in np.geomspace(5e-3, 0.7, 8)]
    path += [ask(0.85 * last, turn / 2, 0.1)]
    band, answers = follow(embedding, band, path, respond=respond)
    assert all((np.asarray(a.status) != balance.FAILS).all() for a in answers)
    end = ask(last, turn, 0.2)
    if regime == "unloading":
        end = path[-1] * rng.uniform(0.2, 0.9, COUNT)
    return embedding, band, end


def uniaxial(s, E, ft, Ep, n, h, **_):
    """Stress and opening of the damage law in uniaxial tension at integrity s = 1 − D."""
    e = Ep / E
    stress = ft * s * (1 + e * s**n) / (s + e * s**n)
    return stress, h * (stress / (s * E) - stress / E)
