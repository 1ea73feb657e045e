"""Compilation is what costs time here: the code generator that is quickest, and a cache to share."""

import os
import subprocess
import sys
import tempfile

import pytest

_kept = tempfile.TemporaryDirectory(prefix="jaxmpm-tests-")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", _kept.name)  # before JAX is imported
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")

_flags = " ".join([os.environ.get("XLA_FLAGS", ""), "--xla_cpu_use_fusion_emitters=false"]).strip()
_probe = subprocess.run(  # an XLA that does not know a flag ends the process
    [sys.executable, "-c", "import jax; jax.devices()"],
    env=os.environ | {"XLA_FLAGS": _flags},
    capture_output=True,
    check=False,
)
if _probe.returncode == 0:
    os.environ["XLA_FLAGS"] = _flags


@pytest.fixture(autouse=True, scope="module")
def _forget_what_was_compiled():
    """Programs of one file are of no use to the next, and they add up to gigabytes."""
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
