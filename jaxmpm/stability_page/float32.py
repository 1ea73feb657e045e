"""What single precision changes, against double precision, over the number of steps."""

from jaxmpm import stability, verify
from jaxmpm.errors import RunError
from jaxmpm.scene import load_scene
from jaxmpm.stability_page.looks import curves, plain

NAME, TITLE = "float32", "float32 against float64, over the number of steps"
LIMIT = 1e-4  # what README says of the peak
RATIO = 0.03  # about: H/H_max of the one band
FACTORS = (0.9, 0.3, 0.1, 0.03)  # on the time step, of a bar
BAR = "bar", ["parameters.cell=10", "output.samples=100"]
SCENES = {  # a scene and its changes, what is compared, factors on the time step
    "den, 5 mm: peak": ("den", ["grid.cell=5", "output.samples=100"], "peak_load", FACTORS[:2]),
    "bar, 10 mm: work": (*BAR, "external_work", FACTORS),
    "bar, 10 mm: peak": (*BAR, "peak_load", FACTORS),
}


def measure(say) -> dict:
    """Relative differences by steps, and why runs stopped that did."""
    rows, stops, runs = _of_one_band(), [], {}
    say(_told(rows, rows[0]["series"]))
    for series, (name, changes, key, factors) in SCENES.items():
        for factor in factors:
            known = name, factor
            runs[known] = runs.get(known) or _both(name, [*changes, "output.frames=2", f"solver.time_step_factor={factor}"])
            exact, found = runs[known]
            stopped = found["status"] != "completed"
            if stopped:
                stops.append(f"{series}, {exact['steps']} steps: {found['status']}")
            rows.append({"series": series, "x": exact["steps"], "y": None if stopped else abs(found[key] / exact[key] - 1)})
        say(_told(rows, series))
    return {"rows": rows, "stops": stops}


def _both(name, changes):
    """The summaries of a scene in float64 and in float32, of a run that stops as far as it came."""
    found = []
    for precision in ("float64", "float32"):
        try:
            found.append(verify.summary_of(load_scene(name, [*changes, f'solver.precision="{precision}"'])))
        except RunError as error:
            found.append({"status": f"stopped: {error}"})
    return found


def _of_one_band() -> list[dict]:
    """The energy of one band pulled apart in so many strain increments."""
    both = [stability.cells(True, ("balance",), (precision,)) for precision in ("float64", "float32")]
    size = min({row["size_ratio"] for row in both[0]}, key=lambda ratio: abs(ratio - RATIO))
    found = {}
    for exact, other in zip(*both, strict=True):
        if exact["path"] == "uniaxial" and exact["size_ratio"] == size:
            found[exact["steps"]] = abs(other["energy_ratio"] / exact["energy_ratio"] - 1)
    return [{"series": "one band: energy", "x": steps, "y": found[steps]} for steps in sorted(found)]


def _told(rows, series) -> str:
    own = [(row["x"], row["y"]) for row in rows if row["series"] == series]
    said = ", ".join(f"{steps} steps {'stopped' if y is None else f'{y:.1e}'}" for steps, y in own)
    return f"{series}: {said}"


def lines(found):
    """Differences in words, and what stopped."""
    for series in dict.fromkeys(row["series"] for row in found["rows"]):
        yield _told(found["rows"], series)
    yield from found["stops"]


def draw(axes, found):
    """Differences over steps."""
    curves(axes, [row for row in found["rows"] if row["y"] != 0])
    axes.axhline(LIMIT, color="#444444", lw=0.9, ls="--", zorder=1)
    axes.set(xscale="log", yscale="log", xlabel="steps", ylabel="relative difference")
    axes.annotate("0.01 %", (0.01, LIMIT), (0, 2), ("axes fraction", "data"), "offset points", fontsize=8, va="bottom")
    axes.legend(fontsize=7.5)
    plain(axes)
