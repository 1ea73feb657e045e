"""From one equilibrium to the next: attempts, what they cost in energy, and cells that crack in between.

An attempt leaves no trace; `accept` takes an equilibrium over, with the histories of its bands and its work. What has
been accepted last is where everything starts from again.
"""

import time as clock
from dataclasses import replace
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import bands_static, compilation, grid
from jaxmpm import model as models
from jaxmpm.bands_static import TOGETHER
from jaxmpm.condensed import GRIP, Condensed
from jaxmpm.errors import RunError
from jaxmpm.full_system import Full
from jaxmpm.increment import Counts, Move, Pending, Point, Trial
from jaxmpm.laws.balance import RESTS
from jaxmpm.multigrid_system import MatrixFree
from jaxmpm.newton import Control, Found, Newton
from jaxmpm.stepping import OVERSHOOT, critical, share_to_onset
from jaxmpm.stiffness import MEAN, MODES, Structure, loads_of

CLOSE = 0.004  # `OVERSHOOT` where derivatives are asked for, which take it for none
SIDEWAYS = (0.05, -0.05, 0.3, -0.3, 2.0, -2.0)  # steps along the softest mode, over the strain at onset
BROKEN = 40.0  # softening p of a band that is as good as broken
MOST_AHEAD = 2.0  # of the last increment that the next is thought to go at most
FIRST = 0.02  # of the last increment that the next is thought to go, where its measure says nothing
STRAY = 100.0  # times the tolerance that a node may be out of balance: equations of cracked cells measure strains
DENSE = 1000  # cells that crack, up to which a dense system is quicker


