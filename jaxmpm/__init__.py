"""jaxmpm: a differentiable Material Point Method for fracture of quasi-brittle materials.

Units everywhere: mm, N, MPa, s, tonne; tension is positive.
"""

import os

# Dense systems here are small: on cores that are busy with other things threads only wait for each other, up to 40
# times as long as one takes alone. NumPy reads this when it is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"

_PUBLIC = {
    "load_scene": "jaxmpm.scene", "run_scene": "jaxmpm.run", "Run": "jaxmpm.differentiable",
    "simulate": "jaxmpm.differentiable", "smooth_peak": "jaxmpm.differentiable",
}  # fmt: skip
__all__ = [*_PUBLIC]


def __getattr__(name):
    """The public names, imported when they are asked for: JAX takes a second."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_PUBLIC[name]), name)
