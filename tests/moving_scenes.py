"""Small scenes whose points move."""

from contextlib import contextmanager

import pytest

from jaxmpm.moving_simulation import MovingSimulation
from jaxmpm.scene import Scene

CONCRETE = {
    "density": 2.4e-9, "bulk": {"law": "elastic", "E": 32000.0, "nu": 0.2},
    "band": {"law": "damage", "ft": 3.0, "Ep": 8.184, "n": 0.128, "h": 0.05},
}  # fmt: skip
RUBBER = {"density": 1e-9, "bulk": {"law": "elastic", "E": 10.0, "nu": 0.3}}


def block(low, high, material="rubber", velocity=(0.0, 0.0), name="block"):
    shape = {"kind": "rectangle", "min": list(low), "max": list(high)}
    return {"name": name, "material": material, "shapes": [shape], "velocity": list(velocity)}


def scene(bodies, size=(60.0, 60.0), cell=5.0, walls=None, **more):
    """Bodies that fly, by default in the updated frame and undamped."""
    used = {body["material"] for body in bodies}
    tree = {
        "name": "test", "title": "test",
        "grid": {"size": list(size), "cell": cell, "stress_state": "plane_stress", "thickness": 1.0,
                 "walls": walls or {}},
        "materials": {k: v for k, v in (("rubber", RUBBER), ("concrete", CONCRETE)) if k in used},
        "bodies": bodies,
        "solver": {"frame": "updated", "duration": 1e-3, "damping": 0.0},
        "output": {"samples": 20, "frames": 3},
    }  # fmt: skip
    for key, value in more.items():
        tree[key] = tree[key] | value if key in ("solver", "output", "grid") else value
    return Scene.from_dict(tree)


@contextmanager
def interrupted(monkeypatch, reading):
    """Inside, a run of moving points is interrupted at so many readings, which ends the block."""
    read, calls = MovingSimulation.read, []

    def stops(self):
        calls.append(1)
        if len(calls) == reading:
            raise KeyboardInterrupt
        return read(self)

    monkeypatch.setattr(MovingSimulation, "read", stops)
    with pytest.raises(KeyboardInterrupt):
        yield
    monkeypatch.setattr(MovingSimulation, "read", read)


def notched(**solver):
    """A small plate with a notch, pulled until its ligament has cracked."""
    inside = lambda low, high: {"inside": [{"kind": "rectangle", "min": low, "max": high}]}  # noqa: E731
    body = block((0, 0), (30, 40), "concrete")
    body["minus"] = [{"kind": "rectangle", "min": [0.0, 17.5], "max": [10.0, 20.0]}]
    return scene(
        [body], size=(30.0, 40.0), cell=2.5,
        sets={"bottom": inside([0.0, 0.0], [30.0, 0.0]), "top": inside([0.0, 40.0], [30.0, 40.0])},
        supports=[{"set": "bottom", "fix": ["x", "y"]}],
        displacements=[{"set": "top", "direction": "y",
                        "history": {"time": [0.0, 1e-3], "value": [0.0, 0.05], "interpolation": "smooth"}}],
        gauges={"load": {"kind": "reaction", "set": "top", "direction": "y"},
                "delta": {"kind": "displacement", "set": "top", "direction": "y"}},
        response={"load": "load", "displacement": "delta"},
        solver={"damping": 0.02, "duration": 1e-3, **solver},
        output={"samples": 40, "frames": 3},
    )  # fmt: skip
