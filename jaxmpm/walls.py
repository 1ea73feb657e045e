"""Walls at the edges of the grid in the total frame, which hold the nodes that lie on them and no others.

A body that comes from elsewhere goes through them there: it must move as points.
"""

import numpy as np
from scipy import ndimage

BY_AXIS = (("left", "right"), ("bottom", "top"))  # low and high end of each axis
SIDES = [(side, axis, -end) for axis, sides in enumerate(BY_AXIS) for end, side in enumerate(sides)]
CORNERS = np.ones((3, 3), int)  # cells hang together by a node


def heading(scene, layout) -> str:
    """Which free body gravity or its speed drives to a wall that it does not touch, "" where none."""
    groups, count = ndimage.label(layout.material >= 0, CORNERS)
    for k in range(1, count + 1):
        mine = groups == k
        for side, axis, end in SIDES:
            wall = getattr(scene.grid.walls, side)
            sign = 1 if end else -1
            if wall not in ("slip", "stick") or np.take(mine, end, axis).any() or _held(layout, mine, axis):
                continue
            body = scene.bodies[int(layout.owner[mine][0])]
            if sign * scene.gravity[axis] > 0:
                return f'gravity pulls "{body.name}" to grid.walls.{side} = "{wall}", which it does not touch'
            if max(sign * scene.bodies[b].velocity[axis] for b in np.unique(layout.owner[mine])) > 0:
                return f'"{body.name}" is thrown at grid.walls.{side} = "{wall}", which it does not touch'
    return ""


def _held(layout, cells, axis) -> bool:
    """Whether a node of these cells is held or moved along an axis."""
    dofs = np.concatenate([layout.held, *(drive.dofs for drive in layout.displacements)]).astype(int)
    found = np.zeros((2, layout.shape[0] + 1, layout.shape[1] + 1), bool)
    found.reshape(-1)[dofs] = True
    return bool((found[axis] & _nodes_of(cells)).any())


def _nodes_of(cells):
    """Nodes (nx + 1, ny + 1) of some cells (nx, ny)."""
    wide = np.pad(cells, 1)
    return wide[1:, 1:] | wide[:-1, 1:] | wide[1:, :-1] | wide[:-1, :-1]


def crossed(scene, layout, displacement) -> str:
    """Which node has gone beyond an edge that is not open, "" where none has.

    Args:
        scene, layout: the scene.
        displacement: of the nodes (2, nx + 1, ny + 1), mm.
    """
    filled = _nodes_of(layout.material >= 0)
    coordinates = layout.node_coordinates()
    for side, axis, end in SIDES:
        wall = getattr(scene.grid.walls, side)
        plane = layout.half is not None and layout.half.axis == axis and not end
        if wall == "open" and not plane:
            continue
        began = coordinates[axis]
        edge = layout.half.plane if plane else scene.grid.origin[axis] + (scene.grid.size[axis] if end else 0.0)
        beyond = (1 if end else -1) * (began + displacement[axis] - edge) > 1e-6 * layout.cell
        beyond &= filled & (abs(began - edge) > layout.cell / 2)  # a body may lie on the edge and stretch
        if beyond.any():
            i, j = np.argwhere(beyond)[0]
            x, y = coordinates[:, i, j]
            what = "the plane of symmetry" if plane else f'grid.walls.{side} = "{wall}"'
            return f"the node from ({x:g}, {y:g}) mm has gone beyond {what}"
    return ""
