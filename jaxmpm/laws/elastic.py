"""Isotropic linear elasticity, and its release along a crack."""

import jax.numpy as jnp

from jaxmpm import tensor
from jaxmpm.laws.law import law


@law
class Elastic:
    """Isotropic elastic material, a point law without history."""

    E: float  # Young's modulus, MPa
    nu: float  # Poisson's ratio

    @property
    def elastic(self):
        """Itself."""
        return self

    def coefficients(self, size):
        """C₁₁, C₁₂ and C₃₃ (shear), MPa, of a stress state known by the size of its vectors."""
        shear = self.E / (2 * (1 + self.nu))
        if size == 1:
            return self.E, 0.0 * self.E, shear
        if size == 3:
            direct = self.E / (1 - self.nu**2)
            return direct, self.nu * direct, shear
        direct = self.E * (1 - self.nu) / ((1 + self.nu) * (1 - 2 * self.nu))
        return direct, direct * self.nu / (1 - self.nu), shear

    def stress(self, strain):
        """Stress (size,), MPa, of a strain (size,)."""
        size = len(strain)
        direct, cross, shear = self.coefficients(size)
        count = tensor.NORMALS[size]
        others = cross * tensor.trace(strain)
        parts = [others + (direct - cross) * strain[i] for i in range(count)]
        return jnp.stack(parts + [shear * strain[i] for i in range(count, size)])

    def strain(self, stress):
        """Strain (size,) of a stress (size,), MPa, where stresses that a vector lacks are zero."""
        size = len(stress)
        count = tensor.NORMALS[size]
        others = self.nu * tensor.trace(stress)
        parts = [(1 + self.nu) * stress[i] - others for i in range(count)]
        shear = [2 * (1 + self.nu) * stress[i] for i in range(count, size)]
        return jnp.stack(parts + shear) / self.E

    def initial(self, size):
        """No history."""
        return ()

    def respond(self, strain, history):
        """Stress (size,), MPa, and no history."""
        return self.stress(strain), history

    def stored(self, strain, history):
        """Elastic energy per volume, N/mm²."""
        return tensor.dot(strain, self.stress(strain)) / 2

    def dissipated(self, history):
        """None."""
        return 0.0 * self.E


def released_stress(bulk, strain, normal, kept):
    """Stress with the direct compliance in the plane of a crack raised from 1/E to 1/(kE), MPa.

    A cell that an inclined crack crosses strains along the crack although the material on
    either side does not; the spurious stress that follows locks the opening. Degrading the
    compliance, not the stress, keeps the stiffness symmetric, so that energy stays accounted
    for (Sherman-Morrison updates of the compliance; k = 1 changes nothing, k = 0 frees the
    directions altogether).

    Args:
        bulk: an isotropic elastic law.
        strain: (size,).
        normal: unit normal of the crack (dimension,).
        kept: k, share of the parallel stiffness that is kept, 0 to 1.
    """
    stress = bulk.stress
    for direction in tensor.in_the_plane_of(normal):
        stress = _softened(stress, tensor.along(direction, len(strain)), kept, bulk.E)
    return stress(strain)


def _softened(stress, pick, kept, E):
    """`stress(strain)` with the compliance along p pᵀ raised by (1/k − 1)/E."""
    column = stress(pick)
    loss = (1 - kept) / (kept * E + (1 - kept) * tensor.dot(pick, column))

    def softer(strain):
        before = stress(strain)
        return before - loss * tensor.dot(pick, before) * column

    return softer
