"""Small scenes in equilibrium: bars that break at one column of cells, a notched plate."""

from jaxmpm.scene import load_scene
from jaxmpm.stiffness import weights_of

STATIC = ['solver.kind="quasistatic"', "solver.damping=0.02"]
COARSE = [  # the scene den on cells of 10 mm, whose notches take a row of cells
    "grid.cell=10", "sets.right_lower.inside.0.max=[200.0, 90.0]", "gauges.left_notch.points=[[0.0, 90.0], [0.0, 100.0]]",
    *(f"bodies.0.minus.{k}.{side}=[{x}, {y}]" for k, xs in ((0, (0, 30)), (1, (170, 200))) for side, x, y in
      (("min", xs[0], 90), ("max", xs[1], 100))),
]  # fmt: skip


def bar(length, *more):
    """The scene bar, its length (mm) and cells of 5 mm, in equilibrium."""
    ends = [f"grid.size=[{length:g}, 10.0]", f"bodies.0.shapes.0.max=[{length:g}, 10.0]"]
    ends += [f"sets.right.inside.0.{side}=[{length:g}, {y}]" for side, y in (("min", 0.0), ("max", 10.0))]
    return load_scene("bar", [*STATIC, *ends, "parameters.cell=5", *more])


def plate(*more):
    """The scene den on cells of 10 mm in equilibrium."""
    return load_scene("den", [*STATIC, *COARSE, *more])


def without(structure, cells, keep):
    """K (dofs, dofs) of a structure without the mean stress of some cells, and of their hourglass the share `keep` left."""
    rows = structure.rows(cells)
    lost = weights_of(structure.volume * structure.elastic[cells], (1 - keep) * structure.hourglass[cells])
    return structure.stiffness - rows.T @ (lost @ rows)
