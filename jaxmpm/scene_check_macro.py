"""Says what does not fit together in a scene whose mean strain is driven."""

from typing import Any

from jaxmpm.errors import Problems
from jaxmpm.scene_tables import entries, table_of


def check_macro(tree: dict[str, Any], problems: Problems) -> None:
    """A representative volume is driven by its mean strain alone."""
    macro = tree.get("macro")
    if not isinstance(macro, dict):
        for name, gauge in entries(tree, "gauges"):
            if str(gauge.get("kind")).startswith("mean_"):
                problems.add(("gauges", name, "kind"), "another kind, or a table [macro]", "it drives the mean strain")
        return
    for key in ("supports", "displacements", "forces"):
        if tree.get(key):
            problems.add((key,), "none with [macro]", "the mean strain is all that drives the volume")
    if not _is_zero(tree.get("gravity")):
        problems.add(("gravity",), "none with [macro]")
    for i, body in entries(tree, "bodies"):
        if not _is_zero(body.get("velocity")):
            problems.add(("bodies", i, "velocity"), "none with [macro]", "the mean strain is all that drives the volume")
    for side, kind in table_of(table_of(tree, "grid"), "walls").items():
        if kind != "stop":
            problems.add(("grid", "walls", side), '"stop" with [macro]')
    if table_of(tree, "solver").get("frame") == "updated":
        problems.add(("solver", "frame"), '"auto" or "total" with [macro]')
    strain = macro.get("strain")
    if not isinstance(strain, dict):
        return
    driven = {name for name in ("xx", "yy", "xy") if strain.get(name) is not None}
    if not driven or not any(strain[name] != 0 for name in driven):
        problems.add(("macro", "strain"), "at least one of xx, yy, xy other than zero")
    if "xy" in driven and len(driven) < 3 and macro.get("boundary", "edges") == "edges":
        what = "xx and yy too where edges are sheared, which moves them both ways"
        problems.add(("macro", "strain"), what, 'or macro.boundary = "periodic"')


def _is_zero(vector) -> bool:
    """Whether a vector is zero or left out; what is no list is reported elsewhere."""
    return not isinstance(vector, list | tuple) or all(value == 0 for value in vector)
