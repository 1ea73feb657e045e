"""From the band tables of a scene to the one law of all its bands, parameters stacked."""

import dataclasses
import importlib
import sys

import numpy as np

from jaxmpm.errors import SceneError, did_you_mean, written
from jaxmpm.laws.cohesive import Cohesive
from jaxmpm.laws.damage import Damage

NEVER = {"law": "damage", "ft": np.inf, "Ep": 1.0, "n": 0.1, "h": 1e-3}


def stacked(materials, array):
    """The band law of a scene's materials, leaves (materials,), each an `array` of numbers.

    A material without a band has infinite strength. Raises SceneError where a law of one's own
    cannot be had, or does not take the parameters that it is given.

    Args:
        materials: tables by name; those with a band have the same law.
        array: makes an array of a list of numbers.
    """
    tables = {name: m.band.model_dump() for name, m in materials.items() if m.band}
    some = next(iter(tables.values()), NEVER)
    if "source" in some:
        cls = _own(tables, _where(next(iter(tables)), "source"))
    else:
        cls = {"damage": Damage, "cohesive": Cohesive}[some["law"]]
    rows = [tables.get(name, some | {"ft": np.inf}) for name in materials]
    values = {}
    for field in dataclasses.fields(cls):
        if field.metadata.get("static"):
            values[field.name] = some.get(field.name, field.default)
        else:
            values[field.name] = array([row[field.name] for row in rows])
    return cls(**values)


def _own(tables, where):
    """The class that a scene names as module:class."""
    source = next(iter(tables.values()))["source"]
    module, _, name = source.partition(":")
    path = list(sys.path)
    sys.path.insert(0, "")  # a module beside the scene that one runs
    try:
        cls = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise SceneError(
            f"{where} = {written(source)}: expected a module on the Python path and a class in "
            f"it ({error})"
        ) from error
    finally:
        sys.path[:] = path
    if not dataclasses.is_dataclass(cls):
        raise SceneError(f"{where} = {written(source)}: expected a class made with @law")
    _check_parameters(cls, tables)
    return cls


def _check_parameters(cls, tables):
    fields = [field.name for field in dataclasses.fields(cls) if not field.metadata.get("static")]
    lines = []
    for name, table in tables.items():
        given = set(table) - {"law", "source"}
        for key in sorted(given - set(fields)):
            near = did_you_mean(key, fields)
            advice = f" (did you mean {near}?)" if near else ""
            known = ", ".join(fields)
            lines.append(
                f"{_where(name, key)} = {written(table[key])}: expected one of the parameters of "
                f"{cls.__name__}, {known}{advice}"
            )
        for key in sorted(set(fields) - given):
            lines.append(f"{_where(name, key)}: absent, expected a parameter of {cls.__name__}")
    if lines:
        raise SceneError(lines)


def _where(material, key):
    return f"materials.{material}.band.{key}"