class Equilibria:
    """A model, its last equilibrium, and the means to find the next."""

    def __init__(self, model, state, tolerance, gauge=None, tape=None):
        self.overshoot = OVERSHOOT if tape is None else CLOSE
        self.model, self.state, self.tolerance, self.gauge = model, state, tolerance, gauge
        self.prepared = jax.jit(models.fields)(model)
        self.structure = Structure.of(model)
        law, bulk = model.embedding.law, model.embedding.bulk
        largest = [float(np.abs(load.value).max()) for load in loads_of(model)]
        self.scale = np.array([*(a if a > 0 else 1.0 for a in largest), 1.0])  # what amplitudes are measured by
        self.strength = float(np.min(law.ft)) if model.numerics.cracks else 1.0
        self.stiffness = float(np.max(bulk.E))
        self.counts, self.pending, self.last = Counts(), None, None
        self.compile_seconds, self._compiled = 0.0, {}
        self.failed = None  # the last attempt that came to nothing
        self.tape = tape  # of what happens, for the way back, or None
        if tape is not None:
            tape.of(self)
        self.restart(state)

    @cached_property
    def energy_of_a_cell(self):
        """Energy (N·mm) that it takes to break the weakest cell."""
        law, bulk = self.model.embedding.law, self.model.embedding.bulk
        energy = np.asarray(jax.jit(lambda: law.given_up(jnp.full_like(law.h, BROKEN), bulk))())
        return float(energy[energy > 0].min()) * self.structure.edge

    def restart(self, state, amplitude=None):
        """Begin from a state, which is taken for an equilibrium at amplitudes (loads,)."""
        self.state = state
        cells = np.asarray(state.pool.cell)[: int(state.pool.count)]
        if self._many(len(cells)):
            self.system = self._of_all_nodes(cells)
        else:
            self.system = Condensed(self.structure, self.gauge)
            if len(cells):
                self.system.add(cells)
        displacement = np.asarray(state.displacement, float).reshape(-1)
        strain = self.structure.rows(cells, MEAN) @ displacement
        stress = np.asarray(state.pool.stress)[:, : len(cells)].T.reshape(-1)
        amplitude = np.zeros(self.structure.force.shape[1]) if amplitude is None else amplitude
        spent = self.respond(strain).spent[: len(cells)] if len(cells) else np.zeros(0)
        force = self.structure.force_of(displacement, cells, stress, GRIP)
        energy = self._energy(displacement, strain, state.pool.records)
        if self.tape is not None and len(cells):
            self.tape.broken = True
        self.now = Point(amplitude, displacement, strain, stress, force, self._ratio(displacement), spent, energy)
        self.pending = self.last = None

    def _call(self, function, *args):
        """A jitted function of bands_static, compiled once for each capacity."""
        key = function, self.state.pool.cell.shape[0]
        if key not in self._compiled:
            began = clock.perf_counter()
            self._compiled[key] = compilation.program(function, self.model, *args)
            self.compile_seconds += clock.perf_counter() - began
        return self._compiled[key](self.model, *args)

    def _many(self, cells):
        return cells > DENSE or self.structure.large

    def _build(self, cells):
        """Make the equations for some cracked cells."""
        if self.structure.large or self._many(len(cells)):
            self.system = self._of_all_nodes(cells)
        else:
            self.system = Condensed(self.structure, self.gauge)
            if len(cells):
                self.system.add(cells)

    def _of_all_nodes(self, cells):
        return (Full if self.structure.grid is None else MatrixFree)(self.structure, cells, self.gauge)

    # -- attempts --------------------------------------------------------------------------------

    def respond(self, strain):
        """`Answers` of all bands to the strains (3k,) of their cells."""
        pool = self.state.pool
        found = self._call(bands_static.answers, pool, bands_static.strains_of(pool, strain))
        asked = ("stress", "tangent", "spent", "spends", "status")
        return found._replace(**{name: np.asarray(getattr(found, name)) for name in asked})

    def _mean(self, displacement):
        n = self.model.numerics
        return grid.strain(displacement.reshape(self.model.free.shape), n.cell)

    def _ratio(self, displacement):
        if not self.model.numerics.cracks:
            return np.zeros(self.model.material.shape)
        return np.asarray(self._call(bands_static.ratios, self.prepared, self.state, self._mean(displacement)))

    def attempt(self, direction, control: Control) -> Trial | None:
        """The equilibrium at the last amplitudes + factor · direction, `control` fixing the factor; None if there is none."""
        now, system = self.now, self.system
        self.counts.attempts += 1
        if not len(system.cells):
            amplitude = now.amplitude + control.target * direction
            displacement = self.structure.response @ amplitude
            found = Found(np.zeros(0), control.target, amplitude, np.zeros(0), converged=True, error=0.0, control=control, direction=direction)
            return self._trial(found, displacement)
        ahead, factor = self._ahead(direction, control)
        guess = system.unknowns(now.displacement + ahead, now.amplitude + factor * direction)
        for rebuilt in (False, True):
            newton = Newton(self.system, self.respond, self.strength, self.stiffness, self.tolerance)
            found = newton.solve(guess, now.amplitude, direction, control, factor)
            if not found.converged:
                self.failed = found
                return None
            trial = self._trial(found, self.system.displacement(found.unknowns, found.stress, found.amplitude))
            if trial.unbalanced <= STRAY * self.tolerance:
                return trial
            if not rebuilt:  # rounding has added up in the system
                self._build(system.cells)
        raise RunError(
            f"an equilibrium leaves {trial.unbalanced:.1e} of the strength of a cell unbalanced at a node, more than {STRAY:g} times "
            f"solver.tolerance = {self.tolerance:g}: the equations are too badly conditioned for it; raise it, or use softer supports"
        )

    def _trial(self, found, displacement):
        """What may be accepted, with its energies."""
        now, structure, cells = self.now, self.structure, self.system.cells
        force = structure.force_of(displacement, cells, found.stress, GRIP)
        move = displacement - now.displacement
        given = structure.force @ ((now.amplitude + found.amplitude) / 2)
        work = np.where(structure.free, given, (now.force + force) / 2) @ move
        energy = self._energy(displacement, found.strain, found.answers.rows if len(cells) else None)
        left = structure.moves.T @ (force - structure.force @ found.amplitude)
        unbalanced = np.abs(left).max(initial=0.0) / (self.strength * structure.edge)
        return Trial(found, displacement, self._ratio(displacement), energy, float(work), force, unbalanced)

    def _energy(self, displacement, strain, rows):
        """Stored and dissipated energy, N·mm, of bands with these records."""
        structure, cells = self.structure, self.system.cells
        total = displacement @ (structure.stiffness @ displacement) / 2
        if not len(cells):
            return float(total)
        own = (structure.rows(cells) @ displacement).reshape(-1, MODES)
        total -= structure.volume / 2 * np.einsum("ki,kij,kj", own[:, :MEAN], structure.elastic[cells], own[:, :MEAN])
        total -= (1 - GRIP) / 2 * (structure.hourglass[cells] @ (own[:, MEAN:] ** 2).sum(1))
        pool = self.state.pool._replace(records=jnp.asarray(rows))
        held = self._call(bands_static.held_energy, pool, bands_static.strains_of(pool, strain))
        return float(total + np.asarray(held)[: len(cells)].sum())

    def missing(self, trial):
        """Energy (N·mm) that an increment has lost besides what cells that cracked have let go of."""
        return trial.missing(self.now.energy) - self._released(trial)

    def switched(self, trial) -> Trial | None:
        """A stable equilibrium beside one that is not, at the same loads; None if none is found.

        Where two cracks might go on and only one can, both going on is an equilibrium, but not one that lasts: it is
        left along its softest mode, either way.
        """
        system, found = self.system, trial.found
        mode, _ = system.softest(found.answers.tangent[: len(system.cells)])
        strained = system.strain(mode, 0 * found.amplitude)
        unit = mode * self.strength / self.stiffness / np.abs(strained).max()
        newton = Newton(system, self.respond, self.strength, self.stiffness, self.tolerance)
        none = np.zeros_like(found.amplitude)
        for far in SIDEWAYS:
            other = newton.solve(found.unknowns + far * unit, found.amplitude, none, Control("load", 0.0))
            if other.converged and other.stable:
                beside = self._trial(other, system.displacement(other.unknowns, other.stress, other.amplitude))
                beside.aside = True
                return beside
        return None

    def _ahead(self, direction, control):
        """Where the last increment would lead: change of the displacement (dofs,) and load factor."""
        last = self.last
        if last is None:
            return 0.0, control.target if control.kind == "load" else 0.0
        known = last.size(control)
        if control.only is not None and not known > 0:
            return 0.0, 0.0
        reach = min(self.size_of(direction, control) / known if known > 0 else FIRST, MOST_AHEAD)
        factor = control.target if control.kind == "load" else reach * _along(last.amplitude, direction)
        return reach * last.displacement, factor

    def size_of(self, direction, control):
        """Size of an increment in the measure of its control."""
        if control.kind == "load":
            return float(np.abs(control.target * direction / self.scale).max())  # of any load
        if control.kind == "dissipation":
            return control.target - self.spent(control.only)
        return abs(control.target - self.reading)

    def spent(self, only=None):
        """Energy (N·mm) that the softening of all bands has taken, or of one."""
        return float(self.now.spent.sum() if only is None else self.now.spent[only])

    @property
    def reading(self):
        """The gauge's reading, mm."""
        return float(self.gauge @ self.now.displacement)

    # -- what an attempt comes to ----------------------------------------------------------------

    def share_to_onset(self, trial):
        """Share of an increment after which the first cell is as far beyond onset as is aimed at; 1 if none is too far."""
        return share_to_onset(self.now.ratio, trial.ratio, self.overshoot)

    def reach_to_onset(self):
        """Multiples of the last increment after which, going on like that, the first cell reaches onset."""
        if self.last is None:
            return np.inf
        rate = np.where(self.now.ratio > 0, self.last.ratio, 0.0)
        rising = rate > 1e-9
        if not rising.any():
            return np.inf
        return float(np.maximum((1 + self.overshoot / 2 - self.now.ratio[rising]) / rate[rising], 0.0).min())

    def accept(self, trial):
        """Take an equilibrium over."""
        now, found = self.now, trial.found
        cells = self.system.cells
        move = trial.displacement - now.displacement
        spent = found.answers.spent[: len(cells)] if len(cells) else now.spent
        released, fall = self._released(trial), max(self.missing(trial), 0.0) if trial.aside else 0.0
        self.pending = None
        ledger = self.state.work
        ledger = ledger._replace(
            external=ledger.external + trial.work, released=ledger.released + released, damping=ledger.damping + fall
        )
        pool = self.state.pool
        if len(cells):
            pool = pool._replace(records=jnp.asarray(found.answers.rows), stress=jnp.asarray(found.answers.stress.T))
        step = self.state.step + 1
        field = jnp.asarray(trial.displacement.reshape(self.model.free.shape))
        self.state = self.state._replace(step=step, displacement=field, pool=pool, work=ledger)
        change = found.amplitude - now.amplitude
        load = float(np.abs(change / self.scale).max())
        if np.abs(move).max() > 0 and (load > 0 or self.last is None):
            rise = np.where(trial.ratio > 0, trial.ratio - now.ratio, 0.0)
            gauge = abs(float(self.gauge @ move)) if self.gauge is not None else 0.0
            self.last = Move(move, rise, change, load, gauge, spent - now.spent)
        self.now = Point(
            found.amplitude, trial.displacement, found.strain, found.stress, trial.force, trial.ratio, spent, trial.energy
        )
        if isinstance(self.system, Condensed) and len(cells):
            rests = found.answers.status[: len(cells)] == RESTS
            self.system.renew(found.strain, found.stress, found.answers.tangent[: len(cells)], rests)
        if self.tape is not None:
            self.tape.keep(found, trial, len(cells))
        self.counts.increments += 1
        self.counts.residual = max(self.counts.residual, trial.unbalanced)
        self.counts.iterations.append(len(found.history) - 1 if found.history else 0)

    def _released(self, trial):
        """Energy (N·mm) let go of by the cells that have cracked on the way: of the hourglass, and of the overshoot."""
        pending = self.pending
        if pending is None:
            return 0.0
        structure, cells = self.structure, self.system.cells[pending.place]
        own = (structure.rows(cells) @ trial.displacement).reshape(-1, MODES)
        before = self.now.strain.reshape(-1, MEAN)[pending.place]
        modes = (1 - GRIP) * structure.hourglass[cells] / 2 * (pending.modes * own[:, MEAN:]).sum(1)
        return modes.sum() + structure.volume / 2 * (pending.fall * (own[:, :MEAN] - before)).sum()

    def let_go(self):
        """Book what cells that have cracked let go of where no increment follows: all their hourglass energy."""
        if self.pending is None:
            return
        cells, work = self.system.cells[self.pending.place], self.state.work
        energy = (1 - GRIP) / 2 * (self.structure.hourglass[cells] @ (self.pending.modes**2).sum(1))
        self.state = self.state._replace(work=work._replace(released=work.released + energy))
        self.pending = None

    # -- cells that crack ------------------------------------------------------------------------

    def open_critical(self) -> int:
        """Give the most critical cells beyond onset a band, one in each neighbourhood; returns how many."""
        cells = critical(self.now.ratio, TOGETHER)
        if not len(cells):
            return 0
        self._make_room()
        listed = np.pad(cells, (0, TOGETHER - len(cells)), mode="edge")
        strain = self._mean(self.now.displacement)
        new = np.arange(TOGETHER) < len(cells)
        if self.tape is not None:
            self.tape.cracked(self.state, strain.mean, cells)
        self.state = self._call(bands_static.opened, self.prepared, self.state, strain, listed, new)
        self._extend(cells)
        return len(cells)

    def _make_room(self):
        pool = self.state.pool
        if int(pool.count) + TOGETHER > pool.cell.shape[0]:
            self.state = models.with_room(self.model, self.state)

    def _extend(self, cells):
        """Take new cells into the equations, and book what they let go of."""
        structure, now, before = self.structure, self.now, len(self.system.cells)
        if isinstance(self.system, Condensed) and self._many(before + len(cells)):
            self.system = self._of_all_nodes(np.concatenate([self.system.cells, cells]))
        else:
            self.system.add(cells)
        own = (structure.rows(cells) @ now.displacement).reshape(-1, MODES)
        elastic = np.einsum("kij,kj->ki", structure.elastic[cells], own[:, :MEAN])
        now.strain = np.concatenate([now.strain, own[:, :MEAN].reshape(-1)])
        now.stress = np.concatenate([now.stress, elastic.reshape(-1)])
        now.spent = np.concatenate([now.spent, np.zeros(len(cells))])
        if self.last is not None:
            self.last.spent = np.concatenate([self.last.spent, np.zeros(len(cells))])
        place = before + np.arange(len(cells))
        found = self.respond(now.strain)
        pool = self.state.pool._replace(records=jnp.asarray(found.rows))
        held = np.asarray(self._call(bands_static.held_energy, pool, bands_static.strains_of(pool, now.strain)))[place]
        now.energy -= (1 - GRIP) / 2 * (structure.hourglass[cells] @ (own[:, MEAN:] ** 2).sum(1))
        lost = structure.volume / 2 * (elastic * own[:, :MEAN]).sum() - held.sum()
        work = self.state.work
        self.state = self.state._replace(work=work._replace(released=work.released + lost))
        now.energy -= lost
        now.ratio = now.ratio.copy()
        now.ratio.reshape(-1)[cells] = 0.0
        modes, fall = own[:, MEAN:], elastic - found.stress[place]
        if self.pending is None:
            self.pending = Pending(place, modes, fall)
        else:
            old = self.pending
            both = lambda name, new: np.concatenate([getattr(old, name), new])  # noqa: E731
            self.pending = replace(old, place=both("place", place), modes=both("modes", modes), fall=both("fall", fall))


def _along(change, direction):
    """How much of a direction a change of the amplitudes holds."""
    square = direction @ direction
    return float(change @ direction / square) if square > 0 else 0.0
