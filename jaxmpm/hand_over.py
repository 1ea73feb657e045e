"""From the total frame to points that move: bodies become points, bands and all.

An uncracked cell becomes a few points; a cracked one becomes one point with its band. Points have the displacement, its gradient and the
velocity that the nodes say. What loads and gauges say of nodes is shared out among the points
around these by their mass, and goes where the points go.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm import bands, carry, cracks, moving, points as points_of, shape_functions
from jaxmpm.errors import RunError
from jaxmpm.fill import owners
from jaxmpm.holds import Hold
from jaxmpm.laws.finite import Corotated, NeoHookean
from jaxmpm.loads import Load

CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))
LAWS = {"elastic": Corotated, "neo_hookean": NeoHookean}


class Cloud(NamedTuple):
    """Points as plain lists: in which cell each is, where in it, and its share of the cell."""

    cell: np.ndarray  # (2, count)
    place: np.ndarray  # in the cell, 0 to 1 (2, count)
    share: np.ndarray  # of the cell's volume (count,)
    body: np.ndarray  # index (count,)
    cracked: np.ndarray  # whether it stands for a whole cracked cell (count,)


def places(per_side, shape):
    """Places 0 to 1 along a cell's side: Gauss points for two linear ones, else evenly spread."""
    if per_side == 2 and shape == "linear":
        return 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)
    return (np.arange(per_side) + 0.5) / per_side


def cloud(scene, layout, cracked, begins):
    """The `Cloud` of a layout: of its cells, or, where the run begins, of what its shapes cover."""
    line = places(scene.points.per_side, scene.points.shape)
    inner = np.stack(np.meshgrid(line, line, indexing="ij")).reshape(2, -1)
    if begins and scene.points.fill == "shapes":
        cell, place = _every(np.stack(np.nonzero(np.ones(layout.shape, bool))), inner)
        at = np.reshape(layout.origin, (2, 1)) + layout.cell * (cell + place)
        body = owners(scene.bodies, *at)
        cell, place, body = cell[:, body >= 0], place[:, body >= 0], body[body >= 0]
    else:
        filled = (layout.material >= 0) & ~cracked
        cell, place = _every(np.stack(np.nonzero(filled)), inner)
        body = layout.owner[tuple(cell)]
    share = np.full(cell.shape[1], 1 / scene.points.per_side**2)
    broken = np.stack(np.nonzero(cracked))
    count = broken.shape[1]
    return Cloud(
        np.concatenate([cell, broken], 1),
        np.concatenate([place, np.full((2, count), 0.5)], 1),
        np.concatenate([share, np.ones(count)]),
        np.concatenate([body, layout.owner[cracked]]),
        np.arange(cell.shape[1] + count) >= cell.shape[1],
    )


def _every(cells, inner):
    """Each cell with each of the places in it."""
    return np.repeat(cells, inner.shape[1], 1), np.tile(inner, cells.shape[1])


def corner_weights(place):
    """Bilinear weights (4, count) of the corners of a cell, and their derivatives times its side."""
    x, y = place
    value, slope = [], []
    for i, j in CORNERS:
        u, v = (x if i else 1 - x), (y if j else 1 - y)
        value.append(u * v)
        slope.append([(1 if i else -1) * v, (1 if j else -1) * u])
    return np.stack(value), np.moveaxis(np.array(slope), 0, 1)


class Bilinear:
    """Values of nodal fields (..., nx+1, ny+1) at the points of a cloud."""

    def __init__(self, points, cell):
        self.value, slope = corner_weights(points.place)
        self.slope = slope / cell
        self.nodes = [tuple(points.cell + np.reshape(corner, (2, 1))) for corner in CORNERS]

    def at(self, field):
        """(..., count)."""
        return sum(w * field[(..., *node)] for w, node in zip(self.value, self.nodes, strict=True))

    def gradient(self, field):
        """∂f_a/∂x_b (a, b, count) of a vector field (a, nx+1, ny+1)."""
        parts = [
            field[(slice(None), None, *node)] * self.slope[None, :, k] for k, node in enumerate(self.nodes)
        ]
        return sum(parts)

    def shares(self, weight, mass, shape):
        """What nodal weights (..., nx+1, ny+1) are as shares of the points (..., count), by mass."""
        lumped = np.zeros(shape)
        for w, node in zip(self.value, self.nodes, strict=True):
            np.add.at(lumped, node, w * mass)
        per_mass = weight / np.where(lumped > 0, lumped, 1.0)
        return self.at(per_mass) * mass


def normals_at(model, state, listed):
    """Normal of the crack of each point (2, count), zero where it has none."""
    out = np.zeros((2, len(listed.share)))
    if model.numerics.cracks:
        normal = np.asarray(bands.bands_of(state.pool, model.numerics.size).normal, float)
        place = np.asarray(state.place)[tuple(listed.cell)]
        out[:, listed.cracked] = normal[:, place[listed.cracked]]
    return out


