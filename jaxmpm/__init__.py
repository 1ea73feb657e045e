"""jaxmpm: a differentiable Material Point Method for fracture of quasi-brittle materials.

    scene = jaxmpm.load_scene("den", {"grid.cell": 5})  # a bundled scene or a TOML file, with changes
    result = jaxmpm.run_scene(scene, "results/den5")    # runs it; result["peak_load"] is in newtons
    result.plot()                                       # response and cracks, inline in a notebook
    result.history["load"]                              # every sample, as an array

Units everywhere: mm, N, MPa, s, tonne; tension is positive.
"""

import os

# Dense systems here are small: on cores that are busy with other things threads only wait for each other, up to 40
# times as long as one takes alone. NumPy reads this when it is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"

_PUBLIC = {
    "load_scene": "jaxmpm.scene", "scene_names": "jaxmpm.scene", "Scene": "jaxmpm.scene",
    "run_scene": "jaxmpm.run", "load_result": "jaxmpm.run_result", "Result": "jaxmpm.run_result",
    "run_ensemble": "jaxmpm.ensemble", "keep_compiled": "jaxmpm.compilation",
    "Run": "jaxmpm.differentiable", "simulate": "jaxmpm.differentiable",
    "about_displacement": "jaxmpm.differentiable", "smooth_peak": "jaxmpm.differentiable",
    "SceneError": "jaxmpm.errors", "RunError": "jaxmpm.errors", "ResultError": "jaxmpm.errors",
}  # fmt: skip
__all__ = [*_PUBLIC]


def __getattr__(name):
    """The public names, imported when they are asked for: JAX takes a second."""
    import importlib

    if name not in _PUBLIC:
        from jaxmpm.errors import did_you_mean

        near = did_you_mean(name, _PUBLIC)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}" + (f", did you mean {near}?" if near else ""))
    found = getattr(importlib.import_module(_PUBLIC[name]), name)
    globals()[name] = found
    return found


def __dir__():
    return sorted({*_PUBLIC, *(name for name in globals() if name.startswith("__"))})
