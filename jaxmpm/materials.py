"""Materials of a scene as tables: the bulk, and the band that a crack in it becomes."""

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from jaxmpm.mesostructure.tables import Scatter
from jaxmpm.shapes import Number, Positive, Table


class Elastic(Table):
    """Linear elastic bulk."""

    law: Literal["elastic"] = Field(description="law of the bulk")
    E: Positive = Field(description="Young's modulus, MPa")
    nu: Number = Field(gt=-1.0, lt=0.5, description="Poisson's ratio, dimensionless")


class NeoHookean(Table):
    """Elastic bulk for large strains, for points that move."""

    law: Literal["neo_hookean"] = Field(description="law of the bulk")
    E: Positive = Field(description="Young's modulus at small strain, MPa")
    nu: Number = Field(gt=-1.0, lt=0.5, description="Poisson's ratio at small strain, dimensionless")


AnyBulk = Annotated[Elastic | NeoHookean, Field(discriminator="law")]


class Damage(Table):
    """The damage law of the localisation band (Nguyen, Eqs. 11-13)."""

    law: Literal["damage"] = Field(description="law of the band")
    ft: Positive = Field(description="tensile strength, MPa")
    Ep: Positive = Field(description="softening modulus at onset, MPa")
    n: Number = Field(
        gt=0.0,
        lt=0.5,
        description="exponent of softening, dimensionless; from 0.5 on the dissipation is infinite",
    )
    h: Positive = Field(description="width of the band, mm")


class Cohesive(Table):
    """A traction-separation law in a thin band, mixed mode."""

    law: Literal["cohesive"] = Field(description="law of the band")
    ft: Positive = Field(description="tensile strength, MPa")
    GF: Positive = Field(description="fracture energy, N/mm")
    curve: Literal["linear", "bilinear", "exponential", "hordijk"] = Field(
        "exponential", description="the softening curve; bilinear is Petersson's"
    )
    beta: Positive = Field(1.0, description="shear strength over tensile strength, dimensionless")
    h: Positive = Field(description="width of the band, mm; small against the cell")


class OwnLaw(Table):
    """A band law from Python code of one's own; its parameters are further keys."""

    model_config = ConfigDict(extra="allow", frozen=True)
    __pydantic_extra__: dict[str, Number]

    law: Literal["own"] = Field(description="law of the band")
    source: str = Field(
        pattern=r"^[^:]+:\w+$",
        description='file beside the scene, or module, and class: "my_laws.py:LinearBand"',
    )
    digest: str = Field("", description="of the text of the file; the program puts it in")
    ft: Positive = Field(description="tensile strength, MPa")
    h: Positive = Field(description="width of the band, mm")


AnyBand = Annotated[Damage | Cohesive | OwnLaw, Field(discriminator="law")]


class Material(Table):
    """A material: its bulk, and the band that a crack in it becomes."""

    density: Positive = Field(description="density, tonne/mm3; concrete is 2.4e-9")
    bulk: AnyBulk = Field(description="law of the bulk")
    band: AnyBand | None = Field(None, description="law of the band; without one it never cracks")
    scatter: Scatter | None = Field(None, description="how its strength varies from place to place")
