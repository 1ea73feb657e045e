"""The tables of a scene that say what a body is made of below the size of a specimen.

A size d is the diameter of the circle of the same area, whatever the shape, and shares of a grading
are by area: in the plane a curve that was measured by mass is taken as one of areas.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from jaxmpm.shapes import Number, Positive, Table

Whole = Annotated[int, Field(strict=True)]
Aspect = Annotated[Number, Field(ge=1.0, le=10.0)]
Seed = Annotated[Whole, Field(ge=0)]


class Fuller(Table):
    """Fuller's grading: the share P(d) = (d^q - d_min^q) / (d_max^q - d_min^q) is smaller than d."""

    kind: Literal["fuller"]
    smallest: Positive = Field(description="smallest size d_min, mm")
    largest: Positive = Field(description="largest size d_max, mm")
    exponent: Positive = Field(0.5, description="exponent q, dimensionless")

    @field_validator("largest")
    @classmethod
    def _ordered(cls, value, info: ValidationInfo):
        smallest = info.data.get("smallest", value)
        if value < smallest:
            raise ValueError(f"no less than smallest = {smallest:g} mm")
        return value

    def share_below(self, size):
        """Share by area of what is smaller than `size`, mm."""
        low, high, q = self.smallest, self.largest, self.exponent
        if low == high:
            return (np.asarray(size) >= low).astype(float)
        return (np.clip(size, low, high) ** q - low**q) / (high**q - low**q)

    def size_at(self, share):
        """The size, mm, that a `share` is smaller than."""
        low, high = self.smallest**self.exponent, self.largest**self.exponent
        return (low + np.asarray(share) * (high - low)) ** (1.0 / self.exponent)


class Sieve(Table):
    """A sieve curve, straight between its points."""

    kind: Literal["sieve"]
    size: tuple[Positive, ...] = Field(min_length=2, description="sizes that increase, mm")
    passing: tuple[Annotated[Number, Field(ge=0.0, le=1.0)], ...] = Field(
        min_length=2, description="share by area that passes each, 0 at the first to 1 at the last"
    )

    @field_validator("size")
    @classmethod
    def _increasing(cls, size):
        if any(b <= a for a, b in zip(size, size[1:], strict=False)):
            raise ValueError("sizes that increase")
        return size

    @field_validator("passing")
    @classmethod
    def _rises(cls, passing, info: ValidationInfo):
        size = info.data.get("size", passing)
        if len(passing) != len(size):
            raise ValueError(f"as many shares as there are sizes, {len(size)}")
        falls = any(b < a for a, b in zip(passing, passing[1:], strict=False))
        if passing[0] != 0.0 or passing[-1] != 1.0 or falls:
            raise ValueError("shares that rise from 0 to 1")
        return passing

    @property
    def smallest(self) -> float:
        """Smallest size, mm."""
        return self.size[0]

    @property
    def largest(self) -> float:
        """Largest size, mm."""
        return self.size[-1]

    def share_below(self, size):
        """Share by area of what is smaller than `size`, mm."""
        return np.interp(size, self.size, self.passing)

    def size_at(self, share):
        """The size, mm, that a `share` is smaller than."""
        return np.interp(share, self.passing, self.size)


class Circle(Table):
    """Discs."""

    kind: Literal["circle"]


class Ellipse(Table):
    """Ellipses at random angles, drawn as polygons of 36 corners of the same area."""

    kind: Literal["ellipse"]
    aspect: Aspect = Field(1.5, description="long over short axis, dimensionless")


class Polygon(Table):
    """Convex polygons at random angles, their corners at irregular places of an ellipse."""

    kind: Literal["polygon"]
    corners: tuple[Annotated[Whole, Field(ge=3, le=36)], Annotated[Whole, Field(ge=3, le=36)]] = Field(
        (5, 9), description="fewest and most corners"
    )
    irregularity: Annotated[Number, Field(ge=0.0, le=1.0)] = Field(
        0.5, description="how far corners may move along the ellipse, from 0, evenly spread, to 1, until they nearly meet"
    )
    aspect: Aspect = Field(1.2, description="long over short axis of the ellipse, dimensionless")

    @field_validator("corners")
    @classmethod
    def _ordered(cls, corners):
        if corners[1] < corners[0]:
            raise ValueError("the fewest corners before the most")
        return corners


class Inclusions(Table):
    """Inclusions placed at random, the largest first."""

    fraction: Annotated[Number, Field(gt=0.0, le=0.8)] = Field(
        description="area of all inclusions over that of the rectangle around the body"
    )
    grading: Annotated[Fuller | Sieve, Field(discriminator="kind")] = Field(
        description="the sizes, diameters of circles of the same area"
    )
    shape: Annotated[Circle | Ellipse | Polygon, Field(discriminator="kind")] = Field(
        Circle(kind="circle"), description="the shape"
    )
    gap: Annotated[Number, Field(ge=0.0)] = Field(
        0.0, description="least distance between inclusions, mm; inside also from the edges"
    )
    edges: Literal["inside", "periodic"] = Field(
        "inside",
        description="of the rectangle around the body. inside: whole inclusions, as in a mould; "
        "periodic: what an edge cuts goes on at the opposite one, as in a piece of something larger",
    )


class LabelImage(Table):
    """A segmented picture, such as a slice of a scan, stretched over the rectangle around the body."""

    file: str = Field(
        pattern=r"(?i)\.(png|npy)$",
        description="PNG or NumPy file beside the scene; its first row is at the top",
    )
    labels: dict[Annotated[str, Field(pattern=r"^-?\d+$")], str] = Field(
        min_length=1, description='material of each grey value: {"0" = "mortar", "255" = "stone"}'
    )
    digest: str = Field("", description="of the file; the program puts it in")


class Mesostructure(Table):
    """What a body is made of: inclusions and their interface in the body's material, or an image."""

    body: str = Field(description="name of the body; its material is the matrix")
    inclusions: Inclusions | None = Field(None, description="inclusions to be placed")
    inclusion: str = Field("", description="name of the inclusions' material")
    interface: str = Field("", description="name of the material around every inclusion, if any")
    interface_thickness: Positive | None = Field(None, description="of the interface, mm")
    image: LabelImage | None = Field(None, description="an image instead of inclusions")
    sampling: Literal["centre", "mixed"] = Field(
        "centre",
        description="centre: a cell is what its middle is; mixed: its bulk is the mean of its parts, its "
        "band that of the interface where the middle of that layer crosses it (for layers thinner than a cell)",
    )
    seed: Seed = Field(0, description="of the random placing; another seed, another structure")


class Scatter(Table):
    """Strength that varies from place to place: f_t times a field of mean 1, G_F times its square.

    So the curve of softening keeps its shape and the characteristic length E G_F / f_t² its value.
    In the law of damage G_F follows by itself, as E_p and n stay.
    """

    modulus: Annotated[Number, Field(ge=1.0)] = Field(
        description="Weibull modulus m of the strength, dimensionless; coefficient of variation about 1.2/m"
    )
    length: Annotated[Number, Field(ge=0.0)] = Field(
        description="distance at which the correlation has fallen to 1/e, mm: the field is the same on "
        "any grid; 0: every cell a draw of its own, another one on another grid"
    )
    seed: Seed = Field(0, description="of the random field")
