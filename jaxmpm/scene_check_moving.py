"""Says what does not fit together in a scene whose points move."""

from typing import Any

from jaxmpm.errors import Problems, written
from jaxmpm.scene_tables import table_of


def check_moving(tree: dict[str, Any], problems: Problems) -> None:
    """Add a line for each choice of points, contact and frame that does not go with the others."""
    solver, points, contact = (table_of(tree, key) for key in ("solver", "points", "contact"))
    frame = solver.get("frame", "auto")
    materials = {k: m for k, m in table_of(tree, "materials").items() if isinstance(m, dict)}
    _check_bulk(materials, frame, problems)
    neo = any(table_of(m, "bulk").get("law") == "neo_hookean" for m in materials.values())
    if neo and table_of(tree, "grid").get("stress_state") == "plane_stress":
        problems.add(("grid", "stress_state"), '"plane_strain" with law "neo_hookean"')
    cracks = [name for name, material in materials.items() if material.get("band")]
    shape = points.get("shape", "gimp")
    if cracks and frame != "total" and shape in ("quadratic", "cubic"):
        problems.add(
            ("points", "shape"), f'"linear" or "gimp" with materials.{cracks[0]}, which cracks',
            "splines reach over a crack of one cell and lock it",
        )  # fmt: skip
    if points.get("fill") == "shapes" and frame != "updated":
        problems.add(("points", "fill"), '"cells" in this frame', 'or solver.frame = "updated"')
    _check_unused(tree, frame, problems)
    if contact.get("between") == "fragments" and frame == "updated":
        what = f'"bodies" with solver.frame = {written(frame)}'
        problems.add(("contact", "between"), what, "fragments are found when the total frame hands over")
    order = points.get("order", "usl")
    if order in ("usf", "musl") and points.get("transfer", "taylor") == "taylor":
        advice = 'or points.transfer = "flip" or "apic": gradients would be a step behind'
        problems.add(("points", "order"), '"usl" with points.transfer = "taylor"', advice)
    if contact.get("kind") == "friction" and points.get("fmpm_order", 1) != 1:
        problems.add(("points", "fmpm_order"), '1 with contact.kind = "friction"')
    if points.get("transfer") == "xpic" and points.get("fmpm_order", 1) != 1:
        problems.add(("points", "fmpm_order"), '1 with points.transfer = "xpic"')
    if frame == "updated":
        _check_starts_at_zero(tree, problems)


def _check_unused(tree: dict[str, Any], frame: str, problems: Problems) -> None:
    """What is set but does nothing; a default, as in the scene of a run, does no harm."""
    from jaxmpm.scene import Points

    points, contact = table_of(tree, "points"), table_of(tree, "contact")
    for key, known in Points.model_fields.items():
        if frame == "total" and key in points and points[key] != known.default:
            advice = 'or solver.frame = "auto" or "updated"'
            problems.add(("points", key), "none in the total frame, which has no points that move", advice)
    bodies = tree.get("bodies")
    alone = isinstance(bodies, list | tuple) and len(bodies) == 1
    if contact.get("kind") == "friction" and contact.get("between", "bodies") == "bodies" and alone:
        advice = 'or contact.between = "fragments", or a second body'
        problems.add(("contact", "kind"), '"stick" with one body', advice)
    if contact.get("kind", "stick") == "stick" and contact.get("friction", 0.3) != 0.3:
        problems.add(("contact", "friction"), "none where bodies stick", 'or contact.kind = "friction"')



def _check_bulk(materials: dict, frame: str, problems: Problems) -> None:
    laws = {}
    for name, material in materials.items():
        bulk = material.get("bulk")
        laws[name] = bulk.get("law") if isinstance(bulk, dict) else None
    first = next((law for law in laws.values() if law), None)
    for name, law in laws.items():
        path = ("materials", name, "bulk", "law")
        if law == "neo_hookean" and frame != "updated":
            problems.add(path, '"elastic" in this frame', 'or solver.frame = "updated"')
        elif law == "neo_hookean" and materials[name].get("band"):
            problems.add(path, '"elastic" in a material that cracks')
        elif law and law != first:
            problems.add(path, f"{written(first)} as the other materials have", "one law for all bulks")


def _check_starts_at_zero(tree: dict, problems: Problems) -> None:
    loads = tree.get("displacements")
    for index, load in enumerate(loads if isinstance(loads, list | tuple) else ()):
        history = load.get("history") if isinstance(load, dict) else None
        value = history.get("value") if isinstance(history, dict) else None
        if isinstance(value, list | tuple) and value and value[0] not in (0, 0.0):
            path = ("displacements", index, "history", "value")
            problems.add(path, "to begin with 0 where points move", "a sudden displacement has no rate")
