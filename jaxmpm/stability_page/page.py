"""Measures the panels one by one, keeps each as soon as it is known, and draws the page."""

import time
from pathlib import Path

from jaxmpm.errors import SceneError, near_or
from jaxmpm.results import ResultError, read_object, write_object, write_table
from jaxmpm.stability_page import cfl, crossing, float32, h_max, locking, methods_map, rate

PANELS = {panel.NAME: panel for panel in (methods_map, cfl, crossing, locking, rate, float32, h_max)}
FILE = "stability_page"  # .json, .csv, .png, .pdf
LOOK = {"fontsize": 9.0, "fontweight": "bold"}  # of titles


def wanted(names) -> list[str]:
    """The panels of these names in their order on the page, all if none; raises SceneError for another name."""
    for name in names:
        if name not in PANELS:
            raise SceneError(f"--only {name}: {near_or(name, PANELS)}")
    return [name for name in PANELS if name in names or not names]


def kept(directory: Path) -> dict:
    """The panels that were measured before, by name; raises ResultError where the file is another one."""
    path = directory / f"{FILE}.json"
    if not path.exists():
        return {}
    panels = read_object(path).get("panels")
    try:
        for name, found in panels.items():
            list(PANELS[name].lines(found))
    except (AttributeError, KeyError, IndexError, TypeError, ValueError) as error:
        raise ResultError(f"{path}: expected the panels of an earlier jaxmpm stability --page ({error!r}); start anew without --resume") from error
    return panels


def make(directory: Path, names, panels: dict, show) -> dict:
    """Measure the named panels but those that are known, and draw all that are; returns the panels by name.

    `show`: called with each line of what is found. Each panel is written as soon as it is known.
    """
    directory.mkdir(parents=True, exist_ok=True)
    for name in names:
        panel = PANELS[name]
        show(f"{name}: {panel.TITLE}".replace(r"$H_\mathrm{max}$", "H_max"))
        if name in panels:
            for line in panel.lines(panels[name]):
                show(f"  {line}")
            continue
        began = time.perf_counter()
        found = panel.measure(lambda line: show(f"  {line}"))
        panels[name] = found | {"seconds": round(time.perf_counter() - began, 1)}
        show(f"  ({panels[name]['seconds']:.0f} s)")
        write(directory, panels)
    return panels


def write(directory: Path, panels: dict) -> None:
    """Write all numbers: as JSON, and as one table."""
    from jaxmpm.chart.files import provenance

    write_object(directory / f"{FILE}.json", {"provenance": provenance(), "panels": panels})
    rows = [[name, row["series"], row["x"], row["y"]] for name in PANELS if name in panels for row in panels[name]["rows"]]
    write_table(directory / f"{FILE}.csv", ("panel", "series", "x", "y"), rows)


def draw(panels: dict, path: Path) -> Path:
    """Draw the panels: the map across the page, the others two beside each other."""
    from jaxmpm import plot_style

    there = [name for name in PANELS if name in panels]
    small = [name for name in there if name != methods_map.NAME]
    tall = (len(small) + 1) // 2
    heights = [2.3] * (methods_map.NAME in panels) + [2.7] * tall
    with plot_style.styled_figure() as figure:
        figure.set_size_inches(8.6, sum(heights))
        parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        letters = iter("abcdefg")
        if methods_map.NAME in panels:
            axes = parts[0].subplots(1, 4, sharex=True, sharey=True)
            parts[0].subplots_adjust(0.1, 0.33, 0.985, 0.78, wspace=0.08)
            parts[0].text(0.1, 0.97, f"{next(letters)}  {methods_map.TITLE}", **LOOK, va="top")
            methods_map.draw(axes, panels[methods_map.NAME])
            methods_map.legend(parts[0])
        for k, name in enumerate(small):
            row = parts[k // 2 + len(heights) - tall]
            axes = row.add_axes((0.1 + 0.5 * (k % 2), 0.2, 0.385, 0.66))
            PANELS[name].draw(axes, panels[name])
            axes.set_title(f"{next(letters)}  {PANELS[name].TITLE}", loc="left", **LOOK)
        return plot_style.save(figure, path)
