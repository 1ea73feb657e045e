"""Speed against accuracy: a scene over its choices, each timed and held against a reference; one chart, its front named.

    from jaxmpm.chart import Source, chart_scene, draw_chart, read_chart, table

    chart = chart_scene(Source("den"), "results/den_chart", budget=600)
    table(chart)                    # rows, quickest first
    draw_chart(axes, chart)         # on axes of Matplotlib
"""

from jaxmpm.chart.settings import Source

_PUBLIC = {
    "chart_scene": "jaxmpm.chart.run", "read_chart": "jaxmpm.chart.files", "table": "jaxmpm.chart.files",
    "draw_chart": "jaxmpm.chart.picture", "plot_chart": "jaxmpm.chart.picture",
}  # fmt: skip
__all__ = ["Source", *_PUBLIC]


def __getattr__(name):
    """The public names, imported when they are asked for, as in `jaxmpm`."""
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_PUBLIC[name]), name)
