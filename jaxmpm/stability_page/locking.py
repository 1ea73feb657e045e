"""The opening test by the angle of the crack to the grid, with and without the release of crack-parallel stress."""

from jaxmpm import verify
from jaxmpm.stability_page.looks import curves, plain

NAME, TITLE = "locking", "A crack opened at an angle to the grid"
ANGLES = (0.0, 7.5, 15.0, 22.5, 30.0, 37.5, 45.0)  # degrees
RELEASES = (0, 1, 3)  # bands.release; 1 is what scenes have


def measure(say) -> dict:
    """Work over G_F × area, and the traction left over the strength, by angle and `bands.release`."""
    rows, left = [], {}
    for release in RELEASES:
        series = f"bands.release = {release}" + {0: ", none", 1: ", default"}.get(release, "")
        pulls = []
        for angle in ANGLES:
            work, traction = verify.opening(angle, changes=[f"bands.release={release}"])
            rows.append({"series": series, "x": angle, "y": work["value"]})
            pulls.append(traction["value"])
        left[series] = max(pulls)
        say(_told(series, rows, left))
    return {"rows": rows, "traction_left": left}


def _told(series, rows, left) -> str:
    works = [row["y"] for row in rows if row["series"] == series]
    return f"{series}: {min(works):.3f} to {max(works):.3f} of the exact work, at most {left[series]:.1%} of the strength left"


def lines(found):
    """The range of each release in words."""
    for series in found["traction_left"]:
        yield _told(series, found["rows"], found["traction_left"])


def draw(axes, found):
    """Work over exact work, by angle."""
    axes.axhspan(0.95, 1.05, color="#eceef1", zorder=0)
    axes.annotate("within 5 %", (1, 0.952), (0, 0), textcoords="offset points", ha="left", va="bottom", fontsize=8, color="#555555")
    curves(axes, found["rows"])
    axes.set(xlabel="angle of the crack to the grid [°]", ylabel="work / exact work", xticks=ANGLES[::2], ylim=(0.9, 1.55))
    axes.legend(fontsize=7.5, loc="upper right")
    plain(axes)
