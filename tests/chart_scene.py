"""A small scene to chart, and a machine on which the scene den is made up of formulae and takes no time."""

import numpy as np

from jaxmpm.chart import measure, run
from jaxmpm.chart.settings import MODEL
from jaxmpm.errors import RunError

BLOCK = """
title = "A block clamped on the left and pulled up on the right"
[grid]
size = [40.0, 20.0]
cell = 10.0
stress_state = "plane_stress"
thickness = 10.0
[materials.soft]
density = 1e-9
bulk = { law = "elastic", E = 100.0, nu = 0.3 }
[[bodies]]
name = "block"
material = "soft"
shapes = [{ kind = "rectangle", min = [0.0, 0.0], max = [40.0, 20.0] }]
[sets]
left = { inside = [{ kind = "rectangle", min = [0.0, 0.0], max = [0.0, 20.0] }] }
right = { inside = [{ kind = "rectangle", min = [40.0, 0.0], max = [40.0, 20.0] }] }
[[supports]]
set = "left"
fix = ["x", "y"]
[[displacements]]
set = "right"
direction = "y"
history = { time = [0.0, 4e-3], value = [0.0, 0.02], interpolation = "smooth" }
[gauges.load]
kind = "reaction"
set = "right"
direction = "y"
[gauges.up]
kind = "displacement"
set = "right"
direction = "y"
[response]
load = "load"
displacement = "up"
[solver]
frame = "total"
duration = 4e-3
damping = 0.3
[output]
samples = 20
"""


def write_scene(folder, text=BLOCK):
    """The block as a file in a folder."""
    path = folder / "block.toml"
    path.write_text(text)
    return path


def seconds_by_work(summary):
    """Time of a run by the cells and steps that it has gone through, so that no test hangs on that of a busy machine."""
    return summary["cells"] * summary["steps"] * 1e-8 * (0.7 if summary["precision"] == "float32" else 1.0)


class Machine:
    """Stands in for runs: seconds and numbers of a setting of den by formulae, time that passes by them alone."""

    def __init__(self, monkeypatch, cell=2.5):
        self.cell, self.now, self.ran = cell, 0.0, []
        self.fails, self.slows = (lambda setting: False), (lambda now: 1.0)
        monkeypatch.setattr(run, "perf_counter", lambda: self.now)
        monkeypatch.setattr(measure, "perf_counter", lambda: self.now)
        monkeypatch.setattr(measure, "run_setting", self.run)
        monkeypatch.setattr(measure, "Clock", lambda *_: self)

    def seconds(self, setting):
        """What a setting takes when the machine is quiet."""
        factor = {"float32": 0.7}.get(setting.get("precision"), 1.0) * (10.0 if "frame" in setting else 1.0)
        factor *= 8.0 if "solver" in setting else 1.0
        return 5.0 * (self.cell / setting.get("cell", self.cell)) ** 2.7 / setting.get("speed", 1.0) * factor

    def top(self, setting):
        """Its peak."""
        model = 0.05 * bool(set(MODEL) & set(setting))
        return 100.0 * (1 + 0.01 * setting.get("cell", self.cell) + 0.003 * (setting.get("speed", 1.0) ** 2 - 1) + model)

    def run(self, source, setting, seconds):
        """Stands in for `run_setting`."""
        from jaxmpm.chart.settings import key

        took = self.seconds(setting) * self.slows(self.now)
        self.now += 1.0
        if self.fails(setting):
            raise RunError("too fast")
        if took > seconds:
            self.now += seconds
            raise RunError("too long")
        self.now += took
        self.ran.append(key(setting))
        x = np.linspace(0.0, 3.0, 31)
        load = np.interp(x, [0.0, 1.0, 3.0], [0.0, self.top(setting), 0.0])
        summary = {"run_seconds": took, "compile_seconds": 2.0, "cell_size": setting.get("cell", self.cell), "frame": "total", "displacement_unit": "mm"}
        return summary, {"displacement": list(x), "load": list(load), "motion": False, "crack": []}

    def tick(self):
        """Stands in for a piece of a run."""
        self.now += 0.5 * self.slows(self.now)
        return 0.5 * self.slows(self.now)
