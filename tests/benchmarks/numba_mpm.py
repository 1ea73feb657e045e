"""The scene in plain loops over points, compiled by Numba, on one thread or on several.

A point is one row (x, y, vx, vy, Fxx, Fxy, Fyx, Fyy) and a node one row (mass, momentum, force),
so that either is a cache line or less. Every thread scatters to a grid of its own; the grids are
added where the nodes are updated. `fused` gathers from one grid and scatters to the next in the
same pass over the points, so that a step reads and writes each of them once.
"""

from functools import lru_cache

import numba
import numpy as np
from numba import njit, prange

PLAIN, FUSED = "loops", "fused loops"


def points(scene, dtype):
    """Rows of all points (count, 8)."""
    x = scene.positions()
    one, no = np.ones(scene.count), np.zeros(scene.count)
    return np.stack([*x, *scene.velocities(x), one, no, no, one], 1).astype(dtype)


def constants(scene, dtype):
    """1/cell, cell, dt, mass and volume of a point, C₁₁, C₁₂, C₃₃."""
    values = [1 / scene.cell, scene.cell, scene.dt, scene.density * scene.volume, scene.volume]
    return tuple(dtype(v) for v in (*values, *scene.stiffness))


def run(scene, points, steps, threads=1, kind=PLAIN):
    """Advance points (count, 8) in place by some steps."""
    dtype = points.dtype.type
    numba.set_num_threads(threads)
    nodes = scene.cells + 1
    grids = np.zeros((2, threads, nodes, nodes, 5), dtype)
    ends = np.linspace(0, len(points), threads + 1).astype(np.int64)
    _kernels(dtype, threads > 1)[kind](points, grids, ends, constants(scene, dtype), steps)


@lru_cache
def _kernels(dtype, parallel):
    """Both forms of the loop over steps, for a precision."""
    update = _update(dtype, parallel)
    scatter, gather, both = _over_points(dtype)
    compiled = njit(fastmath=True, parallel=parallel)

    @compiled
    def plain(points, grids, ends, c, steps):
        for _ in range(steps):
            for t in prange(len(ends) - 1):
                scatter(points[ends[t] : ends[t + 1]], grids[0, t], c)
            update(grids[0], c)
            for t in prange(len(ends) - 1):
                gather(points[ends[t] : ends[t + 1]], grids[0, 0], c)

    @compiled
    def fused(points, grids, ends, c, steps):
        for t in prange(len(ends) - 1):
            scatter(points[ends[t] : ends[t + 1]], grids[0, t], c)
        for step in range(steps):
            now, following = grids[step % 2], grids[(step + 1) % 2]
            update(now, c)
            for t in prange(len(ends) - 1):
                both(points[ends[t] : ends[t + 1]], now[0], following[t], c)

    return {PLAIN: plain, FUSED: fused}


def _over_points(dtype):
    """Loops over the points of a thread: to a grid, from a grid, from one to the next."""
    one_to, one_from = _scatter(dtype), _gather(dtype)
    compiled = njit(fastmath=True, nogil=True)

    @compiled
    def scatter(points, grid, c):
        grid[:] = 0
        for p in range(len(points)):
            one_to(points, p, grid, c)

    @compiled
    def gather(points, grid, c):
        for p in range(len(points)):
            one_from(points, p, grid, c)

    @compiled
    def both(points, now, following, c):
        following[:] = 0
        for p in range(len(points)):
            one_from(points, p, now, c)
            one_to(points, p, following, c)

    return scatter, gather, both


def _scatter(dtype):
    """Mass, momentum and force of a point to its four nodes."""
    one = dtype(1)

    @njit(fastmath=True, inline="always")
    def scatter(points, p, grid, c):
        inverse, _, _, mass, volume, direct, cross, shear = c
        row = points[p]
        x, y, vx, vy = row[0] * inverse, row[1] * inverse, row[2], row[3]
        fxx, fxy, fyx, fyy = row[4], row[5], row[6], row[7]
        i, j = int(x), int(y)
        a, b = x - dtype(i), y - dtype(j)
        exx, eyy = fxx - one, fyy - one
        scale = -volume * inverse
        sxx, syy = scale * (direct * exx + cross * eyy), scale * (cross * exx + direct * eyy)
        sxy = scale * shear * (fxy + fyx)
        px, py = mass * vx, mass * vy
        for k in range(2):
            wx, gx = (a, one) if k else (one - a, -one)
            for l in range(2):
                wy, gy = (b, one) if l else (one - b, -one)
                w, dx, dy = wx * wy, gx * wy, wx * gy
                node = grid[i + k, j + l]
                node[0] += w * mass
                node[1] += w * px
                node[2] += w * py
                node[3] += sxx * dx + sxy * dy
                node[4] += sxy * dx + syy * dy

    return scatter


def _update(dtype, parallel):
    """Add the grids up; the first then holds the velocities after the step and their increments."""
    zero, one = dtype(0), dtype(1)

    @njit(fastmath=True, parallel=parallel)
    def update(grids, c):
        dt, last = c[2], grids.shape[1] - 1
        for i in prange(grids.shape[1]):
            for j in range(grids.shape[2]):
                node = grids[0, i, j]
                for t in range(1, grids.shape[0]):
                    for k in range(5):
                        node[k] += grids[t, i, j, k]
                inverse = one / node[0] if node[0] > zero else zero
                node[3] *= dt * inverse
                node[4] *= dt * inverse
                node[1] = node[1] * inverse + node[3]
                node[2] = node[2] * inverse + node[4]
                if i == 0 or i == last:
                    node[1] = node[3] = zero
                if j == 0 or j == last:
                    node[2] = node[4] = zero

    return update


def _gather(dtype):
    """Velocity, position and deformation of a point from its four nodes."""
    zero, one = dtype(0), dtype(1)

    @njit(fastmath=True, inline="always")
    def gather(points, p, grid, c):
        inverse, _, dt, _, _, _, _, _ = c
        row = points[p]
        x, y, vx, vy = row[0], row[1], row[2], row[3]
        fxx, fxy, fyx, fyy = row[4], row[5], row[6], row[7]
        a, b = x * inverse, y * inverse
        i, j = int(a), int(b)
        a, b = a - dtype(i), b - dtype(j)
        ux = uy = lxx = lxy = lyx = lyy = zero
        for k in range(2):
            wx, gx = (a, one) if k else (one - a, -one)
            for l in range(2):
                wy, gy = (b, one) if l else (one - b, -one)
                node = grid[i + k, j + l]
                w, dx, dy = wx * wy, gx * wy, wx * gy
                ux += w * node[1]
                uy += w * node[2]
                vx += w * node[3]
                vy += w * node[4]
                lxx += dx * node[1]
                lxy += dy * node[1]
                lyx += dx * node[2]
                lyy += dy * node[2]
        h = dt * inverse
        row[0], row[1], row[2], row[3] = x + dt * ux, y + dt * uy, vx, vy
        row[4], row[5] = fxx + h * (lxx * fxx + lxy * fyx), fxy + h * (lxx * fxy + lxy * fyy)
        row[6], row[7] = fyx + h * (lyx * fxx + lyy * fyx), fyy + h * (lyx * fxy + lyy * fyy)

    return gather
