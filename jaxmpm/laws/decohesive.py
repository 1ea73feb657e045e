"""The elastic-decohesive law of sea ice of Schreyer, Sulsky, Munday, Coon and Kwok (2006).

J. Geophys. Res. Oceans 111, C11S26; in two dimensions, with one plane of decohesion to a cell,
of unit normal n and tangent m. With τ_n, τ_t its traction and σ_tt the direct stress along m:

    F = (τ_t/(s_m τ_sf))² + exp(κB) − 1 ≤ 0,   κ = −ln(1 − 1/s_m²)
    B = τ_n/τ_nf − f_n (1 − ⟨−σ_tt⟩²/f_c²),    f_n = ⟨1 − w/u_0⟩
    σ = C : (ε − (n ⊗ u)^s/L)
    du_n = dw = dλ ∂F/∂τ_n,  du_t = dλ ∂F/∂τ_t

so that sliding opens the plane. It is the plane with the largest F where F first passes zero, and
stays. Unloading is elastic as long as there is cohesion, f_n > 0. Opening leaves a gap, but for
opening by sliding under compression. Without cohesion a gap carries nothing, u follows the strain;
faces touch where the gap has closed, so that u_n is never negative, and then F = 0 limits the
friction of faces that slide without opening further.

Backward Euler in one unknown, μ = 2 dλ G/(L (s_m τ_sf)²): it gives τ_t = τ_t*/(1 + μ) from the
elastic trial, then exp(κB) by F = 0 and dw; what is left is an equation with a bracketed root.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxmpm import tensor
from jaxmpm.laws.elastic import Elastic
from jaxmpm.laws.law import law

ANGLES = 19  # planes looked at, from across to along the first principal stress, every 5°
REFINE = 8  # steps of the refinement between two of them
SEARCH = 100  # steps of the search for μ at most; three or four are usual


class Decohesion(NamedTuple):
    """History of a point."""

    normal: jax.Array  # unit normal n (2,) of the plane; zero as long as there is none
    jump: jax.Array  # displacement jump u (2,), mm
    lost: jax.Array  # share of the cohesion that is lost, 1 − f_n
    gap: jax.Array  # how far the faces are from touching, mm
    traction: jax.Array  # on the plane at the end of the last step (2,), MPa
    dissipated: jax.Array  # energy dissipated per volume of the cell, N/mm²


class _Plane(NamedTuple):
    """Elastic trial state of the plane, how the last step left it, and its stiffness."""

    direct: jax.Array  # τ_n*, MPa
    shear: jax.Array  # τ_t*, MPa
    along: jax.Array  # σ_tt*, MPa
    lost: jax.Array
    gap: jax.Array
    stiff: tuple  # −∂τ_n/∂u_n and −∂τ_t/∂u_t, MPa/mm
    lateral: jax.Array  # ∂σ_tt/∂τ_n


class _Flow(NamedTuple):
    """State of the plane after flow by μ."""

    opening: jax.Array  # Δw, mm
    lost: jax.Array  # 1 − f_n
    direct: jax.Array  # τ_n, MPa
    shear: jax.Array  # τ_t, MPa
    exponent: jax.Array  # κB
    left: jax.Array  # 1 − (τ_t/(s_m τ_sf))², which is exp(κB) where F = 0

    def excess(self):
        """F, its exponential held at a number that can be squared."""
        most = math.log(jnp.finfo(self.exponent.dtype).max) / 2
        return jnp.expm1(jnp.minimum(self.exponent, most)) + (1 - self.left)


@law
class Decohesive:
    """Elastic-decohesive law, a point law in plane stress (size 3) and plane strain (size 4).

    Where the return fails, the stress is NaN.
    """

    E: float  # Young's modulus, MPa
    nu: float  # Poisson's ratio
    tau_nf: float  # tensile strength τ_nf, MPa
    tau_sf: float  # shear strength at no normal traction τ_sf, MPa
    s_m: float  # largest shear strength under compression over τ_sf, > 1
    f_c: float  # compressive strength f_c, MPa
    u_0: float  # opening u_0 at which no cohesion is left, mm
    size: float  # L, of the cell, mm; beyond E u_0/τ_nf the response of the cell snaps back

    @property
    def elastic(self):
        """The elastic part."""
        return Elastic(self.E, self.nu)

    def initial(self, size):
        """No plane of decohesion."""
        zero = jnp.zeros((), jnp.result_type(*jax.tree.leaves(self)))
        pair = jnp.zeros(2, zero.dtype)
        return Decohesion(pair, pair, zero, zero, pair, zero)

    def respond(self, strain, history):
        """Stress (size,), MPa, and the new history, at a strain (size,)."""
        trial = self.elastic.stress(self._elastic_strain(strain, history))
        was = tensor.dot(history.normal, history.normal) > 0
        normal = jnp.where(was, history.normal, self.weakest(trial))
        (tangent,) = tensor.in_the_plane_of(normal)
        plane = self._plane(trial, normal, tangent, history)
        (lost, direct, shear, gap), loads, fails = self._advance(plane)
        slip = (plane.direct - direct) / plane.stiff[0]
        slide = (plane.shear - shear) / plane.stiff[1]
        traction, more = direct * normal + shear * tangent, slip * normal + slide * tangent
        # the trapezoidal rule, as work is reckoned; onset comes within a step
        mean = (jnp.where(was, history.traction, traction) + traction) / 2
        new = Decohesion(
            normal,
            history.jump + more,
            lost,
            gap,
            traction,
            history.dissipated + jnp.maximum(tensor.dot(mean, more), 0.0) / self.size,
        )
        cracked = was | loads
        new = jax.tree.map(lambda now, before: jnp.where(cracked, now, before), new, history)
        stress = self.elastic.stress(self._elastic_strain(strain, new))
        stress = jnp.where(cracked, tensor.with_traction(stress, normal, traction), trial)
        return jnp.where(fails, jnp.nan, stress), new

    def stored(self, strain, history):
        """Elastic energy per volume, N/mm²."""
        return self.elastic.stored(self._elastic_strain(strain, history), ())

    def dissipated(self, history):
        """Energy dissipated so far, ∫ τ·du/L, per volume, N/mm²."""
        return history.dissipated

    def weakest(self, stress):
        """Unit normal (2,) of the plane with the largest F; of a mirrored pair always the same."""
        xx, yy, xy = tensor.to_plane(stress)
        centre, half = (xx + yy) / 2, (xx - yy) / 2
        radius = tensor.norm([half, xy])
        alike = radius == 0
        principal = jnp.arctan2(jnp.where(alike, 0.0, xy), jnp.where(alike, 1.0, half)) / 2

        def value(angle, law, centre, radius):
            direct, shear = radius * jnp.cos(2 * angle), radius * jnp.sin(2 * angle)
            return law._state(0.0, 0.0, centre + direct, shear, centre - direct).excess()

        here = self, centre, radius
        still = jax.lax.stop_gradient(here)
        angle, bend = _argmax(lambda angle: value(angle, *still), radius.dtype)
        # a step of Newton's method that goes nowhere, for the derivative
        change = -jax.grad(value)(angle, *here) / jnp.where(bend < 0, bend, -1.0)
        angle += jnp.where(bend < 0, change - jax.lax.stop_gradient(change), 0.0)
        return jnp.stack([jnp.cos(principal + angle), jnp.sin(principal + angle)])

    # ------------------------------------------------------------------ the plane

    def _elastic_strain(self, strain, history):
        opening = tensor.symmetric_product(history.normal, history.jump, len(strain))
        return strain - opening / self.size

    @property
    def _kappa(self):
        return -jnp.log1p(-1 / jnp.square(self.s_m))

    def _state(self, opening, lost, direct, shear, along):
        """`_Flow` with tractions τ_n and τ_t, and σ_tt (MPa)."""
        crushing = jnp.square(jnp.maximum(-along, 0.0) / self.f_c)
        exponent = self._kappa * (direct / self.tau_nf - (1 - lost) * (1 - crushing))
        left = 1 - jnp.square(shear / (self.s_m * self.tau_sf))
        return _Flow(opening, lost, direct, shear, exponent, left)

    def _plane(self, trial, normal, tangent, history):
        traction = tensor.traction(trial, normal)
        direct, cross, shear = self.elastic.coefficients(len(trial))
        return _Plane(
            tensor.dot(traction, normal),
            tensor.dot(traction, tangent),
            tensor.dot(tensor.traction(trial, tangent), tangent),
            history.lost,
            history.gap,
            (direct / self.size, shear / self.size),
            cross / direct,
        )

    def _flow(self, plane, mu):
        """`_Flow` by μ."""
        shear = plane.shear / (1 + mu)
        left = 1 - jnp.square(shear / (self.s_m * self.tau_sf))
        opening = mu * jnp.maximum(left, 0.0) * self._length(plane)
        relief = plane.stiff[0] * opening
        lost = jnp.minimum(plane.lost + opening / self.u_0, 1.0)
        along = plane.along - plane.lateral * relief
        return self._state(opening, lost, plane.direct - relief, shear, along)

    def _length(self, plane):
        """Δw/μ where there is no shear, mm."""
        return self._kappa * (self.s_m * self.tau_sf) ** 2 / (2 * plane.stiff[1] * self.tau_nf)

    def _advance(self, plane):
        """1 − f_n, τ_n, τ_t, gap after a step; whether F was passed; whether the return failed."""
        stiff, kappa = plane.stiff[0], self._kappa
        rest = (1 - plane.lost) * self.u_0
        loads = (rest > 0) & (self._flow(plane, jnp.zeros_like(rest)).excess() > 0)
        size = (jnp.abs(plane.direct) + stiff * rest) / self.tau_nf
        noise = 1 + kappa * (size + jnp.square(plane.along / self.f_c))
        noise *= jnp.finfo(rest.dtype).eps
        mu, ends = self._multiplier(plane, rest, loads, noise)
        flow = self._flow(plane, jnp.where(loads, mu, 0.0))
        fails = loads & ~ends & ~(jnp.abs(flow.excess()) <= 64 * noise)

        loose = (rest == 0) | loads & (ends | (flow.lost == 1))
        opening, free = jnp.where(loose, rest, flow.opening), plane.direct / stiff
        slid = jnp.clip(opening - free, 0.0, opening)  # the part of it under compression
        room = plane.gap - slid + free
        pressed = jnp.minimum(stiff * room, 0.0)
        left = -jnp.expm1(kappa * pressed / self.tau_nf)
        touch = left > 0
        friction = self.s_m * self.tau_sf * jnp.sqrt(jnp.where(touch, left, 1.0))
        friction = jnp.where(touch, jnp.clip(plane.shear, -friction, friction), 0.0)
        now = flow.lost, flow.direct, flow.shear, plane.gap - slid + opening
        then = jnp.ones_like(rest), pressed, friction, jnp.maximum(room, 0.0)
        return [jnp.where(loose, b, a) for a, b in zip(now, then, strict=True)], loads, fails

    def _multiplier(self, plane, rest, loads, noise):
        """μ where F is passed, and whether it uses up f_n before."""
        over = jnp.abs(plane.shear) / (self.s_m * self.tau_sf)
        low = jnp.maximum(over - 1, 0.0)
        high = jnp.maximum(math.sqrt(2) * over, 2 * rest / self._length(plane))  # opens by `rest`
        ends = self._flow(plane, high).excess() > 0

        def closer(state):
            mu, low, high, last, _, count = state
            flow, rate = jax.jvp(lambda mu: self._flow(plane, mu), (mu,), (jnp.ones_like(mu),))
            # ln of exp(κB) over what F = 0 makes of it, nearly linear far from it
            left = jnp.maximum(flow.left, jnp.finfo(mu.dtype).tiny)
            value, slope = flow.exponent - jnp.log(left), rate.exponent - rate.left / left
            low, high = jnp.where(value > 0, mu, low), jnp.where(value > 0, high, mu)
            newton = jnp.clip(mu - value / jnp.where(slope < 0, slope, -1.0), low, high)
            good = (slope < 0) & (jnp.abs(value) < last / 2)
            found = jnp.abs(flow.excess()) <= noise
            there = jnp.where(good, newton, jnp.where(found, mu, (low + high) / 2))
            return there, low, high, jnp.abs(value), found, count + 1

        def search(_, start):
            state = start, low, high, jnp.full_like(over, jnp.inf), ~loads | ends, 0
            return jax.lax.while_loop(lambda s: ~s[4] & (s[5] < SEARCH), closer, state)[0]

        def excess(mu):
            return self._flow(plane, mu).excess()

        def solve(linear, y):  # F falls there wherever the answer of the cell does not snap back
            slope = linear(jnp.ones_like(y))
            return y / jnp.where(slope < 0, slope, -1.0)

        start = jnp.maximum(math.sqrt(2) * over - 1, 0.0)
        return jax.lax.custom_root(excess, start, search, solve), ends


def _argmax(value, dtype):
    """Angle from 0 to π/2 of the largest value, the least of equals, and its second derivative."""
    angles = jnp.linspace(0, math.pi / 2, ANGLES, dtype=dtype)
    best = angles[jnp.argmax(jax.vmap(value)(angles))]
    low, high = jnp.maximum(best - angles[1], 0.0), jnp.minimum(best + angles[1], math.pi / 2)

    def slope(angle):
        return jax.jvp(value, (angle,), (jnp.ones_like(angle),))[1]

    def closer(_, state):
        angle, low, high, _ = state
        rise, bend = jax.jvp(slope, (angle,), (jnp.ones_like(angle),))
        right = (rise > 0) | ((rise == 0) & (bend > 0))
        low, high = jnp.where(right, angle, low), jnp.where(right, high, angle)
        newton = angle - rise / jnp.where(bend < 0, bend, -1.0)
        good = (bend < 0) & (newton >= low) & (newton <= high)
        return jnp.where(good, newton, (low + high) / 2), low, high, bend

    angle, _, _, bend = jax.lax.fori_loop(0, REFINE, closer, (best, low, high, best))
    return angle, bend
