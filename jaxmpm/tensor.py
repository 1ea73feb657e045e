"""Strain and stress as vectors, and the few operations the laws need of them.

A stress state is known by the length of its vectors; a law is written once for all of them.

| size | stress state | components | dimension |
|---|---|---|---|
| 1 | uniaxial stress | xx | 1 |
| 3 | plane stress | xx, yy, xy | 2 |
| 4 | plane strain, zz along the thickness; axisymmetric, zz the hoop | xx, yy, zz, xy | 2 |
| 6 | three-dimensional | xx, yy, zz, yz, xz, xy | 3 |

Shear strains are engineering ones, 2 e_xy. The dimension is the length of normals, jumps and
tractions. All act on one point; since components come first, they act as well on many points
that lie along trailing axes, twice as fast as under `jax.vmap`, which works too.
"""

import jax
import jax.numpy as jnp

# Double precision is the default of the project; a scene asks for float32 by name.
jax.config.update("jax_enable_x64", True)

STRAIN_SIZE = {
    "uniaxial": 1, "plane_stress": 3, "plane_strain": 4, "axisymmetric": 4, "solid": 6,
}  # fmt: skip
DIMENSION = {1: 1, 3: 2, 4: 2, 6: 3}
# row and column of each component in the full tensor
PAIRS = {
    1: ((0, 0),),
    3: ((0, 0), (1, 1), (0, 1)),
    4: ((0, 0), (1, 1), (2, 2), (0, 1)),
    6: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)),
}
IN_SPACE = {1: PAIRS[1], 2: PAIRS[3], 3: PAIRS[6]}  # the same by dimension, in-plane ones only
NORMALS = {1: 1, 3: 2, 4: 3, 6: 3}  # how many direct components come first


@jax.tree_util.register_pytree_node_class
class Matrix(tuple):
    """Rows of components, read like an array (d, d, ...): stacking them would pass over memory once more."""

    def __new__(cls, rows=()):
        """Of rows, each an iterable of components."""
        return super().__new__(cls, map(tuple, rows))

    def __getitem__(self, at):
        """A row, or the component [i, j]."""
        row = tuple.__getitem__(self, at[0] if isinstance(at, tuple) else at)
        return row[at[1]] if isinstance(at, tuple) else row

    def tree_flatten(self):
        """Components row by row."""
        return [value for row in self for value in row], len(self)

    @classmethod
    def tree_unflatten(cls, size, values):
        """Back from components."""
        values = list(values)
        return cls(values[i * size : (i + 1) * size] for i in range(size))


def dot(a, b):
    """Sum of a[i] b[i] over the first axis, unrolled: vectors here are short, batches long."""
    return sum(a[i] * b[i] for i in range(1, len(a))) + a[0] * b[0]


def norm(vector):
    """Euclidean length over the first axis, its derivative zero (not NaN) at zero."""
    square = dot(vector, vector)
    none = square == 0
    return jnp.where(none, 0.0, jnp.sqrt(jnp.where(none, 1.0, square)))


def from_plane(components, size):
    """Strain vector (size,) from its in-plane components xx, yy, xy; a zz strain is zero."""
    xx, yy, xy = components
    return jnp.stack([xx, yy, xy] if size == 3 else [xx, yy, jnp.zeros_like(xx), xy])


def to_plane(vector):
    """In-plane components xx, yy, xy of a strain or stress vector of size 3 or 4."""
    return jnp.stack([vector[0], vector[1], vector[-1]])


def symmetric_product(normal, jump, size):
    """Strain vector (size,) of the symmetric dyad (n ⊗ [u])^s, with engineering shear."""
    n, w, dimension = normal, jump, len(normal)
    zero = jnp.zeros_like(n[0] * w[0])

    def component(i, j):
        if max(i, j) >= dimension:
            return zero
        return n[i] * w[i] if i == j else n[i] * w[j] + n[j] * w[i]

    return jnp.stack([component(i, j) for i, j in PAIRS[size]])


def traction(stress, normal):
    """Traction (dimension,) of a stress vector on the plane with this normal."""
    total = [0.0] * len(normal)
    for value, (i, j) in zip(stress, PAIRS[len(stress)], strict=True):
        if max(i, j) < len(normal):
            total[i] = total[i] + value * normal[j]
            if i != j:
                total[j] = total[j] + value * normal[i]
    return jnp.stack(total)


def with_traction(stress, normal, asked):
    """The stress nearest to `stress` whose traction on the plane with this normal is `asked`."""
    lack = asked - traction(stress, normal)
    along_normal = dot(lack, normal)
    n = normal

    def change(i, j):
        if max(i, j) >= len(n):
            return 0.0
        return n[i] * lack[j] + n[j] * lack[i] - along_normal * n[i] * n[j]

    return jnp.stack([s + change(i, j) for s, (i, j) in zip(stress, PAIRS[len(stress)], strict=True)])


def along(direction, size):
    """Vector p (size,) that picks the direct stress along a unit direction: p·σ = d·σ·d."""
    return symmetric_product(direction, direction, size)


def in_the_plane_of(normal):
    """Unit directions at right angles to a normal, as many as there are."""
    if len(normal) == 1:
        return []
    if len(normal) == 2:
        return [jnp.stack([-normal[1], normal[0]])]
    x, y, z = normal  # Duff et al. (2017): continuous but for the sign of z
    sign = jnp.where(z >= 0, 1.0, -1.0).astype(z.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    return [
        jnp.stack([1 + sign * x * x * a, sign * b, -sign * x]),
        jnp.stack([b, sign + y * y * a, -y]),
    ]


def trace(stress):
    """Sum of the direct components."""
    return sum(stress[i] for i in range(NORMALS[len(stress)]))


def solve(matrix, vector):
    """Solution of a system of one, two or three equations in closed form."""
    m, v = matrix, vector
    if len(v) == 1:
        return v / m[0, 0]
    if len(v) == 2:
        determinant = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
        first, second = m[1, 1] * v[0] - m[0, 1] * v[1], m[0, 0] * v[1] - m[1, 0] * v[0]
        return jnp.stack([first, second]) / determinant
    a, b, c = (cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]))  # rows of the adjugate
    return (a * v[0] + b * v[1] + c * v[2]) / dot(m[0], a)


