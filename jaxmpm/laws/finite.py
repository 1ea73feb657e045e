"""Hyperelastic laws for motion of any size: stress from the deformation gradient F, in total form.

`Corotated` is the small-strain law in a frame that turns with the material: F = R U, the strain
is U − I. `NeoHookean` is for large strains. Kirchhoff stress τ = J σ, in-plane components.
"""

import jax.numpy as jnp

from jaxmpm import tensor
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.law import law


def rotation(deformation):
    """Rotation R (d, d) of the polar decomposition F = R U; in closed form up to two dimensions."""
    f = deformation
    if len(f) == 1:
        return jnp.ones_like(f)
    if len(f) == 2:
        cosine, sine = f[0, 0] + f[1, 1], f[1, 0] - f[0, 1]
        size = tensor.norm([cosine, sine])
        none = size == 0
        c = jnp.where(none, 1.0, cosine / jnp.where(none, 1.0, size))
        s = jnp.where(none, 0.0, sine / jnp.where(none, 1.0, size))
        return jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])
    for _ in range(ITERATIONS):  # Higham (1986): R ← (R + R⁻ᵀ)/2, quadratic
        f = (f + _cofactor(f) / _determinant(f)) / 2
    return f


ITERATIONS = 6


def _cofactor(f):
    return jnp.stack([tensor.cross(f[1], f[2]), tensor.cross(f[2], f[0]), tensor.cross(f[0], f[1])])


def _determinant(f):
    if len(f) == 1:
        return f[0, 0]
    if len(f) == 2:
        return f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    return tensor.dot(f[0], tensor.cross(f[1], f[2]))


def times(a, b):
    """a · b of (d, d, ...)."""
    d = range(len(a))
    return jnp.stack([jnp.stack([sum(a[i, k] * b[k, j] for k in d) for j in d]) for i in d])


def _transposed(a):
    return jnp.swapaxes(a, 0, 1)


def _symmetric(matrix):
    """In-plane components of the symmetric part."""
    return jnp.stack([(matrix[i, j] + matrix[j, i]) / 2 for i, j in tensor.IN_SPACE[len(matrix)]])


def _matrix(vector, d):
    table = {}
    for value, (i, j) in zip(vector, tensor.IN_SPACE[d], strict=True):
        table[i, j] = table[j, i] = value
    return jnp.stack([jnp.stack([table[i, j] for j in range(d)]) for i in range(d)])


@law
class Corotated:
    """Isotropic linear elasticity in the turning frame; plane strain, or plane stress, in 2D."""

    E: float  # Young's modulus, MPa
    nu: float  # Poisson's ratio
    plane_stress: float = 0.0  # 1 in plane stress, 0 in plane strain; of no meaning in 1D and 3D

    def _in_plane(self, strain):
        """Stress of in-plane strains, engineering shear."""
        elastic = Elastic(self.E, self.nu)
        d = {1: 1, 3: 2, 6: 3}[len(strain)]
        direct, cross, shear = elastic.coefficients(6)
        if d == 1:
            return self.E * strain
        if d == 2:
            flat, across, _ = elastic.coefficients(3)
            direct = jnp.where(self.plane_stress > 0, flat, direct)
            cross = jnp.where(self.plane_stress > 0, across, cross)
        trace = sum(strain[i] for i in range(d))
        parts = [cross * trace + (direct - cross) * strain[i] for i in range(d)]
        return jnp.stack(parts + [shear * strain[i] for i in range(d, len(strain))])

    def strain(self, deformation):
        """U − I with engineering shear, and R."""
        turn = rotation(deformation)
        stretch = _symmetric(times(_transposed(turn), deformation))
        d = len(deformation)
        scale = [1.0] * d + [2.0] * (len(stretch) - d)
        shift = [1.0] * d + [0.0] * (len(stretch) - d)
        return jnp.stack([f * (s - o) for f, s, o in zip(scale, stretch, shift, strict=True)]), turn

    def kirchhoff(self, deformation):
        """τ = R S U Rᵀ with S = C : (U − I), in-plane components, MPa."""
        strain, turn = self.strain(deformation)
        d = len(deformation)
        first = times(turn, _matrix(self._in_plane(strain), d))  # first Piola-Kirchhoff stress
        return _symmetric(times(first, _transposed(deformation)))

    def energy(self, deformation):
        """Stored energy per undeformed volume, N/mm²."""
        strain, _ = self.strain(deformation)
        return tensor.dot(strain, self._in_plane(strain)) / 2


@law
class NeoHookean:
    """Compressible neo-Hookean solid, ψ = μ/2 (tr b − 3 − 2 ln J) + λ/2 ln² J; plane strain in 2D."""

    E: float  # Young's modulus at small strain, MPa
    nu: float  # Poisson's ratio at small strain

    @property
    def _lame(self):
        shear = self.E / (2 * (1 + self.nu))
        return 2 * shear * self.nu / (1 - 2 * self.nu), shear

    def kirchhoff(self, deformation):
        """τ = μ (b − I) + λ ln J I, in-plane components, MPa; NaN where J ≤ 0."""
        lame, shear = self._lame
        d = len(deformation)
        left = _symmetric(times(deformation, _transposed(deformation)))
        volumetric = lame * jnp.log(_determinant(deformation)) - shear
        return jnp.stack([shear * b + (volumetric if k < d else 0.0) for k, b in enumerate(left)])

    def energy(self, deformation):
        """Stored energy per undeformed volume, N/mm²."""
        lame, shear = self._lame
        change = jnp.log(_determinant(deformation))
        d = len(deformation)
        trace = sum(deformation[i, j] ** 2 for i in range(d) for j in range(d)) + 3 - d
        return shear / 2 * (trace - 3 - 2 * change) + lame / 2 * change**2
