"""From a laid-out scene to a `Model` (arrays and parameters) and its first `State`.

`Model` and `State` are pytrees. Everything one may want to fit (E, ν, f_t, E_p, n, h, density,
loads) is a leaf of the model and can be differentiated; what changes a shape or a branch is
static.
"""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import band_laws, bands, grid, periodic, tensor
from jaxmpm.bands import Pool
from jaxmpm.errors import SceneError
from jaxmpm.laws.band import Embedding
from jaxmpm.laws.elastic import Elastic
from jaxmpm.layout import Drive
from jaxmpm.loads import Load
from jaxmpm.macro import COMPONENTS
from jaxmpm.scene_check import largest_cell


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Gauge:
    """A measured number: the weighted sum of a nodal field over some degrees of freedom."""

    dofs: jax.Array
    weights: jax.Array
    reaction: bool = field(metadata={"static": True})  # of the reaction, else of displacement


@dataclass(frozen=True)
class Numerics:
    """What is fixed when the step is compiled."""

    cell: float  # mm
    thickness: float  # mm
    size: int  # length of a strain vector
    effective_size: str  # rule for H
    normal_window: int  # cells over which the onset stress is averaged
    cracks: bool  # some material has a band; without one nothing of bands is compiled
    half: int | None = None  # axis along which this is half of a symmetric scene, whose plane is the low edge


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Model:
    """A scene as arrays and parameters."""

    embedding: Embedding  # laws of every material, leaves (materials,)
    density: jax.Array  # tonne/mm³, (materials,)
    damping: jax.Array | None  # local damping coefficient
    viscosity: jax.Array | None  # share of critical damping at the highest frequency
    gravity: jax.Array  # (2,), mm/s²
    material: jax.Array  # material of every cell, -1 where empty, (nx, ny)
    free: jax.Array  # 1 where a degree of freedom may move by itself, (2, nx+1, ny+1)
    displacements: tuple[Load, ...]
    forces: tuple[Load, ...]
    gauges: dict[str, Gauge]
    macro: periodic.Macro | None  # what drives the mean strain of a periodic cell
    numerics: Numerics = field(metadata={"static": True})


class Ledger(NamedTuple):
    """Work done so far, N·mm."""

    initial: jax.Array  # kinetic energy at the start
    external: jax.Array
    damping: jax.Array
    released: jax.Array  # given up by the hourglass modes of cells that crack


class State(NamedTuple):
    """All that changes from step to step."""

    step: jax.Array
    displacement: jax.Array  # (2, nx+1, ny+1), mm
    velocity: jax.Array  # half a step behind, (2, nx+1, ny+1), mm/s
    intact: jax.Array  # 1 where a cell is uncracked, 0 where it has a band, (nx, ny)
    grip: jax.Array  # share of its hourglass stiffness that a cell has kept, (nx, ny)
    place: jax.Array  # of the cell's band in the pool, -1 without one, (nx, ny)
    pool: Pool
    work: Ledger
    failed: jax.Array  # place in the pool of a band that did not converge, or -1


class Fields(NamedTuple):
    """Cell and node fields that follow from the parameters; made once per call, not per step."""

    direct: jax.Array  # C₁₁, MPa, 0 in empty cells, (nx, ny)
    cross: jax.Array  # C₁₂
    shear: jax.Array  # C₃₃
    hourglass: jax.Array  # stiffness of either hourglass amplitude per thickness, MPa
    embedding: Embedding  # laws of every cell, leaves (nx, ny)
    mass: jax.Array  # lumped, tonne, (nx+1, ny+1)
    mobility: jax.Array  # 1/mass where free, else 0, (2, nx+1, ny+1)
    relaxation: jax.Array | None  # time, s, that makes a viscous stress of the rate of an elastic one
    inertia: jax.Array | None  # of each mode of mean strain of a periodic cell, tonne·mm², (3,)


@jax.jit
def fields(model):
    """Stiffness, laws and mass as fields over the grid."""
    n = model.numerics
    filled = model.material >= 0
    laws = bands.at(model.embedding, jnp.maximum(model.material, 0))
    direct, cross, shear = (
        jnp.where(filled, c, 0.0) for c in laws.bulk.coefficients(n.size)
    )
    density = jnp.where(filled, model.density[model.material], 0.0)
    mass = grid.spread(density) * (n.cell**2 * n.thickness)
    moved = mass if model.macro is None else periodic.fold(mass)
    mobility = model.free * jnp.where(mass > 0, 1 / jnp.where(mass > 0, moved, 1.0), 0.0)
    hourglass = grid.hourglass_stiffness(direct, shear)
    relaxation = None if model.viscosity is None else model.viscosity * undamped_time_step(model)
    inertia = None if model.macro is None else periodic.inertia(mass, n.cell)
    return Fields(direct, cross, shear, hourglass, laws, mass, mobility, relaxation, inertia)


