"""The grid under points as sparse operators, for one increment of equilibrium.

Nodes are those of the whole grid, (nx + 1, ny + 1); ghosts outside it are the linear continuation of those inside. Points
are plain lists. A node that hardly any matter reaches has next to no stiffness and would go anywhere. So where a node's
share φ of matter is small it is held to the linear continuation of Δu from the two next nodes along that line of the grid
which has the most matter, softly, after the ghost penalty of finite elements (Coombs 2023):

    K_g:  ½ Δuᵀ K_g Δu = Σ ½ γ E t (1 − φ/φ₀)²₊ |Δu − 2 Δu₁ + Δu₂|²

t the thickness. A linear Δu, and so rigid motion, costs nothing; what it takes is booked as damping. γ = `FLOOR` on the second
differences of all nodes keeps cells of a single point from hourglassing.
"""

from functools import partial
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sparse
from scipy import ndimage

from jaxmpm import carry, transfer
from jaxmpm.errors import SceneError
from jaxmpm.laws.finite import rotation, strain_in
from jaxmpm.points import PER_POINT, bins_of
from jaxmpm.shape_functions import Gimp
from jaxmpm.stiffness import LOOSE, STATIC
from jaxmpm.tensor import Matrix

GHOST = 0.1  # γ
FULL = 0.2  # φ₀: a corner that lies on a node has 1/4 and needs no help
FLOOR = 1e-8  # γ where there is matter enough
LIGHT = 1e-12  # share of the most that reaches a node which does not count
MULTIPLE = 256  # lists begin as long as a multiple of it: a program fits one length


class Listed(NamedTuple):
    """Points as plain lists, some at the end without mass."""

    points: object  # `Points` whose arrays end in (count,), NumPy
    pool: object  # bands, addresses places in the list; None without
    bin: np.ndarray  # number of each point's bin along each axis (2, count)
    where: np.ndarray  # flat index over (slots, *bins) of those with mass, which come first


def listed(points, pool, length=0) -> Listed:
    """Binned points, and a pool or None, as lists that are at least so long."""
    where = np.flatnonzero(np.asarray(points.mass) > 0)
    spare = max(length - len(where), -len(where) % MULTIPLE)
    taken, rank = {}, points.mass.ndim
    for name in PER_POINT:
        whole = np.asarray(getattr(points, name))
        flat = whole.reshape(*whole.shape[: whole.ndim - rank], points.mass.size)[..., where]
        taken[name] = np.pad(flat, [(0, 0)] * (flat.ndim - 1) + [(0, spare)])
    number = np.stack(np.unravel_index(where % int(np.prod(bins_of(points))), bins_of(points)))
    number = np.pad(number + np.asarray(points.window)[:, None], ((0, 0), (0, spare)))
    if pool is not None:
        place = np.full(points.mass.size + 1, -1, np.int32)  # the last for those that have gone
        place[where] = np.arange(len(where))
        pool = pool._replace(cell=place[np.asarray(pool.cell)])
    return Listed(points._replace(**taken), pool, number, where)


def put(points, lists, **fields):
    """Binned points with some fields (..., count) of lists put in."""
    def binned(name, values):
        old = np.array(getattr(points, name))
        flat = old.reshape(*values.shape[:-1], points.mass.size)
        flat[..., lists.where] = values[..., : len(lists.where)]
        return jnp.asarray(flat.reshape(old.shape))

    return points._replace(**{name: binned(name, values) for name, values in fields.items()})


@partial(jax.jit, static_argnums=0)
def _weights(n, points):
    """Their shape functions; GIMP points stretch along the axes with U of F = R U (Coombs and others 2020), cracked ones do not."""
    if n.shape != Gimp():
        return carry.weights(n, points)
    gradient = Matrix(points.gradient)
    strain = strain_in(rotation(gradient), gradient)[: n.dimension]
    halves = [carry.half_width(n, points, jnp.where(points.band > 0, 1.0, 1 + e)) for e in strain]
    parts = [n.shape.weights(y, half) for y, half in zip(points.place, halves, strict=True)]
    return transfer.Weights([value for value, _ in parts], [[s / n.cell for s in slope] for _, slope in parts])


