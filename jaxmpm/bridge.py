"""The dynamic bridge: where no equilibrium lies near, the structure moves to the next one.

The loads are held a little beyond the last equilibrium, and the explicit step with high damping carries the state until
it hardly moves. That is no equilibrium yet: it is one only if Newton's method then converges from there. What damping
takes is the energy of the fall, and is booked as such.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from jaxmpm import compilation, explicit
from jaxmpm import model as models
from jaxmpm.condensed import GRIP
from jaxmpm.errors import RunError
from jaxmpm.newton import Control
from jaxmpm.stiffness import amplitudes, held_at

DAMPING = 0.2  # local damping coefficient
STEPS = 400  # between two looks
LOOKS = 150  # before it is given up
STILL = 1e-4  # kinetic energy, over that of breaking a cell, of what hardly moves
BEYOND = 20.0  # smallest increments by which the loads go on first
STEP = 0.5  # of the stable time step: a fall is quick, and its energy is to be accounted for


def cross(follower, until):
    """Carry a `Follower` from its last equilibrium to the next.

    Returns:
        (energy that damping took, N·mm, time of the loads, s)

    Raises:
        RunError: if the structure does not come to rest, or not in equilibrium.
    """
    eq = follower.equilibria
    eq.let_go()
    time = min(max(follower.time, follower.farthest) + BEYOND * follower.smallest, until)
    amplitude = amplitudes(eq.model, time)
    model = replace(held_at(eq.model, amplitude), damping=jnp.asarray(DAMPING, eq.model.free.dtype), viscosity=None)
    step, before = eq.state.step, float(eq.state.work.damping)
    dt = jnp.asarray(STEP * float(models.stable_time_step(model)), eq.model.free.dtype)
    state = eq.state
    for look in range(LOOKS):
        state = _advanced(model, state, dt, step + (look + 1) * STEPS)
        kinetic = float(models.kinetic_energy(model, eq.prepared.mass, state.velocity))
        if not np.isfinite(kinetic):
            break
        still = kinetic < STILL * eq.energy_of_a_cell
        if (still or look % 10 == 9) and _settled(eq, state, amplitude, kinetic, step):
            return float(eq.state.work.damping) - before, time
    raise RunError(
        f"no equilibrium after t = {follower.time:.6g} s, and none found by moving on from there in {LOOKS * STEPS} damped "
        "steps: the loads may be more than what is left can bear; all is on disk up to the last equilibrium"
    )


def _advanced(model, state, dt, until):
    """The state moved to step `until`, its pool grown as needed."""
    while int(state.step) < int(until):
        if bool(explicit.needs_room(state)):
            state = models.with_room(model, state)
        asked = model, state, dt, jnp.int32(until)
        state = compilation.program(explicit.advance, *asked)(*asked)
        if int(state.failed) >= 0:
            raise RunError(f"a band did not converge on a dynamic bridge, in its cell number {int(state.pool.cell[int(state.failed)])}")
    return state


def _settled(eq, state, amplitude, kinetic, step):
    """Whether Newton's method makes an equilibrium of a state at rest; it is accepted if so."""
    kept = eq.state, eq.now, eq.last, eq.system, eq.pending
    work = state.work._replace(damping=state.work.damping + kinetic)
    grip = jnp.where(state.place >= 0, GRIP, state.grip)
    still = state._replace(velocity=jnp.zeros_like(state.velocity), work=work, grip=grip, step=step)
    eq.restart(still, amplitude)
    trial = eq.attempt(np.zeros_like(amplitude), Control("load", 1.0))
    if trial is not None and trial.found.stable:
        trial.aside = True  # what is left of vibration has energy too, which comes free
        eq.accept(trial)
        return True
    eq.state, eq.now, eq.last, eq.system, eq.pending = kept
    return False