@jax.jit
def stable_time_step(model):
    """Largest stable step (s) of the explicit scheme; viscosity ξ makes it √(1 + ξ²) − ξ times as long."""
    step = undamped_time_step(model)
    if model.viscosity is None:
        return step
    return step * (jnp.sqrt(1 + model.viscosity**2) - model.viscosity)


def undamped_time_step(model):
    """Largest stable step (s) without viscosity: 2/ω of the stiffest cell on its own.

    The highest frequency of a mesh never exceeds that of its stiffest element (Irons'
    theorem). For a square bilinear cell with lumped mass it belongs to a constant strain:
    ω² = 4 max(C₁₁ + C₁₂, 2 C₃₃) / (ρ c²).
    """
    n = model.numerics
    direct, cross, shear = model.embedding.bulk.coefficients(n.size)
    hardest = jnp.maximum(direct + cross, 2 * shear)
    return n.cell * jnp.sqrt(jnp.min(model.density / hardest))


def first_state(model, velocity, capacity=None):
    """State in the reference configuration, with initial nodal velocities (2, nx+1, ny+1), mm/s.

    Room for bands is a quarter of the cells to begin with: it costs memory only (0.2 kB each),
    while every growth costs a compilation.
    """
    dtype = model.free.dtype
    capacity = capacity or max(1024, model.material.size // 4)
    velocity = jnp.asarray(velocity, dtype)
    zero = jnp.zeros((), dtype)
    kinetic = kinetic_energy(model, fields(model).mass, velocity)
    return State(
        step=jnp.zeros((), jnp.int32),
        displacement=jnp.zeros_like(model.free),
        velocity=velocity,
        intact=(model.material >= 0).astype(dtype),
        grip=(model.material >= 0).astype(dtype),
        place=jnp.full(model.material.shape, -1, jnp.int32),
        pool=empty_pool(model, capacity),
        work=Ledger(kinetic, zero, zero, zero),
        failed=jnp.full((), -1, jnp.int32),
    )


def kinetic_energy(model, mass, velocity):
    """Of the nodes, N·mm."""
    if model.macro is not None:
        return periodic.kinetic_energy(mass, velocity, model.numerics.cell)
    return (mass * (velocity**2).sum(0)).sum() / 2


def empty_pool(model, capacity):
    """A pool of bands for this model, without bands."""
    return bands.empty_pool(capacity, model.numerics.size, model.free.dtype)


def with_room(model, state):
    """A state with room for twice as many bands."""
    spare = empty_pool(model, state.pool.cell.shape[0])
    return state._replace(pool=bands.joined(state.pool, spare))


def cell_strain_vectors(mean, cells, size):
    """Strain vectors (size, k) of some cells, by flat index, from the cell fields."""
    return tensor.from_plane([component.reshape(-1)[cells] for component in mean], size)


def from_layout(scene, layout):
    """The `Model` of a laid-out scene, in the scene's precision; raises SceneError where its cells are too large."""
    model = with_local(by_materials(scene, layout), layout.local)
    if layout.local is not None and layout.local.shares is not None:
        _check_mixed(scene, model)
    return model


def by_cells(model):
    """The same model with every cell a material of its own, its parameters leaves (cells,), cells in order."""
    number = jnp.arange(model.material.size, dtype=jnp.int32).reshape(model.material.shape)
    own = jnp.maximum(model.material, 0).reshape(-1)
    return replace(
        model, embedding=bands.at(model.embedding, own), density=model.density[own],
        material=jnp.where(model.material >= 0, number, -1),
    )  # fmt: skip


def with_local(model, local):
    """The model by materials with what differs from cell to cell, `mesostructure.sampling.Local` or None.

    The factor f on the strength leaves the curve of softening its shape: f_t f, and G_F f² where it is a
    parameter. Bulks are mixed by Hill: E = (Σ s_k E_k + 1 / Σ (s_k / E_k)) / 2; ν and density by shares s_k.
    """
    if local is None:
        return model
    named, model = model, by_cells(model)
    bulk, law = model.embedding.bulk, model.embedding.law
    if local.shares is not None:
        shares = jnp.asarray(local.shares.reshape(len(local.shares), -1), model.free.dtype)
        filled = (model.material >= 0).reshape(-1)
        E, nu = named.embedding.bulk.E, named.embedding.bulk.nu
        hill = (E @ shares + 1 / jnp.where(filled, (1 / E) @ shares, 1.0)) / 2
        bulk = Elastic(jnp.where(filled, hill, bulk.E), jnp.where(filled, nu @ shares, bulk.nu))
        model = replace(model, density=jnp.where(filled, named.density @ shares, model.density))
    if local.strength is not None:
        factor = jnp.asarray(local.strength.reshape(-1), model.free.dtype)
        powers = {"ft": 1, "GF": 2}
        law = replace(law, **{k: getattr(law, k) * factor**p for k, p in powers.items() if hasattr(law, k)})
    return replace(model, embedding=replace(model.embedding, bulk=bulk, law=law))


def _check_mixed(scene, model):
    """Raise SceneError where the mixed bulk of a cell is too soft for its band."""
    law, bulk = model.embedding.law, model.embedding.bulk
    cracks = (model.material >= 0).reshape(-1) & jnp.isfinite(law.ft)
    largest = float(jnp.where(cracks, law.largest_size(bulk), jnp.inf).min())
    if scene.grid.cell > largest_cell(largest, scene.bands.effective_size):
        raise SceneError(
            f"grid.cell = {scene.grid.cell:g}: expected at most {largest_cell(largest, scene.bands.effective_size):.4g} "
            f'mm with mesostructure.sampling = "mixed" (bands in cells of mixed stiffness snap back beyond {largest:.4g} mm)'
        )


def by_materials(scene, layout):
    """The model of a laid-out scene without what differs from cell to cell, leaves (materials,)."""
    dtype = jnp.dtype(scene.solver.precision)
    array = partial(jnp.asarray, dtype=dtype)
    materials = {name: scene.materials[name] for name in layout.materials}
    nx, ny = layout.shape
    free = np.ones(2 * (nx + 1) * (ny + 1))
    free[layout.held] = 0
    for drive in layout.displacements:
        free[drive.dofs] = 0
    free = free.reshape(2, nx + 1, ny + 1)
    if _is_periodic(scene):  # each node once
        free[:, -1, :] = free[:, :, -1] = 0
    return Model(
        embedding=_embedding(scene, materials, array),
        density=array([material.density for material in materials.values()]),
        damping=array(scene.solver.damping) if scene.solver.damping else None,
        viscosity=array(scene.solver.viscosity) if scene.solver.viscosity else None,
        gravity=array(scene.gravity),
        material=jnp.asarray(layout.material, jnp.int32),
        free=array(free),
        displacements=tuple(_load(drive, array) for drive in layout.displacements),
        forces=tuple(_load(drive, array) for drive in layout.forces),
        macro=_macro(scene, array),
        gauges={
            gauge.name: Gauge(
                jnp.asarray(gauge.dofs, jnp.int32), array(gauge.weights), gauge.kind == "reaction"
            )
            for gauge in layout.gauges
        },
        numerics=Numerics(
            cell=layout.cell,
            thickness=layout.thickness,
            size=tensor.STRAIN_SIZE[scene.grid.stress_state],
            effective_size=scene.bands.effective_size,
            normal_window=scene.bands.normal_window,
            cracks=any(material.band for material in materials.values()),
            half=layout.half.axis if layout.half else None,
        ),
    )


def _embedding(scene, materials, array):
    """Laws of all materials (tables by name), stacked."""
    bulk = [m.bulk for m in materials.values()]
    return Embedding(
        bulk=Elastic(array([b.E for b in bulk]), array([b.nu for b in bulk])),
        law=band_laws.stacked(materials, scene.grid, scene.bands, array),
        release=array([scene.bands.release] * len(bulk)) if scene.bands.release else None,
        closes=scene.bands.closes,
    )


def _is_periodic(scene):
    return scene.macro is not None and scene.macro.boundary == "periodic"


def _macro(scene, array):
    """What drives the mean strain of a periodic cell; edges are driven by displacements."""
    if not _is_periodic(scene):
        return None
    driven = scene.macro.strain.driven()
    none = np.empty(0, np.int64)
    return periodic.Macro(
        load=_load(Drive(none, none, scene.macro.history), array),
        strain=array([driven.get(name, 0.0) for name in COMPONENTS]),
        driven=array([name in driven for name in COMPONENTS]),
    )


def _load(drive, array):
    """A load of the layout as arrays."""
    history = drive.history
    start = np.zeros(len(history.time) - 1)
    first = history.first_change
    start[first] = history.smooth_start / (history.time[first + 1] - history.time[first])
    return Load(
        dofs=jnp.asarray(drive.dofs, jnp.int32),
        weights=array(drive.weights),
        time=array(history.time),
        value=array(history.value),
        start=array(start),
        smooth=history.interpolation == "smooth",
    )