class Nodes:
    """What lists of points reach of the grid, and what holds it."""

    def __init__(self, n, lists: Listed, thickness: float, stiffness: float):
        """`n`: `moving.Numerics`; `stiffness`: E t, N/mm."""
        self.n, self.shape = n, tuple(cells + 1 for cells in n.cells)
        w = jax.tree.map(np.asarray, _weights(n, lists.points))
        used = lists.points.mass > 0
        ties = _ties(n.cells)
        self.value = self._operator(w.value, lists.bin, used) @ ties  # (count, N)
        slopes = [[(w.slope if a == axis else w.value)[a] for a in range(2)] for axis in range(2)]
        self.by = [self._operator(part, lists.bin, used) @ ties for part in slopes]  # ∂/∂x, ∂/∂y, 1/mm
        self.slope = sparse.vstack(self.by).tocsr()  # (2 count, N)
        volume = np.where(used, lists.points.volume, 0.0)
        self.share = (volume @ self.value / n.cell_volume).reshape(self.shape)
        reach = volume @ abs(self.value) + n.cell * (np.tile(volume, 2) @ abs(self.slope))
        self.active = reach.reshape(self.shape) > LIGHT * reach.max()
        self.ghosts = self._ghosts(stiffness)

    def _operator(self, parts, first, used):
        """Matrix (count, nodes with ghosts) of the products of weights along the axes, [axis][k] (count,)."""
        count, wide = len(used), [cells + 3 for cells in self.n.cells]
        columns, values = [], []
        for i, j in transfer.stencil(self.n.shape, 2):
            x, y = (first[a] - self.n.shape.lead + k + 1 for a, k in enumerate((i, j)))  # the first is node −1
            columns.append(np.where(used, x * wide[1] + y, 0))
            values.append(np.where(used, parts[0][i] * parts[1][j], 0.0))
        rows = np.tile(np.arange(count), len(columns))
        entries = np.concatenate(values), (rows, np.concatenate(columns))
        return sparse.csr_matrix(entries, shape=(count, wide[0] * wide[1]))

    def rate(self, u):
        """G (4, count) of a displacement (2 N,)."""
        return np.concatenate([(self.slope @ part).reshape(2, -1) for part in u.reshape(2, -1)])

    def force(self, pull):
        """Nodal force (2 N,), N, of S (4, count)."""
        return np.concatenate([self.slope.T @ pull[2 * a : 2 * a + 2].reshape(-1) for a in range(2)])

    def stiffness(self, slope):
        """K (2 N, 2 N) of ∂S/∂G (4, 4, count)."""
        across = self.slope.T

        def block(a, b):
            part = slope[2 * a : 2 * a + 2, 2 * b : 2 * b + 2]
            return across @ sparse.vstack([sum(_scaled(by, part[c, d]) for d, by in enumerate(self.by)) for c in range(2)])

        return sparse.block_array([[block(a, b) for b in range(2)] for a in range(2)]).tocsr()

    def _ghosts(self, stiffness):
        """K_g (2 N, 2 N)."""
        number, best = np.arange(self.share.size).reshape(self.shape), np.zeros(self.shape)
        rows, lines = np.zeros((*self.shape, 3), int), []
        for axis, step in product((0, 1), (1, -1)):
            two = [_further(self.share * self.active, axis, k * step) for k in (1, 2)]
            along = np.stack([number, *(_further(number, axis, k * step) for k in (1, 2))], -1)
            heavier = self.active & (np.min(two, axis=0) > best)
            best[heavier], rows[heavier] = np.min(two, axis=0)[heavier], along[heavier]
            if step > 0:
                lines.append(along[self.active & (np.min(two, axis=0) > 0)])
        light = (best > 0) & (self.share < FULL)
        rows = np.concatenate([rows[light], *lines])
        weights = np.full(len(rows), FLOOR)
        weights[: light.sum()] = GHOST * (1 - self.share[light] / FULL) ** 2
        entries = np.tile([1.0, -2.0, 1.0], len(rows)), (np.repeat(np.arange(len(rows)), 3), rows.reshape(-1))
        second = sparse.csr_matrix(entries, shape=(len(rows), self.share.size))
        one = stiffness * (second.T @ sparse.diags(weights) @ second)
        return sparse.block_diag([one, one]).tocsr()

    # -- what acts on them -----------------------------------------------------------------------

    def load(self, model, points, amplitude):
        """Forces of gravity and loads (2 N,), N, at amplitudes (loads,), see `moving_path`."""
        forces = amplitude[len(model.holds) : -1]
        pull = sum((a * points.share[2 * k : 2 * k + 2] for k, a in enumerate(forces)), np.zeros_like(points.place))
        if model.gravity is not None:
            pull = pull + amplitude[-1] * np.asarray(model.gravity)[:, None] * points.mass
        return np.concatenate([self.value.T @ row for row in pull])

    def held(self, model, before, after):
        """Displacement (2 N,), mm, that walls and holds prescribe between amplitudes (loads,), and whether it is (2 N,)."""
        moved, known = np.zeros((2, *self.shape)), np.zeros((2, *self.shape), bool)
        for axis, sides in enumerate(self.n.walls):
            for side, end in zip(sides, (0, -1), strict=True):
                for row in {"slip": (axis,), "stick": (0, 1)}.get(side, ()):
                    known[row].swapaxes(0, axis)[end] = True
        for k, hold in enumerate(model.holds):
            which = shifted(self.n, hold, hold.which, before[k]) > 0
            known |= which
            along = np.reshape(np.asarray(hold.cosines), (2, 1, 1)) * (after[k] - before[k])
            moved = np.where(which, along, moved)
        known &= self.active
        return np.where(known, moved, 0.0).reshape(-1), known.reshape(-1)

    def check_held(self, known):
        """Raise SceneError where a body can move without strain while the components `known` (2 N,) do not."""
        label, count = ndimage.label(self.active, np.ones((3, 3), int))
        known, (x, y) = known.reshape(2, *self.shape), np.indices(self.shape)
        one, none = np.ones(self.shape), np.zeros(self.shape)
        modes = np.stack([np.stack([one, none, -y]), np.stack([none, one, x])])  # rigid, (component, 3, *nodes)
        for k in range(1, count + 1):
            rows = np.moveaxis(modes, 1, -1)[known & (label == k)]
            if np.linalg.matrix_rank(rows) < 3:
                raise SceneError(STATIC + LOOSE)


