"""Says in one line each what is wrong with a scene: types and ranges, then what refers to what."""

import math
import re
import sys
from collections.abc import Sequence
from typing import Any

from jaxmpm.errors import Problems, at, did_you_mean, written
from jaxmpm.scene_check_macro import check_macro
from jaxmpm.scene_check_mesostructure import check_mesostructure
from jaxmpm.scene_check_moving import check_moving
from jaxmpm.scene_check_quasistatic import check_quasistatic
from jaxmpm.scene_check_rise import check_rise
from jaxmpm.scene_tables import entries, table_of

# ---- types and ranges: from the validator's findings and the scene's own JSON schema


def explain(errors: Sequence[dict[str, Any]], schema: dict[str, Any], problems: Problems) -> None:
    """Add a line for each error of the validator, worded from the schema of the scene."""
    suggested = set()
    unknown = [error for error in errors if error["type"] == "extra_forbidden"]
    for error in unknown:
        path = _locate(error, problems.resolved)
        parent, _ = _node(schema, path[:-1], problems.resolved)
        keys = list(parent.get("properties", {}))
        near = did_you_mean(path[-1], keys) or _elsewhere(path[-1], schema)
        suggested.add((*path[:-1], near))
        known = f"one of the keys {', '.join(keys)}"
        problems.add(path, known, f"did you mean {near}?" if near else "remove it")
    paths = [_locate(error, problems.resolved) for error in errors]
    for error, path in zip(errors, paths, strict=True):
        # A misspelt key is one mistake, though the right key is absent too; and a list is not
        # too short because one of its items is wrong.
        misspelt = error["type"] == "missing" and path in suggested
        inner = error["type"] == "too_short" and any(p[:-1][: len(path)] == path for p in paths)
        if error not in unknown and not misspelt and not inner:
            _explain_one(error, path, schema, problems)


def _elsewhere(key: Any, schema: dict, inside: str = "", node: dict | None = None) -> str:
    """Where in the tables that every scene may have a key belongs, as "grid.cell"; "" where it is none of theirs."""
    for name, below in _resolve(node or schema, schema).get("properties", {}).items():
        if inside and name == key:
            return f"{inside}.{name}"
        if found := _elsewhere(key, schema, f"{inside}.{name}".strip("."), below):
            return found
    return ""


def _explain_one(error, path, schema, problems) -> None:
    node, text = _node(schema, path, problems.resolved)
    if error["type"].startswith("union_tag"):
        tags = list(node.get("discriminator", {}).get("mapping", {}))
        path = (*path, error["ctx"]["discriminator"].strip("'"))
        near = did_you_mean(error["ctx"].get("tag", ""), tags)
        expected = "one of " + ", ".join(map(written, tags))
        problems.add(path, expected, f"did you mean {written(near)}?" if near else "")
        return
    if error["type"] == "value_error":
        problems.add(path, str(error["ctx"]["error"]), text)
        return
    value = error["input"]
    expected = _phrase(node) or "something else"
    near = did_you_mean(value, _choices(node)) if isinstance(value, str) else ""
    hint = f"did you mean {written(near)}?" if near else ""
    if not hint and isinstance(value, str) and "number" in expected:
        hint = _number_meant(value, problems.source)
    problems.add(path, expected, "; ".join(part for part in (text, hint) if part))


def _number_meant(text: str, source: Any) -> str:
    """Advice on a text where a number is expected."""
    parameters = source.get("parameters") if isinstance(source, dict) else None
    if isinstance(parameters, dict) and (near := did_you_mean(text, parameters)):
        return f'did you mean "${near}"?'
    found = re.fullmatch(r"\s*([-+]?\d*[.,]?\d+(?:[eE][-+]?\d+)?)\s*([^\d\s.,]\S*)?\s*", text)
    if not found:
        return ""
    return f"write {found[1].replace(',', '.')}, without quotes" + (" or unit" if found[2] else "")


