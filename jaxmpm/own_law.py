"""A band law of one's own: from a file or a module, and checked before anything runs."""

import dataclasses
import importlib
import importlib.util
import math
import os
import sys

import jax
import numpy as np

from jaxmpm.errors import SceneError, did_you_mean, written
from jaxmpm.laws.elastic import Elastic
from jaxmpm.scene_check import largest_cell

METHODS = ("onset", "effective", "soften", "stored", "given_up", "largest_size")
SOFTENINGS = np.array([0.0, 1e-3, 0.1, 1.0, 5.0, 20.0])  # where the curve is looked at


def law_of(source, material):
    """The class that a scene names as file.py:Class or module:Class."""
    where = f"{_where(material, 'source')} = {written(source)}"
    place, _, name = source.rpartition(":")
    try:
        if place.endswith(".py"):
            spec = importlib.util.spec_from_file_location("own_law_" + os.path.basename(place)[:-3], place)
            module = importlib.util.module_from_spec(spec)
            sys.modules[spec.name] = module
            spec.loader.exec_module(module)
        else:
            module = importlib.import_module(place)
    except Exception as error:  # whatever the code of a user does when it is read
        raise SceneError(f"{where}: expected Python code that can be read ({_said(error)})") from error
    cls = getattr(module, name, None)
    if cls is None or not dataclasses.is_dataclass(cls):
        near = did_you_mean(name, vars(module))
        hint = f" (did you mean {near}?)" if near and near != name else ""
        raise SceneError(f"{where}: expected a class made with @law in it{hint}")
    lacks = [method for method in METHODS if not callable(getattr(cls, method, None))]
    if lacks:
        raise SceneError(f"{where}: expected methods {', '.join(lacks)} too (see jaxmpm/laws/law.py)")
    fields = {field.name for field in dataclasses.fields(cls)}
    if not {"ft", "h"} <= fields:
        raise SceneError(f"{where}: expected parameters ft and h among those of {name}")
    return cls


def parameters(cls, tables):
    """Parameters of each material by name, defaults filled in."""
    numbers = [f for f in dataclasses.fields(cls) if not f.metadata.get("static")]
    known = [field.name for field in numbers]
    lines, found = [], {}
    for name, table in tables.items():
        given = {k: v for k, v in table.items() if k not in ("law", "source", "digest")}
        for key in sorted(set(given) - set(known)):
            near = did_you_mean(key, known)
            advice = f" (did you mean {near}?)" if near else ""
            lines.append(
                f"{_where(name, key)} = {written(given[key])}: expected one of the parameters of "
                f"{cls.__name__}, {', '.join(known)}{advice}"
            )
        for field in numbers:
            if field.name not in given and field.default is dataclasses.MISSING:
                lines.append(f"{_where(name, field.name)}: absent, expected a parameter of {cls.__name__}")
            given.setdefault(field.name, field.default)
        found[name] = given
    if lines:
        raise SceneError(lines)
    return found


def check(cls, tables, materials, grid, bands):
    """Try the law of every material: its curve softens, its energy grows, its cells are not too large."""
    for name, table in tables.items():
        where = f"materials.{name}.band: expected of {cls.__name__}"
        given = ", ".join(f"{key} = {written(value)}" for key, value in table.items())
        law = cls(**{key: np.float64(value) for key, value in table.items()})
        bulk = Elastic(materials[name].bulk.E, materials[name].bulk.nu)
        p = SOFTENINGS
        try:
            ratio, integrity = (np.asarray(a) for a in law.soften(jax.numpy.asarray(p), bulk))
            spent = np.asarray(law.given_up(jax.numpy.asarray(p), bulk))
            largest = float(law.largest_size(bulk))
        except Exception as error:  # whatever the code of a user does when it is run
            raise SceneError(f"{where} methods as jaxmpm/laws/law.py has them ({_said(error)})") from error
        right = {
            "soften(p, bulk) to give r̂ = s = 1 at p = 0": np.allclose([ratio[0], integrity[0]], 1),
            "soften(p, bulk) to give a finite r̂ > 0 and an s that falls from 1 towards 0": (
                np.isfinite(ratio).all() and (ratio > 0).all() and np.isfinite(integrity).all()
                and (np.diff(integrity) <= 0).all() and 0 <= integrity[-1] < 1
            ),
            "given_up(p, bulk) to grow from 0": (
                np.isfinite(spent).all() and abs(spent[0]) < 1e-12 and (np.diff(spent) >= -1e-12).all()
            ),
            "largest_size(bulk) to be a number > 0": math.isfinite(largest) and largest > 0,
        }  # fmt: skip
        for what, holds in right.items():
            if not holds:
                raise SceneError(f"{where} {what} (with {given})")
        limit = largest_cell(largest, bands.effective_size)
        if grid.cell > limit:
            raise SceneError(
                f"grid.cell = {grid.cell:g}: expected at most {limit:.4g} mm with materials.{name}, "
                f"whose bands snap back beyond {cls.__name__}.largest_size = {largest:.5g} mm"
            )


def _said(error):
    return f"{type(error).__name__}: {error}".splitlines()[0]


def _where(material, key):
    return f"materials.{material}.band.{key}"
