"""Hyperelastic laws for motion of any size, in total form.

They take the displacement gradient H = F − I: next to one, a strain of 1e-4 would keep three digits
in single precision. It is an array (d, d, ...) or a `Matrix`; vectors come back as lists of components. `Corotated` is the small-strain law in a frame that turns with the material:
F = R U, the strain is U − I. `NeoHookean` is for large strains. Kirchhoff stress τ = J σ, in-plane
components.
"""

from dataclasses import field

import jax
import jax.numpy as jnp

from jaxmpm import tensor
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.law import law
from jaxmpm.tensor import Matrix

ITERATIONS = 6  # of Higham's method


def plus_one(gradient):
    """F = I + H."""
    d = range(len(gradient))
    return Matrix([gradient[i, j] + (i == j) for j in d] for i in d)


def rotation(gradient):
    """Rotation R of the polar decomposition I + H = R U; in closed form up to two dimensions."""
    h = gradient
    if len(h) == 1:
        return Matrix([[jnp.ones_like(h[0, 0])]])
    if len(h) == 2:
        return turned(2 + h[0, 0] + h[1, 1], h[1, 0] - h[0, 1])
    f = plus_one(h)
    for _ in range(ITERATIONS):  # Higham (1986): R ← (R + R⁻ᵀ)/2, quadratic
        other, size = _cofactor(f), _determinant(f)
        f = jax.tree.map(lambda a, b: (a + b / size) / 2, f, other)  # noqa: B023
    return f


def turned(cosine, sine):
    """Rotation by the angle of a vector (cosine, sine) of any length; none where that is zero."""
    size = tensor.norm([cosine, sine])
    none = size == 0
    c = jnp.where(none, 1.0, cosine / jnp.where(none, 1.0, size))
    s = jnp.where(none, 0.0, sine / jnp.where(none, 1.0, size))
    return Matrix([[c, -s], [s, c]])


def strain_in(turn, gradient):
    """sym(Rᵀ F) − I in the frame that has turned by R: in-plane components, engineering shear."""
    d = len(gradient)
    inner = _symmetric(times(_transposed(turn), gradient))
    less = [turn[i, i] - 1 for i in range(d)] + [
        (turn[i, j] + turn[j, i]) / 2 for i, j in tensor.IN_SPACE[d][d:]
    ]
    if d == 2:  # 1 − cos without loss of digits, and a rotation has no symmetric shear
        c, s = turn[0, 0], turn[1, 0]
        small = c > 0
        less = [jnp.where(small, -s * s / jnp.where(small, 1 + c, 1.0), c - 1)] * 2 + [0.0]
    twice = [1.0] * d + [2.0] * (len(inner) - d)
    return [f * (s + o) for f, s, o in zip(twice, inner, less, strict=True)]


def turned_stress(turn, stress, gradient):
    """τ = sym(R S Fᵀ) of a stress in the frame that has turned by R, in-plane components."""
    first = times(turn, _matrix(stress, len(gradient)))  # first Piola-Kirchhoff stress
    return _symmetric(times(first, _transposed(plus_one(gradient))))


def _cofactor(f):
    return Matrix([tensor.cross(f[1], f[2]), tensor.cross(f[2], f[0]), tensor.cross(f[0], f[1])])


def _determinant(f):
    if len(f) == 1:
        return f[0, 0]
    if len(f) == 2:
        return f[0, 0] * f[1, 1] - f[0, 1] * f[1, 0]
    return tensor.dot(f[0], tensor.cross(f[1], f[2]))


def volume_change(gradient):
    """J − 1 = det(I + H) − 1."""
    h, d = gradient, len(gradient)
    trace = sum(h[i, i] for i in range(d))
    if d == 1:
        return trace
    if d == 2:
        return trace + _determinant(h)
    minors = sum(h[i, i] * h[j, j] - h[i, j] * h[j, i] for i, j in ((0, 1), (1, 2), (0, 2)))
    return trace + minors + _determinant(h)


def inverse(a):
    """a⁻¹."""
    d = len(a)
    if d == 1:
        return Matrix([[1 / a[0, 0]]])
    if d == 2:
        adjoint = Matrix([[a[1, 1], -a[0, 1]], [-a[1, 0], a[0, 0]]])
    else:
        adjoint = _transposed(_cofactor(a))
    size = _determinant(a)
    return jax.tree.map(lambda each: each / size, adjoint)


def times(a, b):
    """a · b."""
    d = range(len(a))
    return Matrix([sum(a[i, k] * b[k, j] for k in d) for j in d] for i in d)


def _transposed(a):
    return Matrix(zip(*a, strict=True))


def _symmetric(matrix):
    """In-plane components of the symmetric part."""
    return [(matrix[i, j] + matrix[j, i]) / 2 for i, j in tensor.IN_SPACE[len(matrix)]]


def _matrix(vector, d):
    table = {}
    for value, (i, j) in zip(vector, tensor.IN_SPACE[d], strict=True):
        table[i, j] = table[j, i] = value
    return Matrix([table[i, j] for j in range(d)] for i in range(d))


@law
class Corotated:
    """Isotropic linear elasticity in the turning frame; plane strain, or plane stress, in 2D."""

    E: float  # Young's modulus, MPa
    nu: float  # Poisson's ratio
    plane_stress: bool = field(default=False, metadata={"static": True})  # in 2D, else plane strain

    def _in_plane(self, strain):
        """Stress of in-plane strains, engineering shear."""
        d = {1: 1, 3: 2, 6: 3}[len(strain)]
        if d == 1:
            return [self.E * strain[0]]
        size = 3 if d == 2 and self.plane_stress else 6
        direct, cross, shear = Elastic(self.E, self.nu).coefficients(size)
        trace = sum(strain[i] for i in range(d))
        parts = [cross * trace + (direct - cross) * strain[i] for i in range(d)]
        return parts + [shear * strain[i] for i in range(d, len(strain))]

    def kirchhoff(self, gradient):
        """τ = R S U Rᵀ with S = C : (U − I), in-plane components, MPa."""
        turn = rotation(gradient)
        return turned_stress(turn, self._in_plane(strain_in(turn, gradient)), gradient)

    def energy(self, gradient):
        """Stored energy per undeformed volume, N/mm²."""
        strain = strain_in(rotation(gradient), gradient)
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

    def kirchhoff(self, gradient):
        """τ = μ (b − I) + λ ln J I, in-plane components, MPa; NaN where J ≤ 0."""
        lame, shear = self._lame
        d = len(gradient)
        square = _symmetric(times(gradient, _transposed(gradient)))
        left = [2 * h + b for h, b in zip(_symmetric(gradient), square, strict=True)]  # b − I
        volumetric = lame * jnp.log1p(volume_change(gradient))
        return [shear * b + (volumetric if k < d else 0.0) for k, b in enumerate(left)]

    def energy(self, gradient):
        """Stored energy per undeformed volume, N/mm²."""
        lame, shear = self._lame
        change = jnp.log1p(volume_change(gradient))
        d = len(gradient)
        square = sum(gradient[i, j] ** 2 for i in range(d) for j in range(d))
        trace = 2 * sum(gradient[i, i] for i in range(d)) + square  # tr b − 3
        return shear / 2 * (trace - 2 * change) + lame / 2 * change**2
