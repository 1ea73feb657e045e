"""The scene that every code computes: an elastic block that fills a box and swirls in it.

A square block in plane strain, four points to a cell, between walls without friction. Its first
velocity is a vortex, and its points start as if the vortex had turned for a while, so that from
the first step on some of them cross cells. (A block with free edges would not do: with linear
functions and the stress updated last, the nodes of little mass beyond a free edge are unstable.)
The scheme is the same for all codes: linear functions, FLIP, stress updated last, and the
small-strain law of the displacement gradient F − I, with F kept in full.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Scene:
    """A block of `cells` × `cells` cells."""

    cells: int
    cell: float = 1.0  # mm
    young: float = 1000.0  # MPa
    poisson: float = 0.3
    density: float = 1e-9  # tonne/mm³
    courant: float = 0.3
    speed: float = 0.02  # largest of the vortex over the speed of sound
    turned: float = 0.6  # largest displacement of the first positions, cells

    @property
    def count(self):
        """Number of points."""
        return 4 * self.cells**2

    @property
    def stiffness(self):
        """C₁₁, C₁₂ and C₃₃ in plane strain, MPa."""
        e, nu = self.young, self.poisson
        direct = e * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
        return direct, direct * nu / (1 - nu), e / (2 * (1 + nu))

    @property
    def sound(self):
        """Speed of longitudinal waves, mm/s."""
        return (self.stiffness[0] / self.density) ** 0.5

    @property
    def dt(self):
        """Time step, s."""
        return self.courant * self.cell / self.sound

    @property
    def volume(self):
        """Of a point, for a thickness of 1 mm, mm³."""
        return self.cell**2 / 4

    def positions(self):
        """First positions (2, count), mm, cell by cell."""
        corner = np.stack(np.meshgrid(*[np.arange(self.cells)] * 2, indexing="ij")).reshape(2, -1, 1)
        inside = np.array([[0.25, 0.25, 0.75, 0.75], [0.25, 0.75, 0.25, 0.75]])[:, None]
        x = self.cell * (corner + inside).reshape(2, -1)
        return x + self.cell * self.turned * self._vortex(x)

    def velocities(self, x):
        """First velocities (2, ...) at positions x (2, ...), mm/s."""
        return self.sound * self.speed * self._vortex(x)

    def _vortex(self, x):
        """A field without divergence that stays within the walls, at most 1."""
        a, b = np.pi / (self.cells * self.cell) * x
        return np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)])
