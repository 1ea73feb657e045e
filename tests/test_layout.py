"""Laying a scene on its grid: counts, shares and partitions against values worked out by hand."""

import numpy as np
import pytest

from jaxmpm.errors import SceneError
from jaxmpm.layout import lay_out
from jaxmpm.scene import Scene, load_scene


def laid(name, *overrides):
    return lay_out(load_scene(name, overrides))


def lines_of(name, *overrides):
    scene = load_scene(name, overrides)
    with pytest.raises(SceneError) as caught:
        lay_out(scene)
    return caught.value.lines


def plate(**changes):
    """A square of 4 x 4 cells of 10 mm, held below and pulled above."""
    tree = {
        "title": "plate",
        "grid": {"size": [40, 40], "cell": 10, "stress_state": "plane_strain", "thickness": 2.0},
        "materials": {
            "light": {"density": 1e-9, "bulk": {"law": "elastic", "E": 100.0, "nu": 0.0}},
            "heavy": {"density": 3e-9, "bulk": {"law": "elastic", "E": 100.0, "nu": 0.0}},
        },
        "bodies": [{"name": "all", "material": "light", "shapes": [box(0, 0, 40, 40)]}],
        "sets": {
            "bottom": {"inside": [box(0, 0, 40, 0)]},
            "top": {"inside": [box(0, 40, 40, 40)]},
            "right": {"inside": [box(40, 0, 40, 40)]},
            "edge": {"on": "boundary", "inside": [box(0, 0, 40, 40)]},
        },
        "supports": [{"set": "bottom", "fix": ["x", "y"]}],
        "forces": [load("top", "y")],
        "solver": {"duration": 1.0},
    }
    tree.update(changes)
    return Scene.from_dict(tree)


def box(x0, y0, x1, y1):
    return {"kind": "rectangle", "min": [x0, y0], "max": [x1, y1]}


def load(name, direction, kind="force"):
    history = {"time": [0, 1], "value": [0, 1]}
    return {"set": name, "direction": direction, "kind": kind, "history": history}


def refused(**changes):
    with pytest.raises(SceneError) as caught:
        lay_out(plate(**changes))
    return caught.value.lines


# ---- the bundled scenes


@pytest.mark.parametrize(
    ("cell", "rows", "top", "left_upper", "right_lower"),
    # Rows: how many rows of cells a notch takes; on 5 mm only the lower of the two it half covers.
    [(5.0, 1, 41, 21, 20), (2.5, 2, 81, 40, 40), (1.25, 4, 161, 79, 79)],
)
def test_den_plate(cell, rows, top, left_upper, right_lower):
    layout = laid("den", f"grid.cell={cell}")
    n = round(200 / cell)
    assert layout.shape == layout.material.shape == (n, n)
    assert (layout.material >= 0).sum() == n * n - 2 * rows * round(25 / cell)
    sizes = {name: len(nodes) for name, nodes in layout.sets.items()}
    assert sizes == {
        "top": top, "bottom": top, "left_upper": left_upper, "right_lower": right_lower
    }
    x, y = layout.node_coordinates().reshape(2, -1)
    assert np.ptp(y[layout.sets["top"]]) == 0.0 and x[layout.sets["left_upper"]].max() == 0.0
    # The lips of the notches, as cut into the cells.
    assert y[layout.sets["right_lower"]].max() == (95.0 if cell == 5.0 else 97.5)
    assert y[layout.sets["left_upper"]].min() == (100.0 if cell == 5.0 else 102.5)
    assert layout.materials == ("concrete",)


def test_a_notch_through_cell_centres_takes_the_lower_row_only():
    empty = laid("den", "grid.cell=5").material < 0
    assert np.flatnonzero(empty.any(axis=0)).tolist() == [19]
    assert np.flatnonzero(empty.any(axis=1)).tolist() == [0, 1, 2, 3, 4, 35, 36, 37, 38, 39]


def test_den_loads_act_on_the_edges_they_name():
    layout = laid("den", "grid.cell=5")
    nodes = 41 * 41
    top, left = layout.displacements
    assert np.array_equal(top.dofs, nodes + layout.sets["top"])
    assert np.array_equal(left.dofs, layout.sets["left_upper"])
    assert (top.weights == 1.0).all() and left.history.value == (0.0, -0.06)
    held = np.union1d(layout.sets["bottom"], layout.sets["right_lower"])
    assert np.array_equal(layout.held, np.concatenate([held, held + nodes]))


