"""A bar that swings so far that its points cross cells: the error of displacements on ever finer grids."""

from jaxmpm.particles_per_cell import FUNCTIONS, error_or_nan
from jaxmpm.shape_functions import Linear
from jaxmpm.stability_page.looks import curves, plain
from jaxmpm.verify_moving import Bar, fitted_order

NAME, TITLE = "crossing", "Points that cross cells: error of a swinging bar"
CELLS, EACH = (8, 16, 32, 64), 4  # cells of the bar, points in one
AMPLITUDE, STILL = 0.05, 1e-4  # of the bar's length; in the second no point crosses
WITHOUT = "linear, none crosses"
SLOPE = 0.02  # where a line of second order begins


def measure(say) -> dict:
    """Displacement errors over the amplitude, by the number of cells."""
    cases = {name: (Bar(AMPLITUDE), make(EACH)) for name, make in FUNCTIONS.items()} | {WITHOUT: (Bar(STILL), Linear())}
    rows = []
    for name, (bar, shape) in cases.items():
        for cells in CELLS:
            error = error_or_nan(bar, cells, shape, EACH) / bar.amplitude
            rows.append({"series": name, "x": cells, "y": error if error < float("inf") else None})
        say(_told(name, rows))
    return {"rows": rows}


def _told(name, rows) -> str:
    own = [(row["x"], row["y"]) for row in rows if row["series"] == name and row["y"] is not None]
    if len(own) < 2:
        return f"{name}: fails"
    return f"{name}: {own[0][1]:.1e} on {own[0][0]} cells, {own[-1][1]:.1e} on {own[-1][0]}, order {fitted_order(*zip(*own, strict=True)):.1f}"


def lines(found):
    """Errors and orders in words."""
    for name in dict.fromkeys(row["series"] for row in found["rows"]):
        yield _told(name, found["rows"])


def draw(axes, found):
    """Errors over cells, and a slope of two."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    curves(axes, found["rows"])
    low, high = CELLS[0], CELLS[-1]
    axes.plot([low, high], [SLOPE, SLOPE * (low / high) ** 2], color="#8d96a0", lw=0.9)
    axes.annotate("second order", (high, SLOPE * (low / high) ** 2), (-6, -1), textcoords="offset points", ha="right", va="top", fontsize=8)
    axes.set(xscale="log", yscale="log", xlabel=f"cells of the bar, {EACH} points in each", ylabel="error / amplitude", ylim=(4e-5, 1))
    axes.xaxis.set_major_locator(FixedLocator(CELLS))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.legend(fontsize=7.5, loc="lower left", framealpha=0.9)
    plain(axes)
