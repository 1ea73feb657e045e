"""The choices that a chart tries on a scene: what each changes, which values are worth a try, what it is called.

A setting is a table of what differs from the scene as given, {"cell": 5.0, "precision": "float32"};
the empty one is the scene itself.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from jaxmpm import scene_source
from jaxmpm.errors import SceneError
from jaxmpm.scene import Scene, load_scene

Setting = Mapping[str, Any]

HALVINGS = (4.0, 2.0, 1.0, 0.5, 0.25)  # of the scene's cell: sizes that keep its edges where they are, if it does
BETWEEN = (3.0, 1.5, 4 / 3, 0.8, 0.75, 2 / 3)  # sizes between, for bodies that they fill alike
SAME_AREA = 1e-3  # relative difference up to which bodies are filled alike
MODEL = ("law", "size", "window")  # they change what is modelled, not how well
OF_POINTS = ("shape", "per_side", "transfer")  # they change nothing unless points move
OF_TOTAL = ("half",)  # they are for the total frame


@dataclass(frozen=True)
class Source:
    """Where a scene comes from, so that it can be read again with other cells.

    `name`: a bundled name or a TOML file; `overrides`: "key.path=value", as of `load_scene`.
    """

    name: str
    overrides: tuple[str, ...] = ()

    def scene(self, cell: float | None = None) -> Scene:
        """The scene, with cells of a size (mm); raises SceneError."""
        more = () if cell is None else (f"{self._cell_key()}={cell!r}",)
        return load_scene(self.name, [*self.overrides, *more])

    def _cell_key(self) -> str:
        """What sets the cell: a parameter, where the scene's other numbers may follow from it, or the key itself."""
        tree = scene_source.override(scene_source.read(scene_source.find(self.name)), self.overrides)
        cell = tree.get("grid", {}).get("cell")
        return f"parameters.{cell[1:]}" if isinstance(cell, str) and cell.startswith("$") else "grid.cell"


@dataclass(frozen=True)
class Axis:
    """One kind of choice.

    `own`: its value in a scene; `others`: those worth a try; `put`: puts a value into a scene's
    tables; `say`: a value in words, for a label; `what`: the axis in words.
    """

    what: str
    own: Callable[[Scene], Any]
    others: Callable[[Scene], Iterable[Any]]
    put: Callable[[dict, Any], None]
    say: Callable[[Any], str]


def apply(source: Source, setting: Setting) -> Scene:
    """The scene of a setting; raises SceneError where the scene does not allow it."""
    scene = source.scene(setting.get("cell"))
    tree = scene.to_dict()
    for name, axis in AXES.items():
        if name in setting:
            axis.put(tree, setting[name])
    return Scene.from_dict(tree)


def label(setting: Setting, cell: float) -> str:
    """A setting in words; `cell`: of the scene as given, mm."""
    words = [AXES[name].say(setting[name]) for name in AXES if name in setting]
    return ", ".join([f"{setting.get('cell', cell):.4g} mm", *words])


def rest(setting: Setting) -> dict[str, Any]:
    """All of a setting but its cells."""
    return {name: value for name, value in setting.items() if name != "cell"}


def flies(scene: Scene) -> bool:
    """Whether bodies move by themselves: they are thrown or have weight."""
    return any(body.velocity != (0.0, 0.0) for body in scene.bodies) or scene.gravity != (0.0, 0.0)


def key(setting: Setting) -> str:
    """A setting as text that tells it from others."""
    return ", ".join(f"{name}={setting[name]}" for name in ("cell", *AXES) if name in setting)


def cells(source: Source, finest: float = 0.0) -> tuple[list[float], dict[str, str]]:
    """The sizes of cells that a scene can be tried on, coarse to fine, mm, and why others cannot.

    Halvings and doublings of its own, and sizes between where the bodies fill as much of the grid; none below `finest`.
    """
    from jaxmpm.layout import lay_out

    own = source.scene()
    found, refused, area = [], {}, _area(lay_out(own))
    for factor in sorted((*HALVINGS, *BETWEEN), reverse=True):
        cell = own.grid.cell * factor
        whole = all(math.isclose(size / cell, round(size / cell), abs_tol=1e-6) for size in own.grid.size)
        if cell < (1 - 1e-9) * finest or not whole:
            continue
        try:
            filled = _area(lay_out(source.scene(cell)))
        except SceneError as error:
            refused[f"{cell:.4g} mm"] = str(error)
            continue
        if factor in HALVINGS or abs(filled / area - 1) < SAME_AREA:
            found.append(own.grid.cell if factor == 1.0 else cell)
    return found, refused


def _area(layout) -> float:
    return float((layout.material >= 0).sum()) * layout.cell**2


def choices(source: Source, moved: bool) -> tuple[dict[str, list], dict[str, str]]:
    """Values of each axis worth a try on a scene, and why others are not allowed.

    `moved`: whether the scene as given goes on with points that move.
    """
    scene, found, refused = source.scene(), {}, {}
    for name, axis in AXES.items():
        if name in (OF_TOTAL if moved else OF_POINTS):
            continue
        for value in axis.others(scene):
            try:
                apply(source, {name: value})
            except SceneError as error:
                refused[axis.say(value)] = str(error)
            else:
                found.setdefault(name, []).append(value)
    return found, refused


# -- what each axis changes ---------------------------------------------------------------------------


def _put_speed(tree: dict, speed: float) -> None:
    """Load `speed` times as fast."""
    loads = [*tree.get("displacements", ()), *tree.get("forces", ())]
    for load in (*loads, *([tree["macro"]] if tree.get("macro") else ())):
        history = load["history"]
        history["time"] = [time / speed for time in history["time"]]
        history["smooth_start"] /= speed
    tree["solver"]["duration"] /= speed


