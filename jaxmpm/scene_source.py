"""From a name or a file to one tree of tables: TOML, overrides, parameters (no types yet)."""

import ast
import copy
import hashlib
import math
import operator
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxmpm.errors import Problems, SceneError, did_you_mean, written
from jaxmpm.scene_check_quasistatic import OF_MOTION

SCENES = Path(__file__).parent / "scenes"


def bundled() -> dict[str, Path]:
    """The scenes that come with the program, name to file."""
    return {path.stem: path for path in sorted(SCENES.glob("*.toml"))}


def find(source: str | Path) -> Path:
    """The file of a scene given by bundled name or by path; a bundled name wins."""
    names = bundled()
    if isinstance(source, str) and source in names:
        return names[source]
    path = Path(source)
    if path.is_dir():
        run = (path / "summary.json").exists()
        hint = f"it is a folder of results: jaxmpm plot {path} draws them" if run else "it is a folder"
    elif path.is_file():
        return path
    elif path.suffix == ".toml":
        near = did_you_mean(path.stem, [one.stem for one in path.parent.glob("*.toml")])
        near = str(path.with_name(f"{near}.toml")) if near else did_you_mean(path.stem, names)
        hint = near and f"did you mean {written(near)}?"
        hint = f"No such file; {hint or f'jaxmpm new {path} writes one'}"
    else:
        near = did_you_mean(source, names)
        hint = f"did you mean {written(near)}?" if near else "a file's name ends in .toml"
    raise SceneError(f"scene = {written(str(source))}: expected a TOML file or one of {', '.join(names)} ({hint})")


def read(path: Path) -> dict[str, Any]:
    """The tables of a TOML file."""
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except OSError as error:
        reason = error.strerror or str(error)
        raise SceneError(
            f"scene = {written(str(path))}: expected a file to read ({reason})"
        ) from None
    except UnicodeDecodeError as error:
        raise SceneError(
            f"scene = {written(str(path))}: expected UTF-8 text (byte {error.start} is not)"
        ) from None
    except (ValueError, RecursionError) as error:
        raise SceneError(f"scene = {written(str(path))}: expected TOML ({error}{_line(path, str(error))})") from None


def _line(path: Path, error: str) -> str:
    """The line of a file that an error names."""
    found = re.search(r"at line (\d+)", error)
    lines = path.read_text(encoding="utf-8").splitlines()
    return f": {lines[int(found[1]) - 1].strip()}" if found and int(found[1]) <= len(lines) else ""


def find_own_laws(tree: dict[str, Any], folder: Path) -> None:
    """Put in where the files of band laws of one's own are, and a digest of what they say.

    A file is looked for beside the scene. With its digest in the scene, a run is not resumed with
    another law unnoticed.
    """
    materials = tree.get("materials")
    for name, material in materials.items() if isinstance(materials, dict) else ():
        band = material.get("band") if isinstance(material, dict) else None
        source = band.get("source") if isinstance(band, dict) else None
        if not isinstance(source, str) or ".py:" not in source:
            continue
        file, _, cls = source.rpartition(":")
        path = folder / file
        try:
            digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        except OSError as error:
            raise SceneError(
                f"materials.{name}.band.source = {written(source)}: expected a file beside the "
                f"scene to read ({error.strerror}: {path})"
            ) from None
        if band.get("digest", digest) != digest:
            raise SceneError(
                f"materials.{name}.band.source = {written(source)}: expected the file as it was "
                f"when this scene was written (digest {band['digest']}, now {digest}; remove the digest)"
            )
        band |= {"source": f"{path.resolve()}:{cls}", "digest": digest}


def override(tree: dict[str, Any], overrides: Sequence[str] | Mapping[str, Any]) -> dict[str, Any]:
    """A copy of `tree` with each "key.path=value" put in, tables made where they are missing.

    `overrides`: such texts, or values by "key.path", NumPy's too.
    """
    before, tree = tree.get("parameters"), copy.deepcopy(tree)
    known = list(before) if isinstance(before, dict) else []
    lines = []
    changes = _changes(overrides, lines)
    for text, path, value in changes:
        try:
            _put(tree, text, path, value)
        except SceneError as error:
            lines += error.lines
    for text, path, _ in changes:
        group, *name = path
        if group == "parameters" and name and name[0] not in known and not _mentions(tree, name[0]):
            near = did_you_mean(name[0], known)
            advice = f"did you mean {near}?" if near else "nothing in the scene asks for it"
            lines.append(f"override {written(text)}: expected a parameter of the scene, one of {', '.join(known) or 'none'} ({advice})")
    if lines:
        raise SceneError(lines)
    _leave_motion(tree, {".".join(path) for _, path, _ in changes})
    return tree


def _leave_motion(tree, said):
    """Where an override asks for equilibrium, what the file says of motion alone is left out; what overrides say stays."""
    solver = tree.get("solver")
    if "solver.kind" in said and isinstance(solver, dict) and solver.get("kind") == "quasistatic":
        for key in set(OF_MOTION) & set(solver):
            if f"solver.{key}" not in said:
                del solver[key]


