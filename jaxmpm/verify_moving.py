"""Checks of points that move: exact solutions, order of convergence, what is conserved.

Each check yields rows as `verify` makes them. Units are those of the sources, dimensionless where
E = ρ = 1. Displacement errors are the rms over points, the largest in time, as mpmat has them.

What limits the order is the quadrature of forces. Under a uniform stress τ, points a distance s
apart load nodes a distance h apart with a force that should be nil, and is

    4π (h/s) sinc(h/s)ᵖ⁺¹ τ sin(2π x/s) + …      sinc x = sin πx / πx, splines of degree p

at a node at x (Poisson summation). With whole h/s it is nil; once the body is stretched it is not, and does not
shrink with h while the force that accelerates a node does. Quadratic splines with 2 points per
cell reach that floor at 16 % of stretch and 64 cells to a half wave; cubic splines and more
points per cell push it away.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxmpm.laws.finite import NeoHookean
from jaxmpm.moving import Model, Numerics, Transfer, first_state
from jaxmpm.shape_functions import Cubic, Gimp, Linear, Quadratic
from jaxmpm.verify_points import body, forward, lattice, points_of, row

SAMPLES = 10  # times at which errors are taken
TAYLOR = Transfer("taylor")
ORDER = 1.9  # least order asked for


def displacement_error(model, points, exact, dt, steps) -> float:
    """Largest in time of the rms over points; `exact(home, time)` is the displacement (d, count)."""
    state, errors = first_state(points), []
    begin, fields = points_of(model, state)
    corner = (begin - fields["home"])[:, :1]
    for k in range(1, SAMPLES + 1):
        until = k * steps // SAMPLES
        state = forward(model, state, dt, until)
        x, fields = points_of(model, state)
        miss = x - corner - fields["home"] - exact(fields["home"], until * dt)
        errors.append(np.sqrt((miss**2).sum(0).mean()))
    return float(np.max(errors))  # NaN if one is


def fitted_order(cells, errors) -> float:
    """Slope of the straight line through the logarithms of errors over the cell size; NaN if one is."""
    if not np.isfinite(errors).all():
        return float("nan")
    return -float(np.polyfit(np.log(cells), np.log(errors), 1)[0])


def _orders(name, cells, errors, most) -> Iterator[dict]:
    """Rows: the fitted order, at least `ORDER`, and the error on the finest grid, at most `most`."""
    order = fitted_order(cells, errors)
    yield row(f"{name}, order", order, 2.0, 2 - ORDER, side="≥")
    yield row(f"{name}, error", errors[-1], 0.0, most)


# ------------------------------------------------------------------ bar, manufactured


@dataclass(frozen=True)
class Bar:
    """u = G sin πX sin πt of a neo-Hookean bar with held ends; E = ρ = 1, ν = 0, one full period.

    The body force is a − ∂P/∂X = π² u (F⁻² − 1)/2. The times and errors of mpmat's E = 1e7, ρ = 1000
    are the same in these units.
    """

    amplitude: float  # G

    def displacement(self, home, time):
        """u (1, count)."""
        return self.amplitude * np.sin(np.pi * home) * np.sin(np.pi * time)

    def __call__(self, points, time):
        """Acceleration by the body force."""
        swing = jnp.sin(jnp.pi * time)
        stretch = 1 + self.amplitude * jnp.pi * jnp.cos(jnp.pi * points.home) * swing
        pull = jnp.pi**2 * self.amplitude * jnp.sin(jnp.pi * points.home) * swing
        return pull * (stretch**-2 - 1) / 2

    def error(self, cells, shape, transfer=TAYLOR, each=2, order="usl", per_cell=20):
        """Displacement error with so many `cells`, points and time steps per cell."""
        numerics = Numerics(1 / cells, (cells,), shape, transfer, order, (("stick", "stick"),))
        law = NeoHookean(jnp.array([1.0]), jnp.array([0.0]))
        model = Model(law, jnp.zeros(1), numerics, self)
        start = lambda x: jnp.pi * self.amplitude * jnp.sin(jnp.pi * x)
        spacing = 1 / cells / each
        points = body(numerics, lattice((0,), (1,), spacing), start, spacing, slots=3 * each)
        steps = per_cell * cells
        return displacement_error(model, points, self.displacement, 2 / steps, steps)


# ------------------------------------------------------------------ vortex


@dataclass(frozen=True)
class Vortex:
    """Generalised vortex (Kamojjala, Brannon, Sadeghirad, Guilkey 2015); E = 1000, ν = 0.3, ρ = 1000.

    A ring 0.75 ≤ R ≤ 1.25 turns by α = g h, g = A sin πt, h = 1 − 32 (R−1)² + 256 (R−1)⁴. Both h and
    h′ are nil at the edges, which are at rest and free of traction.
    """

    amplitude: float  # A, rad
    young, poisson, density = 1000.0, 0.3, 1000.0
    inner, outer, half = 0.75, 1.25, 1.5  # radii, and half the side of the grid

    def _turn(self, radius, time, np=jnp):
        """α and its derivatives: (α, α_t, α_tt, α_R, α_RR)."""
        s = radius - 1
        h, slope, bend = 1 - 32 * s**2 + 256 * s**4, 1024 * s**3 - 64 * s, 3072 * s**2 - 64
        g = self.amplitude * np.sin(np.pi * time)
        speed = self.amplitude * np.pi * np.cos(np.pi * time)
        return g * h, speed * h, -(np.pi**2) * g * h, g * slope, g * bend

    def position(self, home, time, np=jnp):
        """Where the points are (2, ...), from the centre."""
        alpha = self._turn(np.hypot(home[0], home[1]), time, np)[0]
        c, s = np.cos(alpha), np.sin(alpha)
        return np.stack([c * home[0] - s * home[1], s * home[0] + c * home[1]])

    def displacement(self, home, time):
        """u (2, count)."""
        return self.position(home, time, np) - home

    def __call__(self, points, time):
        """Acceleration b by the body force: a = ∇·P/ρ + b.

        With x = R e^{i(θ+α)} and J = 1: ∇·P = μ ∇²x = μ (i (3 α_R + R α_RR) − R α_R²) e^{i(θ+α)}.
        """
        used = points.mass > 0
        home = jnp.where(used, points.home, 1.0)
        radius = jnp.hypot(home[0], home[1])
        _, speed, change, slope, bend = self._turn(radius, time)
        wave = self.young / (2 * (1 + self.poisson)) / self.density
        outward = wave * slope**2 - speed**2
        around = change - wave * (3 * slope / radius + bend)
        x, y = self.position(home, time)
        return jnp.stack([outward * x - around * y, outward * y + around * x])

    def rings(self, cell, each):
        """Positions (2, count) of points in rings, from the centre, and their volumes.

        A square lattice cut by circles has steps at the free edges, and evenly spaced rings sum the
        body force to a torque of order `cell`² that nothing holds: the whole ring turns by more than
        the error looked for. The Gauss points of layers one cell thick do not.
        """
        layers = max(round((self.outer - self.inner) / cell), 1)
        thick = (self.outer - self.inner) / layers
        place, weight = np.polynomial.legendre.leggauss(each)
        position, volume = [], []
        for layer in range(layers):
            for y, w in zip(place, weight, strict=True):
                radius = self.inner + thick * (layer + (1 + y) / 2)
                number = round(2 * np.pi * radius / cell * each)
                angle = 2 * np.pi * (np.arange(number) + 0.5) / number
                position.append(radius * np.stack([np.cos(angle), np.sin(angle)]))
                volume.append(np.full(number, w / 2 * 2 * np.pi * radius * thick / number))
        return np.concatenate(position, 1), np.concatenate(volume)

    def error(self, per_unit, shape, transfer=TAYLOR, each=2, order="usl", courant=0.5):
        """Displacement error with so many cells per unit length, to t = 1: there and back."""
        cell, d = 1 / per_unit, 2
        count = round(2 * self.half * per_unit)
        numerics = Numerics(cell, (count,) * d, shape, transfer, order)
        law = NeoHookean(jnp.array([self.young]), jnp.array([self.poisson]))
        model = Model(law, jnp.zeros(d), numerics, self)
        centre = np.full(d, count * cell / 2)
        x, volume = self.rings(cell, each)
        x = x + centre[:, None]
        steps = SAMPLES * int(np.ceil(per_unit / courant * 1.16 / SAMPLES))
        dt = 1 / steps

        def start(place):
            # velocities are half a step behind positions
            moves = lambda t: self.position(place - centre, t)
            return jax.jvp(moves, (-dt / 2,), (1.0,))[1]

        points = body(numerics, x, start, volume, self.density, centre, slots=2 * each**2 + 4)
        return displacement_error(model, points, self.displacement, dt, steps)


def vortex(cells=(8, 16, 32, 64), amplitude=0.1) -> Iterator[dict]:
    """Order of the displacement in the generalised vortex, over cells per unit length."""
    case = Vortex(amplitude)
    for name, shape, count in (("quadratic", Quadratic(), 4), ("cubic", Cubic(), 3), ("GIMP", Gimp(0.25), 3)):
        used = cells[:count]
        errors = [case.error(n, shape) for n in used]
        yield from _orders(f"vortex, {name}", used, errors, 0.8 / used[-1] ** 2)


CELLS = (8, 16, 32, 64)
# Points per cell that keep the quadrature of forces below the error of the functions, see above.
ENOUGH = (("GIMP", Gimp(0.0625), 8), ("quadratic", Quadratic(), 8), ("cubic", Cubic(), 2))


def manufactured(cells=CELLS) -> Iterator[dict]:
    """Order of the displacement in a bar, without and with points that cross cells."""
    still, crossing = Bar(1e-4), Bar(0.05)
    for name, shape in (("linear", Linear()), ("GIMP", Gimp(0.25)), ("quadratic", Quadratic()), ("cubic", Cubic())):
        errors = [still.error(n, shape) for n in cells]
        yield from _orders(f"bar, {name}", cells, errors, 1e-4 * 20 / cells[-1] ** 2)
    for name, shape, each in ENOUGH:
        errors = [crossing.error(n, shape, each=each) for n in cells]
        yield from _orders(f"bar, crossing, {name}", cells, errors, 0.05 * 20 / cells[-1] ** 2)
    errors = [crossing.error(n, Linear()) for n in cells]
    order = fitted_order(cells, errors)
    # the known failure of the method's first form: finer grids make it worse
    yield row("bar, crossing, linear, order lost", order, 0.0, 0.0, side="≤")


def quadrature_noise(shape, each, stretch, count=4000) -> float:
    """Largest nodal force over the stress of a uniformly stretched bar, without its ends; exactly nil."""
    spacing = stretch / each
    y = spacing * np.arange(count) + 0.5 * shape.centred
    first = np.floor(y).astype(int)
    slopes = shape.weights(jnp.asarray(y - first))[1]
    force = np.zeros(first.max() + shape.count + 1)
    for k, slope in enumerate(slopes):
        np.add.at(force, first + k, spacing * np.asarray(slope))
    return float(np.abs(force[10:-10]).max())


def poisson(each, stretch, power, width=0.0) -> float:
    """What `quadrature_noise` should give: the waves k = 1, 2, … of the module's formula, at their worst place."""
    k, place = np.arange(1, 60)[:, None], np.linspace(0, 1, 2001)
    x = k * each / stretch
    waves = 4 * np.pi * x * np.sinc(x) ** power * np.sinc(x * width) * np.sin(2 * np.pi * k * place)
    return float(np.abs(waves.sum(0)).max())


def noise(each=2, stretch=1 + 0.05 * np.pi) -> Iterator[dict]:
    """The quadrature of forces against Poisson's summation, at the largest stretch of the bar."""
    cases = ("GIMP", Gimp(0.5 / each), 2, 1 / each), ("quadratic", Quadratic(), 3, 0.0), ("cubic", Cubic(), 4, 0.0)
    for name, shape, power, width in cases:
        value = quadrature_noise(shape, each, stretch)
        yield row(f"force of a uniform stress, {name}", value, poisson(each, stretch, power, width), 0.01)
