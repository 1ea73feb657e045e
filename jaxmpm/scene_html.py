"""A scene as a notebook shows it: its picture, and its tables with the units of their numbers."""

from __future__ import annotations

import re
from html import escape
from typing import TYPE_CHECKING

from pydantic import BaseModel

from jaxmpm.errors import SceneError, written
from jaxmpm.html import Markup, image, table

if TYPE_CHECKING:
    from jaxmpm.scene import Scene

UNITS = ("mm", "MPa", "N", "s", "N/mm", "degrees", "tonne/mm3", "mm/s", "mm/s2")
LONGEST = 60  # characters of a value


def scene_html(scene: Scene) -> str:
    """A scene in HTML: a picture, where it can be laid out and is not too large, and all that it says itself."""
    rows = [row for name in type(scene).model_fields if name not in ("name", "title") for row in _rows(name, getattr(scene, name))]
    head = f"<p><b>{escape(scene.title)}</b> ({escape(scene.name)})</p>"
    return head + _picture(scene) + table(rows)


def _picture(scene: Scene) -> str:
    from jaxmpm.plot_scene import LARGEST, scene_picture

    nx, ny = scene.grid.shape
    if nx * ny > LARGEST:
        return f"<p>{nx} × {ny} cells: too many for a picture</p>"
    try:
        return image(scene_picture(scene), ".png", scene.name)
    except SceneError as error:
        return "".join(f"<p>{escape(line)}</p>" for line in error.lines)


def _rows(name: str, value) -> list[tuple]:
    """A row for a table of the scene, or for each table in a group of them; none for what is left out."""
    if isinstance(value, dict) and all(isinstance(item, BaseModel) for item in value.values()):
        return [(f"{name}.{key}", _table(item)) for key, item in value.items()]
    if isinstance(value, tuple) and value and all(isinstance(item, BaseModel) for item in value):
        return [(name if len(value) == 1 else f"{name}.{k}", _table(item)) for k, item in enumerate(value)]
    if isinstance(value, BaseModel):
        return [(name, words)] if (words := _table(value)) else []
    return [(name, written(value, LONGEST))] if value and value != (0.0, 0.0) else []


def _table(model: BaseModel) -> Markup:
    """The keys that were given, each with its unit, and what it means where the pointer rests on it."""
    parts = []
    for key in type(model).model_fields:
        value = getattr(model, key)
        if key not in model.model_fields_set:
            continue
        meaning = type(model).model_fields[key].description or ""
        words = _value(value) + _unit(meaning)
        parts.append(f'<span title="{escape(meaning)}">{escape(key)} = {words}</span>')
    extra = (model.model_extra or {}).items()
    return Markup(", ".join(parts + [f"{escape(key)} = {escape(written(value, LONGEST))}" for key, value in extra]))


def _value(value) -> str:
    if isinstance(value, BaseModel):
        return "{ " + _table(value) + " }"
    if isinstance(value, tuple) and value and all(isinstance(item, BaseModel) for item in value):
        return "[" + ", ".join("{ " + _table(item) + " }" for item in value) + "]"
    return escape(written(value, LONGEST))


def _unit(meaning: str) -> str:
    """The unit at the end of what a key means, " mm" of "side of a square cell, mm"."""
    found = re.search(r", ([^ ,;]+)(;|$)", meaning)
    return f" {found[1]}" if found and found[1] in UNITS else ""
