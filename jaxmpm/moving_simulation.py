"""A scene of points that move made ready to run: rooms for points and bands, what leaves the grid."""

import time as clock
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import bands, compilation, hand_over, model as models, moving, observe_moving
from jaxmpm import explicit, walls
from jaxmpm.errors import RunError
from jaxmpm.fragments import fragments
from jaxmpm.points import Points, Room, listed, slots_of
from jaxmpm.simulation import FRAME_FIELDS, LOST_LIMIT, check_energy, check_finite, little_energy

MOVING_FIELDS = FRAME_FIELDS | {"side": 1, "velocity": 3}
STABLE = 0.5  # of the step that is stable for a cell full of matter: nodes at an edge carry less


@dataclass
class MovingSimulation:
    """The counterpart of `Simulation` for points that move."""

    scene: object
    layout: object
    total: models.Model  # the same scene in the total frame, whose parameters it shares
    model: moving.Model
    state: moving.State
    sets: tuple  # what gauges read
    dt: float  # s
    stable_dt: float  # s
    begin: float  # time of step 0, s
    steps: int  # from there to the end
    steps_before: int = 0  # in the total frame
    left: dict = field(default_factory=lambda: {"points": 0, "mass": 0.0, "energy": 0.0})
    compile_seconds: float = 0.0
    run_seconds: float = 0.0
    _compiled: dict = field(default_factory=dict)

    @classmethod
    def of(cls, simulation) -> "MovingSimulation":
        """Go on from a `Simulation` in the total frame."""
        before, simulation = simulation, simulation.on_whole_grid()
        scene, layout = simulation.scene, simulation.layout
        begin = int(simulation.state.step) * simulation.dt
        fields, body_of = _fields(scene, layout, simulation)
        model, state = hand_over.to_points(
            scene, layout, simulation.model, simulation.state, begin, fields, body_of
        )
        stable = STABLE * simulation.stable_dt
        left = scene.solver.duration - begin
        steps = max(1, int(np.ceil(left / (stable * scene.solver.time_step_factor))))
        sim = cls(
            scene, layout, simulation.model, model, state, _sets(layout, model), left / steps,
            stable, begin, steps, int(simulation.state.step), run_seconds=simulation.run_seconds,
            compile_seconds=simulation.compile_seconds,
        )  # fmt: skip
        if begin > 0:
            sim._join_gauges(before)
        return sim

    def _join_gauges(self, simulation):
        """Displacement gauges go on from what they read in the total frame."""
        before, now = simulation.read(), self.read()
        moved, reactions = self.sets
        offsets = {name: jnp.asarray(before.gauges[name] - now.gauges[name]) for name in moved}
        self.sets = offsets, reactions

    @classmethod
    def blank(cls, simulation) -> "MovingSimulation":
        """One whose state is only the shape of one, to be filled from a restart file."""
        simulation, no = simulation.on_whole_grid(), jnp.zeros((), bool)
        zero = jnp.zeros(())
        pool = simulation.state.pool if simulation.model.numerics.cracks else None
        state = moving.State(Points(*[zero] * len(Points._fields)), zero, Room(no, no, no), pool, zero, simulation.state.work, zero)
        return cls(simulation.scene, simulation.layout, simulation.model, None, state, (), 0.0,
                   STABLE * simulation.stable_dt, 0.0, 0)  # fmt: skip

    def meta(self) -> dict:
        """What a restart file must know besides the state."""
        offsets = {name: float(value) for name, value in self.sets[0].items()}
        return {
            "begin": self.begin, "dt": self.dt, "steps": self.steps, "offsets": offsets,
            "steps_before": self.steps_before,
            "left": self.left, "fields": self.model.numerics.fields,
        }  # fmt: skip

    def resume(self, meta) -> None:
        """Go on with the state of a restart file and what `meta` told it."""
        known = ("begin", "dt", "steps", "left", "steps_before")
        self.begin, self.dt, self.steps, self.left, self.steps_before = (meta[k] for k in known)
        self.model = hand_over.moving_model(self.scene, self.layout, self.total, self.begin, meta["fields"])
        moved, reactions = _sets(self.layout, self.model)
        offsets = {name: jnp.asarray(meta["offsets"][name], value.dtype) for name, value in moved.items()}
        self.sets = offsets, reactions

    def count(self) -> int:
        """Number of points."""
        return int((np.asarray(self.state.points.mass) > 0).sum())

    def cracked(self) -> int:
        """Number of bands."""
        return 0 if self.state.pool is None else int(self.state.pool.count)

    def step_at(self, sample, samples):
        """Number of the step of a sample."""
        time = self.scene.solver.duration * sample / samples
        return int(np.clip(round((time - self.begin) / self.dt), 0, self.steps))

    def step_of(self, time):
        """Number of the step at a time (s), from the begin of the run."""
        return self.steps_before + round((time - self.begin) / self.dt)

    def _dt(self):
        return jnp.asarray(self.dt, self.total.free.dtype)

    def compiled(self, function, *extra):
        """`function(model, state, dt, *extra)` compiled for the present rooms, timed once."""
        key = function, jax.tree.map(jnp.shape, (self.state, extra)).__repr__()
        if key not in self._compiled:
            began = clock.perf_counter()
            self._compiled[key] = compilation.program(function, self.model, self.state, self._dt(), *extra)
            self.compile_seconds += clock.perf_counter() - began
        return self._compiled[key]

    def advance(self, until: int) -> None:
        """Advance to step `until`; raises RunError where a band fails or a point may not leave."""
        while int(self.state.step) < until:
            state = self.state
            if state.pool is not None and bool(explicit.needs_room(state)):
                self.state = models.with_room(self.total, state)
            if bool(state.room.slots) or bool(state.room.window):
                self._make_room()
            function = self.compiled(moving.advance, jnp.int32(0))
            began = clock.perf_counter()
            self.state = function(self.model, self.state, self._dt(), jnp.int32(until))
            jax.block_until_ready(self.state.step)
            self.run_seconds += clock.perf_counter() - began
            self._check_bands()
        if bool(self.state.room.slots) or bool(self.state.room.window):
            self._make_room()

    def _check_bands(self):
        if bool(self.state.room.wild):
            raise RunError(
                f"a point has moved by more than a cell in step {int(self.state.step)} (t = "
                f"{self.time():.6g} s): the run has become unstable; lower solver.time_step_factor (now "
                f"{self.scene.solver.time_step_factor:g})"
            )
        failed = int(self.state.failed)
        if failed >= 0:
            raise RunError(
                f"the band of the point at {self.place(int(self.state.pool.cell[failed]))} did not "
                f"converge in step {int(self.state.step)} (t = {self.time():.6g} s): try a smaller "
                "solver.time_step_factor, a slower load or smaller cells"
            )

    def time(self) -> float:
        """Time of the state, s."""
        return self.begin + int(self.state.step) * self.dt

    # -- room ----------------------------------------------------------------------------------

    def _make_room(self):
        """A window around the points, slots for all in it; those outside the grid leave or stop the run."""
        n, state = self.model.numerics, self.state
        position, lists = listed(state.points, self.layout.origin, n.cell, n.shape.centred)
        stays = self._inside(position)
        if not stays.any():
            raise RunError(f"all points have left the grid at t = {self.time():.6g} s")
        if not stays.all():
            self._let_go(position, lists, ~stays)
            position, lists = position[:, stays], {k: v[..., stays] for k, v in lists.items()}
        slots = slots_of(state.points) + (2 if bool(state.room.slots) else 0)
        points = hand_over.binned_points(
            n, self.layout.origin, position, lists, slots, state.points.mass.shape[1:]
        )
        no = jnp.zeros((), bool)
        self.state = self.state._replace(points=points, room=state.room._replace(slots=no, window=no))
        if self.state.pool is not None:
            pool = hand_over.with_addresses(self.state.pool, points)
            self.state = self.state._replace(pool=pool)

    def _inside(self, position):
        """Which points stay; those beyond a wall that lets nothing through are put back, in `position`."""
        n = self.model.numerics
        low, cells = np.reshape(self.layout.origin, (2, 1)), np.reshape(n.cells, (2, 1))
        stays = np.ones(position.shape[1], bool)
        for axis, sides in enumerate(walls.BY_AXIS):
            y = (position[axis] - low[axis]) / n.cell
            edges = (1e-6, float(cells[axis, 0]) - 1e-6)
            for side, beyond, edge in zip(sides, (y < 0, y > cells[axis]), edges, strict=True):
                wall = getattr(self.scene.grid.walls, side)
                if not beyond.any():
                    continue
                if wall == "stop":
                    k = np.flatnonzero(beyond)[0]
                    raise RunError(
                        f"a point at ({position[0, k]:.6g}, {position[1, k]:.6g}) mm would leave the grid "
                        f'across its {side} edge at t = {self.time():.6g} s and grid.walls.{side} = "stop": '
                        'use a larger grid, or "open", "slip" or "stick"'
                    )
                if wall == "open":
                    stays &= ~beyond
                else:  # by round-off
                    position[axis] = np.where(beyond, low[axis] + n.cell * edge, position[axis])
        return stays

    def _let_go(self, position, lists, leaves):
        """Book what points that leave take along."""
        self._gauges_without(position, lists, leaves)
        before = self._energy()
        mass = np.asarray(self.state.points.mass)
        flags = np.zeros(mass.shape, bool)
        flags[mass > 0] = leaves
        points = self.state.points
        gone = jnp.asarray(flags)
        keep = {name: jnp.where(gone, 0, getattr(points, name)) for name in ("mass", "volume", "band")}
        self.state = self.state._replace(points=points._replace(**keep))
        if self.state.pool is not None:
            pool = hand_over.with_addresses(self.state.pool, self.state.points)
            self.state = self.state._replace(pool=pool)
        energy = before - self._energy()
        self.left["points"] += int(leaves.sum())
        self.left["mass"] += float(lists["mass"][leaves].sum())
        self.left["energy"] += energy
        work = self.state.work
        self.state = self.state._replace(work=work._replace(external=work.external - energy))

    def _gauges_without(self, position, lists, leaves):
        """Displacement gauges keep what points that leave have said last."""
        moved, reactions = self.sets
        home = np.reshape(self.layout.origin, (2, 1)) + lists["home"]
        first = len(self.model.forces)
        for k, name in enumerate(list(moved)):
            share = lists["share"][2 * (first + k) : 2 * (first + k) + 2]
            said = (share * (position - home))[:, leaves].sum()
            moved = moved | {name: moved[name] + said}
        self.sets = moved, reactions

    def _energy(self):
        parts = jax.jit(moving.energies)(self.model, self.state.points, self.state.pool)
        return float(sum(parts))

    # -- what it says --------------------------------------------------------------------------

    def read(self):
        """Gauges and energies now, as NumPy numbers."""
        function = self.compiled(observe_moving.read, self.sets)
        return jax.tree.map(np.asarray, function(self.model, self.state, self._dt(), self.sets))

    def frame(self):
        """Positions of the points (N, 3), mm, and their fields."""
        return observe_moving.frame(
            self.model, self.state, self.layout.origin, self.scene.grid.thickness
        )

    def little_energy(self) -> float:
        """Too little energy to judge a balance by, N·mm."""
        return little_energy(self.scene, self.layout)

    def place(self, address: int) -> str:
        """Where a point is, for a message."""
        where = np.asarray(observe_moving.located(self.model, self.state.points))
        x, y = where.reshape(2, -1)[:, address] + np.asarray(self.layout.origin)
        return f"({x:.6g}, {y:.6g}) mm"

    def check(self, reading, energy_error: float) -> None:
        """Raise RunError where a result can no longer be trusted."""
        solver = self.scene.solver
        when = f"at t = {float(reading.time):.6g} s"
        check_finite(solver, [*reading.gauges.values(), *reading.energies()], when)
        check_energy(solver, energy_error, when, LOST_LIMIT)