def turned_gradient(gradient, normal):
    """The gradient H whose strain in the turned frame is the small strain of a given one, (2, 2, count).

    The total frame knows a rotation to first order only. It is taken as one of finite size, of the
    faces where there is a crack: strains, and so stresses, jumps and energy, stay what they were.
    """
    xx, yy = gradient[0, 0], gradient[1, 1]
    shear, spin = gradient[0, 1] + gradient[1, 0], (gradient[1, 0] - gradient[0, 1]) / 2
    inner = np.array([[xx, shear / 2], [shear / 2, yy]])
    # in the frame of the faces a line along the crack does not turn
    n, m = normal, np.stack([-normal[1], normal[0]])
    across = sum(n[i] * inner[i, j] * m[j] for i in range(2) for j in range(2))
    inner = inner + across * (m[:, None] * n[None] - n[:, None] * m[None])
    angle = spin + across
    less, s = -2 * np.sin(angle / 2) ** 2, np.sin(angle)
    turn = np.array([[less, -s], [s, less]])  # R − 1
    return turn + inner + np.einsum("ijp,jkp->ikp", turn, inner)


def numerics(scene, layout, fields=1):
    """`moving.Numerics` of a scene."""
    p = scene.points
    shape = {
        "linear": shape_functions.Linear(),
        "gimp": shape_functions.Gimp(),
        "quadratic": shape_functions.Quadratic(),
        "cubic": shape_functions.Cubic(),
    }[p.shape]
    walls = scene.grid.walls
    hard = lambda side: side if side in ("slip", "stick") else "open"  # noqa: E731
    return moving.Numerics(
        cell=layout.cell,
        cells=tuple(layout.shape),
        shape=shape,
        transfer=moving.Transfer(p.transfer, p.flip, p.xpic_order, p.fmpm_order),
        order=p.order,
        walls=((hard(walls.left), hard(walls.right)), (hard(walls.bottom), hard(walls.top))),
        cell_volume=layout.cell**2 * layout.thickness,
        fields=fields,
    )


def dense(layout, dofs, weights):
    """A nodal field (2, nx+1, ny+1) of weights on degrees of freedom."""
    shape = (2, layout.shape[0] + 1, layout.shape[1] + 1)
    out = np.zeros(shape)
    np.add.at(out.reshape(-1), dofs, weights)
    return out


def _still(array):
    return Load(np.zeros(0, np.int32), array([]), array([0.0, 1.0]), array([0.0, 0.0]), array([0.0]))


def holds(model, layout, array):
    """Supports as one hold, then one for each moved set in their order."""
    found = []
    if len(layout.held):
        which = dense(layout, layout.held, np.ones(len(layout.held)))
        found.append(Hold(array(which), array([0.0, 0.0]), _still(array), rides=False))
    for drive, load in zip(layout.displacements, model.displacements, strict=True):
        which = dense(layout, drive.dofs, np.ones(len(drive.dofs)))
        weights = dense(layout, drive.dofs, drive.weights)
        cosines = [component[which[c] > 0].mean() if which[c].any() else 0.0 for c, component in enumerate(weights)]
        found.append(Hold(array(which), array(cosines), load))
    return tuple(found)


def moving_model(scene, layout, model, time, fields=1):
    """The `moving.Model` of a scene whose total-frame `model` is given; parameters are shared."""
    dtype = model.free.dtype
    array = lambda values: jnp.asarray(values, dtype)  # noqa: E731
    bulk, n = model.embedding.bulk, model.numerics
    kind = scene.materials[layout.materials[0]].bulk.law
    law = LAWS[kind](bulk.E, bulk.nu, *((n.size == 3,) if kind == "elastic" else ()))
    cracking = None
    if n.cracks:
        embedding = model.embedding
        cracking = cracks.Cracking(
            embedding.law, embedding.release, n.thickness, n.size, n.effective_size,
            n.normal_window, embedding.closes,
        )  # fmt: skip
    return moving.Model(
        law=law,
        gravity=model.gravity if any(scene.gravity) else None,
        numerics=numerics(scene, layout, fields),
        holds=holds(model, layout, array),
        forces=model.forces,
        cracking=cracking,
        damping=model.damping if scene.solver.damping else None,
        friction=array(scene.contact.friction),
        begin=array(time),
    )


def gauges_of_points(layout):
    """The gauges that follow points, in the scene's order."""
    return [gauge for gauge in layout.gauges if gauge.kind != "reaction"]


