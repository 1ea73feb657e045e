"""Parameters to be found, on a scale where every number is admissible.

A parameter above zero is sought as its logarithm, one between two bounds as its logit, so that no
step of a descent leaves what is admissible. For parameters on a logarithm a step of 0.01 is 1 %.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp


@dataclass(frozen=True)
class Free:
    """A parameter to be found, with a start; above 0, or between two bounds if `high` is given."""

    start: float
    low: float = 0.0
    high: float | None = None
    unit: str = ""

    def inward(self, value):
        """Value to free number."""
        over = jnp.log(value - self.low)
        return over if self.high is None else over - jnp.log(self.high - value)

    def outward(self, number):
        """Free number to value."""
        if self.high is None:
            return self.low + jnp.exp(number)
        return self.low + (self.high - self.low) * jax.nn.sigmoid(number)

    def relative(self, number):
        """d ln(value)/d(free number)."""
        value = self.outward(number)
        below = 1.0 if self.high is None else (self.high - value) / (self.high - self.low)
        return (value - self.low) * below / value


class Parameters:
    """Named parameters, free and fixed; a vector theta (k,) stands for the free ones, in order."""

    def __init__(self, free: Mapping[str, Free], fixed: Mapping[str, float] | None = None):
        self.free, self.fixed = dict(free), dict(fixed or {})
        self.names = list(self.free)

    def start(self):
        """theta (k,) of the starts."""
        return self.theta({name: one.start for name, one in self.free.items()})

    def theta(self, values: Mapping[str, float]):
        """theta (k,) of values."""
        return jnp.stack(
            [jnp.asarray(f.inward(values[name]), float) for name, f in self.free.items()]
        )

    def values(self, theta) -> dict:
        """All parameters, fixed ones too, of theta (k,)."""
        found = {
            name: one.outward(x) for (name, one), x in zip(self.free.items(), theta, strict=True)
        }
        return self.fixed | found

    def relative(self, theta):
        """d ln(value)/d theta of the free parameters (k,): what a step is, as a share of the value."""
        return jnp.stack(
            [one.relative(x) for one, x in zip(self.free.values(), theta, strict=True)]
        )

    def about(self, count: int, spread: float = 0.7, seed: int = 0):
        """Starts (count, k): the given one, and others at random around it."""
        shape = (count, len(self.names))
        noise = spread * jax.random.normal(jax.random.key(seed), shape, self.start().dtype)
        return self.start() + noise.at[0].set(0.0)

    def show(self, theta) -> str:
        """The free parameters in a few words."""
        values = self.values(theta)
        return "  ".join(f"{name} = {float(values[name]):.6g}" for name in self.names)
