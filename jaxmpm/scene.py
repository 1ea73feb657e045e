"""What to simulate: a typed, checked scene, read from TOML (mm, N, MPa, s, tonne)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator

from jaxmpm import scene_check, scene_source
from jaxmpm.errors import SceneError, written
from jaxmpm.load_history import History
from jaxmpm.macro import Macro, MeanStrainGauge, MeanStressGauge
from jaxmpm.materials import Material
from jaxmpm.mesostructure.image import find_image
from jaxmpm.mesostructure.tables import Mesostructure
from jaxmpm.reference import Reference, find_reference
from jaxmpm.shapes import Number, Pair, Positive, Shape, Table, cosines

Count = Annotated[int, Field(strict=True)]
Direction = Annotated[
    Literal["x", "y"] | Number, Field(description="an axis, or an angle from the x axis in degrees")
]
Shapes = Annotated[tuple[Shape, ...], Field(min_length=1)]
Share = Annotated[Number, Field(gt=0.0, le=1.0)]
SetName = Annotated[str, Field(description="name of a node set")]


def direction_cosines(direction: str | float) -> tuple[float, float]:
    """Unit vector of a direction, "x", "y" or an angle in degrees from the x axis."""
    return cosines({"x": 0.0, "y": 90.0}.get(direction, direction))


Edge = Annotated[
    Literal["stop", "open", "slip", "stick"],
    Field(
        description="stop: the run stops before a point leaves; open: points leave and are counted; "
        "slip: no motion across; stick: no motion"
    ),
]


class Walls(Table):
    """What the edges of the grid do to points that move."""

    left: Edge = "stop"
    right: Edge = "stop"
    bottom: Edge = "stop"
    top: Edge = "stop"


class Grid(Table):
    """The Cartesian grid."""

    size: tuple[Positive, Positive] = Field(description="extent [x, y] of the grid, mm")
    origin: Pair = Field((0.0, 0.0), description="lower left corner [x, y] of the grid, mm")
    cell: Positive = Field(description="side of a square cell, mm")
    stress_state: Literal["plane_stress", "plane_strain"] = Field(description="the stress state")
    thickness: Positive = Field(description="thickness out of the plane, mm")
    walls: Walls = Field(Walls(), description="what the edges of the grid do to points that move")
    half: Literal["x", "y"] | None = Field(
        None,
        description="model half of a scene that is symmetric about the middle of the grid, that at larger coordinates "
        "along this axis; answers are those of the whole (total frame)",
    )

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells along x and y."""
        return round(self.size[0] / self.cell), round(self.size[1] / self.cell)


class Body(Table):
    """A part of the scene; later bodies replace earlier ones where they overlap."""

    name: str = Field(description="name of the body")
    material: str = Field(description="name of a material")
    shapes: Shapes = Field(description="what the body covers, the union of these")
    minus: tuple[Shape, ...] = Field((), description="what is cut out of it")
    velocity: Pair = Field((0.0, 0.0), description="initial velocity [x, y], mm/s")


class NodeSet(Table):
    """Nodes of filled cells, chosen by where they are."""

    on: Literal["all", "boundary"] = Field(
        "all", description="any node of a filled cell, or only those that touch fewer than 4"
    )
    inside: Shapes = Field(description="where the nodes are, the union of these, edges included")
    outside: tuple[Shape, ...] = Field((), description="where they are not, edges included")


class Support(Table):
    """Nodes that do not move."""

    set: SetName
    fix: tuple[Literal["x", "y"], ...] = Field(min_length=1, description="components held at zero")


class Displacement(Table):
    """Nodes that are moved; an axis leaves the other component free, an angle leaves none."""

    set: SetName
    direction: Direction
    history: History = Field(description="displacement against time, mm")


class Force(Table):
    """Nodes that are pulled."""

    set: SetName
    direction: Direction
    kind: Literal["force", "traction"] = Field(
        description="force: total in N; traction: MPa on the boundary edges within the set"
    )
    history: History = Field(description="force against time, N or MPa")


class ReactionGauge(Table):
    """Sum of the reactions of a set's prescribed nodes, N."""

    kind: Literal["reaction"]
    set: SetName
    direction: Direction


class DisplacementGauge(Table):
    """Mean displacement of a set, mm."""

    kind: Literal["displacement"]
    set: SetName
    direction: Direction


class RelativeGauge(Table):
    """Displacement of a second point less that of a first, mm."""

    kind: Literal["relative_displacement"]
    points: tuple[Pair, Pair] = Field(description="first and second point [x, y], mm")
    direction: Direction


AnyGauge = Annotated[
    ReactionGauge | DisplacementGauge | RelativeGauge | MeanStressGauge | MeanStrainGauge,
    Field(discriminator="kind"),
]