def to_points(scene, layout, model, state, time, fields=1, body_of=None):
    """The moving model and state that go on from a state of the total frame.

    Args:
        scene, layout: the scene.
        model, state: of the total frame.
        time: of the state, s.
        fields: number of velocity fields.
        body_of: field of every cell (nx, ny), 0 if None.

    Returns:
        (moving.Model, moving.State)
    """
    dtype = np.dtype(model.free.dtype)
    place = np.asarray(state.place)
    begins = int(state.step) == 0
    listed = cloud(scene, layout, place >= 0, begins)
    nodal = Bilinear(listed, layout.cell)
    displacement, velocity = (np.asarray(f, float) for f in (state.displacement, state.velocity))
    here = tuple(listed.cell)
    names = [scene.bodies[k].material for k in range(len(scene.bodies))]
    index = [layout.materials.index(name) if name in layout.materials else 0 for name in names]
    # A place that shapes cover in a cell that is empty, or another body's, is of the body's own material.
    filled = layout.owner[here] == listed.body
    material = np.where(filled, layout.material[here], np.array(index)[listed.body])
    volume = layout.cell**2 * layout.thickness * listed.share
    mass = volume * np.asarray(model.density, float)[material]
    corner = np.reshape(layout.origin, (2, 1))
    home = corner + layout.cell * (listed.cell + listed.place)
    thrown = np.array([body.velocity for body in scene.bodies]).T[:, listed.body]
    new = moving_model(scene, layout, model, time, fields)
    shape = (layout.shape[0] + 1, layout.shape[1] + 1)
    known = [*layout.forces, *gauges_of_points(layout)]
    share = [nodal.shares(dense(layout, k.dofs, k.weights), mass, shape) for k in known]
    lists = {
        "velocity": thrown if begins else nodal.at(velocity),
        "gradient": turned_gradient(nodal.gradient(displacement), normals_at(model, state, listed)),
        "stress": np.zeros((3, len(mass))),
        "mass": mass.astype(dtype), "volume": volume,
        "material": material, "home": home - corner,
        "band": np.where(listed.cracked, place[here] + 1, 0),
        "body": np.zeros(len(mass), int) if body_of is None else body_of(listed),
        "share": np.concatenate(share) if share else np.zeros((0, len(mass))),
    }  # fmt: skip
    if new.numerics.affine:
        still = np.zeros((2, 2, len(mass)))
        lists["affine"] = still if begins else nodal.gradient(velocity)
    position = home + nodal.at(displacement)
    _check_inside(layout, position, time)
    binned = binned_points(new.numerics, layout.origin, position, lists)
    pool = None
    if new.cracking is not None:
        pool = with_addresses(state.pool, binned)
    first = moving.first_state(binned, pool)
    if begins:  # nothing is strained yet
        return new, first._replace(work=state.work._replace(initial=_kinetic(new.numerics, binned)))
    return new, _settled(new, first)._replace(work=state.work)


def _check_inside(layout, position, time):
    """Raise RunError where a point has left the grid in the total frame."""
    low = np.reshape(layout.origin, (2, 1))
    high = low + layout.cell * np.reshape(layout.shape, (2, 1))
    outside = ((position < low) | (position > high)).any(0)
    if outside.any():
        x, y = position[:, np.argmax(outside)]
        raise RunError(
            f"the point at ({x:.6g}, {y:.6g}) mm is outside the grid at t = {time:.6g} s, where the total frame "
            'hands over: use a larger grid, or solver.frame = "updated"'
        )


@partial(jax.jit, static_argnums=0)
def _kinetic(n, points):
    return carry.kinetic_energy(n, points, carry.weights(n, points))


@jax.jit
def _settled(model, state):
    """The state with the stresses of its deformation."""
    points, pool, failed = moving.stressed(model, points_of.separate(state.points), state.pool)
    return state._replace(points=points_of.joined(points), pool=pool, failed=failed)


MARGIN = 2  # bins around the points to begin with
MULTIPLE = 8  # a window is a multiple of so many bins, so that few programs are compiled
GROWTH = 1.4  # of a window that has become too small
SPARE = 1.5  # slots over the most points in a bin


def binned_points(n, origin, position, lists, slots=0, bins=None):
    """Points in a window around them with some room; see `points.in_bins`.

    Not less room than `slots`, and the same `bins` if these are enough: a program fits one of each.
    """
    centred = n.shape.centred
    most = np.array(n.cells) + centred
    number = (position - np.reshape(origin, (-1, 1))) / n.cell + 0.5 * centred
    number = np.clip(np.floor(number).astype(int), 0, most[:, None] - 1)
    low = np.maximum(number.min(1) - MARGIN, 0)
    high = np.minimum(number.max(1) + 1 + MARGIN, most)
    needed = high - low
    if bins is not None:
        grown = np.maximum(needed, np.ceil(GROWTH * np.array(bins)).astype(int))
        needed = np.where(needed <= bins, bins, grown)
    length = np.minimum(-(-needed // MULTIPLE) * MULTIPLE, most)
    low = np.clip(low - (length - (high - low)) // 2, 0, most - length)
    local = np.ravel_multi_index(tuple(number - low[:, None]), tuple(length))
    fullest = int(np.bincount(local).max())
    slots = max(slots, fullest if fullest < 3 else int(np.ceil(SPARE * fullest)), 4)
    return points_of.in_bins(
        position, lists, origin, n.cell, centred, slots=slots, bins=tuple(length), window=low
    )


def with_addresses(pool, points):
    """The pool with the flat index of each band's point, -1 where it has gone."""
    band = np.asarray(points.band).reshape(-1)
    address = np.full(pool.cell.shape[0], -1, np.int32)
    here = np.flatnonzero(band > 0)
    address[band[here] - 1] = here
    return pool._replace(cell=jnp.asarray(address))
