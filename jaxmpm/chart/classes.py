"""What charts of the bundled scenes say about scenes of their kind: what faster loading and float32 shift, and save.

`measured.json` holds the numbers of their runs; `python -m jaxmpm.chart.classes DIR…` writes it from the directories of charts, after
it has run what they left out of `NEEDED`: a chart leaves out what would not be on its front.
"""

import argparse
import json
import math
import sys
from pathlib import Path
from statistics import median

from jaxmpm.chart.files import read_chart
from jaxmpm.chart.reference import numbers_of
from jaxmpm.chart.settings import AXES, Source, flies, key, rest
from jaxmpm.errors import SceneError
from jaxmpm.results import ResultError
from jaxmpm.scene import Scene

FILE = Path(__file__).with_name("measured.json")
CHOICES = ("cell", "speed", "precision")
AS_FAST, FASTER, FASTEST = {"precision": "float32"}, {"speed": 2.0, "precision": "float32"}, {"speed": 4.0, "precision": "float32"}
NEEDED = [  # on cells over the scene's
    (2.0, FASTEST), (1.0, FASTEST), (0.5, FASTEST), (2.0, FASTER), (1.0, FASTER), (1.0, AS_FAST), (0.5, AS_FAST),
]  # fmt: skip
BETWEEN = [{}, FASTEST]  # on cells between, where there are some: they need not behave like either
EXPONENTS = (1.0, 2.0)  # of the loading rate, in what it shifts, that are believed
WORDS = {
    "specimen": "a body that cracks", "volume": "a volume with inclusions", "elastic": "a body that does not crack",
    "moving": "bodies that move",
}  # fmt: skip


def kind_of(scene: Scene) -> str:
    """The kind of a scene, one of WORDS."""
    if flies(scene) or scene.solver.frame == "updated" or scene.contact.kind != "stick" or not scene.response:
        return "moving"
    if scene.mesostructure:
        return "volume"
    return "specimen" if any(material.band for material in scene.materials.values()) else "elastic"


def compact(chart: dict) -> dict:
    """Of a chart what `Experience` needs: numbers and seconds of the runs that differ in cells, loading rate and precision.

    Raises ResultError where no run came to its end.
    """
    if not chart["reference"]:
        raise ResultError(f"the chart of {chart['name']}: no run came to its end; go on with jaxmpm chart --resume")
    until = chart["reference"]["until"]
    runs = [
        {"setting": record["setting"] | {"cell": record["cell_size"]}, "seconds": float(f"{record['seconds']:.3g}")}
        | {name: float(f"{value:.6g}") for name, value in numbers_of(record["outcome"], until).items()}
        for record in chart["runs"]
        if "seconds" in record and set(record["setting"]) <= set(CHOICES)
    ]
    own, scene = chart["scene"]["grid"]["cell"], Scene.from_dict(chart["scene"])
    return {"scene": chart["name"], "kind": kind_of(scene), "cell": own, "until": until, "made_on": chart["made_on"], "runs": runs}


def completed(directory: str) -> dict:
    """The chart of a directory with what it left out of `NEEDED`, which is run; raises ResultError where there is none, or of another scene."""
    from jaxmpm.chart.run import Chart

    known = read_chart(directory)
    chart = Chart(Source(known["name"]), Path(directory), math.inf, True, "auto", None, tuple(AXES), True)
    chart.judge()
    own = chart.cell
    between = max((size for size in chart.search.sizes if own / 2 < size < own), default=None)
    settings = [({"cell": ratio * own} if ratio != 1.0 else {}) | choice for ratio, choice in NEEDED]
    for setting in settings + [{"cell": between} | choice for choice in BETWEEN if between]:
        if key(setting) not in {record["key"] for record in chart.records}:
            chart.one(setting, at_least=math.inf)  # it is needed, whatever it takes
    chart.write()
    return chart.found