def cross(a, b):
    """Vector product of two vectors of three."""
    turn = lambda i, j: a[i] * b[j] - a[j] * b[i]  # noqa: E731
    return jnp.stack([turn(1, 2), turn(2, 0), turn(0, 1)])


# ------------------------------------------------------------------ principal values


def principal_values(stress):
    """Principal values (3,) of a stress vector.

    Size 1 to 4: the in-plane pair in falling order, then the one out of plane. Size 6: falling.
    Where two coincide their derivative is finite, and right for functions symmetric in them.
    """
    if len(stress) == 1:
        zero = jnp.zeros_like(stress[0])
        return jnp.stack([stress[0], zero, zero])
    if len(stress) == 6:
        return _values_and_directions(stress)[0]
    xx, yy, xy = to_plane(stress)
    out_of_plane = jnp.zeros_like(xx) if len(stress) == 3 else stress[2]
    centre, half = (xx + yy) / 2, (xx - yy) / 2
    radius = norm([half, xy])
    return jnp.stack([centre + radius, centre - radius, out_of_plane])


def first_principal_direction(stress):
    """Unit direction (dimension,) of the largest in-plane (2D) or any (3D) principal stress.

    x where all directions are as good.
    """
    if len(stress) == 1:
        return jnp.ones_like(stress)
    if len(stress) == 6:
        return _values_and_directions(stress)[1][0]
    xx, yy, xy = to_plane(stress)
    angle = jnp.arctan2(2 * xy, xx - yy) / 2
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)])


@jax.custom_jvp
def _values_and_directions(stress):
    """Principal values (3,) of a solid stress in falling order, and directions (3, 3), rows."""
    values, rows = _jacobi(stress)
    for i, j in ((0, 1), (1, 2), (0, 1)):
        swap = values[i] < values[j]
        pick = lambda a, b: (jnp.where(swap, b, a), jnp.where(swap, a, b))  # noqa: B023, E731
        values[i], values[j] = pick(values[i], values[j])
        rows[i], rows[j] = pick(rows[i], rows[j])
    return jnp.stack(values), jnp.stack(rows)


@_values_and_directions.defjvp
def _values_and_directions_jvp(primals, tangents):
    """dλ_i = n_i·dσ·n_i; directions turn by dσ_ij/(λ_i − λ_j), not at all where values coincide.

    A mean over coinciding values makes their derivative independent of the directions found.
    """
    values, rows = _values_and_directions(*primals)
    image = jnp.einsum("ai...,ij...,bj...->ab...", rows, _matrix(tangents[0]), rows)
    slack = 64 * jnp.finfo(values.dtype).eps * jnp.abs(values).max(0)
    gap = values[:, None] - values[None, :]
    same = (jnp.abs(gap) <= slack).astype(values.dtype)
    diagonal = jnp.stack([image[i, i] for i in range(3)])
    change = (same * diagonal[None]).sum(1) / same.sum(1)
    turn = jnp.where(same > 0, 0.0, image / jnp.where(same > 0, 1.0, gap))
    return (values, rows), (change, jnp.einsum("ab...,bi...->ai...", turn, rows))


def _matrix(stress):
    xx, yy, zz, yz, xz, xy = stress
    return jnp.stack([jnp.stack([xx, xy, xz]), jnp.stack([xy, yy, yz]), jnp.stack([xz, yz, zz])])


SWEEPS = 5  # of the Jacobi method: quadratic, three equations are at round-off after five


def _jacobi(stress):
    """Eigenvalues and vectors by cyclic Jacobi rotations, free of branches: lists of 3 and of 3.

    As accurate where values coincide as elsewhere, and it maps over batches, where a library's
    `eigh` goes through them one by one.
    """
    zero, one = jnp.zeros_like(stress[0]), jnp.ones_like(stress[0])
    scale = jnp.abs(stress).max(0)
    scale = jnp.where(scale > 0, scale, 1.0)
    xx, yy, zz, yz, xz, xy = stress / scale
    a = {(0, 0): xx, (1, 1): yy, (2, 2): zz, (1, 2): yz, (0, 2): xz, (0, 1): xy}
    rows = [jnp.stack(v) for v in ([one, zero, zero], [zero, one, zero], [zero, zero, one])]
    for _ in range(SWEEPS):
        for p, q, r in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            gap, off = a[q, q] - a[p, p], 2 * a[p, q]
            long = jnp.abs(gap) + jnp.sqrt(gap * gap + off * off)
            still = long == 0
            t = jnp.where(gap < 0, -off, off) / jnp.where(still, 1.0, long)
            c = jax.lax.rsqrt(1 + t * t)
            s = t * c
            a[p, p], a[q, q] = a[p, p] - t * a[p, q], a[q, q] + t * a[p, q]
            a[p, q] = zero
            pr, qr = (min(p, r), max(p, r)), (min(q, r), max(q, r))
            a[pr], a[qr] = c * a[pr] - s * a[qr], s * a[pr] + c * a[qr]
            rows[p], rows[q] = c * rows[p] - s * rows[q], s * rows[p] + c * rows[q]
    return [a[i, i] * scale for i in range(3)], rows
