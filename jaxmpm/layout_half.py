"""Half of a scene that is symmetric about the middle of its grid: whether it is, and the layout of that half.

Modelled is the half at larger coordinates, twice as thick. So masses, forces and energies are those of the whole,
and displacements are as they were; what pulls at the other half pulls at the image here. Nodes on the plane of
symmetry do not leave it. Gauges read what they would read on the whole.
"""

from dataclasses import dataclass, replace

import numpy as np

from jaxmpm.errors import Problems
from jaxmpm.fill import cells_at_nodes
from jaxmpm.scene_check import fitting_cells

AXES = ("x", "y")
SAME = 1e-9  # relative difference up to which numbers are the same


@dataclass(frozen=True)
class Half:
    """The plane of symmetry of a layout, its low edge along `axis` (0 or 1), at the coordinate `plane` (mm)."""

    axis: int
    plane: float

    def with_images(self, points: np.ndarray, data: dict, cell: float) -> tuple[np.ndarray, dict]:
        """Places (N, 3), mm, and fields (N,) or (N, 3) of a frame, followed by those of their images; `cell`: mm.

        A crack along the plane, which a cell shares with its image, has opened by half in either.
        """
        along = np.abs(data["normal"][:, self.axis]) > np.abs(data["normal"][:, 1 - self.axis])
        shared = along & (points[:, self.axis] < self.plane + cell)
        data = data | {"opening": np.where(shared, 0.5, 1.0) * data["opening"]}
        turned = np.where(np.arange(3) == self.axis, -1.0, 1.0)
        image = turned * points
        image[:, self.axis] += 2 * self.plane
        signs = {"displacement": turned, "normal": turned, "stress": np.array([1.0, 1.0, -1.0])}
        images = {name: value * signs.get(name, 1.0) for name, value in data.items()}
        return np.concatenate([points, image]), {name: np.concatenate([data[name], images[name]]) for name in data}


def halved(scene, layout):
    """The layout of the half that `grid.half` asks for; raises SceneError where the scene is not symmetric."""
    axis, problems = AXES.index(scene.grid.half), Problems(scene.to_dict())
    if why := unsymmetric(scene, layout, axis):
        problems.add(("grid", "half"), f"a scene that is symmetric about {_plane(scene, axis)}", why)
        problems.raise_any()
    half = _Halving(scene, layout, axis).layout()
    if any(gauge.name == scene.solver.control and not len(gauge.dofs) for gauge in half.gauges):
        problems.add(("solver", "control"), "another gauge with grid.half", "by symmetry it reads nothing")
        problems.raise_any()
    return half


def symmetries(scene, layout) -> list[str]:
    """Axes, "x" and "y", along which half of a scene would do for the whole; of a scene that is half already none."""
    if scene.grid.half is not None:
        return []
    return [name for axis, name in enumerate(AXES) if not unsymmetric(scene, layout, axis)]


def offer(scene, layout) -> str:
    """What to say of a scene, half of which would do; "" where it would not."""
    found = symmetries(scene, layout)
    if not found:
        return ""
    planes = " and ".join(_plane(scene, AXES.index(name)) for name in found)
    return f"the scene is symmetric about {planes}: half of it will do, --set grid.half={found[0]}"


def unsymmetric(scene, layout, axis: int) -> str:
    """What of a scene and its whole layout is not symmetric along an axis, or beyond what a half can do; "" for nothing."""
    return _cannot(scene, axis) or _cells_differ(layout, axis) or _loads_differ(layout, axis)


def _plane(scene, axis: int) -> str:
    return f"{AXES[axis]} = {_middle(scene.grid, axis):g} mm"


def _middle(grid, axis: int) -> float:
    return grid.origin[axis] + 0.5 * grid.size[axis]


def _cannot(scene, axis: int) -> str:
    """What the scene's tables say against it."""
    grid, name = scene.grid, AXES[axis]
    if scene.solver.frame == "updated":
        return 'solver.frame = "updated": a half stays in the total frame'
    if scene.macro is not None:
        return "a table [macro] drives the mean strain of the whole"
    if scene.contact.kind != "stick":
        return f'contact.kind = "{scene.contact.kind}": a half stays in the total frame, where bodies stick'
    if scene.gravity[axis] != 0.0:
        return f"gravity pulls along {name}"
    speeds = {body.velocity for body in scene.bodies}
    if len(speeds) > 1 or next(iter(speeds))[axis] != 0.0:
        return f"bodies are thrown along {name}, or at different speeds"
    if grid.shape[axis] % 2:
        size = [0.5 * side if k == axis else side for k, side in enumerate(grid.size)]
        fit = ", ".join(f"{cell:.12g}" for cell in fitting_cells(size, grid.cell))
        near = f", as with cells of {fit} mm" if fit else ""
        return f"there are {grid.shape[axis]} cells along {name}, expected an even number{near}"
    return ""


