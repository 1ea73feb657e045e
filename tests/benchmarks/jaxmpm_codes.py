"""The scene in jaxmpm: as points that move, and in the total frame."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import explicit, moving
from jaxmpm import model as total_model
from jaxmpm.laws.band import Embedding
from jaxmpm.compilation import compiled
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.law import law
from jaxmpm.points import in_bins, listed
from jaxmpm.rebinning import rebin
from jaxmpm.shape_functions import Linear

PLANE_STRESS, PLANE_STRAIN = 3, 4  # lengths of a strain vector


@law
class SmallStrain:
    """Linear elasticity of the displacement gradient F − I, plane strain."""

    bulk: Elastic

    def kirchhoff(self, gradient):
        """In-plane stress xx, yy, xy, a list, MPa."""
        direct, cross, shear = self.bulk.coefficients(PLANE_STRAIN)
        xx, yy = gradient[0, 0], gradient[1, 1]
        across = shear * (gradient[0, 1] + gradient[1, 0])
        return [direct * xx + cross * yy, cross * xx + direct * yy, across]


def points(scene, dtype):
    """First points in the order of the grid, each with its number as `home`."""
    x = scene.positions()
    fields = {
        "velocity": scene.velocities(x), "stress": np.zeros((3, scene.count)),
        "gradient": np.zeros((2, 2, scene.count)),
        "mass": np.full(scene.count, scene.density * scene.volume, dtype),
        "volume": np.full(scene.count, scene.volume), "material": np.zeros(scene.count, int),
        "home": np.stack([np.arange(scene.count)] * 2), "affine": np.zeros((0, 0, scene.count)),
    }  # fmt: skip
    bins = (scene.cells,) * 2
    return in_bins(x, fields, np.zeros(2), scene.cell, False, bins=bins, window=(0, 0))


def moving_model(scene, dtype):
    """The moving points' model."""
    numerics = moving.Numerics(
        scene.cell, (scene.cells,) * 2, Linear(), moving.Transfer("flip"), walls=(("slip",) * 2,) * 2
    )
    bulk = Elastic(jnp.full(1, scene.young, dtype), jnp.full(1, scene.poisson, dtype))
    return moving.Model(SmallStrain(bulk), jnp.zeros(2, dtype), numerics)


def moving_runner(scene, dtype):
    """Three functions: begin, take a number of steps, give positions and velocities (4, count)."""
    model, dt = moving_model(scene, dtype), jnp.asarray(scene.dt, dtype)
    first = moving.first_state(points(scene, dtype))
    held = {"state": first, "slots": None}

    def reset():
        held["state"] = _with_slots(first, held["slots"])

    def step(steps):
        state = held["state"]
        until = state.step + steps
        while int(state.step) < int(until):
            advance = _program(moving.advance, model, state, dt)
            state = jax.block_until_ready(advance(model, state, dt, until))
            if bool(state.room.slots):
                held["slots"] = state.points.mass.shape[0] + 1
                state = _with_slots(state, held["slots"])
        held["state"] = state

    def read():
        x, fields = listed(held["state"].points, np.zeros(2), scene.cell, False)
        order = np.argsort(fields["home"][0].astype(int))
        return np.concatenate([x, fields["velocity"]])[:, order]

    return reset, step, read


def _with_slots(state, slots):
    """A state with at least so many slots a bin."""
    more = (slots or 0) - state.points.mass.shape[0]
    if more <= 0:
        return state
    pad = lambda a: jnp.pad(a, [(0, 0)] * (a.ndim - 3) + [(0, more), (0, 0), (0, 0)])  # noqa: E731
    fields = {k: pad(a) for k, a in state.points._asdict().items() if k != "window"}
    points, _, room = jax.jit(rebin)(state.points._replace(**fields))  # those that found no room
    return state._replace(points=points, room=room)


def total_runner(scene, dtype):
    """The same in the total frame; gives displacements and velocities of the nodes (4, *nodes)."""
    cells, size = scene.cells, scene.cell
    one = lambda value: jnp.full(1, value, dtype)  # noqa: E731
    nodes = np.arange(cells + 1) * size
    x = np.stack(np.meshgrid(nodes, nodes, indexing="ij"))
    free = np.ones(x.shape)
    free[0, [0, -1], :] = free[1][:, [0, -1]] = 0
    nu = scene.poisson / (1 - scene.poisson)  # plane strain as plane stress of another material
    elastic = Elastic(one(scene.young / (1 - scene.poisson**2)), one(nu))
    embedding = Embedding(elastic, Damage(*map(one, (1.0, 1.0, 1.0, 1.0))))
    model = total_model.Model(
        embedding=embedding, density=one(scene.density), damping=None, viscosity=None,
        gravity=jnp.zeros(2, dtype), material=jnp.zeros((cells, cells), jnp.int32),
        free=jnp.asarray(free, dtype), displacements=(), forces=(), gauges={}, macro=None,
        numerics=total_model.Numerics(size, 1.0, PLANE_STRESS, "fixed", 1, False),
    )  # fmt: skip
    dt = jnp.asarray(scene.dt, dtype)
    first = total_model.first_state(model, free * scene.velocities(x), capacity=1)
    held = {"state": first}

    def reset():
        held["state"] = first

    def step(steps):
        state = held["state"]
        advance = _program(explicit.advance, model, state, dt)
        held["state"] = jax.block_until_ready(advance(model, state, dt, state.step + steps))

    def read():
        state = held["state"]
        return np.concatenate([state.displacement, state.velocity])

    return reset, step, read


_programs = {}


def _program(advance, model, state, dt):
    """A loop over steps as the project compiles it."""
    key = (advance, jax.tree.structure((model, state)), *((jnp.shape(a), jnp.result_type(a)) for a in jax.tree.leaves((model, state))))
    if key not in _programs:
        _programs[key] = compiled(advance.lower(model, state, dt, state.step))
    return _programs[key]