def _locate(error: dict[str, Any], tree: Any) -> tuple:
    """The path of an error in the scene as written, without the words that unions put in."""
    path: list = []
    loc = error["loc"]
    for i, part in enumerate(loc):
        if isinstance(tree, dict) and part in tree:
            path.append(part)
            tree = tree[part]
        elif isinstance(tree, list | tuple) and isinstance(part, int) and part < len(tree):
            path.append(part)
            tree = tree[part]
        elif i == len(loc) - 1 and error["type"] == "missing" and isinstance(tree, dict):
            path.append(part)
    return tuple(path)


def _resolve(node: dict, root: dict, data: Any = None) -> dict:
    """A node of the schema with references followed and, where `data` tells, the union's member."""
    while True:
        if "$ref" in node:
            node = {**root["$defs"][node["$ref"].rsplit("/", 1)[-1]], **node}
            del node["$ref"]
        elif "discriminator" in node and isinstance(data, dict):
            tag = data.get(node["discriminator"]["propertyName"])
            mapping = node["discriminator"]["mapping"]
            if not isinstance(tag, str) or tag not in mapping:
                return node
            node = {"$ref": mapping[tag]}
        elif any(option.get("type") == "null" for option in node.get("anyOf", ())):
            (node,) = [option for option in node["anyOf"] if option.get("type") != "null"]
        else:
            return node


def _node(schema: dict, path: Sequence, tree: Any) -> tuple[dict, str]:
    """The schema of what stands at `path`, and the description nearest to it."""
    node, data, text = schema, tree, ""
    for part in path:
        node = _resolve(node, schema, data)
        if part in node.get("properties", {}):
            node = node["properties"][part]
            text = node.get("description", "")
        elif isinstance(node.get("additionalProperties"), dict):
            node, text = node["additionalProperties"], ""
        elif isinstance(part, int) and part < len(node.get("prefixItems", ())):
            node = node["prefixItems"][part]
        elif "items" in node:
            node = node["items"]
        else:
            return {}, text
        try:
            data = at(data, (part,))
        except (KeyError, IndexError):
            data = None
    return _resolve(node, schema, data), text


def _choices(node: dict) -> list[str]:
    found = []
    for option in (node, *node.get("anyOf", ())):
        found += option.get("enum", [])
        found += [option["const"]] if "const" in option else []
    return found


def _phrase(node: dict, many: bool = False) -> str:
    """What a node of the schema accepts, in words."""
    s = "s" if many else ""
    if "anyOf" in node:
        return " or ".join(_phrase(option, many) for option in node["anyOf"])
    if choices := _choices(node):
        return " or ".join(map(written, choices))
    one = "" if many else "a "
    match node.get("type"):
        case "number" | "integer" as kind:
            words = f"{one}finite number{s}" if kind == "number" else f"{one}whole number{s}"
            signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
            bounds = [f"{sign} {node[key]:g}" for key, sign in signs.items() if key in node]
            return " ".join([words, " and ".join(bounds)]).strip()
        case "string":
            return f"{one}string{s} in quotes"
        case "boolean":
            return "true or false"
        case "array":
            return f"{one}list{s} of {_items(node)}"
        case "object":
            least = node.get("minProperties", 0)
            return f"{one}table{s}" + (f" of at least {least}" if least else "")
    return f"{one}table{s}" if {"$ref", "oneOf"} & node.keys() else ""


def _items(node: dict) -> str:
    if "prefixItems" in node:
        return f"{len(node['prefixItems'])} {_phrase(node['prefixItems'][0], True)}"
    least = f"at least {node['minItems']}, each " if "minItems" in node else ""
    return least + _phrase(node.get("items", {}), not least)


# ---- what refers to what: on the plain tables, so that it is reported beside wrong types