def _fields(scene, layout, simulation):
    """Number of velocity fields and what gives each point of a cloud its own."""
    if scene.contact.kind == "stick":
        return 1, None
    if scene.contact.between == "bodies" or int(simulation.state.step) == 0:
        return max(1, len(scene.bodies)), lambda cloud: cloud.body
    number, _ = fragments(layout.owner, cohesion(simulation))
    return int(number.max()) + 1, lambda cloud: number[tuple(cloud.cell)]


def cohesion(simulation):
    """What the band of each cell (nx, ny) still holds, over its strength; 1 where uncracked."""
    model, state = simulation.model, simulation.state
    place = np.asarray(state.place)
    out = np.ones(place.shape)
    if not model.numerics.cracks:
        return out
    found = bands.bands_of(state.pool, model.numerics.size)
    laws = bands.laws_of(model.embedding, model.material.reshape(-1), state.pool.cell)
    ratio, integrity = laws.law.soften(found.softening, laws.bulk)
    holds = np.asarray(ratio * integrity)
    return np.where(place >= 0, holds[np.maximum(place, 0)], out)


def _sets(layout, model):
    """What gauges read: offsets of those of displacement; of reactions, nodal weights for each hold."""
    dtype = model.begin.dtype
    moved, reactions = {}, {}
    for gauge in layout.gauges:
        if gauge.kind != "reaction":
            moved[gauge.name] = jnp.zeros((), dtype)
            continue
        weight = jnp.asarray(hand_over.dense(layout, gauge.dofs, gauge.weights), dtype)
        # rides with whatever holds these nodes
        parts = [weight * (hold.which > 0) for hold in model.holds]
        reactions[gauge.name] = tuple(part if bool((part != 0).any()) else None for part in parts)
    return moved, reactions
