"""Samples a mesostructure on the cells of a grid.

The distance d from the nearest outline says what a place is: inclusion for d < 0, interface for
0 ≤ d < its thickness t, else matrix. How a cell takes it:

`centre`: what its middle is. The interface must be a cell thick at least, or it would have holes; at one
cell it hangs together by corners, where it is inclined, and is some 15 % too strong: two cells are enough.

`mixed`, for thinner layers: sub-samples, each of which an outline may divide, give the shares of the
phases in the cell, of layers however thin. Its bulk is their mean: E by Hill, half the sum of Voigt's bound (layers in
parallel) and Reuss's (in series); ν and density by shares. Its band is not mixed, for a crack runs in
the weakest layer that hangs together: it is the interface's in each cell that the middle of that
layer, the line d = t/2, crosses, elsewhere that of the phase at the middle. So a row of cells one cell
wide follows every inclusion, whatever t, with the strength, fracture energy and width of the
interface's band as the scene gives them. In an image the phase at the middle decides.
"""

from dataclasses import dataclass

import numpy as np

from jaxmpm.mesostructure import image, placement
from jaxmpm.mesostructure.scatter import strength_factor

SIDES = 8  # sub-samples along the side of a cell


@dataclass(frozen=True, eq=False)
class Local:
    """What differs from cell to cell beyond the material; None where the materials say it all."""

    strength: np.ndarray | None  # factor on the strength, (nx, ny)
    shares: np.ndarray | None  # of each material in the cell, (materials, nx, ny); their sum is 1


def box_of(body, grid) -> tuple[float, float, float, float]:
    """The rectangle around a body, (x min, y min, x max, y max), mm."""
    whole = (*grid.origin, *np.add(grid.origin, grid.size))
    bounds = np.array([shape.bounds() or whole for shape in body.shapes])
    low = np.maximum(bounds[:, :2].min(axis=0), whole[:2])
    high = np.minimum(bounds[:, 2:].max(axis=0), whole[2:])
    return tuple(map(float, (*low, *high)))


