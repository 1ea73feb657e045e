"""Compilation is what costs time here: the code generator that is quickest, little optimisation, a cache to share, and for each worker
cores of its own, as many as threads of its.

A file that compares what runs yield, in programs that take longer to optimise than to run, says
`HASTY = True`: they are hardly optimised. Not one that takes derivatives and does not hold them against differences, or against
those of a program that is optimised: without optimisation this code generator gives wrong ones (of a band that releases stress at
onset, by E and h), of the right values.
"""

import os
import subprocess
import sys
import tempfile

import pytest

_kept = tempfile.TemporaryDirectory(prefix="jaxmpm-tests-")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", _kept.name)  # before JAX is imported
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")  # small ones are many

if "PYTEST_XDIST_WORKER" in os.environ and hasattr(os, "sched_setaffinity"):
    _cores, _number = sorted(os.sched_getaffinity(0)), int(os.environ["PYTEST_XDIST_WORKER"].removeprefix("gw"))
    os.sched_setaffinity(0, _cores[_number :: int(os.environ["PYTEST_XDIST_WORKER_COUNT"])] or _cores)

_quick = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=1 --xla_cpu_parallel_codegen_split_count=1"
_flags = " ".join([os.environ.get("XLA_FLAGS", ""), _quick]).strip()
_probe = subprocess.run(  # an XLA that does not know a flag ends the process
    [sys.executable, "-c", "import jax; jax.devices()"],
    env=os.environ | {"XLA_FLAGS": _flags},
    capture_output=True,
    check=False,
)
if _probe.returncode == 0:
    os.environ["XLA_FLAGS"] = _flags


@pytest.fixture(autouse=True, scope="module")
def _programs_of_one_file(request):
    """They are optimised or not, and of no use to the next file, and they add up to gigabytes."""
    hasty = getattr(request.module, "HASTY", False)
    with pytest.MonkeyPatch.context() as patch:
        if hasty:
            patch.setenv("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")  # of processes that it starts
        if "jax" in sys.modules:
            sys.modules["jax"].config.update("jax_disable_most_optimizations", hasty)
        yield
    if "jax" in sys.modules:
        sys.modules["jax"].clear_caches()
    if "jaxmpm.compilation" in sys.modules:
        sys.modules["jaxmpm.compilation"].forget_programs()


@pytest.fixture
def figures(monkeypatch):
    """The Matplotlib figures that are saved, for a look at what is in them."""
    from jaxmpm import plot_style

    saved, save = [], plot_style.save

    def keep(figure, path):
        saved.append(figure)
        return save(figure, path)

    monkeypatch.setattr(plot_style, "save", keep)
    return saved


LONGEST = ("test_notebooks", "test_balance", "test_tangent", "test_differentiable", "test_moving", "test_hand_over", "test_run")


def pytest_configure(config):
    if hasattr(config.option, "loadscopereorder"):  # xdist would begin with files of many tests
        config.option.loadscopereorder = False


def pytest_collection_modifyitems(items):
    """Files that take long come first, so that no worker is left alone with one at the end."""
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST))
