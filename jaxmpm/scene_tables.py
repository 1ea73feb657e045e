"""The tables of a scene as they were written, right or wrong: what is no table is empty, and reported elsewhere."""

from collections.abc import Iterator
from typing import Any


def table_of(tree: dict, key: str) -> dict:
    """The table at a key."""
    value = tree.get(key)
    return value if isinstance(value, dict) else {}


def entries(tree: dict, key: str) -> Iterator[tuple[Any, dict]]:
    """The tables in a group, a table or a list of them, each with its name or number."""
    group = tree.get(key)
    if isinstance(group, list | tuple):
        group = dict(enumerate(group))
    items = group.items() if isinstance(group, dict) else ()
    return ((name, item) for name, item in items if isinstance(item, dict))
