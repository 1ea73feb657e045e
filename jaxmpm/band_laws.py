"""From the band tables of a scene to the one law of all its bands, parameters stacked."""

import dataclasses

import numpy as np

from jaxmpm import own_law
from jaxmpm.laws.cohesive import Cohesive
from jaxmpm.laws.damage import Damage

NEVER = {"law": "damage", "ft": np.inf, "Ep": 1.0, "n": 0.1, "h": 1e-3}


def stacked(materials, grid, bands, array):
    """The band law of a scene's materials, leaves (materials,), each an `array` of numbers.

    A material without a band has infinite strength. Raises SceneError where a law of one's own
    cannot be had, or is not what a band law is.

    Args:
        materials: tables by name; those with a band have the same law.
        grid, bands: those tables of the scene.
        array: makes an array of a list of numbers.
    """
    tables = {name: m.band.model_dump() for name, m in materials.items() if m.band}
    some = next(iter(tables.values()), NEVER)
    if "source" in some:
        cls = own_law.law_of(some["source"], next(iter(tables)))
        tables = own_law.parameters(cls, tables)
        own_law.check(cls, tables, materials, grid, bands)
    else:
        cls = {"damage": Damage, "cohesive": Cohesive}[some["law"]]
    some = next(iter(tables.values()), NEVER)
    rows = [tables.get(name, some | {"ft": np.inf}) for name in materials]
    values = {}
    for field in dataclasses.fields(cls):
        if field.metadata.get("static"):
            values[field.name] = some.get(field.name, field.default)
        else:
            values[field.name] = array([row[field.name] for row in rows])
    return cls(**values)
