"""`jaxmpm size-effect` on the command line."""

COLUMNS = ("law", "depth", "rows", "cell", "strength", "seconds")
LINE = "{:<38}{:>11}{:>10}{:>15}{:>10}"


def add_command(commands, folder, keep_compiled) -> None:
    """Add the command; `folder` and `keep_compiled` are those of `cli`."""
    size = commands.add_parser(
        "size-effect", help="similar notched beams against Bažant's size effect law",
        description="Breaks half-notched beams 50 to 800 mm high, with bands and with smeared cracks, and holds their nominal strength "
        "against Bažant's size effect law.",
    )  # fmt: skip
    size.add_argument("--out", metavar="DIR", default="results/size_effect", help="where to write (default: results/size_effect)")
    size.add_argument("--coarse", action="store_true", help="cells of a tenth of the depth only")
    size.add_argument("--resume", action="store_true", help="keep the beams of size_effect.csv in DIR and go on")
    size.set_defaults(command=lambda options: run(options, folder, keep_compiled))


def run(options, folder, keep_compiled) -> int:
    """Break the beams; a row is printed, and written, as it is known."""
    directory = folder("--out", options.out)
    from jaxmpm import size_effect
    from jaxmpm.results import write_object, write_table
    from jaxmpm.size_effect_plot import plot_size_effect

    keep_compiled()
    directory.mkdir(parents=True, exist_ok=True)
    many = size_effect.series(rows=10) if options.coarse else [*size_effect.series(), *size_effect.on_other_cells()]
    print(LINE.format("law", "depth, mm", "cell, mm", "strength, MPa", "time, s"))
    rows = []
    known = kept(directory / "size_effect.csv") if options.resume else []
    for row in size_effect.measure(many, known):
        rows.append(row)
        print(LINE.format(row["law"], f"{row['depth']:g}", f"{row['cell']:.3g}", f"{row['strength']:.4f}", f"{row['seconds']:.1f}"), flush=True)
        write_table(directory / "size_effect.csv", COLUMNS, [[one[name] for name in COLUMNS] for one in rows])
    fits = size_effect.fits(rows)
    write_object(directory / "size_effect.json", {"rows": rows, "fits": {name: said(fit) for name, fit in fits.items()}})
    print(*report(fits), sep="\n")
    for suffix in ("png", "pdf"):
        plot_size_effect(rows, fits, directory / f"size_effect.{suffix}")
    print(f"written to {directory}: size_effect.csv size_effect.json size_effect.png size_effect.pdf")
    return 0


def kept(path) -> list[dict]:
    """The rows of a table that was written before, none where there is none; raises ResultError where it is another one."""
    import csv

    from jaxmpm.results import ResultError

    if not path.exists():
        return []
    try:
        with open(path, encoding="utf-8", newline="") as file:
            return [
                {"law": row["law"], "rows": int(row["rows"])} | {name: float(row[name]) for name in ("depth", "cell", "strength", "seconds")}
                for row in csv.DictReader(file)
            ]
    except (KeyError, ValueError, TypeError) as error:
        raise ResultError(f"{path}: expected the table of an earlier jaxmpm size-effect ({error!r}); start anew without --resume") from error


def said(fit) -> dict:
    """A fit as numbers, None where there is no size effect."""
    finite = lambda value: value if value < float("inf") else None  # noqa: E731
    return {"plastic": fit.plastic, "transition": finite(fit.transition), "energy": finite(fit.energy), "deviation": fit.deviation}


def report(fits: dict) -> list[str]:
    """The fits as lines."""
    lines = ["", LINE.format("Bažant's law", "B f_t, MPa", "D₀, mm", "G_f, N/mm", "off by")]
    for name, fit in fits.items():
        numbers = [f"{fit.plastic:.3f}", f"{fit.transition:.4g}", f"{fit.energy:.4f}", f"{fit.deviation:.1%}"]
        lines.append(LINE.format(name, *numbers))
    return lines