def test_shear_of_path_4a_is_5_kn_in_all():
    (force,) = laid("den_4a").forces
    assert force.weights.sum() == pytest.approx(1.0, abs=1e-14)
    assert force.history.value[-1] == 5000.0
    # Inner nodes of the edge carry a whole cell's length, its two ends half.
    assert force.weights.max() / force.weights.min() == pytest.approx(2.0)
    assert np.isclose(force.weights, force.weights.min()).sum() == 2


def test_bar_has_one_weak_column_on_any_mesh():
    for cell in (5.0, 2.5, 1.25):
        layout = laid("bar", f"parameters.cell={cell}")
        weak = layout.material == layout.materials.index("weak")
        columns = np.flatnonzero(weak.any(axis=1))
        assert columns.tolist() == [round(50 / cell)] and weak[columns[0]].all()
        assert len(layout.held) == round(10 / cell) + 2


@pytest.mark.parametrize("angle", [0.0, 15.0, 22.5, 30.0, 45.0, 60.0, 90.0])
def test_opening_sets_partition_the_boundary(angle):
    layout = laid("opening", f"parameters.angle={angle}")
    upper, lower = layout.sets["upper"], layout.sets["lower"]
    both = np.concatenate([upper, lower])
    assert len(both) == len(np.unique(both)) == 4 * 40
    x, y = layout.node_coordinates().reshape(2, -1)
    t = np.deg2rad(angle)
    above = -np.sin(t) * (x - 50.31) + np.cos(t) * (y - 50.17)
    assert (above[upper] > 0.01).all() and (above[lower] < -0.01).all()
    (drive,) = layout.displacements
    assert len(drive.dofs) == 2 * len(upper)
    assert drive.weights[: len(upper)] == pytest.approx(-np.sin(t), abs=1e-15)
    assert drive.weights[len(upper) :] == pytest.approx(np.cos(t), abs=1e-15)


# ---- bodies, sets, loads, gauges


def test_later_bodies_replace_earlier_ones_and_origin_shifts_all():
    layout = lay_out(
        plate(
            grid={
                "size": [40, 20], "origin": [-20, 5], "cell": 10,
                "stress_state": "plane_strain", "thickness": 1.0,
            },
            bodies=[
                {"name": "a", "material": "heavy", "shapes": [box(-20, 5, 20, 25)]},
                {"name": "b", "material": "light", "shapes": [box(0, 5, 10, 15)]},
            ],
            sets={
                "bottom": {"inside": [box(-20, 5, 20, 5)]},
                "top": {"inside": [box(-20, 25, 20, 25)]},
            },
        )
    )
    assert layout.materials == ("light", "heavy")
    assert layout.material.tolist() == [[1, 1], [1, 1], [0, 1], [1, 1]]
    assert layout.node_coordinates()[:, 0, 0].tolist() == [-20.0, 5.0]
    assert layout.node_coordinates()[:, -1, -1].tolist() == [20.0, 25.0]
    assert layout.sets["bottom"].tolist() == [0, 3, 6, 9, 12]


def test_a_material_no_body_uses_is_left_out():
    assert lay_out(plate()).materials == ("light",)


def test_sets_can_leave_nodes_out():
    layout = lay_out(
        plate(
            sets={
                "bottom": {"inside": [box(0, 0, 40, 0)], "outside": [box(40, 0, 40, 40)]},
                "top": {"inside": [box(0, 40, 40, 40)]},
                "edge": {"on": "boundary", "inside": [box(0, 0, 40, 40)]},
                "all": {"inside": [box(0, 0, 40, 40)]},
            }
        )
    )
    assert layout.sets["bottom"].tolist() == [0, 5, 10, 15]
    assert len(layout.sets["edge"]) == 16 and len(layout.sets["all"]) == 25


def test_boundary_of_a_body_includes_its_holes():
    body = {"name": "a", "material": "light", "shapes": [box(0, 0, 40, 40)]}
    layout = lay_out(plate(bodies=[{**body, "minus": [box(10, 10, 30, 30)]}]))
    # 16 outer nodes and 8 round the hole; the node in its middle belongs to no cell.
    assert len(layout.sets["edge"]) == 24