def centres(grid) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the cells along x (nx,) and y (ny,), mm."""
    x, y = (o + (np.arange(n) + 0.5) * grid.cell for o, n in zip(grid.origin, grid.shape, strict=True))
    return x, y


def structure_of(scene):
    """The inclusions of a scene, `structure.Structure`; None where it has none."""
    table = scene.mesostructure
    if table is None or table.inclusions is None:
        return None
    (body,) = (body for body in scene.bodies if body.name == table.body)
    return placement.place(table.inclusions, box_of(body, scene.grid), table.seed)


class Sampler:
    """The phases of a scene's mesostructure, as indices into its materials."""

    def __init__(self, scene):
        self.table, self.cell = scene.mesostructure, scene.grid.cell
        names = list(scene.materials)
        (body,) = (body for body in scene.bodies if body.name == self.table.body)
        self.structure = structure_of(scene)
        self.thickness = self.table.interface_thickness or 0.0
        if self.structure is None:
            self.box = box_of(body, scene.grid)
            self.pixels = image.phases(self.table.image, names)
            return
        # inclusion, interface, matrix: by how many of the limits 0 and thickness d has passed
        of = (self.table.inclusion, self.table.interface or body.material, body.material)
        self.index = np.array([names.index(name) for name in of])

    def at(self, x, y) -> np.ndarray:
        """Material of the places x (nx,) × y (ny,), (nx, ny)."""
        if self.structure is None:
            return image.at(self.pixels, self.box, x, y)
        return self.index[np.digitize(self.distance(x, y), (0.0, self.thickness))]

    def distance(self, x, y) -> np.ndarray:
        """Distance from the outlines, mm, (nx, ny), negative inside, as far as it matters."""
        return self.structure.distance(x, y, self.thickness + 2 * self.cell)

    def crossed(self, grid) -> np.ndarray:
        """Cells (nx, ny) that the middle of the interface crosses."""
        if self.structure is None or not self.thickness:
            return np.zeros(grid.shape, bool)
        lines = (o + np.arange(n + 1) * grid.cell for o, n in zip(grid.origin, grid.shape, strict=True))
        beyond = self.distance(*lines) >= 0.5 * self.thickness
        corners = beyond[:-1, :-1].astype(int) + beyond[1:, :-1] + beyond[:-1, 1:] + beyond[1:, 1:]
        return (corners > 0) & (corners < 4)

    def shares(self, grid, count) -> np.ndarray:
        """Shares of `count` materials in each cell, (count, nx, ny)."""
        inner = ((np.arange(SIDES) + 0.5) / SIDES - 0.5) * grid.cell
        x, y = centres(grid)
        found = np.zeros((count, *grid.shape))
        fine_y = (y[:, None] + inner).reshape(-1)
        for part in np.array_split(np.arange(len(x)), max(1, len(x) * len(y) * SIDES**2 // 2_000_000)):
            for k, share in self._parts((x[part, None] + inner).reshape(-1), fine_y, grid.cell / SIDES):
                found[k, part] += share.reshape(len(part), SIDES, len(y), SIDES).mean(axis=(1, 3))
        return found

    def _parts(self, x, y, side):
        """Materials, and the share (nx, ny) of each in squares around the places x × y, as an outline divides them."""
        if self.structure is None:
            here = self.at(x, y)
            return [(k, here == k) for k in np.unique(here)]
        distance = self.distance(x, y)
        # Of a square whose sides lie along the outline; the mean over many at any angle is as good.
        inner, outer = (np.clip(0.5 - (distance - d) / side, 0.0, 1.0) for d in (0.0, self.thickness))
        return zip(self.index, (inner, outer - inner, 1.0 - outer), strict=True)


def materials_of(scene, owner: np.ndarray) -> tuple[tuple[str, ...], np.ndarray, Local | None]:
    """What the cells of a scene are made of.

    Args:
        scene: `jaxmpm.scene.Scene`.
        owner: body of each cell, (nx, ny), -1 where empty.

    Returns:
        Names of the materials in use, in the scene's order; the index of each cell's into them, (nx, ny),
        -1 where empty; what differs from cell to cell beyond that, or None.

    Raises:
        SceneError: inclusions that do not fit in, an image that cannot be used.
    """
    material, shares = _sampled(scene, owner)
    strength = _strength(scene, material)
    present = np.bincount(material[material >= 0], minlength=len(scene.materials)) > 0
    if shares is not None:
        present |= shares.any(axis=(1, 2))
        shares = shares[present]
    names = tuple(name for name, used in zip(scene.materials, present, strict=True) if used)
    # The last entry is what -1 picks.
    index = np.append(np.cumsum(present) - 1, -1)
    differs = strength is not None or shares is not None
    return names, index[material], Local(strength, shares) if differs else None


def _sampled(scene, owner) -> tuple[np.ndarray, np.ndarray | None]:
    """Index of each cell's material into the scene's, and shares (materials, nx, ny) where they are mixed."""
    names = list(scene.materials)
    material = np.array([*(names.index(body.material) for body in scene.bodies), -1])[owner]
    table = scene.mesostructure
    if table is None:
        return material, None
    mine = owner == [body.name for body in scene.bodies].index(table.body)
    sampler = Sampler(scene)
    whole = np.arange(len(names))[:, None, None] == material
    material = np.where(mine, sampler.at(*centres(scene.grid)), material)
    if table.sampling == "centre":
        return material, None
    shares = np.where(mine, sampler.shares(scene.grid, len(names)), whole)
    if table.interface:
        material[mine & sampler.crossed(scene.grid)] = names.index(table.interface)
    return material, shares


def _strength(scene, material: np.ndarray) -> np.ndarray | None:
    """Factors (nx, ny) on the strength of cells with these materials of the scene; None where none scatters."""
    found = None
    for index, (name, one) in enumerate(scene.materials.items()):
        if one.scatter is not None and (material == index).any():
            found = np.ones(material.shape) if found is None else found
            field = strength_factor(one.scatter, name, *centres(scene.grid))
            found = np.where(material == index, field, found)
    return found
