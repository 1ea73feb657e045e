"""The elastic rise of a run in motion, passed at once: before the first crack a slow response is equilibrium.

Until something cracks the displacement is u(t) = Σ aᵢ(t) uᵢ, uᵢ what the structure answers to a unit of each load: one
factorisation instead of a tenth to a half of all steps. The run goes on in motion from shortly before onset, at the positions of
equilibrium and at the velocity at which these change. Its kinetic energy is the guard: where it is more than a small
share of what is stored, loads are not slow and the rise is left to motion.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import explicit, grid
from jaxmpm.model import Fields, fields, kinetic_energy
from jaxmpm.stiffness import Structure, amplitudes

NEAR = 0.97  # strength ratio of the most critical cell at which motion takes over
SLOW = 0.05  # kinetic over stored energy, before the first crack, up to which loads are slow


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
            marks: numbers of steps at which it is looked at, growing; in between the loads must not turn.

        Raises:
            SceneError: where supports leave a body free to move.
        """
        structure = Structure.of(model, 'solver.elastic_rise = "equilibrium"')
        rise = cls(model, dt, structure, fields(model))
        rise.last = rise._end(state, [step for step in marks if step > 1])
        if rise.last and not (share := rise.share()) <= SLOW:
            rise.why = (
                f"the kinetic energy of the elastic rise is {share:.2g} of what is stored, more than {SLOW:g}: loads "
                "are not slow, and it is passed in motion"
            )
            rise.last = 0
        return rise

    def share(self) -> float:
        """Kinetic over stored energy where motion takes over."""
        _, velocity, stored = self._at(self.last)
        return self._kinetic(velocity) / stored

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


@jax.jit
def _largest_ratio(model, prepared, state, displacement):
    """Strength ratio of the most critical cell; 0 where nothing cracks."""
    n = model.numerics
    if not n.cracks:
        return jnp.zeros(())
    elastic = explicit.intact_stress(prepared, state, grid.strain(displacement, n.cell), n.size)
    return explicit.onset_ratio(prepared, elastic, n.size).max()
