"""Loads in time: history tables and the degrees of freedom they drive."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Load:
    """A history applied to a set of degrees of freedom, each with its weight."""

    dofs: jax.Array  # flat indices into a (2, nx+1, ny+1) field, (k,)
    weights: jax.Array  # what one unit of the history means at each of them, (k,)
    time: jax.Array  # knots of the history, s, (m,)
    value: jax.Array  # mm or N at the knots, (m,)
    start: jax.Array  # parabolic start of each segment as a share of it, 0 for none, (m-1,)
    smooth: bool = field(metadata={"static": True}, default=False)  # quintic between knots

    def amplitude(self, time):
        """Value of the history at a time (s); constant outside the table."""
        begin, length = self.time[:-1], jnp.diff(self.time)
        x = jnp.clip((time - begin) / length, 0.0, 1.0)
        if self.smooth:
            shape = x**3 * (10 - 15 * x + 6 * x * x)
        else:
            a = self.start
            curved = x * x / (jnp.where(a > 0, a, 1.0) * (2 - a))
            shape = jnp.where(x < a, curved, (2 * x - a) / (2 - a))
        return self.value[0] + jnp.diff(self.value) @ shape

    def at(self, time):
        """Value at every driven degree of freedom, (k,)."""
        return self.weights * self.amplitude(time)


def amplitudes_at(loads, time):
    """Value of every history at a time (s), (loads,), as NumPy's numbers, by one small program."""
    return np.asarray(_amplitudes(list(loads), time), float)


@jax.jit
def _amplitudes(loads, time):
    return jnp.stack([load.amplitude(time) for load in loads]) if loads else jnp.zeros(0)
