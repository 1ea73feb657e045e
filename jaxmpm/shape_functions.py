"""Shape functions of the grid along one axis: linear, uGIMP, quadratic and cubic B-splines.

A point is kept in the bin that its functions are the same over: a cell (linear, cubic), or the
surroundings of a node (uGIMP, quadratic), one cell wide either. With y in [0, 1) its place in
the bin, each function is a polynomial of y, and a bin touches `count` nodes, the first of them
`lead` nodes before the one that has the bin's number.

The nodes outside the edge of the grid are ghosts: what they would carry is that of a linear
continuation, v₋₁ = 2 v₀ − v₁. That gives B-splines their boundary forms (Steffen, Kirby, Berzins
2008): a partition of unity, linear fields exact, and the value at the edge that of its node.
"""

from dataclasses import dataclass

import jax.numpy as jnp


@dataclass(frozen=True)
class Linear:
    """Tents; a bin is a cell."""

    count = 2
    lead = 0
    centred = False

    def weights(self, y):
        """Values at the nodes of a bin, and their derivatives times the cell size."""
        one = jnp.ones_like(y)
        return [1 - y, y], [-one, one]


@dataclass(frozen=True)
class Gimp:
    """uGIMP (Bardenhagen, Kober 2004): tents averaged over a point's own width; a bin is a node's.

    The width stays that of the undeformed point.
    """

    half: float | None = None  # half the width over the cell size, at most 1/2; None: see `weights`

    count = 3
    lead = 1
    centred = True

    def weights(self, y, half=None):
        """Values at the nodes of a bin, and their derivatives times the cell size.

        `half` is that of each point, at most 1/2, where the shape has not one for all.
        """
        a = half if self.half is None else self.half
        values, slopes = [], []
        for shift in (1.0, 0.0, -1.0):
            x = y - 0.5 + shift
            sign, d = jnp.sign(x), jnp.abs(x)
            near, far = d < a, d > 1 - a
            edge = jnp.maximum(1 + a - d, 0.0)
            middle = jnp.where(near, 1 - (d * d + a * a) / (2 * a), 1 - d)
            values.append(jnp.where(far, edge * edge / (4 * a), middle))
            slopes.append(-sign * jnp.where(far, edge / (2 * a), jnp.where(near, d / a, 1.0)))
        return values, slopes


@dataclass(frozen=True)
class Quadratic:
    """Quadratic B-splines centred at the nodes; a bin is a node's."""

    count = 3
    lead = 1
    centred = True

    def weights(self, y):
        """Values at the nodes of a bin, and their derivatives times the cell size."""
        x = y - 0.5
        return (
            [(1 - y) ** 2 / 2, 0.75 - x * x, y * y / 2],
            [y - 1, -2 * x, y],
        )


@dataclass(frozen=True)
class Cubic:
    """Cubic B-splines centred at the nodes; a bin is a cell."""

    count = 4
    lead = 1
    centred = False

    def weights(self, y):
        """Values at the nodes of a bin, and their derivatives times the cell size."""
        z = 1 - y
        return (
            [
                z**3 / 6,
                (3 * y**3 - 6 * y**2 + 4) / 6,
                (3 * z**3 - 6 * z**2 + 4) / 6,
                y**3 / 6,
            ],
            [-z * z / 2, (1.5 * y - 2) * y, (2 - 1.5 * z) * z, y * y / 2],
        )