def test_velocity_keeps_the_momentum_of_bodies_that_meet():
    bodies = [
        {"name": "a", "material": "light", "shapes": [box(0, 0, 20, 40)], "velocity": [6, 0]},
        {"name": "b", "material": "heavy", "shapes": [box(20, 0, 40, 40)], "velocity": [-2, 4]},
    ]
    velocity = lay_out(plate(bodies=bodies)).velocity
    assert velocity.shape == (2, 5, 5)
    assert velocity[:, 1, 2].tolist() == [6.0, 0.0]
    assert velocity[:, 3, 2].tolist() == [-2.0, 4.0]
    assert velocity[:, 2, 2] == pytest.approx([(6 - 3 * 2) / 4, 3 * 4 / 4])
    assert (velocity[:, :, 0] == 0.0).all()  # held


def test_force_is_shared_by_length():
    (force,) = lay_out(plate()).forces
    assert force.weights.tolist() == [0.125, 0.25, 0.25, 0.25, 0.125]
    assert force.dofs.tolist() == [25 + node for node in (4, 9, 14, 19, 24)]


def test_traction_adds_up_to_length_times_thickness():
    (force,) = lay_out(plate(forces=[load("top", 60.0, "traction")])).forces
    n = len(force.dofs) // 2
    total = 40.0 * 2.0
    assert force.weights[:n].sum() == pytest.approx(total * 0.5)
    assert force.weights[n:].sum() == pytest.approx(total * 3**0.5 / 2)
    assert (force.dofs[:n] + 25).tolist() == force.dofs[n:].tolist()


def test_force_inside_the_body_is_shared_equally():
    sets = {"bottom": {"inside": [box(0, 0, 40, 0)]}, "top": {"inside": [box(10, 20, 30, 20)]}}
    (force,) = lay_out(plate(sets=sets)).forces
    assert force.weights == pytest.approx(1 / 3)
    sets_lines = refused(sets=sets, forces=[load("top", "y", "traction")])
    assert sets_lines == [
        'forces.0.set = "top": expected a set with both nodes of at least one boundary edge '
        '(use kind = "force", or a set along the boundary)'
    ]


def test_an_angle_prescribes_both_components_and_an_axis_one():
    moved = {key: value for key, value in load("top", 90.0).items() if key != "kind"}
    (drive,) = lay_out(plate(forces=[], displacements=[moved])).displacements
    assert len(drive.dofs) == 10 and drive.weights.tolist() == [0.0] * 5 + [1.0] * 5
    (drive,) = lay_out(plate(forces=[], displacements=[{**moved, "direction": "y"}])).displacements
    assert len(drive.dofs) == 5
    # A force along 90 degrees pulls along y only.
    assert len(lay_out(plate(forces=[load("top", 90.0)])).forces[0].dofs) == 5


def test_gauges_read_a_linear_field():
    gauges = {
        "mean": {"kind": "displacement", "set": "right", "direction": 30.0},
        "span": {
            "kind": "relative_displacement", "points": [[1, 9], [40, 22]], "direction": "x"
        },
        "base": {"kind": "reaction", "set": "bottom", "direction": "y"},
        "part": {"kind": "reaction", "set": "edge", "direction": "y"},
    }
    layout = lay_out(plate(gauges=gauges))
    x, y = layout.node_coordinates()
    field = np.stack([2.0 * x + y, 5.0 * y + 1.0]).reshape(-1)
    mean, span, base, part = (float(g.weights @ field[g.dofs]) for g in layout.gauges)
    assert mean == pytest.approx((80 + 20) * 3**0.5 / 2 + (5 * 20 + 1) * 0.5)
    assert span == pytest.approx((2 * 40 + 20) - (0 + 10))
    assert base == pytest.approx(5.0)
    # Free nodes of the edge have no reaction.
    assert part == base
    assert [g.unit for g in layout.gauges] == ["mm", "mm", "N", "N"]


# ---- mistakes


def test_shapes_narrower_than_a_cell():
    lines = lines_of("den", "grid.cell=10")
    assert len(lines) == 2
    assert lines[0].startswith(
        'bodies.0.minus.0 = {kind = "rectangle", min = [0.0, 97.5], max = [25.0, 102.5]}: '
        "expected to be at least a cell wide, 10 mm; it is 5 mm"
    )
    (line,) = lines_of("bar", "grid.cell=5")
    assert line.startswith("bodies.1.shapes.0 = ") and "at least a cell wide, 5 mm" in line
    thin = {"kind": "polygon", "points": [[0, 0], [40, 40], [40, 39], [1, 0]]}
    bodies = [{"name": "a", "material": "light", "shapes": [thin]}]
    assert "at least a cell wide, 10 mm; it is" in refused(bodies=bodies)[0]