def shifted(n, hold, field, amplitude):
    """A field (2, *nodes) that belongs to a hold, as it lies where the hold has moved to, by whole cells."""
    field = np.asarray(field)
    if not hold.rides:
        return field
    by = np.round(amplitude * np.asarray(hold.cosines) / n.cell).astype(int)
    wide = np.pad(field, [(0, 0), *((abs(b), abs(b)) for b in by)])
    start = [abs(b) - b for b in by]
    return wide[:, start[0] : start[0] + field.shape[1], start[1] : start[1] + field.shape[2]]


def _further(field, axis, steps):
    """A field (*nodes) so many nodes further along an axis, two at most, zero beyond the edge."""
    wide, at = np.pad(field, 2), [slice(2, -2)] * 2
    at[axis] = slice(2 + steps, 2 + steps + field.shape[axis])
    return wide[tuple(at)]


def _scaled(matrix, by):
    """A CSR matrix with each row times a number."""
    data = matrix.data * np.repeat(by, np.diff(matrix.indptr))
    return sparse.csr_matrix((data, matrix.indices, matrix.indptr), shape=matrix.shape)


def _ties(cells):
    """Values at nodes −1 to n + 1 along both axes from those inside the grid (wide N, N)."""
    one = []
    for count in cells:
        table = sparse.eye(count + 3, format="lil")[:, 1:-1]
        table[0, :2], table[-1, -2:] = [2, -1], [-1, 2]
        one.append(table.tocsr())
    return sparse.kron(*one).tocsr()