class Experience:
    """What has been measured on scenes of one kind."""

    def __init__(self, kind: str, charts: list[dict] | None = None):
        """`charts`: as of `compact`; those that come with the program if None."""
        charts = json.loads(FILE.read_text())["charts"] if charts is None else charts
        self.charts = [chart for chart in charts if chart["kind"] == kind]
        self.scenes = [chart["scene"] for chart in self.charts]

    def shift(self, number: str, coarse: bool, **choice) -> float | None:
        """The largest relative shift of a number by one choice, in magnitude; None where it was never tried.

        `coarse`: on whatever cells; else on those of a chart's scene as given and finer ones.
        """
        found = [abs(one[number] / other[number] - 1) for one, other in self._pairs(coarse, choice)]
        return max(found, default=None)

    def quicker(self, **choice) -> float:
        """By how much a choice shortens a run on cells of the scene or finer ones, the middle of what was measured; 1 if never."""
        found = [other["seconds"] / one["seconds"] for one, other in self._pairs(False, choice, same=True)]
        return median(found) if found else 1.0

    def rate(self, number: str, speed: float, coarse: bool) -> float | None:
        """The largest shift that loading `speed` times as fast makes; between the speeds measured, 2 and 4, by a power of them.

        None below 2, where it is not believed to fall: any change lets other cells crack first.
        """
        if speed == 1.0:
            return 0.0
        known = {value: self.shift(number, coarse, speed=value) for value in (2.0, 4.0)}
        if None in known.values() or not 2.0 <= speed <= 4.0:
            return None
        low, high = known[2.0], max(known[4.0], known[2.0])
        power = math.log2(max(high / low - 1, 1e-9)) if low > 0 else EXPONENTS[0]
        power = min(max(power, EXPONENTS[0]), EXPONENTS[1])
        return low + (high - low) * (speed**power - 2**power) / (4**power - 2**power)

    def blur(self, number: str, **quick) -> float:
        """By how much the shift from finer cells differs where both runs are quick ones from where they are as given, at most."""
        differences = []
        for chart in self.charts:
            slow, fast = ({run["setting"]["cell"]: run[number] for run in chart["runs"] if rest(run["setting"]) == other} for other in ({}, quick))
            sizes = sorted(cell for cell in slow.keys() & fast.keys() if cell <= chart["cell"])
            differences += [abs(slow[a] / slow[b] - fast[a] / fast[b]) for b, a in zip(sizes, sizes[1:], strict=False)]
        return max(differences, default=0.0)

    def _pairs(self, coarse: bool, choice: dict, same: bool = False):
        """Runs with a choice and the same without; `same`: in the precision as well, unless that is the choice."""
        for chart in self.charts:
            for one in chart["runs"]:
                tried, cell = rest(one["setting"]), one["setting"]["cell"]
                if not choice.items() <= tried.items() or (cell > chart["cell"] and not coarse):
                    continue
                without = {name: value for name, value in tried.items() if name not in choice}
                if not same:
                    without.pop("precision", None)
                yield from ((one, other) for other in chart["runs"] if other["setting"]["cell"] == cell and rest(other["setting"]) == without)


def main(arguments: list[str] | None = None) -> None:
    """Write measured.json from the directories of charts; raises ResultError where one has none, SceneError where its scene is none."""
    parser = argparse.ArgumentParser(
        prog="python -m jaxmpm.chart.classes", description="Writes measured.json from the directories of charts, with what these left out."
    )
    parser.add_argument("directories", metavar="DIR", nargs="+", help="of `jaxmpm chart`, of bundled scenes")
    parser.add_argument("--out", type=Path, default=FILE, metavar="FILE", help="where to (default: the one that comes with the program)")
    options = parser.parse_args(arguments)
    if not options.out.parent.is_dir() or options.out.is_dir():
        raise ResultError(f"--out = {options.out}: expected a file in a folder that is there")
    rows = ",\n".join(_text(compact(completed(directory))) for directory in options.directories)
    options.out.write_text(f'{{"about": "runs of charts of bundled scenes: N, mm, MPa, s", "charts": [\n{rows}\n]}}\n')


def _text(chart: dict) -> str:
    """A chart as JSON, a run a line."""
    head = json.dumps(chart | {"runs": []})
    return head[:-2] + "\n  " + ",\n  ".join(json.dumps(run) for run in chart["runs"]) + "]}"


if __name__ == "__main__":
    try:
        main()
    except (SceneError, ResultError) as error:
        sys.exit(f"error: {error}")
