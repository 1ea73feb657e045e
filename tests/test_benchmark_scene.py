"""The scene of the benchmarks, small, in both of the project's ways: what is not timed here must still run."""

import jax
import numpy as np

from tests.benchmarks import jaxmpm_codes
from tests.benchmarks.scene import Scene


def test_both_frames_build_the_scene_and_read_it_at_the_start():
    with jax.enable_x64():
        scene = Scene(4)
        positions = scene.positions()
        *_, read = jaxmpm_codes.moving_runner(scene, np.float64)
        np.testing.assert_allclose(read()[:2], positions, atol=1e-12)
        reset, _, read = jaxmpm_codes.total_runner(scene, np.float64)
        reset()
        assert read().shape == (4, 5, 5)
