"""The scene in Taichi on the processor, in its usual kernels.

One loop over points adds to the nodes (atomic adds), one goes over the nodes, one over points
reads them. (A grid for every thread and points gathered and scattered in one pass, as in the
plain loops, were measured too and were no faster.)
"""

import numpy as np
import taichi as ti


def start(dtype, threads):
    """Begin anew in a precision; fields made before are gone."""
    real = {np.float32: ti.f32, np.float64: ti.f64}[dtype]
    ti.init(arch=ti.cpu, default_fp=real, cpu_max_num_threads=threads, fast_math=True, log_level=ti.ERROR)


def runner(scene, points):
    """Three functions: begin from points (count, 8), take a number of steps, give the points."""
    c = (scene.dt, scene.density * scene.volume, scene.volume, *scene.stiffness)
    code = _Code(scene.cells, 1 / scene.cell, len(points), c)

    def reset():
        code.x.from_numpy(points[:, 0:2])
        code.v.from_numpy(points[:, 2:4])
        code.F.from_numpy(points[:, 4:8].reshape(-1, 2, 2))

    def step(steps):
        for _ in range(steps):
            code.clear()
            code.scatter()
            code.update()
            code.gather()
        ti.sync()

    def read():
        F = code.F.to_numpy().reshape(-1, 4)
        return np.concatenate([code.x.to_numpy(), code.v.to_numpy(), F], 1)

    return reset, step, read


@ti.data_oriented
class _Code:
    """Fields and kernels."""

    def __init__(self, cells, inverse, count, constants):
        self.cells, self.inverse, self.count = cells, inverse, count
        self.dt, self.mass, self.volume, self.direct, self.cross, self.shear = constants
        self.x, self.v = ti.Vector.field(2, float, count), ti.Vector.field(2, float, count)
        self.F = ti.Matrix.field(2, 2, float, count)
        # mass, momentum and force; where the points read: velocity and its increment
        self.grid = ti.Vector.field(5, float, (cells + 1, cells + 1))

    @ti.func
    def weights(self, p):
        """Cell of a point, and functions and slopes of its nodes along each axis."""
        y = self.x[p] * self.inverse
        corner = ti.cast(y, int)
        y -= corner
        return corner, ti.Matrix.cols([1 - y, y])

    @ti.func
    def contribution(self, p, w, i, j):
        """Mass, momentum and force of a point at one of its nodes."""
        strain = self.F[p] - ti.Matrix.identity(float, 2)
        sxx = self.direct * strain[0, 0] + self.cross * strain[1, 1]
        syy = self.cross * strain[0, 0] + self.direct * strain[1, 1]
        sxy = self.shear * (strain[0, 1] + strain[1, 0])
        dx, dy = (2 * i - 1) * w[1, j], w[0, i] * (2 * j - 1)
        scale = -self.volume * self.inverse
        m = w[0, i] * w[1, j] * self.mass
        fx, fy = scale * (sxx * dx + sxy * dy), scale * (sxy * dx + syy * dy)
        return ti.Vector([m, m * self.v[p][0], m * self.v[p][1], fx, fy])

    @ti.func
    def collect(self, p):
        """Move and deform a point."""
        corner, w = self.weights(p)
        carried, change = ti.Vector.zero(float, 2), ti.Vector.zero(float, 2)
        slope = ti.Matrix.zero(float, 2, 2)
        for i, j in ti.static(ti.ndrange(2, 2)):
            node = self.grid[corner[0] + i, corner[1] + j]
            after = ti.Vector([node[1], node[2]])
            share = w[0, i] * w[1, j]
            carried += share * after
            change += share * ti.Vector([node[3], node[4]])
            slope += after.outer_product(ti.Vector([(2 * i - 1) * w[1, j], w[0, i] * (2 * j - 1)]))
        self.v[p] += change
        self.x[p] += self.dt * carried
        self.F[p] += self.dt * self.inverse * slope @ self.F[p]

    @ti.kernel
    def clear(self):
        for i, j in self.grid:
            self.grid[i, j] = 0

    @ti.kernel
    def scatter(self):
        for p in range(self.count):
            corner, w = self.weights(p)
            for i, j in ti.static(ti.ndrange(2, 2)):
                self.grid[corner[0] + i, corner[1] + j] += self.contribution(p, w, i, j)

    @ti.kernel
    def gather(self):
        for p in range(self.count):
            self.collect(p)

    @ti.kernel
    def update(self):
        """The first grid then holds the velocities after the step and their increments."""
        for i, j in self.grid:
            node = self.grid[i, j]
            inverse = 1 / node[0] if node[0] > 0 else 0.0
            change = self.dt * inverse * ti.Vector([node[3], node[4]])
            after = inverse * ti.Vector([node[1], node[2]]) + change
            if i == 0 or i == self.cells:
                after[0] = change[0] = 0
            if j == 0 or j == self.cells:
                after[1] = change[1] = 0
            self.grid[i, j] = ti.Vector([node[0], after[0], after[1], change[0], change[1]])