class Response(Table):
    """Which gauges make the response curve."""

    load: str = Field(description="name of a reaction or mean stress gauge")
    displacement: str = Field(description="name of a displacement or mean strain gauge")
    reference: Reference | None = Field(
        None, description="what was measured, a CSV file beside the scene or its numbers"
    )


class Bands(Table):
    """How bands sit in their cells."""

    effective_size: Literal["projected", "centreline", "sqrt_area"] = Field(
        "projected", description="how the effective size H of a cracked cell is measured"
    )
    normal_window: Annotated[Count, Field(ge=1)] = Field(
        5, description="odd: cells each way over which stress is averaged for the normal"
    )
    release: Annotated[Number, Field(ge=0.0)] = Field(
        1.0,
        description="exponent p of the release of crack-parallel stress with the band's cohesion "
        "to the power p; 0 keeps that stress",
    )
    closes: bool = Field(
        False,
        strict=True,
        description="whether a closed crack carries compression with the stiffness of the bulk",
    )

    @field_validator("normal_window")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError("an odd number, so that the window has a middle cell")
        return value


class Points(Table):
    """How points move through the grid."""

    per_side: Annotated[Count, Field(ge=1, le=8)] = Field(
        2, description="points along each side of a cell"
    )
    fill: Literal["cells", "shapes"] = Field(
        "cells",
        description="cells: as many in every cell that the total frame fills; shapes: where the shapes "
        "cover, which follows curved edges (frame updated only)",
    )
    shape: Literal["linear", "gimp", "quadratic", "cubic"] = Field(
        "gimp", description="shape functions of the grid"
    )
    transfer: Literal["taylor", "flip", "apic", "xpic"] = Field(
        "taylor", description="how velocities go to the grid and back"
    )
    flip: Annotated[Number, Field(ge=0.0, le=1.0)] = Field(
        1.0, description="share of FLIP in taylor and flip, the rest is PIC, dimensionless"
    )
    xpic_order: Annotated[Count, Field(ge=1, le=10)] = Field(2, description="order m of XPIC(m)")
    fmpm_order: Annotated[Count, Field(ge=1, le=4)] = Field(
        1,
        description="how much of the consistent mass increments of velocity solve for: 1 none (lumped), "
        "2 suits cubic functions (not in xpic)",
    )
    order: Literal["usf", "usl", "musl"] = Field(
        "usl", description="when stresses are updated: first, last, or last by velocities mapped anew"
    )


class Contact(Table):
    """How bodies meet that move."""

    kind: Literal["stick", "friction"] = Field(
        "stick",
        description="stick: through the grid, without slip; friction: each in a velocity field of its own",
    )
    between: Literal["bodies", "fragments"] = Field(
        "bodies", description="what has a field of its own; fragments are found at the hand-over"
    )
    friction: Annotated[Number, Field(ge=0.0)] = Field(
        0.3, description="coefficient of friction, dimensionless"
    )


class Solver(Table):
    """How time is stepped."""

    kind: Literal["explicit", "quasistatic"] = Field(
        "explicit",
        description="explicit: the motion, step by step; quasistatic: equilibrium under loads whose histories' time is "
        "no more than a load factor (total frame, or updated: large slow deformation)",
    )
    control: str = Field(
        "time",
        description="what quasistatic increments prescribe once something cracks: time: the loads; dissipation: the "
        "energy that bands dissipate; or the name of a displacement gauge",
    )
    tolerance: Positive = Field(
        1e-6,
        description="out-of-balance strain of quasistatic equilibrium, over the strain at onset, dimensionless; of points that "
        "move force, over that of the strength on the side of a cell, or over the largest on a node",
    )
    first_increment: Share = Field(0.005, description="first quasistatic increment over the duration, dimensionless")
    smallest_increment: Share = Field(1e-6, description="smallest, over the duration, dimensionless")
    largest_increment: Share = Field(0.02, description="largest, over the duration, dimensionless")
    frame: Literal["auto", "total", "updated"] = Field(
        "auto",
        description="total: a body that hardly moves; updated: points that move; auto: total until "
        "the motion asks for updated",
    )
    hand_over_gradient: Positive = Field(
        0.005,
        description="displacement gradient of an uncracked cell at which auto hands over, dimensionless",
    )
    hand_over_displacement: Positive | None = Field(
        None, description="displacement at which auto hands over, mm; a cell if left out"
    )
    duration: Positive = Field(description="time to simulate, s")
    time_step_factor: Annotated[Number, Field(gt=0.0, lt=1.0)] = Field(
        0.9, description="time step over the largest stable one, dimensionless"
    )
    elastic_rise: Literal["motion", "equilibrium"] = Field(
        "motion",
        description="how all that happens before the first crack is passed: motion: step by step; equilibrium: at once, by one "
        "elastic solution, where loads are slow",
    )
    damping: Annotated[Number, Field(ge=0.0, lt=1.0)] = Field(
        0.02, description="local damping coefficient, dimensionless"
    )
    viscosity: Annotated[Number, Field(ge=0.0, le=1.0)] = Field(
        0.0,
        description="viscosity of uncracked cells in the total frame, as a share of critical damping "
        "at the highest frequency, dimensionless; unlike damping it has a derivative",
    )
    precision: Literal["float64", "float32"] = Field("float64", description="of all numbers")
    energy_error_limit: Positive | None = Field(
        None,
        description="energy error that stops a run, relative to the most energy met so far; if left out "
        "0.05, and 0.2 for what points that move lose to the grid",
    )
    gradient_limit: Positive = Field(
        0.02,
        description="largest displacement gradient of an uncracked cell that the total frame "
        "accepts, dimensionless",
    )


