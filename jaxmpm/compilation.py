"""Compilation, and where compiled programs are kept from run to run."""

import hashlib
import os
import platform
from collections import OrderedDict
from pathlib import Path

import jax

MOST_PROGRAMS = 16  # kept in memory; a run in the total frame has three for each size of its pool
_programs: OrderedDict = OrderedDict()  # the one used last at the end


def program(function, *arguments, optimised=True):
    """The jitted `function` compiled for arguments like these, pytrees: a second scene that looks alike takes the first's.

    Alike are arguments of the same structure, static parts included, whose arrays have the same shapes
    and types, as those of two scenes on one grid have, whatever their materials, loads and seeds.
    """
    leaves, structure = jax.tree.flatten(arguments)
    key = function, structure, tuple(jax.typeof(leaf) for leaf in leaves)
    if key not in _programs:
        _programs[key] = compiled(function.lower(*arguments), optimised)
        while len(_programs) > MOST_PROGRAMS:
            _programs.popitem(last=False)
    _programs.move_to_end(key)
    return _programs[key]


def forget_programs() -> None:
    """Give back the memory of the programs that are kept for scenes to come."""
    _programs.clear()


def compiled(lowered, optimised=True):
    """Compile; on CPUs without XLA's newer code generator, which takes half as long again.

    What is not `optimised` takes half the time to compile there: long programs of simple loops run as fast.
    """
    if jax.default_backend() == "cpu":
        options = {"xla_cpu_use_fusion_emitters": False} | ({} if optimised else {"xla_backend_optimization_level": 1})
        try:
            return lowered.compile(compiler_options=options)
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