def _speeds(scene: Scene):
    """None where the motion itself is the matter: weight, bodies that fly or rub, equilibrium without time."""
    loads = [*scene.displacements, *scene.forces, *([scene.macro] if scene.macro else [])]
    if flies(scene) or not loads or scene.contact.kind != "stick" or scene.solver.kind == "quasistatic":
        return ()
    return (4.0, 2.0, 0.5)


def _steps(scene: Scene):
    own = scene.solver.time_step_factor
    return [value for value in (2 * own, own / 2) if value < 1.0] if scene.solver.kind == "explicit" else ()


def _put_solver(tree: dict, control: str) -> None:
    """Equilibrium, controlled by time or dissipation; what only motion needs is left out."""
    from jaxmpm.scene_check_quasistatic import OF_MOTION

    kept = {name: value for name, value in tree["solver"].items() if name not in OF_MOTION}
    tree["solver"] = kept | {"kind": "quasistatic", "control": control}


def _frames(scene: Scene):
    if scene.solver.kind != "explicit":
        return ()
    return ("total",) if scene.solver.frame == "updated" else ("updated",)


def _halves(scene: Scene):
    from jaxmpm.layout import lay_out
    from jaxmpm.layout_half import symmetries

    return symmetries(scene, lay_out(scene))


def _cracks(scene: Scene) -> bool:
    return any(material.band for material in scene.materials.values())


def _put_law(tree: dict, curve: str) -> None:
    """Cohesive bands of the same strength and fracture energy."""
    from jaxmpm.laws.damage import Damage
    from jaxmpm.laws.elastic import Elastic

    for material in tree["materials"].values():
        if (band := material.get("band")) is not None:
            law = Damage(*(band[name] for name in ("ft", "Ep", "n", "h")))
            energy = float(law.fracture_energy(Elastic(material["bulk"]["E"], material["bulk"]["nu"])))
            material["band"] = {"law": "cohesive", "curve": curve, "ft": band["ft"], "GF": energy, "h": band["h"]}


def _laws(scene: Scene):
    bands = [material.band for material in scene.materials.values() if material.band]
    return ("hordijk", "exponential") if bands and all(band.law == "damage" for band in bands) else ()


def _others(table: str, name: str, values):
    """Of one key of the scene: the values that it has not."""
    return lambda scene: [value for value in values if value != getattr(getattr(scene, table), name)]


def _key(table: str, name: str, what: str, values, say, only=lambda scene: True) -> Axis:
    """The axis of one key of the scene."""
    others = _others(table, name, values)
    return Axis(
        what,
        lambda scene: getattr(getattr(scene, table), name),
        lambda scene: others(scene) if only(scene) else (),
        lambda tree, value: tree[table].update({name: value}),
        say,
    )


def _say_speed(speed: float) -> str:
    return {0.5: "half as fast", 2.0: "twice as fast"}.get(speed, f"{speed:.3g}× as fast")


SHAPES = ("linear", "gimp", "quadratic", "cubic")
SIZES = {"projected": "H projected", "centreline": "H along the middle", "sqrt_area": "H = √area"}

AXES = {
    "solver": Axis(
        "equilibrium",
        lambda scene: scene.solver.control if scene.solver.kind == "quasistatic" else "",
        lambda scene: ("time", "dissipation") if scene.solver.kind == "explicit" else (),
        _put_solver,
        lambda control: "equilibrium" if control == "time" else f"equilibrium by {control}",
    ),
    "speed": Axis("loading rate", lambda scene: 1.0, _speeds, _put_speed, _say_speed),
    "step": Axis(
        "time step",
        lambda scene: scene.solver.time_step_factor,
        _steps,
        lambda tree, value: tree["solver"].update(time_step_factor=value),
        lambda value: f"{value:.3g} of the stable step",
    ),
    "rise": _key(
        "solver", "elastic_rise", "elastic rise", ("motion", "equilibrium"), lambda value: f"elastic rise in {value}",
        only=lambda scene: scene.solver.kind == "explicit" and _cracks(scene),
    ),
    "precision": _key("solver", "precision", "precision", ("float32", "float64"), str),
    "frame": Axis(
        "frame",
        lambda scene: scene.solver.frame,
        _frames,
        lambda tree, value: tree["solver"].update(frame=value),
        lambda value: "points that move" if value == "updated" else "total frame",
    ),
    "shape": _key("points", "shape", "shape functions", SHAPES, lambda value: f"{value} functions"),
    "per_side": _key("points", "per_side", "points in a cell", (1, 2, 3), lambda value: f"{value}×{value} points a cell"),
    "transfer": _key("points", "transfer", "transfer", ("taylor", "flip", "apic", "xpic"), lambda value: f"transfer {value}"),
    "size": _key("bands", "effective_size", "size H", SIZES, SIZES.get, only=_cracks),
    "window": _key(
        "bands", "normal_window", "normal", (1, 3, 5), lambda value: f"normal over {value}×{value} cells", only=_cracks
    ),
    "law": Axis("band law", lambda scene: "damage", _laws, _put_law, lambda curve: f"cohesive law, {curve}"),
    "half": Axis(
        "half of what is symmetric",
        lambda scene: scene.grid.half or "",
        _halves,
        lambda tree, axis: tree["grid"].update(half=axis),
        lambda axis: f"half along {axis}",
    ),
}  # fmt: skip
