"""The Pareto front of a chart, and what it says in one sentence."""

from jaxmpm.chart.reference import Reference, worst
from jaxmpm.chart.settings import MODEL

LEVELS = (0.05, 0.02, 0.01)  # errors that the sentence speaks of
BETTER = 0.97  # of the error of the member before: what is hardly better is none
SHORT = {"peak": "peak", "work": "work", "end": "kinetic energy kept", "balance": "energy lost"}


def judged(records: list[dict], names: list[str], given: bool) -> list[dict]:
    """Records with `error`, the largest of the errors of some numbers, and whether they are on the `front`.

    A choice that changes what is modelled is near a reference of other runs by accident only: it stays off the
    front, unless the reference is `given` from outside.
    """
    out = [{"front": False} | record | ({"error": worst(record["errors"], names)} if "errors" in record else {}) for record in records]
    able = [record for record in out if "error" in record and (given or not set(MODEL) & set(record["setting"]))]
    best = float("inf")
    for record in sorted(able, key=lambda one: (one["seconds"], one["error"])):
        record["front"] = record["error"] < BETTER * best
        best = record["error"] if record["front"] else best
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
    what = f"of {reference.words} ({' and '.join(SHORT[name] for name in reference.names)})"
    parts = []
    for index, level in tightest.items():
        parts.append(f"within {100 * level:g} % {'' if parts else what}".strip() + f": {members[index]['label']} ({seconds(members[index]['seconds'])})")
    if not parts:
        parts = [f"nothing is within {100 * LEVELS[0]:g} % {what}: {members[-1]['label']} is off by {percent(members[-1]['error'])}"]
    given = next((record for record in records if not record["setting"] and "error" in record), None)
    if given and given["error"] > 0.0:
        parts.append(f"as given ({given['label']}) the scene takes {seconds(given['seconds'])} and is off by {percent(given['error'])}")
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def percent(share: float) -> str:
    """A share as it is printed, to two digits."""
    value = 100 * share
    return f"{value:.0f} %" if value >= 9.5 else f"{value:#.2g} %"


def seconds(value: float) -> str:
    """A time as it is printed."""
    return f"{value:.2g} s" if value < 100 else f"{value:.0f} s"
