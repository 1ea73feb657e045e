"""The elastic rise of a run in motion, passed at once: before the first crack a slow response is equilibrium.

Until something cracks the displacement is u(t) = Σ aᵢ(t) uᵢ, uᵢ what the structure answers to a unit of each load: one
factorisation instead of a tenth to a half of all steps. The run goes on in motion from shortly before onset, at the positions of
equilibrium and at the velocity at which these change. Its kinetic energy is the guard: where it has ever been more than a
small share of what is stored, as where a load jumps, loads are not slow and the rise is left to motion.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import explicit, grid
from jaxmpm.loads import amplitudes_at
from jaxmpm.model import Fields, fields, kinetic_energy
from jaxmpm.stiffness import Structure, amplitudes, loads_of

NEAR = 0.97  # strength ratio of the most critical cell at which motion takes over
SLOW = 0.05  # kinetic over stored energy, before the first crack, up to which loads are slow
LOOKS = 50  # at the kinetic energy, between two knots of the histories


@dataclass(eq=False)
class ElasticRise:
    """The states of a model up to `last`, the step at which motion takes over; 0 if it begins in motion."""

    model: object
    dt: float  # s
    structure: Structure
    prepared: Fields
    last: int = 0
    why: str = ""  # it begins in motion, if it does

    @classmethod
    def of(cls, model, state, dt, marks) -> "ElasticRise":
        """Look how far the rise goes.

        Args:
            model: with supports that hold every body.
            state: its first state.
            dt: time step, s.
            marks: numbers of steps at which it is looked at, besides those where loads turn; the last is the end of the run.

        Raises:
            SceneError: where supports leave a body free to move.
        """
        structure = Structure.of(model, 'solver.elastic_rise = "equilibrium"')
        rise = cls(model, dt, structure, fields(model))
        rise.last = rise._end(state, [step for step in sorted({*marks, *rise._knots(max(marks))}) if step > 1])
        if rise.last and not (share := rise.share()) <= SLOW:
            rise.why = (
                f"the kinetic energy of the elastic rise is {share:.2g} of what is stored, more than {SLOW:g}: loads "
                "are not slow, and it is passed in motion"
            )
            rise.last = 0
        return rise

    def share(self) -> float:
        """The most kinetic over the most stored energy until motion takes over; a load that begins with a value jumps there."""
        response, loads = self.structure.response, loads_of(self.model)
        knots = self._knots(self.last)
        steps = np.concatenate([np.linspace(*ends, LOOKS + 2) for ends in zip(knots, knots[1:], strict=False)])
        steps = np.unique(np.maximum(steps.round(), 1))
        here, before = (np.array([amplitudes_at(loads, float(s * self.dt)) for s in at]) for at in (steps, steps - 1))
        before[steps == 1] = 0.0
        units = [response[:, k].reshape(self.model.free.shape) for k in range(len(loads))]
        inertia = _quadratic(lambda rate: self._kinetic(np.tensordot(rate, units, 1)), len(loads))
        stiffness = response[:, : len(loads)].T @ (self.structure.stiffness @ response[:, : len(loads)])
        most = lambda form, values: np.einsum("si,ij,sj->s", values, form, values).max()  # noqa: E731
        kinetic, stored = most(inertia, (here - before) / self.dt), most(stiffness, here) / 2
        return 0.0 if kinetic == 0 else kinetic / stored if stored > 0 else np.inf

    def _knots(self, last: int) -> list[int]:
        """Numbers of the steps up to `last` beside which a history has a knot, growing; between them no load turns."""
        times = np.concatenate([[0.0, last * self.dt], *(np.asarray(load.time, float) for load in loads_of(self.model))]) / self.dt
        steps = np.concatenate([np.floor(times), np.ceil(times)]).astype(int)
        return sorted({int(step) for step in steps if step <= last})

    def state(self, first, step: int):
        """The state at a step up to `last`, made of the first state; its work is what it has taken to get there."""
        displacement, velocity, stored = self._at(step)
        like = lambda a: jnp.asarray(a, first.displacement.dtype)  # noqa: E731
        taken = like(stored + self._kinetic(velocity)) - first.work.initial
        return first._replace(
            step=jnp.int32(step), displacement=like(displacement), velocity=like(velocity),
            work=first.work._replace(external=taken),
        )  # fmt: skip

    def _at(self, step):
        """Displacement (mm) and, half a step before, velocity (mm/s) and stored energy (N·mm)."""
        here, before = (self._displacement(s) for s in (step, step - 1))
        stored = here.reshape(-1) @ (self.structure.stiffness @ before.reshape(-1)) / 2
        return here, (here - before) / self.dt, stored

    def _displacement(self, step: int):
        """Of the nodes in equilibrium, (2, nx+1, ny+1), mm."""
        response = self.structure.response @ amplitudes(self.model, step * self.dt)
        return response.reshape(self.model.free.shape)

    def _kinetic(self, velocity) -> float:
        return float(kinetic_energy(self.model, np.asarray(self.prepared.mass, float), velocity))

    def _end(self, state, marks) -> int:
        """The last step before which no cell is near onset."""
        low, high = 0, 0
        for high in marks:
            if self._ratio(state, high) >= NEAR:
                break
            low = high
        else:
            return low
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self._ratio(state, middle) < NEAR else (low, middle)
        return low if low > 1 else 0

    def _ratio(self, state, step) -> float:
        displacement = jnp.asarray(self._displacement(step), state.displacement.dtype)
        return float(_largest_ratio(self.model, self.prepared, state, displacement))


def _quadratic(energy, count: int) -> np.ndarray:
    """The symmetric matrix Q (count, count) of an energy a·Q·a of as many numbers."""
    unit = np.eye(count)
    pairs = np.array([[energy(a + b) - energy(a) - energy(b) for b in unit] for a in unit]).reshape(count, count)
    return pairs / 2


@jax.jit
def _largest_ratio(model, prepared, state, displacement):
    """Strength ratio of the most critical cell; 0 where nothing cracks."""
    n = model.numerics
    if not n.cracks:
        return jnp.zeros(())
    elastic = explicit.intact_stress(prepared, state, grid.strain(displacement, n.cell), n.size)
    return explicit.onset_ratio(prepared, elastic, n.size).max()