def check(tree: dict[str, Any], problems: Problems) -> None:
    """Add a line for each name that names nothing and each pair of values that do not fit."""
    _check_names(tree, problems)
    _check_response(tree, problems)
    _check_grid(tree, problems)
    for name, material in entries(tree, "materials"):
        _check_band(tree, name, material, problems)
    _check_one_law(tree, problems)
    _check_something_happens(tree, problems)
    check_moving(tree, problems)
    check_macro(tree, problems)
    check_mesostructure(tree, problems)
    check_quasistatic(tree, problems)
    check_rise(tree, problems)


def _names(tree: dict, key: str) -> list[str] | None:
    """The names in a group, or None where the group is no table, which is reported elsewhere."""
    group = tree.get(key, {})
    return list(group) if isinstance(group, dict) else None


def _number(tree: Any, *path: str) -> float | None:
    """A positive finite number at `path`, or None."""
    try:
        value = at(tree, path)
    except (KeyError, IndexError):
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    # Compared before it is made a float: TOML has integers too large for one.
    return float(value) if 0 < value <= sys.float_info.max else None


def _check_names(tree: dict, problems: Problems) -> None:
    uses = [("bodies", "material", "materials", "the name of a material")]
    users = ("supports", "displacements", "forces", "gauges")
    uses += [(user, "set", "sets", "the name of a node set") for user in users]
    for user, key, group, what in uses:
        for entry, item in entries(tree, user):
            word = item.get(key)
            known = _names(tree, group)
            if isinstance(word, str) and known is not None and word not in known:
                problems.name((user, entry, key), word, known, what)


_LOADS, _DISPLACEMENTS = ("reaction", "mean_stress"), ("displacement", "relative_displacement", "mean_strain")


def _check_response(tree: dict, problems: Problems) -> None:
    kinds = {name: str(gauge.get("kind")) for name, gauge in entries(tree, "gauges")}
    response = tree.get("response")
    for key in ("load", "displacement"):
        word = response.get(key) if isinstance(response, dict) else None
        if not isinstance(word, str) or _names(tree, "gauges") is None:
            continue
        if word in kinds and kinds[word] not in _LOADS + _DISPLACEMENTS:
            continue
        what = f"the name of a {'reaction' if key == 'load' else 'displacement'} gauge"
        fitting = [n for n, kind in kinds.items() if (kind in _LOADS) == (key == "load")]
        if word not in fitting:
            problems.name(("response", key), word, fitting, what)


def _check_grid(tree: dict, problems: Problems) -> None:
    cell = _number(tree, "grid", "cell")
    size = [_number(tree, "grid", "size", i) for i in (0, 1)]
    if cell is None or None in size:
        return
    counts = [side / cell for side in size]
    if counts[0] * counts[1] > 1e8:
        most = f"a size that makes no more than 1e8 cells, not {counts[0] * counts[1]:.2g}"
        problems.add(("grid", "cell"), most, "choose a larger cell")
    elif any(round(n) == 0 or abs(n - round(n)) > 1e-6 for n in counts):
        fit = ", ".join(f"{c:.12g}" for c in fitting_cells(size, cell))
        advice = f"cells near it that fit: {fit}" if fit else "none near it fits: change grid.size"
        whole = f"a size that fits a whole number of times into grid.size = {written(size)}"
        problems.add(("grid", "cell"), whole, advice)


def fitting_cells(size: Sequence[float], cell: float) -> list[float]:
    """The nearest smaller and larger cell (mm) that divide both sides of `size` (mm)."""
    start = size[0] / cell
    ranges = (
        range(max(math.ceil(start), 1), math.ceil(start) + 10000),
        range(math.floor(start), max(math.floor(start) - 10000, 0), -1),
    )
    found = []
    for counts in ranges:
        for count in counts:
            other = size[1] * count / size[0]
            if round(other) >= 1 and abs(other - round(other)) <= 1e-7:
                found.append(size[0] / count)
                break
    return found


