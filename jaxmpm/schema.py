"""A JSON schema of scene files, for editors that complete, explain and check TOML."""

import json
from pathlib import Path
from typing import Any

from jaxmpm.results import write_text
from jaxmpm.scene import Scene

NAME = "jaxmpm.schema.json"
LINE = f"#:schema ./{NAME}\n"  # which editors look for at the top of a TOML file
PARAMETER = {"type": "string", "pattern": r"^-?\$.+$", "description": 'a parameter of the scene, "$name" or "-$name"'}
EXPRESSION = {"type": "string", "description": 'worked out of earlier parameters: "side / 2"'}
DROPPED = ("discriminator", "default", "title")  # no part of a schema, or of no use where one writes


def scene_schema() -> dict[str, Any]:
    """Draft 7, which editors of TOML know: the tables of `scene.Scene` as a file may write them.

    A file may say more than a scene: "$name" for a number, an expression for a parameter, and the name of
    a file for the numbers of a reference.
    """
    tree = _plain(Scene.model_json_schema())
    keys = tree["properties"]
    keys["parameters"]["additionalProperties"] = {"anyOf": [{"type": "number"}, EXPRESSION]}
    reference = tree["definitions"]["Response"]["properties"]["reference"]
    reference["anyOf"] = [{"type": "string", "description": "a CSV file beside the scene"}, *reference.pop("allOf")]
    return {"$schema": "http://json-schema.org/draft-07/schema#", "title": "a scene of jaxmpm (mm, N, MPa, s, tonne)"} | tree


def write_schema(folder: Path) -> Path:
    """Write it into a folder, anew where there is one; returns its path."""
    return write_text(folder / NAME, json.dumps(scene_schema(), indent=1, ensure_ascii=False) + "\n")


def _plain(node: Any) -> Any:
    """A node of pydantic's schema in Draft 7, with parameters wherever there may be numbers."""
    if isinstance(node, list):
        return [_plain(item) for item in node]
    if not isinstance(node, dict):
        return node
    out = {key: _plain(value) for key, value in node.items() if key not in (*DROPPED, "properties", "$defs", "prefixItems")}
    for old, new in (("properties", "properties"), ("$defs", "definitions")):  # keys of these are names
        if old in node:
            out[new] = {name: _plain(value) for name, value in node[old].items()}
    if "prefixItems" in node:
        out |= {"items": _plain(node["prefixItems"]), "additionalItems": False}
    if "$ref" in out:
        out["$ref"] = out["$ref"].replace("#/$defs/", "#/definitions/")
    if "$ref" in out and len(out) > 1:  # beside a reference nothing counts
        out = {"allOf": [{"$ref": out.pop("$ref")}], **out}
    return _numbers(_present(out))


def _present(node: dict) -> dict:
    """Without null, which TOML has not: what is not there is left out."""
    options = [option for option in node.get("anyOf", ()) if option.get("type") != "null"]
    if not options or len(options) == len(node["anyOf"]):
        return node
    rest = {key: value for key, value in node.items() if key != "anyOf"}
    if len(options) > 1:
        return {"anyOf": options} | rest
    return ({"allOf": options} if "$ref" in options[0] else options[0]) | rest


def _numbers(node: dict) -> dict:
    if node.get("type") not in ("number", "integer"):
        return node
    words = {key: node.pop(key) for key in ("description",) if key in node}
    return {"anyOf": [node, PARAMETER]} | words
