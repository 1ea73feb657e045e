"""Says what does not go with an elastic rise that is passed in equilibrium."""

from typing import Any

from jaxmpm.errors import Problems, written
from jaxmpm.scene_tables import table_of


def check_rise(tree: dict[str, Any], problems: Problems) -> None:
    """Add a line where `solver.elastic_rise = "equilibrium"` would leave out what the scene is about."""
    solver = table_of(tree, "solver")
    if solver.get("elastic_rise") != "equilibrium" or solver.get("kind") == "quasistatic":
        return
    expected = lambda why: problems.add(("solver", "elastic_rise"), f'"motion" with {why}', "the rise is motion there")  # noqa: E731
    gravity = tree.get("gravity")
    bodies = tree.get("bodies")
    velocities = [body.get("velocity") for body in bodies if isinstance(body, dict)] if isinstance(bodies, list | tuple) else []
    if solver.get("frame") == "updated":
        expected('solver.frame = "updated"')
    if isinstance(gravity, list | tuple) and any(gravity):
        expected(f"gravity = {written(list(gravity))}")
    if any(isinstance(velocity, list | tuple) and any(velocity) for velocity in velocities):
        expected("bodies that have a velocity")
    if table_of(tree, "contact").get("kind") == "friction":
        expected('contact.kind = "friction"')
