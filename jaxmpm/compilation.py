"""Compilation, and where compiled programs are kept from run to run."""

import hashlib
import os
import platform
from pathlib import Path

import jax


def compiled(lowered):
    """Compile; on CPUs without XLA's newer code generator, which takes half as long again."""
    if jax.default_backend() == "cpu":
        try:
            return lowered.compile(compiler_options={"xla_cpu_use_fusion_emitters": False})
        except Exception as error:  # a later XLA may no longer know the option
            if "No such compile option" not in str(error):
                raise
    return lowered.compile()


def keep_compiled() -> None:
    """Keep programs in the user's cache: a scene of known size need not be compiled again.

    Materials, loads and supports are no part of a program, so a parameter study compiles once.
    Set JAX_COMPILATION_CACHE_DIR to keep them elsewhere, JAX_ENABLE_COMPILATION_CACHE=0 not at all.
    """
    if jax.config.jax_compilation_cache_dir is None:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        jax.config.update("jax_compilation_cache_dir", str(Path(base) / "jaxmpm" / _processor()))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def _processor():
    """A name for this kind of processor: machine code for one may not run on another."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        about = sorted({line for line in lines if line.startswith(("model name", "flags", "Features"))})
    except OSError:
        about = [platform.processor()]
    name = "\n".join([platform.machine(), *about])
    return hashlib.sha256(name.encode()).hexdigest()[:16]
