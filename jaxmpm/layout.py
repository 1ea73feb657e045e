"""Lays a scene on its grid: which cells are filled, which nodes are held, moved, pulled, measured.

A node (i, j) has flat index i (ny + 1) + j; a degree of freedom has flat index
component (nx + 1)(ny + 1) + node, component 0 along x and 1 along y.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from jaxmpm import layout_half, layout_macro
from jaxmpm.errors import Problems, written
from jaxmpm.fill import boundary_length, cells_at_nodes, fill
from jaxmpm.mesostructure import sampling
from jaxmpm.scene import Force, History, Scene, direction_cosines
from jaxmpm.shapes import nodes_in


@dataclass(frozen=True, eq=False)
class Drive:
    """A load: at each time, `weights` times the history's value on `dofs`.

    Weights of a displacement are direction cosines; those of a force hold each dof's share, so
    that the value is the total force (N) or the traction (MPa).
    """

    dofs: np.ndarray
    weights: np.ndarray
    history: History


@dataclass(frozen=True, eq=False)
class Gauge:
    """A reading, the sum of weights times field[dofs].

    The field is the internal force (N) for kind "reaction", otherwise the displacement (mm). `unit` is
    that of the reading.
    """

    name: str
    kind: str
    dofs: np.ndarray
    weights: np.ndarray
    unit: str


@dataclass(frozen=True, eq=False)
class Layout:
    """A scene on its grid."""

    shape: tuple[int, int]  # cells along x and y
    cell: float  # mm
    origin: tuple[float, float]  # mm
    materials: tuple[str, ...]  # those in use, in the scene's order
    material: np.ndarray  # (nx, ny), index into materials, -1 where empty
    owner: np.ndarray  # (nx, ny), index of the body, -1 where empty
    sets: dict[str, np.ndarray]  # sorted flat node indices
    velocity: np.ndarray  # (2, nx + 1, ny + 1), initial, mm/s, zero where held
    held: np.ndarray  # sorted flat dof indices
    displacements: tuple[Drive, ...]
    forces: tuple[Drive, ...]
    gauges: tuple[Gauge, ...]
    local: sampling.Local | None  # what else differs from cell to cell
    thickness: float  # mm, of what is modelled
    half: layout_half.Half | None = None  # the plane of symmetry, where half of the scene is modelled

    def node_coordinates(self) -> np.ndarray:
        """Coordinates of the nodes, (2, nx + 1, ny + 1), mm."""
        x, y = node_lines(self.origin, self.shape, self.cell)
        return np.stack(np.meshgrid(x, y, indexing="ij"))

    def shares(self) -> dict[str, float]:
        """Share of each material of the filled area."""
        filled = self.material >= 0
        if self.local is not None and self.local.shares is not None:
            found = self.local.shares[:, filled].mean(axis=1)
        else:
            found = np.bincount(self.material[filled]) / filled.sum()
        return dict(zip(self.materials, found.tolist(), strict=True))


def node_lines(origin, shape, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions of the nodes along x (nx + 1) and along y (ny + 1), mm."""
    x, y = (o + np.arange(n + 1) * cell for o, n in zip(origin, shape, strict=True))
    return x, y


def lay_out(scene: Scene) -> Layout:
    """The scene on its grid, or the half of it that `grid.half` asks for.

    Raises one SceneError that lists every geometric mistake, or says what is not symmetric.
    """
    layout = _lay_out(scene)
    return layout_half.halved(scene, layout) if scene.grid.half else layout


def _lay_out(scene: Scene) -> Layout:
    """The whole scene."""
    work = _Work(scene)
    owner = fill(scene, work.problems)
    if scene.macro and (owner < 0).any() and not work.problems.lines:
        work.problems.add(("macro", "boundary"), "bodies that fill the grid", "set grid.size and origin to the volume's")
    # Sets and loads on a body that came out wrong would only repeat its mistakes.
    work.problems.raise_any()
    work.place(owner)
    held = work.held()
    displacements = work.displacements()
    forces = work.forces()
    work.check_conflicts()
    gauges = work.gauges()
    work.problems.raise_any()
    materials, material, local = sampling.materials_of(scene, owner)
    velocity = _velocity(scene, owner, materials, material)
    velocity.reshape(-1)[held] = 0.0
    return Layout(
        shape=scene.grid.shape,
        cell=scene.grid.cell,
        origin=scene.grid.origin,
        materials=materials,
        material=material,
        owner=owner,
        sets=work.sets,
        velocity=velocity,
        held=held,
        displacements=displacements,
        forces=forces,
        gauges=gauges,
        local=local,
        thickness=scene.grid.thickness,
    )


def _velocity(scene: Scene, owner: np.ndarray, materials, material: np.ndarray) -> np.ndarray:
    density = np.array([*(scene.materials[name].density for name in materials), 0.0])[material]
    mass = cells_at_nodes(density)
    velocity = np.zeros((2, *mass.shape))
    for component in (0, 1):
        speed = np.array([*(b.velocity[component] for b in scene.bodies), 0.0])[owner]
        # Weighed by mass, so that bodies that meet keep their momentum.
        np.divide(cells_at_nodes(density * speed), mass, out=velocity[component], where=mass > 0)
    return velocity