def test_a_notch_that_removes_nothing():
    (line,) = lines_of("den", "bodies.0.minus.0.min=[0, 220]", "bodies.0.minus.0.max=[25, 240]")
    assert line.startswith("bodies.0.minus.0 = ")
    assert "expected a shape that removes at least one cell of 2.5 mm" in line


def test_a_body_without_a_cell():
    tiny = {"kind": "circle", "center": [20, 20], "radius": 5}
    whole = {"name": "a", "material": "light", "shapes": [box(0, 0, 40, 40)]}
    # Centred on a node: the centres of all four cells around it lie outside.
    (line,) = refused(bodies=[whole, {**whole, "shapes": [tiny]}])
    assert line.startswith("bodies.1.shapes.0 = ") and "covers at least one cell of 10 mm" in line
    (line,) = refused(bodies=[{**whole, "minus": [box(0, 0, 40, 40)]}])
    assert line.startswith("bodies.0.minus = ") and "leave the body at least one cell" in line
    (line,) = refused(bodies=[whole, {**whole, "name": "b"}])
    assert line.startswith("bodies.0.shapes = ") and "later bodies cover all of it" in line


def test_a_body_beyond_the_grid():
    (line,) = lines_of("den", "bodies.0.shapes.0.max=[200, 210]")
    assert line.startswith('bodies.0.shapes.0 = {kind = "rectangle", min = [0.0, 0.0], max = [200')
    assert "expected to lie inside the grid, x 0 to 200 and y 0 to 200 mm" in line


def test_a_set_without_a_node():
    (line,) = lines_of("den", "sets.spare.inside=[{kind='circle', center=[10, 100], radius=1}]")
    assert line.startswith('sets.spare.inside = [{kind = "circle", center = [10.0, 100.0], radius')
    assert "expected shapes that hold at least one filled node" in line


def test_two_entries_on_one_degree_of_freedom():
    moved = {key: value for key, value in load("top", "y").items() if key != "kind"}
    edge = {**moved, "set": "right", "direction": "x"}
    cases = [
        # displacement and support
        ({"forces": [], "displacements": [moved, edge]}, "displacements.1", "supports.0",
         'along x, but supports.0 (set "bottom") also holds 1 node of them there, one at (40, 0)'),
        # displacement and displacement
        ({"forces": [], "displacements": [moved, {**moved, "direction": 45.0}]}, "displacements.1",
         "displacements.0", "(set \"top\") also moves 5 nodes of them there, one at (0, 40) mm"),
        # displacement and force
        ({"displacements": [moved]}, "forces.0", "displacements.0", "also moves 5 nodes"),
        # force and force
        ({"forces": [load("top", "y"), load("top", 60.0)]}, "forces.1", "forces.0",
         "also pulls 5 nodes"),
        # force and support
        ({"forces": [load("bottom", "x")]}, "forces.0", "supports.0", "also holds 5 nodes"),
    ]
    for changes, first, second, said in cases:
        (line,) = refused(**changes)
        assert line.startswith(f"{first}.set = ") and f"but {second} (set " in line and said in line


def test_two_supports_on_one_node_are_one():
    supports = [{"set": "bottom", "fix": ["x", "y"]}, {"set": "right", "fix": ["x"]}]
    held = lay_out(plate(supports=supports)).held
    assert held.tolist() == sorted({*(0, 5, 10, 15, 20), *range(20, 25), *(25, 30, 35, 40, 45)})


def test_gauges_that_read_nothing():
    gauges = {
        "free": {"kind": "reaction", "set": "top", "direction": "y"},
        "far": {"kind": "relative_displacement", "points": [[0, 0], [60, 40]], "direction": "x"},
        "same": {"kind": "relative_displacement", "points": [[0, 0], [1, 1]], "direction": "x"},
    }
    free, far, same = refused(gauges=gauges)
    assert free.startswith('gauges.free.set = "top": expected a set with nodes held or moved')
    assert "would always read zero" in free
    assert far.startswith("gauges.far.points.1 = [60.0, 40.0]: expected a point within one cell,")
    assert "(40, 40) mm" in far
    assert same.startswith("gauges.same.points = ") and "different nearest nodes" in same
