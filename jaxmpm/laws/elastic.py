"""Isotropic linear elasticity (Hooke), and its release along a crack."""

import jax.numpy as jnp

from jaxmpm import tensor
from jaxmpm.laws.law import law


@law
class Elastic:
    """Isotropic elastic material."""

    E: float  # Young's modulus, MPa
    nu: float  # Poisson's ratio

    def coefficients(self, size):
        """C₁₁, C₁₂ and C₃₃ (MPa): plane stress for size 3, plane strain for size 4."""
        shear = self.E / (2 * (1 + self.nu))
        if size == 3:
            direct = self.E / (1 - self.nu**2)
            return direct, self.nu * direct, shear
        direct = self.E * (1 - self.nu) / ((1 + self.nu) * (1 - 2 * self.nu))
        return direct, direct * self.nu / (1 - self.nu), shear

    def stress(self, strain):
        """Stress (size,), MPa, of a strain (size,)."""
        direct, cross, shear = self.coefficients(len(strain))
        *normal, engineering = strain
        others = cross * sum(normal)
        return jnp.stack([others + (direct - cross) * e for e in normal] + [shear * engineering])


def released_stress(bulk, strain, normal, kept):
    """Stress with the direct compliance parallel to a crack raised from 1/E to 1/(kE), MPa.

    A cell that an inclined crack crosses strains along the crack although the material on
    either side does not; the spurious stress σ_mm that follows locks the opening. Degrading
    the compliance, not the stress, keeps the stiffness symmetric, so that energy stays
    accounted for (Sherman-Morrison update of the compliance; k = 1 changes nothing, k = 0
    frees the direction altogether).

    Args:
        bulk: an isotropic elastic law.
        strain: (size,).
        normal: unit normal of the crack (2,).
        kept: k, share of the parallel stiffness that is kept, 0 to 1.
    """
    parallel = jnp.stack([-normal[1], normal[0]])
    pick = tensor.along(parallel, len(strain))
    column = bulk.stress(pick)
    stress = bulk.stress(strain)
    loss = (1 - kept) / (kept * bulk.E + (1 - kept) * tensor.dot(pick, column))
    return stress - loss * tensor.dot(pick, stress) * column
