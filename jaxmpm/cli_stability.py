"""`jaxmpm stability` on the command line: the map of methods, and the page of all that is stable or not."""

from jaxmpm.errors import SceneError

PASSED, FAILED = 0, 1


def add_command(commands, folder, keep_compiled) -> None:
    """Add the command; `folder` and `keep_compiled` are those of `cli`."""
    stability = commands.add_parser(
        "stability", help="map where methods for a crack fail, and where the program does",
        description="Maps where ways to update a cracked point fail; with --page draws, on one page, that map, critical time steps, cell "
        "crossing, locking by angle, loading rate against equilibrium, float32 against float64, and bars beyond H_max.",
    )  # fmt: skip
    stability.add_argument("--out", metavar="DIR", default="results/stability", help="where to write (default: results/stability)")
    stability.add_argument("--coarse", action="store_true", help="a quick map, float64 only")
    stability.add_argument("--page", action="store_true", help="the whole page, some minutes")
    stability.add_argument("--only", nargs="+", metavar="PANEL", default=[], help="of the page: map, cfl, crossing, locking, rate, float32, h_max")
    stability.add_argument("--resume", action="store_true", help="of the page: keep the panels that stability_page.json in DIR has")
    stability.set_defaults(command=lambda options: run(options, folder, keep_compiled))


def run(options, folder, keep_compiled) -> int:
    """The map, or the page."""
    directory = folder("--out", options.out)
    for option, given, fits in (("--only", options.only, options.page), ("--resume", options.resume, options.page), ("--coarse", options.coarse, not options.page)):
        if given and not fits:
            raise SceneError(f"stability: {option}: expected only {'without' if options.page else 'with'} --page")
    if options.page:
        return _page(options, directory, keep_compiled)
    keep_compiled()
    from jaxmpm import stability

    summary = stability.run(directory, options.coarse, show=print)
    print(f"written to {options.out}: stability.png stability.csv stability.json")
    return PASSED if summary["passed"] else FAILED


def _page(options, directory, keep_compiled) -> int:
    from jaxmpm.stability_page import page

    names = page.wanted(options.only)
    panels = page.kept(directory) if options.resume else {}
    keep_compiled()
    panels = page.make(directory, names, panels, lambda line: print(line, flush=True))
    for suffix in ("png", "pdf"):
        page.draw(panels, directory / f"{page.FILE}.{suffix}")
    print(f"written to {options.out}: {' '.join(f'{page.FILE}.{suffix}' for suffix in ('png', 'pdf', 'csv', 'json'))}")
    return PASSED
