"""Derivatives of a path of equilibria by the implicit function theorem, from its end back to its beginning.

At each equilibrium the residual r(u, q, θ) = 0, q what the bands remember of the equilibrium before, θ the parameters of the laws.
What depends on u through a function J does so on θ and q by

    dJ = (∂J/∂θ − λᵀ ∂r/∂θ) dθ + (∂J/∂q − λᵀ ∂r/∂q) dq,      Kᵀ λ = ∂J/∂u,      K = ∂r/∂u

so that one linear system with the transposed tangent stiffness is solved for each increment, whatever the number of parameters.
Where energy or a gauge is under control the load factor is one unknown more, and what is controlled one equation. So it is where a
cell is about to crack: its strength ratio stays what it was, and the loads follow. Derivatives are those of one order of events, as of
runs in time (`differentiable.py`).
"""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm.bands_adjoint import Answered, Lasting, elastic_pulled_back, less, onset_pulled_back, pulled_back, ratio_slopes
from jaxmpm.bands_static import TOGETHER
from jaxmpm.condensed import GRIP, Condensed
from jaxmpm.errors import RunError
from jaxmpm.laws.balance import RESTS
from jaxmpm.stiffness import MEAN, MODES

FOLLOWS = True  # whether the loads at which a cell cracks follow from its strength, or stay as they were


@dataclass
class Step:
    """An equilibrium that was accepted."""

    found: object  # `newton.Found`
    displacement: np.ndarray  # (dofs,)
    cells: int  # cracked ones
    readings: np.ndarray  # of the gauges, N or mm
    time: float | None = None  # s


@dataclass
class Onset:
    """Cells that cracked between two equilibria."""

    state: object  # before
    mean: tuple  # strain of all cells
    cells: np.ndarray  # (j,)


@dataclass(eq=False)
class Tape:
    """What happened on a path, in order."""

    events: list = field(default_factory=list)
    broken: bool = False  # a dynamic bridge was crossed
    equilibria: object = None
    gauges: "Gauges | None" = None

    def of(self, equilibria):
        """Begin, with the equilibria of a model."""
        self.equilibria, self.gauges = equilibria, Gauges(equilibria.model)

    def keep(self, found, trial, cells):
        """Keep an equilibrium."""
        readings = self.gauges.read(trial.force - self.equilibria.structure.force @ found.amplitude, trial.displacement)
        if cells:  # the rows are in the way of memory: what is needed of them is among the unknowns
            found = replace(found, answers=found.answers._replace(rows=None))
        self.events.append(Step(found, trial.displacement, cells, readings))

    def cracked(self, state, mean, cells):
        """Keep what cracks, and from what."""
        self.events.append(Onset(state, mean, cells))

    def stamp(self, time):
        """Say when the equilibria that have no time yet were, s."""
        for event in reversed(self.events):
            if isinstance(event, Step):
                if event.time is not None:
                    break
                event.time = time

    @property
    def steps(self):
        """The equilibria among the events."""
        return [event for event in self.events if isinstance(event, Step)]


# in the eyes of JAX one thing without numbers, so that it passes from the way there to the way back
jax.tree_util.register_pytree_node(Tape, lambda tape: ((), tape), lambda tape, _: tape)


class Gauges:
    """The gauges of a model as matrices."""

    def __init__(self, model):
        self.names = list(model.gauges)
        self.of_force, self.of_displacement = np.zeros((2, len(self.names), model.free.size))
        for row, gauge in enumerate(model.gauges.values()):
            np.add.at((self.of_force if gauge.reaction else self.of_displacement)[row], np.asarray(gauge.dofs), np.asarray(gauge.weights))

    def read(self, force, displacement):
        """Readings (gauges,) from the forces that supports and loads bear (dofs,), N, and displacements (dofs,), mm."""
        return self.of_force @ force + self.of_displacement @ displacement


