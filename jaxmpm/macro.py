"""A representative volume: its mean strain is driven, its mean stress measured.

The mean strain xx, yy, xy follows a history; components that are not named are free, and their mean
stress stays zero. By "edges" the displacement of the edges is that of the mean strain, as between
stiff platens without friction where another component is free; "periodic" ties opposite edges.
"""

from typing import Literal

from pydantic import Field

from jaxmpm.load_history import History
from jaxmpm.shapes import Number, Table

COMPONENTS = ("xx", "yy", "xy")
Component = Literal["xx", "yy", "xy"]


class MeanStrain(Table):
    """Components of the mean strain, xy the engineering shear, per unit of the history."""

    xx: Number | None = Field(None, description="mean strain along x, free if left out")
    yy: Number | None = Field(None, description="mean strain along y, free if left out")
    xy: Number | None = Field(None, description="mean engineering shear strain, free if left out")

    def driven(self) -> dict[str, float]:
        """The components that are driven."""
        return {name: getattr(self, name) for name in COMPONENTS if getattr(self, name) is not None}


class Macro(Table):
    """How the mean strain of a representative volume is driven."""

    boundary: Literal["edges", "periodic"] = Field(
        "edges",
        description="edges: move as the mean strain says; periodic: opposite edges move alike but for it",
    )
    strain: MeanStrain = Field(description="which components are driven, and by how much")
    history: History = Field(description="factor on them against time")


class MeanStressGauge(Table):
    """Mean stress of the volume, MPa."""

    kind: Literal["mean_stress"]
    component: Component = Field(description="component of the stress")


class MeanStrainGauge(Table):
    """Mean strain of the volume, dimensionless; xy is the engineering shear."""

    kind: Literal["mean_strain"]
    component: Component = Field(description="component of the strain")
