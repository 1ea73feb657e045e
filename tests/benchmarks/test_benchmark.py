"""Speed beside plain loops and Taichi: `pytest tests/benchmarks -p no:xdist`.

That all codes compute the same is asserted; their speed is printed, and asserted only where
`--benchmark-only` asks for it, since a busy machine says nothing.
"""

import json

import numpy as np
import pytest

from tests.benchmarks import compare
from tests.benchmarks.scene import Scene

pytest.importorskip("pytest_benchmark", reason="pytest-benchmark is not installed")
if compare.missing():
    pytest.skip(f"{', '.join(compare.missing())} not installed", allow_module_level=True)
pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore")]

PRECISIONS = [np.float32, np.float64]
POINTS = [*compare.LOOPS, compare.TAICHI, compare.MOVING]
TOTALS = [compare.TOTAL_SAME, compare.TOTAL]


@pytest.fixture(scope="module", autouse=True)
def _both_precisions():
    import jax

    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


def after(name, scene, dtype, steps):
    reset, step, read = compare.codes(dtype)[name](scene, dtype)
    reset()
    step(steps)
    return np.asarray(read(), float)


@pytest.fixture(scope="module")
def reference():
    scene = Scene(24)
    return scene, after(compare.LOOPS[0], scene, np.float64, 60)


@pytest.mark.parametrize("dtype", PRECISIONS, ids=lambda d: d.__name__)
@pytest.mark.parametrize("name", POINTS)
def test_all_codes_compute_the_same(reference, name, dtype):
    """Points that cross cells make single precision differ where one crosses a step later."""
    scene, expected = reference
    got = after(name, scene, dtype, 60)
    scale = abs(expected).max(1, keepdims=True)
    error = np.sqrt((((got - expected) / scale) ** 2).mean(1))
    crossed = np.floor(expected[:2]) != np.floor(scene.positions())
    assert crossed.any(0).mean() > 0.1
    assert (error < (1e-12 if dtype is np.float64 else 5e-3)).all(), error


@pytest.mark.parametrize("dtype", PRECISIONS, ids=lambda d: d.__name__)
def test_total_frame_computes_the_same_while_no_point_crosses(dtype):
    """Up to points not being Gauss points, and to velocities that go over nodes first."""
    scene = Scene(64, turned=0.0, speed=1e-4)
    points = after(compare.LOOPS[0], scene, np.float64, 60)
    nodes = after(compare.TOTAL_SAME, scene, dtype, 60)
    corners = nodes.reshape(4, scene.cells + 1, scene.cells + 1)
    middle = (corners[:, 1:, 1:] + corners[:, :-1, 1:] + corners[:, 1:, :-1] + corners[:, :-1, :-1]) / 4
    points[:2] -= scene.positions()
    points = points.reshape(4, scene.cells, scene.cells, 4).mean(-1)
    scale = abs(points).max((1, 2), keepdims=True)
    np.testing.assert_allclose(middle / scale, points / scale, rtol=0, atol=5e-3)


@pytest.mark.parametrize("dtype", PRECISIONS, ids=lambda d: d.__name__)
@pytest.mark.parametrize("name", POINTS + TOTALS)
def test_speed(benchmark, name, dtype):
    scene = Scene(compare.CELLS)
    reset, step, _ = compare.codes(dtype)[name](scene, dtype)
    for _ in range(2):
        reset()
        step(compare.STEPS)
    benchmark.pedantic(step, (compare.STEPS,), setup=reset, rounds=compare.TURNS)
    best = benchmark.stats.stats.min
    benchmark.extra_info["million_point_steps_per_s"] = scene.count * compare.STEPS / best / 1e6


@pytest.mark.parametrize("dtype", PRECISIONS, ids=lambda d: d.__name__)
def test_ratios(dtype, tmp_path_factory, request):
    """In turns, the ratios that the project promises; written to `ratios-<precision>.json`."""
    rate = compare.rates(Scene(compare.CELLS), dtype)
    ratio = compare.summary(rate)
    where = tmp_path_factory.mktemp("ratios") / f"ratios-{dtype.__name__}.json"
    where.write_text(json.dumps({"rate": rate, "summary": ratio}, indent=1))
    print(f"\n{where}\n{json.dumps(ratio, indent=1)}")
    if request.config.getoption("benchmark_only"):
        assert ratio[compare.TOTAL] >= 3 and ratio[compare.MOVING] >= 1
