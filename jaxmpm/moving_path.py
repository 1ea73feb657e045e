"""From one equilibrium of moving points to the next: attempts, where they lead, and cells that crack in between.

An attempt leaves no trace. Amplitudes of loads are those of the holds of the model, of its forces, and of gravity, last.
"""

import time as clock
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import compilation, cracks, moving_nodes, moving_tangent
from jaxmpm.explicit import ROOM
from jaxmpm.loads import amplitudes_at
from jaxmpm.moving_equilibrium import SMALL, Found, Increment, Newton
from jaxmpm.points import separate


def loads_of(model):
    """The loads of a `moving.Model` but gravity."""
    return [hold.load for hold in model.holds] + list(model.forces)


def amplitudes(model, time, duration):
    """Amplitude of every load at a time (s), (loads,); before 0 those at 0 grow from nothing."""
    now = np.append(amplitudes_at(loads_of(model), max(time, 0.0)), float(model.gravity is not None))
    return now * (1 + time / duration) if time < 0 else now


@jax.jit
def strength_ratio(model, points):
    """Strength ratio r̂ of the cells of the window of binned points."""
    return cracks.onset_ratio(model, separate(points))


@jax.jit
def with_bands(model, points, pool, cells, new):
    """Points and pool with bands in those `cells` (k,) of the window that are `new`; a point may lie beyond its bin."""
    return cracks.opened(model, points, pool, cells, new)


@dataclass
class Attempt:
    """An equilibrium that may be accepted."""

    found: Found
    lists: moving_nodes.Listed  # points where they were
    nodes: moving_nodes.Nodes
    before: np.ndarray  # amplitudes at its begin
    amplitude: np.ndarray  # and at its end
    ratio: np.ndarray  # r̂ of the cells of the window, points at the places where they were

    def missing(self, energy: float) -> float:
        """Energy (N·mm) that forces have done work and points, which had `energy`, have not got: next to none but in a leap."""
        return self.found.gained - (float(self.found.answer.energy) - energy)

    def lost(self, energy: float) -> float:
        """Energy (N·mm) that loads have brought and points, which had `energy`, have not got."""
        return self.found.work - self.found.ghosts - (float(self.found.answer.energy) - energy)

    def gauges(self, model, parts) -> dict:
        """Gauges of reactions, N, by name; `parts` are nodal weights (2, *nodes) for each hold or None."""
        found = {}
        for name, weights in parts.items():
            there = zip(model.holds, weights, self.before, strict=False)
            lies = [moving_nodes.shifted(self.nodes.n, hold, weight, a) for hold, weight, a in there if weight is not None]
            found[name] = float(sum(weight.reshape(-1) @ self.found.reaction for weight in lies))
        return found


class Path:
    """A model of moving points, and what finds its equilibria."""

    def __init__(self, model, thickness, tolerance):
        n = model.numerics
        self.model, self.thickness, self.tolerance = model, thickness, tolerance
        self.stiffness = float(np.max(model.law.E)) * thickness
        self.scale = float(np.min(model.cracking.law.ft)) * n.cell * thickness if model.cracking is not None else 0.0
        self.iterations, self.attempts, self.cut_backs = [], 0, 0
        self.compile_seconds, self._programs, self.length = 0.0, {}, 0

    def call(self, function, *args):
        """A jitted function compiled for arguments of such shapes, timed once."""
        key = function, tuple(jnp.shape(leaf) for leaf in jax.tree.leaves(args))
        if key not in self._programs:
            began = clock.perf_counter()
            self._programs[key] = compilation.program(function, *args)
            self.compile_seconds += clock.perf_counter() - began
        return self._programs[key](*args)

    def increment(self, state, before, after):
        """The `Increment` of a state between two amplitudes of the loads, and its points as lists."""
        lists = moving_nodes.listed(state.points, state.pool, self.length)
        self.length = lists.points.mass.size
        nodes = moving_nodes.Nodes(self.model.numerics, lists, self.thickness, self.stiffness)
        loads = [nodes.load(self.model, lists.points, a) for a in (before, after)]
        respond = lambda rate: self.call(moving_tangent.respond, self.model, lists.points, lists.pool, rate)  # noqa: E731
        small = SMALL * self.stiffness * self.model.numerics.cell
        return Increment(nodes, respond, *loads, *nodes.held(self.model, before, after), self.scale, small), lists

    def attempt(self, state, before, after, guess=None) -> Attempt | None:
        """Equilibrium at amplitudes `after` of a state that is in equilibrium at `before`; None if there is none near."""
        self.attempts += 1
        asked, lists = self.increment(state, before, after)
        newton = Newton(asked)
        found = newton.solve(self.tolerance, guess)
        if guess is not None and not found.converged:
            found = newton.solve(self.tolerance)
        if not found.converged:
            self.cut_backs += 1
            return None
        points = moving_nodes.put(state.points, lists, stress=found.answer.stress)
        return Attempt(found, lists, asked.nodes, before, after, self.ratio(points))

    def reached(self, state, attempt):
        """The state with points where an equilibrium has moved them to, which may be beyond their bins."""
        found, lists, nodes = attempt.found, attempt.lists, attempt.nodes
        self.iterations.append(len(found.history))
        by = np.stack([nodes.value @ part for part in found.displacement.reshape(2, -1)])
        place, answer = lists.points.place + by / nodes.n.cell, found.answer
        points = moving_nodes.put(state.points, lists, place=place, gradient=answer.gradient, stress=answer.stress)
        pool = None if state.pool is None else answer.pool._replace(cell=state.pool.cell)
        return state._replace(points=points, pool=pool, step=state.step + 1)

    def ratio(self, points):
        """r̂ of the cells of the window of binned points, zero where nothing can crack."""
        if self.model.cracking is None:
            return np.zeros((1, 1))
        return np.asarray(self.call(strength_ratio, self.model, points))

    def opened(self, state, cells):
        """The state with bands in some cells of its window; a point may lie beyond its bin."""
        listed = np.pad(cells, (0, ROOM - len(cells)), mode="edge").astype(np.int32)
        points, pool = self.call(with_bands, self.model, state.points, state.pool, listed, np.arange(ROOM) < len(cells))
        return state._replace(points=points, pool=pool)