class Output(Table):
    """How much is written."""

    samples: Annotated[Count, Field(ge=2)] = Field(400, description="rows of history.csv")
    frames: Annotated[Count, Field(ge=2)] = Field(20, description="frames of result.vtkhdf")


class Scene(Table):
    """A whole scene."""

    name: str = Field("", description="short name; the file's name where the scene gives none")
    title: str = Field(description="one line on what the scene shows")
    parameters: dict[str, Number] = Field({}, description='numbers used elsewhere as "$name"')
    grid: Grid = Field(description="the grid")
    materials: dict[str, Material] = Field(min_length=1, description="materials by name")
    bodies: tuple[Body, ...] = Field(min_length=1, description="what fills the grid")
    mesostructure: Mesostructure | None = Field(
        None, description="inclusions and their interface in a body, or an image of them"
    )
    sets: dict[str, NodeSet] = Field({}, description="node sets by name")
    supports: tuple[Support, ...] = Field((), description="what is held")
    displacements: tuple[Displacement, ...] = Field((), description="what is moved")
    forces: tuple[Force, ...] = Field((), description="what is pulled")
    macro: Macro | None = Field(None, description="how the mean strain of a representative volume is driven")
    gauges: dict[str, AnyGauge] = Field({}, description="what is measured, by name")
    response: Response | None = Field(None, description="the gauges of the response curve")
    gravity: Pair = Field((0.0, 0.0), description="acceleration [x, y], mm/s2")
    bands: Bands = Field(Bands(), description="how bands sit in their cells")
    points: Points = Field(Points(), description="how points move through the grid")
    contact: Contact = Field(Contact(), description="how bodies meet that move")
    solver: Solver = Field(description="how time is stepped")
    output: Output = Field(Output(), description="how much is written")

    @classmethod
    def from_dict(cls, tree: dict[str, Any]) -> "Scene":
        """The scene of nested tables; raises one SceneError that lists everything wrong with it."""
        if not isinstance(tree, dict):
            raise SceneError(f"scene = {written(tree)}: expected a table of tables")
        resolved, problems = scene_source.resolve(tree)
        scene = None
        try:
            scene = cls.model_validate(resolved)
        except ValidationError as error:
            scene_check.explain(error.errors(), cls.model_json_schema(), problems)
        scene_check.check(resolved, problems)
        problems.raise_any()
        if scene is None:
            raise SceneError("scene: expected tables as the README describes them")
        return scene

    def to_dict(self) -> dict[str, Any]:
        """The scene as tables ready for JSON, parameters replaced; `from_dict` takes it back."""
        return self.model_dump(mode="json", exclude_none=True)

    def _repr_html_(self) -> str:
        from jaxmpm.scene_html import scene_html

        return scene_html(self)


def load_scene(source: str | Path, overrides: Sequence[str] | Mapping[str, Any] = ()) -> Scene:
    """The scene of a bundled name or a TOML file, with changes put in.

    `overrides`: "key.path=value" each, as on the command line, or values by "key.path": {"grid.cell": 2.5}.
    Raises SceneError, one line for each thing wrong.
    """
    path = scene_source.find(source)
    tree = scene_source.override(scene_source.read(path), overrides)
    tree.setdefault("name", path.stem)
    scene_source.find_own_laws(tree, path.parent)
    find_reference(tree, path.parent)
    find_image(tree, path.parent)
    return Scene.from_dict(tree)


def scene_names() -> dict[str, str]:
    """The bundled scenes, name to title."""
    found = scene_source.bundled().items()
    return {name: str(scene_source.read(path).get("title", "")) for name, path in found}
