"""Says what does not fit together in a scene in equilibrium, and what is set that its solver does not use."""

from typing import Any

from jaxmpm.errors import Problems, written
from jaxmpm.scene_tables import table_of

OF_MOTION = {
    "damping": "nothing moves", "viscosity": "nothing moves", "time_step_factor": "there are no time steps",
    "hand_over_gradient": "it stays in its frame", "hand_over_displacement": "it stays in its frame",
    "elastic_rise": "all of it is equilibrium",
}  # fmt: skip
OF_VELOCITY = ("transfer", "flip", "xpic_order", "fmpm_order", "order")
OF_EQUILIBRIUM = ("control", "tolerance", "first_increment", "smallest_increment", "largest_increment")


def check_quasistatic(tree: dict[str, Any], problems: Problems) -> None:
    """Add a line for each choice of the solver that does not go with its kind."""
    from jaxmpm.scene import Solver

    solver = tree.get("solver")
    if not isinstance(solver, dict):
        return
    changed = {key for key, field in Solver.model_fields.items() if key in solver and solver[key] != field.default}
    static = 'solver.kind = "quasistatic"'
    if solver.get("kind", "explicit") != "quasistatic":
        for key in OF_EQUILIBRIUM:
            if key in changed:
                problems.add(("solver", key), f"none without {static}", "remove it, or set solver.kind")
        return
    for key, why in OF_MOTION.items():
        if key in changed:
            default = Solver.model_fields[key].default
            usual = "" if default is None else f", or {written(default)} where the scene has it"
            problems.add(("solver", key), f"none with {static}{usual}", why)
    if solver.get("precision") == "float32":
        problems.add(("solver", "precision"), f'"float64" with {static}', "equilibrium is solved to more digits than float32 has")
    _check_increments(solver, problems)
    _check_control(tree, solver, problems)
    _check_bodies(tree, static, problems)
    if solver.get("frame") == "updated":
        _check_points(tree, solver, static, problems)


def _check_points(tree, solver, static, problems):
    """Points carry no velocities to the grid, and their path is followed by the loads alone."""
    from jaxmpm.scene import Points

    points = table_of(tree, "points")
    for key in OF_VELOCITY:
        known = Points.model_fields[key].default
        if key in points and points[key] != known:
            problems.add(("points", key), f"none with {static}, or {written(known)} where the scene has it", "points have no velocities")
    if solver.get("control", "time") != "time":
        problems.add(("solver", "control"), '"time" with solver.frame = "updated"', 'or solver.frame = "total"')


def _check_increments(solver, problems):
    known = {"first_increment": 0.005, "smallest_increment": 1e-6, "largest_increment": 0.02}
    small, large = (solver.get(key, known[key]) for key in ("smallest_increment", "largest_increment"))
    numbers = all(isinstance(value, int | float) and value > 0 for value in (small, large))
    if numbers and not small < large:
        if "smallest_increment" in solver:
            problems.add(("solver", "smallest_increment"), f"less than solver.largest_increment = {large:g}")
        else:
            problems.add(("solver", "largest_increment"), f"more than solver.smallest_increment = {written(small)}, the usual one")


def _check_control(tree, solver, problems):
    """Control is by time, dissipation or a displacement gauge."""
    control, gauges = solver.get("control", "time"), tree.get("gauges", {})
    if not isinstance(control, str) or control in ("time", "dissipation") or not isinstance(gauges, dict):
        return
    kinds = ("displacement", "relative_displacement")
    fitting = [name for name, gauge in gauges.items() if isinstance(gauge, dict) and gauge.get("kind") in kinds]
    if control not in fitting:
        problems.name(("solver", "control"), control, ["time", "dissipation", *fitting], "time, dissipation or the name of a displacement gauge")


def _check_bodies(tree, static, problems):
    bodies = tree.get("bodies")
    for index, body in enumerate(bodies if isinstance(bodies, list | tuple) else ()):
        velocity = body.get("velocity") if isinstance(body, dict) else None
        if isinstance(velocity, list | tuple) and any(value != 0 for value in velocity):
            problems.add(("bodies", index, "velocity"), f"none with {static}", "nothing moves by itself in equilibrium")
    contact = tree.get("contact")
    if isinstance(contact, dict) and contact.get("kind", "stick") != "stick":
        problems.add(("contact", "kind"), f'"stick" with {static}', "bodies do not slide in the total frame")
