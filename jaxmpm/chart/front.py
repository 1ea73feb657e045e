"""The Pareto front of a chart, and what it says in one sentence."""

from jaxmpm.chart.reference import Reference, worst
from jaxmpm.chart.settings import MODEL

LEVELS = (0.05, 0.02, 0.01)  # errors that the sentence speaks of
SHORT = {"peak": "peak", "work": "work", "end": "energy at the end"}


def judged(records: list[dict], names: list[str], given: bool) -> list[dict]:
    """Records with `error`, the largest of the errors of some numbers, and whether they are on the `front`.

    A choice that changes what is modelled is near a reference of other runs by accident only: it stays off the
    front, unless the reference is `given` from outside.
    """
    out = [{"front": False} | record | ({"error": worst(record["errors"], names)} if "errors" in record else {}) for record in records]
    able = [record for record in out if "error" in record and (given or not set(MODEL) & set(record["setting"]))]
    best = float("inf")
    for record in sorted(able, key=lambda one: (one["seconds"], one["error"])):
        record["front"] = record["error"] < best
        best = min(best, record["error"])
    return out


def front(records: list[dict]) -> list[dict]:
    """The members of the front, quickest first."""
    return sorted((record for record in records if record["front"]), key=lambda record: record["seconds"])


def sentence(records: list[dict], reference: Reference) -> str:
    """What a chart says: the cheapest setting for each of some errors, against the scene as given."""
    members = front(records)
    tightest = {}  # by index of the member
    for level in LEVELS:
        index = next((index for index, record in enumerate(members) if record["error"] <= level), None)
        if index is not None:
            tightest[index] = level
    parts = [f"within {level:.0%} {members[index]['label']} ({seconds(members[index]['seconds'])})" for index, level in tightest.items()]
    if not parts:
        parts = [f"nothing within {LEVELS[0]:.0%}, nearest is {members[-1]['label']}, off by {members[-1]['error']:.1%}"]
    if given := next((record for record in records if not record["setting"] and "error" in record), None):
        parts.append(f"as given, {given['label']}, it takes {seconds(given['seconds'])} and is off by {given['error']:.1%}")
    return f"{' and '.join(SHORT[name] for name in reference.names).capitalize()} against {reference.words}: {'; '.join(parts)}."


def seconds(value: float) -> str:
    """A time as it is printed."""
    return f"{value:.2g} s" if value < 100 else f"{value:.0f} s"