def _cells_differ(layout, axis: int) -> str:
    fields = [("the materials of", layout.material)]
    if layout.local is not None:
        fields += [("the strengths of", layout.local.strength), ("the shares of phases in", layout.local.shares)]
    for what, field in fields:
        if field is None:
            continue
        image = np.flip(field, axis=axis - 2)
        differs = np.abs(field - image) > SAME * np.abs(field)
        if differs.any():
            cell = np.argwhere(differs)[0][-2:]
            other = np.where(np.arange(2) == axis, np.array(layout.shape) - 1 - cell, cell)
            return f"{what} the cells at {_at(layout, cell + 0.5)} and {_at(layout, other + 0.5)} mm differ"
    return ""


def _at(layout, index) -> str:
    x, y = np.array(layout.origin) + layout.cell * np.asarray(index)
    return f"({x:g}, {y:g})"


def _loads_differ(layout, axis: int) -> str:
    held = _prescribed(layout)
    if loose(layout, axis) is not None:
        held[axis] = False
    fields = [("what holds or moves", held.astype(float), np.abs(_image(held.astype(float), axis)))]
    for what, drives in (("what moves", layout.displacements), ("what pulls", layout.forces)):
        fields += [(what, field, _image(field, axis)) for field in _by_history(layout, drives)]
    for what, field, image in fields:
        differs = np.abs(field - image) > SAME * np.abs(field).max(initial=0.0)
        if differs.any():
            component, *node = np.argwhere(differs)[0]
            return f"{what} the node at {_at(layout, node)} mm along {AXES[component]} has no mirror image"
    return ""


def _by_history(layout, drives) -> list[np.ndarray]:
    """Weights on all degrees of freedom of the drives that change alike with time, but for a factor."""
    found: dict[tuple, np.ndarray] = {}
    for drive in drives:
        history = drive.history
        scale = next((value for value in history.value if value), 1.0)
        shape = tuple(round(value / scale, 12) for value in history.value)
        key = (history.time, shape, history.smooth_start, history.interpolation)
        found[key] = found.get(key, 0.0) + scale * _dense(layout, drive.dofs, drive.weights)
    return list(found.values())


def _dense(layout, dofs, weights) -> np.ndarray:
    """A nodal field (2, nx + 1, ny + 1) of weights on degrees of freedom."""
    out = np.zeros((2, layout.shape[0] + 1, layout.shape[1] + 1))
    np.add.at(out.reshape(-1), dofs, weights)
    return out


def _prescribed(layout) -> np.ndarray:
    """Which degrees of freedom are held or moved, (2, nx + 1, ny + 1)."""
    out = np.zeros((2, layout.shape[0] + 1, layout.shape[1] + 1), bool)
    for dofs in (layout.held, *(drive.dofs for drive in layout.displacements)):
        out.reshape(-1)[dofs] = True
    return out


def _image(field: np.ndarray, axis: int) -> np.ndarray:
    """The mirror image of a vector field of the nodes, (2, nx + 1, ny + 1)."""
    out = np.flip(field, axis=axis + 1).copy()
    out[axis] *= -1
    return out


def loose(layout, axis: int) -> int | None:
    """The degree of freedom that alone keeps the whole from moving along an axis as one, None where there is no such.

    It bears nothing, where all else is symmetric; the plane of symmetry does its service.
    """
    prescribed = np.flatnonzero(_prescribed(layout)[axis])
    dof = axis * (layout.shape[0] + 1) * (layout.shape[1] + 1) + (prescribed[0] if len(prescribed) else 0)
    return int(dof) if len(prescribed) == 1 and dof in layout.held else None


