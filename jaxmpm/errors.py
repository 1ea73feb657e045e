"""The errors meant for people, and the collector that turns findings about a scene into lines."""

import difflib
import json
from collections.abc import Iterable, Sequence
from typing import Any


class SceneError(ValueError):
    """What is wrong with a scene, one line for each thing, in `lines`."""

    def __init__(self, lines: str | Iterable[str]):
        self.lines = [lines] if isinstance(lines, str) else list(lines)
        super().__init__(self.lines)

    def __str__(self) -> str:
        return "\n".join(self.lines)


class ResultError(Exception):
    """A file of results is missing, broken or not what was expected."""


class RunError(RuntimeError):
    """A run that started and could not go on."""


class OutOfTime(RunError):
    """A run that took longer than it was given."""


def written(value: Any, limit: int = 100) -> str:
    """A value the way TOML writes it, cut to `limit` characters."""
    text = _toml(value)
    return text if len(text) <= limit else text[: limit - 4] + " ..."


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return str(value)


def did_you_mean(word: Any, known: Iterable[str]) -> str:
    """The known word nearest to `word`, or "" where none is near."""
    by_small = {str(one).lower(): str(one) for one in known}
    near = difflib.get_close_matches(str(word).lower(), by_small, n=1, cutoff=0.6)
    return by_small[near[0]] if near else ""


def near_or(word: str, known: Iterable[str]) -> str:
    """Advice on a word that is none of the known ones: the one that was meant, or all of them."""
    known = list(known)
    near = did_you_mean(word, known)
    return f"did you mean {near}?" if near else f"expected one of {', '.join(known)}"


def at(tree: Any, path: Sequence[str | int]) -> Any:
    """The value under `path` in nested tables and lists; KeyError or IndexError without."""
    for part in path:
        fits = isinstance(tree, dict) if isinstance(part, str) else isinstance(tree, list | tuple)
        if not fits:
            raise KeyError(part)
        tree = tree[part]
    return tree


class Problems:
    """Collects findings about a scene, so that all of them can be raised together."""

    def __init__(self, source: Any, resolved: Any = None):
        """`source`: the scene as written; `resolved`: the same with its parameters replaced."""
        self.lines: list[str] = []
        self.source = source
        self.resolved = source if resolved is None else resolved
        self._seen: set[tuple] = set()

    def add(
        self, path: Sequence[str | int], expected: str, advice: str = "", again: bool = False
    ) -> None:
        """Note that the value at `path` is not as `expected`; said once a path unless `again`."""
        if tuple(path) in self._seen and not again:
            return
        self._seen.add(tuple(path))
        dotted = ".".join(map(str, path))
        try:
            head = f"{dotted} = {self._value(path)}: expected"
        except (KeyError, IndexError):
            head = f"{dotted}: absent, expected"
        self.lines.append(f"{head} {expected}" + (f" ({advice})" if advice else ""))

    def name(self, path: Sequence[str | int], word: Any, known: Iterable[str], what: str) -> None:
        """Note that `word` at `path` is none of the `known` names of a `what`."""
        known = list(known)
        near = did_you_mean(word, known)
        expected = f"{what}, one of {', '.join(map(written, known))}" if known else what
        advice = f"did you mean {written(near)}?" if near else "" if known else "the scene has none"
        self.add(path, expected, advice)

    def skip(self, path: Sequence[str | int]) -> None:
        """Say nothing of the value at `path`: what is wrong with it is said elsewhere."""
        self._seen.add(tuple(path))

    def raise_any(self) -> None:
        """Raise one SceneError with every line, if there is any."""
        if self.lines:
            raise SceneError(self.lines)

    def _value(self, path: Sequence[str | int]) -> str:
        source = at(self.source, path)
        try:
            resolved = at(self.resolved, path)
        except (KeyError, IndexError):
            return written(source)
        if isinstance(source, str) and not isinstance(resolved, str):
            return f"{written(source)} (= {written(resolved)})"
        return written(source)
