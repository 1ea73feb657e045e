"""The Cartesian grid: from nodes to cells and back, as shifted slices of whole arrays.

Nodal fields are (2, nx+1, ny+1), cell fields (..., nx, ny). With bilinear functions on square
cells the displacement of a cell is a rigid motion, a constant strain and one hourglass mode
q ξη for each component, and full 2×2 Gauss integration separates the energies of the two
exactly; so a cell costs its mean strain and two hourglass amplitudes, nothing more.
"""

from typing import NamedTuple

import jax.numpy as jnp


class CellStrain(NamedTuple):
    """Deformation of every cell."""

    mean: tuple  # in-plane strain xx, yy, xy, each (nx, ny)
    hourglass: tuple  # amplitudes q_x, q_y, mm, each (nx, ny)


class CellStress(NamedTuple):
    """What resists that deformation."""

    mean: tuple  # in-plane stress xx, yy, xy, MPa, each (nx, ny)
    hourglass: tuple  # amplitudes conjugate to q over the thickness, MPa·mm, each (nx, ny)


def strain(displacement, cell):
    """Strain of every cell from nodal displacements (2, nx+1, ny+1), mm; cell size in mm."""
    u = displacement
    a, b, c, d = u[:, :-1, :-1], u[:, 1:, :-1], u[:, 1:, 1:], u[:, :-1, 1:]
    by_x = ((b + c) - (a + d)) * (0.5 / cell)
    by_y = ((d + c) - (a + b)) * (0.5 / cell)
    q = ((a + c) - (b + d)) * 0.25
    return CellStrain((by_x[0], by_y[1], by_y[0] + by_x[1]), (q[0], q[1]))


def hourglass_stiffness(direct, shear):
    """Stiffness of either hourglass amplitude per thickness, (4/3)(C₁₁ + C₃₃), MPa."""
    return (direct + shear) * (4 / 3)


def internal_force(stress, cell, thickness):
    """Nodal forces (2, nx+1, ny+1), N, that the cells exert against their deformation."""
    xx, yy, xy = (component * (0.5 * cell * thickness) for component in stress.mean)
    gx, gy = (component * (0.25 * thickness) for component in stress.hourglass)

    def gather(along_x, along_y, hourglass):
        """One component: the corner shares of each cell, shifted onto the nodes and added."""
        total, difference = along_x + along_y, along_x - along_y
        lower_left = jnp.pad(hourglass - total, ((0, 1), (0, 1)))
        lower_right = jnp.pad(difference - hourglass, ((1, 0), (0, 1)))
        upper_right = jnp.pad(hourglass + total, ((1, 0), (1, 0)))
        upper_left = jnp.pad(-difference - hourglass, ((0, 1), (1, 0)))
        return lower_left + lower_right + upper_right + upper_left

    return jnp.stack([gather(xx, xy, gx), gather(xy, yy, gy)])


def spread(field):
    """Share a cell field (nx, ny) equally among the four nodes of each cell, (nx+1, ny+1)."""
    quarter = field * 0.25
    return sum(
        jnp.pad(quarter, ((i, 1 - i), (j, 1 - j))) for i in (0, 1) for j in (0, 1)
    )
