"""Numbers of a scene's materials in its `Model`, by name: "concrete.ft".

They are leaves of the model, so a function of them can be compiled once, mapped and differentiated.
"""

import dataclasses

import jax.numpy as jnp

from jaxmpm import model as models
from jaxmpm.errors import SceneError, near_or


class OfMaterials:
    """What has a model by names of its materials: `model`, `named` (the model before what is local made one of every
    cell), `local` (what is, or None) and `materials` (names, in order)."""

    def with_values(self, values) -> models.Model:
        """The model with other numbers of its materials, by name: {"concrete.ft": 3.1}."""
        return models.with_local(with_values(self.named, self.materials, values), self.local)

    def values(self, names) -> dict:
        """Numbers of the scene's materials by name."""
        return values_of(self.named, self.materials, names)

    def by_cells(self):
        """The same run with every cell a material of its own, its parameters leaves (cells,), cells in order.

        For the derivative by a field: one run in reverse says what each cell would do for the answer.
        """
        return dataclasses.replace(self, model=models.by_cells(self.model), materials=())


def names_of(model, materials) -> list[str]:
    """All names that `with_values` knows; `materials` names the model's materials in order."""
    rows = ["density", *_leaves(model.embedding.bulk), *_leaves(model.embedding.law)]
    return [f"{material}.{name}" for material in materials for name in rows]


def values_of(model, materials, names) -> dict:
    """The numbers of these names, as they stand in a model."""
    found = {}
    for name in names:
        row, leaf = _parsed(model, materials, name)
        found[name] = getattr(_part(model, leaf), leaf)[row]
    return found


def with_values(model, materials, values):
    """A model with other numbers.

    Args:
        model: `jaxmpm.model.Model`.
        materials: names of its materials, in order.
        values: numbers by name, MPa, mm, N/mm, tonne/mm³; may be traced.

    Raises:
        SceneError: a name that is none of the model's.
    """
    for name, value in values.items():
        row, leaf = _parsed(model, materials, name)
        part = _part(model, leaf)
        column = getattr(part, leaf)
        changed = dataclasses.replace(part, **{leaf: column.at[row].set(jnp.asarray(value).astype(column.dtype))})
        if part is model:
            model = changed
            continue
        which = "bulk" if part is model.embedding.bulk else "law"
        embedding = dataclasses.replace(model.embedding, **{which: changed})
        model = dataclasses.replace(model, embedding=embedding)
    return model


def _leaves(part):
    return [f.name for f in dataclasses.fields(part) if not f.metadata.get("static")]


def _part(model, leaf):
    if leaf == "density":
        return model
    return model.embedding.bulk if leaf in _leaves(model.embedding.bulk) else model.embedding.law


def _parsed(model, materials, name):
    known = names_of(model, materials)
    if name not in known:
        raise SceneError(f"{name}: no parameter of the model ({near_or(name, known)})")
    material, _, leaf = name.rpartition(".")
    return list(materials).index(material), leaf