# steepest slope of the curves of a cohesive law, in f_t²/G_F
STEEPEST = {"linear": 1 / 2, "bilinear": 5 / 6, "exponential": 1.0, "hordijk": 1.35462}


def _check_band(tree: dict, name: str, material: dict, problems: Problems) -> None:
    cell, h = _number(tree, "grid", "cell"), _number(material, "band", "h")
    if cell is None or h is None:
        return
    if h >= cell:
        advice = "use a larger cell or a narrower band"
        problems.add(("materials", name, "band", "h"), f"less than grid.cell = {cell:g} mm", advice)
        return
    found = _largest_size(material)
    if found is None:
        return
    largest, formula, change = found
    bands = tree.get("bands")
    limit = largest_cell(largest, bands.get("effective_size") if isinstance(bands, dict) else None)
    halved = table_of(tree, "grid").get("half") is not None
    limit /= 1 + halved  # a band on the plane of symmetry has two cells
    if cell > limit:
        limit = math.floor(limit * 1e4) / 1e4
        problems.add(
            ("grid", "cell"),
            f"at most {limit:g} mm with materials.{name}{' and grid.half' * halved}, whose bands snap back beyond an "
            f"effective size H_max = {formula} = {largest:.5g} mm",
            f"use a smaller cell, or a band with {change}",
        )


def largest_cell(largest_size: float, rule: str | None) -> float:
    """The largest cell whose bands stay within H_max, by the rule for their effective size."""
    # A crack along a cell's diagonal has the largest effective size.
    return largest_size if rule == "sqrt_area" else largest_size / math.sqrt(2.0)


def _largest_size(material: dict) -> tuple[float, str, str] | None:
    """H_max of a material's band, its formula, and what makes it larger."""
    modulus, h = _number(material, "bulk", "E"), _number(material, "band", "h")
    softening, strength, energy = (_number(material, "band", k) for k in ("Ep", "ft", "GF"))
    if modulus is not None and softening is not None:
        return h * (1.0 + modulus / softening), "h (1 + E/Ep)", "larger h or smaller Ep"
    if None not in (modulus, strength, energy) and material["band"].get("law") == "cohesive":
        slope = STEEPEST.get(str(material["band"].get("curve", "exponential")), 1.0)
        largest = modulus * energy / (strength**2 * slope)
        return largest, f"E GF/({slope:.3g} ft²)", "larger GF or smaller ft"
    return None


def _check_one_law(tree: dict, problems: Problems) -> None:
    """All bands of a scene are answered together: by one law, whose parameters may differ."""
    first = None
    for name, material in entries(tree, "materials"):
        band = material.get("band")
        if not isinstance(band, dict):
            continue
        law = {key: band[key] for key in ("law", "curve", "source") if key in band}
        if band.get("law") == "cohesive":
            law.setdefault("curve", "exponential")
        if first is None:
            first = name, law
        for key, value in law.items():
            if key in first[1] and value != first[1][key]:
                what = f"{written(first[1][key])} as materials.{first[0]} has"
                problems.add(("materials", name, "band", key), what, "one law for all bands")


def _check_something_happens(tree: dict, problems: Problems) -> None:
    loads = [item for key in ("displacements", "forces") for _, item in entries(tree, key)]
    loads += [tree["macro"]] if isinstance(tree.get("macro"), dict) else []
    values = []
    for load in loads:
        history = load.get("history")
        values.append(history.get("value") if isinstance(history, dict) else None)
    values += [body.get("velocity", [0.0]) for _, body in entries(tree, "bodies")]
    values.append(tree.get("gravity", [0.0]))
    # Whatever is no list of numbers is reported elsewhere and may well be meant to move.
    if all(isinstance(v, list | tuple) and all(item == 0 for item in v) for v in values):
        what = "a displacement, a force, gravity or an initial velocity other than zero"
        advice = "as it stands nothing happens"
        problems.add(("displacements",), what, advice)