class _Work:
    """What is known half-way: node sets, and who acts on which degree of freedom."""

    def __init__(self, scene: Scene):
        self.scene = scene
        self.problems = Problems(scene.to_dict())
        self.sets: dict[str, np.ndarray] = {}
        # (path, what it does, dofs) of every support and load
        self.acting: list[tuple[tuple, str, np.ndarray]] = []

    def place(self, owner: np.ndarray) -> None:
        """Find the nodes of filled cells and the node sets among them."""
        grid = self.scene.grid
        self.filled = owner >= 0
        self.touching = cells_at_nodes(self.filled.astype(int))
        self.nodes = self.touching.size
        self.xy = node_lines(grid.origin, grid.shape, grid.cell)
        x, y = self.xy[0][:, None], self.xy[1][None, :]
        for name, chosen in self.scene.sets.items():
            mask = (self.touching > 0) & nodes_in(chosen.inside, x, y, grid.cell)
            if chosen.on == "boundary":
                mask &= self.touching < 4
            if chosen.outside:
                mask &= ~nodes_in(chosen.outside, x, y, grid.cell)
            self.sets[name] = np.flatnonzero(mask)
            if not mask.any():
                where = "boundary" if chosen.on == "boundary" else "filled"
                advice = f"nodes are every {grid.cell:g} mm from grid.origin; move or widen it"
                self.problems.add(
                    ("sets", name, "inside"), f"shapes that hold at least one {where} node", advice
                )

    def along(self, nodes: np.ndarray, direction, both: bool = False) -> tuple:
        """Dofs of nodes that a direction touches, and its cosine on each."""
        parts = enumerate(direction_cosines(direction))
        chosen = [(c, w) for c, w in parts if w != 0.0 or (both and not isinstance(direction, str))]
        dofs = [c * self.nodes + nodes for c, _ in chosen]
        weights = [np.full(len(nodes), w) for _, w in chosen]
        return np.concatenate(dofs).astype(np.int64), np.concatenate(weights)

    def held(self) -> np.ndarray:
        """Dofs of the supports."""
        everything = [np.empty(0, np.int64), self.at_walls()]
        if self.scene.macro and self.scene.macro.boundary == "edges":
            everything.append(layout_macro.edges_held(self.scene.macro, self.filled.shape))
        for i, support in enumerate(self.scene.supports):
            parts = [self.along(self.sets[support.set], axis)[0] for axis in support.fix]
            dofs = np.unique(np.concatenate(parts))
            self.acting.append((("supports", i), "hold", dofs))
            everything.append(dofs)
        return np.unique(np.concatenate(everything))

    def at_walls(self) -> np.ndarray:
        """Dofs of the nodes at slip and stick walls that no displacement moves."""
        nx, ny = (k - 1 for k in self.touching.shape)
        i, j = np.indices(self.touching.shape)
        found = [np.empty(0, np.int64)]
        for side, there, across in (("left", i == 0, 0), ("right", i == nx, 0), ("bottom", j == 0, 1), ("top", j == ny, 1)):
            kind = getattr(self.scene.grid.walls, side)
            for component in {"slip": (across,), "stick": (0, 1)}.get(kind, ()):
                found.append(component * self.nodes + np.flatnonzero(there & (self.touching > 0)))
        moved = [self.along(self.sets[load.set], load.direction, both=True)[0] for load in self.scene.displacements]
        return np.setdiff1d(np.concatenate(found), np.concatenate([np.empty(0, np.int64), *moved]))

    def displacements(self) -> tuple[Drive, ...]:
        """The prescribed displacements."""
        drives = []
        for i, load in enumerate(self.scene.displacements):
            dofs, weights = self.along(self.sets[load.set], load.direction, both=True)
            self.acting.append((("displacements", i), "move", dofs))
            drives.append(Drive(dofs, weights, load.history))
        macro = self.scene.macro
        if macro and macro.boundary == "edges":
            moved = layout_macro.edges_moved(macro, self.filled.shape, self.scene.grid.cell)
            drives.append(Drive(*moved, macro.history))
        return tuple(drives)

    def forces(self) -> tuple[Drive, ...]:
        """The forces."""
        drives = []
        for i, load in enumerate(self.scene.forces):
            share = self._shares(i, load)
            nodes = np.flatnonzero(share)
            dofs, weights = self.along(nodes, load.direction)
            repeats = len(dofs) // max(len(nodes), 1)
            self.acting.append((("forces", i), "pull", dofs))
            drives.append(Drive(dofs, weights * np.tile(share[nodes], repeats), load.history))
        return tuple(drives)

    def _shares(self, index: int, load: Force) -> np.ndarray:
        grid, nodes = self.scene.grid, self.sets[load.set]
        chosen = np.zeros(self.touching.shape, dtype=bool)
        chosen.flat[nodes] = True
        length = boundary_length(self.filled, chosen, grid.cell).reshape(-1)
        if load.kind == "traction":
            if len(nodes) and not length.any():
                advice = 'use kind = "force", or a set along the boundary'
                expected = "a set with both nodes of at least one boundary edge"
                self.problems.add(("forces", index, "set"), expected, advice)
            return length * grid.thickness
        if length.any():
            return length / length.sum()
        return chosen.reshape(-1) / max(len(nodes), 1)

    def check_conflicts(self) -> None:
        """Two entries must not act on one degree of freedom, unless both only hold it."""
        for i, (path, does, dofs) in enumerate(self.acting):
            for other, did, theirs in self.acting[:i]:
                shared = np.intersect1d(dofs, theirs)
                if len(shared) and {does, did} != {"hold"}:
                    self._conflict(path, other, did, shared)

    def _conflict(self, path: tuple, other: tuple, did: str, shared: np.ndarray) -> None:
        nodes = np.unique(shared % self.nodes)
        axes = " and ".join("xy"[c] for c in np.unique(shared // self.nodes))
        count = f"{len(nodes)} node" + "s" * (len(nodes) > 1)
        name = self.problems.source[other[0]][other[1]]["set"]
        self.problems.add(
            (*path, "set"),
            f"nodes free along {axes}, but {other[0]}.{other[1]} (set {written(name)}) also {did}s "
            f"{count} of them there, one at {self._point(nodes[0])}",
            'take them out of one of the two sets with "outside"',
            again=True,
        )

    def _point(self, node: int) -> str:
        i, j = divmod(int(node), self.touching.shape[1])
        return f"({self.xy[0][i]:g}, {self.xy[1][j]:g}) mm"

    def gauges(self) -> tuple[Gauge, ...]:
        """The gauges, in the scene's order."""
        return tuple(self._gauges())

    def _gauges(self) -> Iterator[Gauge]:
        for name, gauge in self.scene.gauges.items():
            if gauge.kind in ("mean_stress", "mean_strain"):
                yield self._mean(name, gauge)
                continue
            if gauge.kind == "relative_displacement":
                nodes, weights = self._two_points(name, gauge.points), np.array([-1.0, 1.0])
            else:
                nodes = self.sets[gauge.set]
                weights = np.full(len(nodes), 1.0 / max(len(nodes), 1))
            dofs, cosines = self.along(nodes, gauge.direction)
            if gauge.kind == "reaction":
                dofs, weights = self._prescribed(name, dofs, cosines)
                yield Gauge(name, gauge.kind, dofs, weights, "N")
            else:
                repeats = len(dofs) // max(len(nodes), 1)
                yield Gauge(name, gauge.kind, dofs, cosines * np.tile(weights, repeats), "mm")

    def _mean(self, name: str, gauge) -> Gauge:
        """A gauge of mean stress or strain."""
        grid, shape = self.scene.grid, self.filled.shape
        if gauge.kind == "mean_stress":
            weights = layout_macro.stress_weights(gauge.component, shape, grid.cell, grid.thickness)
        else:
            weights = layout_macro.strain_weights(gauge.component, shape, grid.cell)
        dofs = np.flatnonzero(weights)
        kind, unit = ("reaction", "MPa") if gauge.kind == "mean_stress" else ("displacement", "")
        return Gauge(name, kind, dofs, weights[dofs], unit)

    def _prescribed(self, name: str, dofs: np.ndarray, cosines: np.ndarray) -> tuple:
        # The internal force of a free node is no reaction but its inertia.
        known = [theirs for _, does, theirs in self.acting if does != "pull"]
        keep = np.isin(dofs, np.concatenate([np.empty(0, np.int64), *known]))
        if len(dofs) and not keep.any():
            expected = "a set with nodes held or moved in the gauge's direction"
            advice = "this gauge would always read zero"
            self.problems.add(("gauges", name, "set"), expected, advice)
        return dofs[keep], cosines[keep]

    def _two_points(self, name: str, points) -> np.ndarray:
        cell, nodes = self.scene.grid.cell, []
        for i, (x, y) in enumerate(points):
            distance = np.hypot(self.xy[0][:, None] - x, self.xy[1][None, :] - y) / cell
            # Rounded, so that of nodes equally far the first is taken on every machine.
            distance = np.where(self.touching > 0, np.round(distance, 6), np.inf)
            nodes.append(int(np.argmin(distance)))
            if distance.min() > 1.0:
                advice = f"the nearest node of a body is at {self._point(nodes[-1])}"
                expected = f"a point within one cell, {cell:g} mm, of a body's node"
                self.problems.add(("gauges", name, "points", i), expected, advice)
        if nodes[0] == nodes[1]:
            expected = f"two points with different nearest nodes, not both {self._point(nodes[0])}"
            self.problems.add(("gauges", name, "points"), expected, "move them apart")
        return np.array(nodes)
