"""Says what does not fit together in the mesostructure of a scene, and in the scatter of its materials."""

from typing import Any

from jaxmpm.errors import Problems, written
from jaxmpm.scene_tables import table_of


def check_mesostructure(tree: dict[str, Any], problems: Problems) -> None:
    """Add a line for each name that names nothing and each value that does not go with another."""
    materials = {k: m for k, m in table_of(tree, "materials").items() if isinstance(m, dict)}
    _check_scatter(tree, materials, problems)
    table = tree.get("mesostructure")
    if not isinstance(table, dict):
        return
    _check_body(tree, table, problems)
    for key in ("inclusion", "interface"):
        _check_material(("mesostructure", key), table.get(key), tree, problems)
    labels = table_of(table_of(table, "image"), "labels")
    for value, word in labels.items():
        _check_material(("mesostructure", "image", "labels", value), word, tree, problems)
    if "image" in table:
        _check_image(table, problems)
    else:
        _check_inclusions(tree, table, problems)
    if table.get("sampling") == "mixed":
        _check_total(tree, ("mesostructure", "sampling"), '"centre"', problems)


def _check_scatter(tree, materials, problems) -> None:
    for name, material in materials.items():
        if not isinstance(material.get("scatter"), dict):
            continue
        if not material.get("band"):
            advice = f"or give materials.{name}.band"
            problems.add(("materials", name, "scatter"), "none in a material that never cracks", advice)
        else:
            _check_total(tree, ("materials", name, "scatter"), "none", problems)


def _check_total(tree, path, otherwise, problems) -> None:
    frame = table_of(tree, "solver").get("frame", "auto")
    if frame == "updated" or (frame == "auto" and not tree.get("macro")):  # a volume that strains hands nothing over
        advice = 'or solver.frame = "total": points that move have the numbers of their material'
        problems.add(path, f"{otherwise} with solver.frame = {written(frame)}", advice)


def _check_body(tree, table, problems) -> None:
    bodies = tree.get("bodies")
    names = [b.get("name") for b in bodies if isinstance(b, dict)] if isinstance(bodies, list | tuple) else []
    word = table.get("body")
    if not isinstance(word, str):
        return
    if word not in names:
        problems.name(("mesostructure", "body"), word, names, "the name of a body")
    elif names.count(word) > 1:
        problems.add(("mesostructure", "body"), f"the name of one body, not of {names.count(word)}")


def _check_material(path, word, tree, problems) -> None:
    known = tree.get("materials", {})
    if isinstance(word, str) and word and isinstance(known, dict) and word not in known:
        problems.name(path, word, list(known), "the name of a material")


def _check_image(table, problems) -> None:
    for key in ("inclusions", "inclusion", "interface", "interface_thickness"):
        if table.get(key):
            advice = "the labels name all phases"
            problems.add(("mesostructure", key), "none beside mesostructure.image", advice)


def _check_inclusions(tree, table, problems) -> None:
    for key, what in (("inclusions", "a table of inclusions"), ("inclusion", "the name of a material")):
        if not table.get(key):
            advice = "or mesostructure.image" if key == "inclusions" else "of the inclusions"
            problems.add(("mesostructure", key), what, advice)
    if table.get("interface") and "interface_thickness" not in table:
        problems.add(("mesostructure", "interface_thickness"), "a finite number > 0", "of the interface, mm")
    if "interface_thickness" in table and not table.get("interface"):
        problems.add(("mesostructure", "interface"), "the name of a material", "of the layer around inclusions")
    _check_resolved(tree, table, problems)


def _check_resolved(tree, table, problems) -> None:
    """Inclusions and interfaces must not be lost between the middles of cells."""
    cell = _positive(table_of(tree, "grid").get("cell"))
    thickness = _positive(table.get("interface_thickness"))
    if cell is None:
        return
    if thickness and thickness < cell * (1 - 1e-9) and table.get("sampling", "centre") == "centre":
        advice = 'or mesostructure.sampling = "mixed", for layers thinner than a cell'
        path = ("mesostructure", "interface_thickness")
        problems.add(path, f"at least a cell, {cell:g} mm, where cells are what their middle is", advice)
    grading = table_of(table_of(table, "inclusions"), "grading")
    key, smallest = "smallest", grading.get("smallest")
    if isinstance(grading.get("size"), list | tuple) and grading["size"]:
        key, smallest = "size", grading["size"][0]
    smallest = _positive(smallest)
    if smallest is not None and smallest < cell:
        path = ("mesostructure", "inclusions", "grading", key)
        problems.add(path, f"inclusions of at least a cell, {cell:g} mm", "or use a smaller grid.cell")


def _positive(value) -> float | None:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return value if number and value > 0 else None