class WayBack:
    """From the derivatives of something by all readings to those by the laws of the model."""

    def __init__(self, tape: Tape):
        """Takes over the system of the equilibria; raises RunError where the path has no derivative."""
        if tape.broken:
            raise RunError(
                "the path goes over a dynamic bridge, whose derivative equilibrium does not know: differentiate the explicit run "
                "(solver.kind = \"explicit\"), or a scene that does without (smaller cells, solver.control)"
            )
        eq = tape.equilibria
        self.tape, self.model, self.structure, self.system = tape, eq.model, eq.structure, eq.system
        self.pool = eq.state.pool
        self.cells = np.asarray(self.pool.cell)[: int(self.pool.count)]
        if len(self.system.cells) < len(self.cells):  # the way back has been gone before
            self.system.add(self.cells[len(self.system.cells) :])
        self.rows = self.first = self.structure.rows(self.cells)  # of the strain operator, those of the cells that crack
        self.across, self.back = self.first.T.tocsr(), self.structure.moves.T.tocsr()
        count, shape = len(self.cells), self.model.material.shape
        size = self.model.numerics.size
        self.softening = np.zeros(count)  # derivatives by p, after the events that are still to come
        self.lasting = Lasting(np.zeros((2, count)), np.zeros(count), np.zeros((size, count)))
        self.displacement = np.zeros(self.model.free.size)
        self.stress = np.zeros((count, MEAN))
        self.amplitude = np.zeros(self.structure.force.shape[1])  # of the loads, where they have stayed
        self.elastic = [np.zeros(shape) for _ in range(4)]
        self.laws = jax.tree.map(jnp.zeros_like, self.model.embedding)
        self.grip = np.ones(len(self.structure.hourglass))  # share of hourglass stiffness that cells have
        self.grip[self.cells] = GRIP

    def go(self, by_readings):
        """Derivatives by the laws (`Embedding`) from those by all readings (steps, gauges)."""
        events, left = self.tape.events, len(self.tape.steps)
        previous, onset = [None, *self.tape.steps], None
        for event in reversed(events):
            if isinstance(event, Step):
                left -= 1
                self._step(event, previous[left], np.asarray(by_readings[left], float), onset)
                onset = None
            else:
                self._onset(event)
                onset = event
        by_cells = tuple(jnp.asarray(field, self.model.free.dtype) for field in self.elastic)
        return jax.tree.map(jnp.add, self.laws, elastic_pulled_back(self.model, by_cells))

    def _step(self, step, before, by_reading, onset):
        structure, found, k = self.structure, step.found, step.cells
        if self.first.shape[0] != MODES * k:
            self.first = self.rows[: MODES * k]
            self.across = self.first.T.tocsr()
        by_force = by_reading @ self.tape.gauges.of_force
        by_displacement = self.displacement + by_reading @ self.tape.gauges.of_displacement
        tangent = found.answers.tangent[:k] if k else np.zeros((0, MEAN, MEAN))
        softens = np.asarray(found.answers.softens)[:k] if k else np.zeros((0, MEAN))
        by_strain = self.softening[:k, None] * softens + np.einsum("ki,kij->kj", self.stress[:k], tangent)
        whole = by_displacement + self._stiff(by_force, tangent) + self._spread(by_strain)
        adjoint, by_spent = self._solved(step, tangent, whole, by_force, onset)
        through = by_force - structure.moves @ adjoint
        seen = (self.rows @ through).reshape(-1, MODES)
        by_stress = structure.volume * seen[:k, :MEAN] + self.stress[:k]
        self._stiffness(through, step.displacement, k)
        if k:
            self._bands(step, before, Answered(self.softening[:k], by_stress, by_spent))
        self.displacement, self.stress = np.zeros_like(self.displacement), np.zeros_like(self.stress)

    def _stiff(self, vector, tangent):
        """Kᵀ times a vector (dofs,)."""
        k = len(tangent)
        stress = np.einsum("kij,ki->kj", tangent, (self.first @ vector).reshape(-1, MODES)[:, :MEAN])
        return self.structure.force_of(vector, self.cells[:k], stress, GRIP, self.first)

    def _spread(self, by_strain):
        """Derivatives by displacement (dofs,) from those by the strains of the first cells (k, 3)."""
        k = len(by_strain)
        padded = np.zeros((k, MODES))
        padded[:, :MEAN] = by_strain
        return self.across @ padded.reshape(-1)

    def _solved(self, step, tangent, whole, by_force, onset):
        """λ of the unknowns (m,), and the derivatives by the energy that each band has spent (k,)."""
        structure, system, found, k = self.structure, self.system, step.found, step.cells
        moves, back, direction = structure.moves, self.back, found.direction
        system.keep(k)
        if isinstance(system, Condensed) and k:
            system.renew(found.strain, found.stress, tangent, found.answers.status[:k] == RESTS)
        controlled, by_spent, by_laws = self._controlled(step, onset)
        if controlled is None:
            there = system.adjoint(tangent, back @ whole)
            self.amplitude = self._by_amplitude(tangent, whole, by_force, moves @ there) if _stays(found) else 0 * self.amplitude
            return there, by_spent
        along = structure.prescribed @ direction
        driven = self._stiff_forward(along, tangent) - structure.force @ direction
        slope = whole @ along - by_force @ (structure.force @ direction) + self.amplitude @ direction
        self.amplitude = 0 * self.amplitude
        there, beside = system.adjoint(tangent, back @ np.stack([whole, controlled], 1)).T
        pull = back @ driven
        factor = (pull @ there - slope) / (pull @ beside - controlled @ along)
        if by_laws is not None:
            self.laws = less(self.laws, factor, by_laws)
        return there - factor * beside, -factor * by_spent

    def _by_amplitude(self, tangent, whole, by_force, adjoint):
        """Derivatives by the amplitudes (loads,) of an equilibrium at which they stay, in which they follow those before it."""
        structure = self.structure
        through = whole - self._stiff(adjoint, tangent)
        return self.amplitude + structure.prescribed.T @ through - structure.force.T @ (by_force - adjoint)

    def _controlled(self, step, onset):
        """How what fixed the load factor depends on displacements (dofs,), on what bands have spent (k,), and on the laws."""
        found, k, control = step.found, step.cells, step.found.control
        none = np.zeros(k)
        if _stays(found):
            return None, none, None
        if onset is not None and FOLLOWS:
            cell = onset.cells[0]
            rows = self.structure.rows([cell], MEAN)
            by_laws, by_strain = ratio_slopes(self.model, rows @ step.displacement, np.int32(cell))
            return rows.T @ np.asarray(by_strain), none, by_laws
        if control.kind == "dissipation":
            meant = control.among(np.ones(k))
            return self._spread(meant[:, None] * found.answers.spends[:k]), meant, None
        return (self.tape.equilibria.gauge, none, None) if control.kind == "gauge" else (None, none, None)

    def _stiff_forward(self, vector, tangent):
        """K times a vector (dofs,)."""
        return self._stiff(vector, tangent.swapaxes(1, 2))

    def _stiffness(self, through, displacement, k):
        """Derivatives by the elastic stiffness of cells: of the mean strain of intact ones, of the hourglass of all."""
        n, shape = self.model.numerics, self.model.material.shape
        left, right = ((self.structure.strain @ v).reshape(-1, MODES).T for v in (through, displacement))
        intact = np.ones(len(self.grip))
        intact[self.cells[:k]] = 0.0
        weight, grip = self.structure.volume * intact, np.where(intact > 0, 1.0, self.grip) * n.thickness
        parts = (
            weight * (left[0] * right[0] + left[1] * right[1]), weight * (left[0] * right[1] + left[1] * right[0]),
            weight * left[2] * right[2], grip * (left[3] * right[3] + left[4] * right[4]),
        )  # fmt: skip
        for total, part in zip(self.elastic, parts, strict=True):
            total += part.reshape(shape)

    def _bands(self, step, before, by):
        """Through the answers of the bands, to what they have remembered."""
        k, capacity = step.cells, self.pool.cell.shape[0]
        padded = lambda a: np.concatenate([a, np.zeros((capacity - len(a), *a.shape[1:]), a.dtype)])  # noqa: E731
        fit = lambda a: padded(np.asarray(a)[:k])  # noqa: E731
        had = np.zeros(capacity)
        if before is not None and before.cells:
            had[: before.cells] = np.asarray(before.found.answers.unknowns)[: before.cells, -1]
        pool = self.pool._replace(count=np.int32(k))
        self.laws, lasting, softening = pulled_back(
            self.model, self.laws, pool, had, fit(step.found.answers.unknowns), fit(step.found.answers.status),
            padded(step.found.strain.reshape(-1, MEAN)), jax.tree.map(padded, by),
        )  # fmt: skip
        for total, part in zip(self.lasting, lasting, strict=True):
            total += np.asarray(part)[..., : total.shape[-1]]
        self.softening[:k] = np.asarray(softening)[:k]

    def _onset(self, onset):
        """Through the onset of bands, to the equilibrium before it."""
        spare = TOGETHER - len(onset.cells)
        place = int(onset.state.pool.count) + np.arange(len(onset.cells))
        taken = jax.tree.map(lambda a: np.pad(a[..., place], [(0, 0)] * (a.ndim - 1) + [(0, spare)]), self.lasting)
        cells = np.pad(onset.cells, (0, spare), mode="edge")
        self.laws, mean, stress = onset_pulled_back(self.model, self.laws, onset.state, onset.mean, cells, taken)
        by_cell = np.zeros((len(self.grip), MODES))
        by_cell[:, :MEAN] = np.stack([np.asarray(component).reshape(-1) for component in mean], axis=1)
        self.displacement += self.structure.strain.T @ by_cell.reshape(-1)
        count = int(onset.state.pool.count)
        self.stress[:count] += np.asarray(stress).T[:count]
        self.softening[place] = 0.0


def _stays(found):
    """Whether an equilibrium is at the loads of the one before."""
    return found.direction is None or not np.any(found.direction)
