"""What the panels' pictures share: Okabe and Ito's colours, with a marker and a line of its own for each."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#444444")
MARKERS = ("o", "s", "D", "^", "v", "x")
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), "-")


def plain(axes) -> None:
    """A light grid behind, no frame above and right."""
    axes.grid(color="#e4e4e4", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def curves(axes, rows, first=0, **more) -> None:
    """A line with markers for each series of rows, by x, in the order of the rows; `first`: of the looks."""
    for k, series in enumerate(dict.fromkeys(row["series"] for row in rows), first):
        own = [row for row in rows if row["series"] == series and row["y"] is not None]
        look = {"color": COLOURS[k], "marker": MARKERS[k], "ls": DASHES[k], "ms": 4.5, "lw": 1.2, "label": series} | more
        axes.plot([row["x"] for row in own], [row["y"] for row in own], **look)
