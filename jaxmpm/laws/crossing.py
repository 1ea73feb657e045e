"""A second band that crosses the first: a cracked point is itself the bulk of another band.

The embedding asks of its bulk only that it answers a strain, so a cracked point will do: its
history is its `Band`. The outer solver balances the second band with a bulk that at every trial
balances the first, and derivatives go through both.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxmpm import tensor
from jaxmpm.laws import balance
from jaxmpm.laws.band import Embedding, begun, continued, energies


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Cracked:
    """A point law: a bulk with a band in it. Its history is that `Band`."""

    embedding: Embedding

    @property
    def elastic(self):
        """The elastic part of its bulk."""
        return self.embedding.bulk.elastic

    def respond(self, strain, history):
        """Stress (size,), MPa (NaN where the first band finds no balance), and its new `Band`."""
        found = balance.respond(self.embedding, history, strain)
        return found.stress, found.band

    def stored(self, strain, history):
        """Energy stored in bulk and first band per volume, N/mm²."""
        outside = energies(self.embedding, history, strain)
        return outside[0]

    def dissipated(self, history):
        """Energy dissipated by the first band and its bulk per volume, N/mm²."""
        return energies(self.embedding, history, history.onset_strain)[1]


def parallel_ratio(embedding, band, strain):
    """Strength ratio r̂ of the stress parallel to a crack; a second band opens where it is 1.

    Args:
        embedding, band: the first crack, as it is at this strain.
        strain: macroscopic strain (size,).

    Returns:
        (r̂, unit normal of the second band (dimension,)): in a solid the direction in the plane
        of the crack that is pulled most.
    """
    stress = balance.stress_at(strain, embedding, band)
    best, normal = None, None
    for direction in _directions(stress, band.normal):
        pull = tensor.dot(tensor.traction(stress, direction), direction)
        ratio = jnp.maximum(pull, 0.0) / embedding.law.ft
        normal = direction if best is None else jnp.where(ratio > best, direction, normal)
        best = ratio if best is None else jnp.maximum(best, ratio)
    return best, normal


def _directions(stress, normal):
    plane = tensor.in_the_plane_of(normal)
    if len(plane) < 2:
        return plane
    a, b = plane
    pull = lambda p, q: tensor.dot(tensor.traction(stress, p), q)  # noqa: E731
    flat = jnp.stack([pull(a, a), pull(b, b), pull(a, b)])
    c, s = tensor.first_principal_direction(flat)
    return [c * a + s * b, -s * a + c * b]


def open_second(embedding, band, strain, size, law=None):
    """A second band across the first, at onset.

    Args:
        embedding, band: the first crack.
        strain: macroscopic strain (size,) at which `parallel_ratio` has reached 1.
        size: effective size H of the second band, mm.
        law: band law of the second; that of the first if None.

    Returns:
        (embedding of the second band in the cracked point, its `Band`), for `balance.respond`.
    """
    ratio, normal = parallel_ratio(embedding, band, strain)
    law = law or embedding.law
    outer = Embedding(Cracked(embedding), law, closes=embedding.closes)
    # the stress that the second band knows of: the pull across it, which has come to its strength
    pull = jnp.maximum(ratio, 1.0) * embedding.law.ft * tensor.along(normal, len(strain))
    shear = jnp.arange(len(strain)) >= tensor.NORMALS[len(strain)]
    elastic = embedding.bulk.elastic.strain(jnp.where(shear, pull / 2, pull))
    onset = elastic / law.onset(embedding.bulk.elastic.stress(elastic), embedding.bulk.elastic)
    size = jnp.asarray(size, strain.dtype)
    second = begun(normal, size, onset, band, strain - onset)
    whole = outer.bulk.stored(strain, band) + outer.bulk.dissipated(band)
    return outer, continued(outer, second, strain, whole)
