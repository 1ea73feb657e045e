"""A representative volume on its grid: the modes of mean strain, and what drives and measures them.

For a mean strain ε the nodes about the centre of the grid move by u = ε x. That of the nodes' internal
forces does the work V σ̄ : ε, which is how the mean stress is measured (Hill's theorem).
"""

import numpy as np

from jaxmpm.macro import COMPONENTS


def modes(shape, cell) -> np.ndarray:
    """Displacement of the nodes for a unit of xx, yy and engineering xy, (3, 2, nx + 1, ny + 1), mm."""
    x, y = np.meshgrid(*((np.arange(n + 1) - n / 2) * cell for n in shape), indexing="ij")
    none = np.zeros_like(x)
    return np.stack([[x, none], [none, y], [y / 2, x / 2]])


def edges_moved(macro, shape, cell) -> tuple[np.ndarray, np.ndarray]:
    """Dofs that the mean strain moves along the edges, and by how much per unit of the history, mm.

    Edges across a normal component move along their normal; with shear all edges move both ways.
    """
    driven = macro.strain.driven()
    field = sum(driven[name] * mode for name, mode in zip(COMPONENTS, modes(shape, cell), strict=True) if name in driven)
    moves = np.zeros(field.shape, bool)
    if "xx" in driven:
        moves[0, [0, -1], :] = True
    if "yy" in driven:
        moves[1, :, [0, -1]] = True
    if "xy" in driven:
        moves[:, [0, -1], :] = moves[:, :, [0, -1]] = True
    dofs = np.flatnonzero(moves)
    return dofs, field.reshape(-1)[dofs]


def edges_held(macro, shape) -> np.ndarray:
    """The dof that stops a body as a whole from drifting along a free component, at the middle of an edge."""
    driven, (nx, ny) = macro.strain.driven(), shape
    nodes = (nx + 1) * (ny + 1)
    if "yy" not in driven:
        return np.array([nodes + ny // 2])
    if "xx" not in driven:
        return np.array([(nx // 2) * (ny + 1)])
    return np.empty(0, np.int64)


def stress_weights(component, shape, cell, thickness) -> np.ndarray:
    """What of every dof's internal force (N) makes the mean stress (MPa), flat."""
    volume = shape[0] * shape[1] * cell**2 * thickness
    return modes(shape, cell)[COMPONENTS.index(component)].reshape(-1) / volume


def strain_weights(component, shape, cell) -> np.ndarray:
    """What of every dof's displacement (mm) makes the mean strain, 1/A ∮ (n ⊗ u)^s ds by the trapezoidal rule, flat."""
    nx, ny = shape
    along = [np.ones(n + 1) for n in (ny, nx)]
    for ends in along:
        ends[[0, -1]] = 0.5
    by_x, by_y = np.zeros((2, nx + 1, ny + 1))
    by_x[0], by_x[-1] = -along[0], along[0]
    by_y[:, 0], by_y[:, -1] = -along[1], along[1]
    none = np.zeros_like(by_x)
    field = {"xx": (by_x, none), "yy": (none, by_y), "xy": (by_y, by_x)}[component]
    return np.stack(field).reshape(-1) / (nx * ny * cell)