class _Halving:
    """A layout on its way to its half."""

    def __init__(self, scene, layout, axis: int):
        self.scene, self.whole, self.axis = scene, layout, axis
        self.first = layout.shape[axis] // 2
        self.loose = loose(layout, axis)
        shape = tuple(n // 2 if k == axis else n for k, n in enumerate(layout.shape))
        self.shape, nodes = shape, (2, shape[0] + 1, shape[1] + 1)
        # number of each degree of freedom of the whole in the half, -1 where it is in the other
        number = np.full((2, layout.shape[0] + 1, layout.shape[1] + 1), -1)
        self.cut(number)[...] = np.arange(np.prod(nodes)).reshape(nodes)
        self.number = number.reshape(-1)
        self.across = np.zeros(nodes, bool)  # the degrees of freedom that would leave the plane
        self.on_plane(self.across)[axis] = True

    def cut(self, field: np.ndarray) -> np.ndarray:
        """The part in the half of a field whose last two axes are those of the grid."""
        return field[..., self.first :, :] if self.axis == 0 else field[..., self.first :]

    def on_plane(self, field: np.ndarray) -> np.ndarray:
        """The part on the plane of a nodal field of the half, (2, nodes of the plane)."""
        return field[:, 0] if self.axis == 0 else field[:, :, 0]

    def layout(self):
        """The layout of the half."""
        whole = self.whole
        material = self.cut(whole.material)
        velocity = self.cut(whole.velocity).copy()
        velocity[self.across] = 0.0
        origin = [o + (self.first * whole.cell if k == self.axis else 0.0) for k, o in enumerate(whole.origin)]
        return replace(
            whole, shape=self.shape, origin=tuple(origin), material=material, owner=self.cut(whole.owner), velocity=velocity,
            sets={name: self.nodes(nodes) for name, nodes in whole.sets.items()},
            held=self.held(material), displacements=tuple(map(self.moved, whole.displacements)),
            forces=tuple(map(self.pulled, whole.forces)), gauges=tuple(map(self.gauge, whole.gauges)), local=self.local(),
            thickness=2 * whole.thickness, half=Half(self.axis, _middle(self.scene.grid, self.axis)),
        )  # fmt: skip

    def nodes(self, nodes: np.ndarray) -> np.ndarray:
        """Nodes of a set, or their images."""
        chosen = np.zeros((self.whole.shape[0] + 1, self.whole.shape[1] + 1), bool)
        chosen.flat[nodes] = True
        return np.flatnonzero(self.cut(chosen | np.flip(chosen, axis=self.axis)))

    def dofs(self, dofs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Numbers in the half of degrees of freedom of the whole, and which have one and may leave where they are."""
        number = self.number[dofs]
        keep = (number >= 0) & ~self.across.reshape(-1)[number]
        return number[keep], keep

    def held(self, material: np.ndarray) -> np.ndarray:
        """What is held, and the plane."""
        held = self.dofs(np.setdiff1d(self.whole.held, [] if self.loose is None else [self.loose]))[0]
        plane = self.across & (cells_at_nodes((material >= 0).astype(int)) > 0)
        return np.union1d(held, np.flatnonzero(plane)).astype(np.int64)

    def moved(self, drive):
        """A prescribed displacement."""
        dofs, keep = self.dofs(drive.dofs)
        return replace(drive, dofs=dofs, weights=drive.weights[keep])

    def pulled(self, drive):
        """A force, and what pulls at the images."""
        return self.folded(drive, _dense(self.whole, drive.dofs, drive.weights))

    def gauge(self, gauge):
        """A gauge that reads here what it would on the whole."""
        field = _dense(self.whole, gauge.dofs, gauge.weights)
        if gauge.kind == "reaction":  # here twice what it is on either side, as the cells are twice as thick
            if self.loose is not None:
                field.flat[self.loose] = 0.0
            field = 0.5 * field
            self.on_plane(self.cut(field))[...] *= 2
        elif self.loose is not None:  # the whole does not move there, whereas here it may
            field.flat[self.loose] -= field[self.axis].sum()
        return self.folded(gauge, field)

    def folded(self, what, field: np.ndarray):
        """A drive or gauge by the weights (2, nx + 1, ny + 1) that it has on the whole; those on images go to their origins."""
        field = self.cut(field + _image(field, self.axis))
        self.on_plane(field)[...] *= 0.5
        dofs = np.flatnonzero(field)
        return replace(what, dofs=dofs, weights=field.reshape(-1)[dofs])

    def local(self):
        """What differs from cell to cell."""
        if self.whole.local is None:
            return None
        cut = lambda field: None if field is None else self.cut(field)  # noqa: E731
        return replace(self.whole.local, strength=cut(self.whole.local.strength), shares=cut(self.whole.local.shares))