def _changes(overrides, lines: list[str]) -> list[tuple[str, list[str], Any]]:
    """The overrides as they are to be named in an error, with path and value; what is none goes to `lines`."""
    if isinstance(overrides, str):
        raise SceneError(f'overrides = {written(overrides)}: expected a list of "key.path=value", or a table {{"key.path": value}}')
    if isinstance(overrides, Mapping):
        plain = {key: value.tolist() if hasattr(value, "tolist") else value for key, value in overrides.items()}
        return [(f"{key}={written(value)}", [part.strip() for part in key.split(".")], value) for key, value in plain.items()]
    changes = []
    for text in overrides:
        dotted, equals, value = text.partition("=")
        path = [part.strip() for part in dotted.split(".")]
        if not equals or not all(path):
            lines.append(f"override {written(text)}: expected key.path=value (as in grid.cell=2.5)")
        else:
            changes.append((text, path, _value(value.strip())))
    return changes


def _mentions(node: Any, name: str) -> bool:
    """Whether a text in nested tables names a parameter."""
    if isinstance(node, dict | list):
        return any(_mentions(item, name) for item in (node.values() if isinstance(node, dict) else node))
    return isinstance(node, str) and re.search(rf"\b{re.escape(name)}\b", node) is not None


def _put(tree: dict[str, Any], text: str, parts: list[str], value: Any) -> None:
    node: Any = tree
    for depth, part in enumerate(parts):
        where = ".".join(parts[:depth])
        last = depth == len(parts) - 1
        if isinstance(node, list):
            # One past the end appends: a load can be added to a scene that has some.
            if not part.isdecimal() or int(part) > len(node):
                raise SceneError(
                    f"override {written(text)}: expected an item number 0 to {len(node)} "
                    f"after {where}"
                )
            key = int(part)
            if key == len(node):
                node.append({})
        elif isinstance(node, dict):
            key = part
            node.setdefault(key, {})
        else:
            raise SceneError(
                f"override {written(text)}: expected {where} to be a table or a list, "
                f"it is {written(node)}"
            )
        if last:
            node[key] = copy.deepcopy(value)
        node = node[key]


def _value(text: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return parsed["value"] if len(parsed) == 1 else text


def resolve(tree: dict[str, Any]) -> tuple[dict[str, Any], Problems]:
    """A copy of `tree` with its parameters worked out and every "$name" and "-$name" replaced."""
    resolved = copy.deepcopy(tree)
    problems = Problems(tree, resolved)
    table = resolved.get("parameters", {})
    values: dict[str, float] = {}
    for name, value in table.items() if isinstance(table, dict) else ():
        # A parameter that is wrong still counts as known, so that it is reported once.
        values[name] = value
        if isinstance(value, str):
            _work_out(values, name, value, problems)
            table[name] = values[name]
    for key in resolved:
        if key != "parameters":
            resolved[key] = _replace(resolved[key], (key,), values, problems)
    return resolved, problems


def _work_out(values: dict[str, float], name: str, text: str, problems: Problems) -> None:
    earlier = {key: value for key, value in values.items() if key != name}
    try:
        values[name] = evaluate(text, earlier)
        if any(isinstance(value, float) and math.isnan(value) for value in earlier.values()):
            # It may rest on a parameter that is wrong and reported already.
            problems.skip(("parameters", name))
        return
    except NameError as error:
        near = did_you_mean(error.name, earlier)
        known = ", ".join(earlier) or "none"
        advice = f"did you mean {written(near)}?" if near else f"earlier parameters: {known}"
        advice = f"{written(error.name)} is no earlier parameter; {advice}"
    except ZeroDivisionError:
        advice = "it divides by zero"
    except (ValueError, OverflowError):
        advice = 'for example "angle + 90"'
    problems.add(
        ("parameters", name),
        "a number, or an expression of numbers, + - * / ( ), max, min and the names of earlier parameters",
        advice,
    )
    values[name] = math.nan


def _replace(node: Any, path: tuple, values: dict[str, float], problems: Problems) -> Any:
    if isinstance(node, dict):
        return {k: _replace(v, (*path, k), values, problems) for k, v in node.items()}
    if isinstance(node, list):
        return [_replace(v, (*path, i), values, problems) for i, v in enumerate(node)]
    match = re.fullmatch(r"(-?)\$(.+)", node) if isinstance(node, str) else None
    if not match:
        return node
    sign, name = match.groups()
    if name not in values:
        near = did_you_mean(name, values)
        known = ", ".join(f"${key}" for key in values) or "none: add it to [parameters]"
        problems.add(
            path, f"a parameter, one of {known}", f'did you mean "{sign}${near}"?' if near else ""
        )
        return node
    value = values[name]
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not math.isfinite(value):
        problems.skip(path)
        return math.nan
    return -value if sign else value


_OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}


def evaluate(text: str, names: dict[str, float]) -> float:
    """The value of an expression of numbers, + - * / ( ), max and min, and names.

    Raises NameError (with the name), ZeroDivisionError, or ValueError for anything else.
    """
    try:
        return float(_evaluate(ast.parse(text.strip(), mode="eval").body, names))
    except (SyntaxError, RecursionError, MemoryError, TypeError) as error:
        raise ValueError(str(error)) from None


def _evaluate(node: ast.expr, names: dict[str, float]) -> float:
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return value
        case ast.Name(id=name):
            if name not in names:
                raise NameError(name, name=name)
            return names[name]
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_evaluate(operand, names))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_evaluate(left, names), _evaluate(right, names))
        case ast.Call(func=ast.Name(id="max" | "min" as name), args=[_, _, *_] as parts, keywords=[]):
            return {"max": max, "min": min}[name](_evaluate(part, names) for part in parts)
    raise ValueError(f"cannot evaluate {ast.dump(node)}")
