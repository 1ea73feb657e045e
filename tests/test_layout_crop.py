"""Rows and columns that no body fills: left out they change nothing, and points that move find them again."""

import jax.numpy as jnp
import numpy as np
import pytest
from test_layout import plate

from jaxmpm.layout import lay_out
from jaxmpm.layout_crop import cropped, filled_window, padded
from jaxmpm.model import first_state, from_layout
from jaxmpm.scene import load_scene
from jaxmpm.simulation import Simulation

TOP = {"kind": "rectangle", "min": [80.0, 50.0], "max": [95.0, 50.0]}
WIDE = {"grid.size": [140.0, 30.0], "grid.origin": [-25.0, -5.0]}


def bar(**changes):
    """A bar of 20 x 2 cells, on a grid of 28 x 6, pulled quickly until its weak column has cracked."""
    return load_scene("bar", WIDE | {"parameters.cell": 5, "displacements.0.history": {"time": [0, 1e-4], "value": [0, 0.05]}} | changes)


def test_window_is_that_of_the_bodies_and_the_plane_of_symmetry():
    layout = lay_out(bar())
    assert filled_window(layout) == (slice(5, 25), slice(1, 3))
    small = cropped(layout)
    assert (small.shape, small.origin) == ((20, 2), (0.0, 0.0)) and cropped(small) is small
    for name, nodes in layout.sets.items():
        there, here = (one.node_coordinates().reshape(2, -1)[:, k] for one, k in ((layout, nodes), (small, small.sets[name])))
        np.testing.assert_array_equal(here, there)
    beam = {"bodies.0.minus.0.max": [90.0, 50.0], "bodies.0.minus.0.min": [85.0, 0.0], "sets.top.inside.0": TOP}
    half = lay_out(load_scene("beam", beam | {"grid.half": "x"}))
    assert (half.material[0] < 0).all() and cropped(half).origin == half.origin  # bodies that do not touch the plane


def test_motion_and_energies_are_the_same_and_the_whole_grid_is_found_again():
    wide = {"size": [40, 60], "origin": [0, -20], "cell": 10, "stress_state": "plane_strain", "thickness": 2.0}
    gauges = {"moved": {"kind": "displacement", "set": "top", "direction": "y"}, "held": {"kind": "reaction", "set": "bottom", "direction": "y"}}
    scene = plate(grid=wide, gauges=gauges, gravity=[0.0, -1e4], solver={"duration": 1e-2})
    small, whole = (Simulation.of(scene, crop=crop) for crop in (True, False))
    assert small.model.material.shape == (4, 4) and whole.model.material.shape == (4, 6)
    for sim in (small, whole):
        sim.advance(120)
    read, other = small.read(), whole.read()
    assert read.kinetic > 0 and read.external > 0
    np.testing.assert_allclose(other.energies(), read.energies(), rtol=1e-11, atol=1e-15)
    for name, value in read.gauges.items():
        assert other.gauges[name] == pytest.approx(float(value), rel=1e-11)
    for one, other in zip(small.frame(), whole.frame(), strict=True):
        pairs = [(one, other)] if isinstance(one, np.ndarray) else [(one[k], other[k]) for k in one]
        for a, b in pairs:
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(a).max())
    again = small.on_whole_grid()
    assert again.layout.shape == (4, 6) and whole.on_whole_grid() is whole
    np.testing.assert_allclose(again.state.displacement, whole.state.displacement, rtol=0, atol=1e-12)


def test_bands_keep_their_cells_on_the_whole_grid():
    whole = lay_out(bar())
    small = cropped(whole)
    model = from_layout(bar(), small)
    state, rng = first_state(model, small.velocity), np.random.default_rng(1)
    cells = np.array([3, 17, 38])
    place = np.full(40, -1)
    place[cells] = range(3)
    pool = state.pool._replace(cell=state.pool.cell.at[:3].set(jnp.asarray(cells, jnp.int32)), count=jnp.int32(3))
    state = state._replace(displacement=jnp.asarray(rng.normal(size=(2, 21, 3))), place=jnp.asarray(place.reshape(20, 2)), pool=pool)
    wide = padded(state, small, whole)
    there = np.asarray(wide.pool.cell[:3])
    np.testing.assert_array_equal(np.asarray(wide.place).reshape(-1)[there], range(3))
    np.testing.assert_array_equal(np.stack(np.divmod(there, 6)) - [[5], [1]], np.stack(np.divmod(cells, 2)))
    assert (np.asarray(wide.place) >= 0).sum() == 3 and wide.intact.sum() == 40
    np.testing.assert_array_equal(wide.displacement[:, 5:26, 1:4], state.displacement)
