"""What a notebook shows of a scene, a run and its progress; and a scene's picture, which the command line draws too."""

import io
import re
from base64 import b64decode
from html.parser import HTMLParser
from types import SimpleNamespace

import IPython
import IPython.display
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from jaxmpm import plot_scene, progress, results
from jaxmpm.html import table
from jaxmpm.layout import lay_out
from jaxmpm.run_result import History, load_result
from jaxmpm.scene import load_scene

EMPTY = ("img", "br")


class Parsed(HTMLParser):
    """HTML whose tags must match: its words, and its pictures decoded."""

    def __init__(self, text):
        super().__init__()
        self.open, self.words, self.images, self.titles = [], [], [], {}
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        if tag == "img":
            kind, _, data = attrs["src"].partition(";base64,")
            assert kind == "data:image/png"
            self.images.append(imread(io.BytesIO(b64decode(data))))
        if tag not in EMPTY:
            self.open.append((tag, attrs.get("title")))

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        self.words.append(data)
        if self.open and self.open[-1][1]:
            self.titles[data] = self.open[-1][1]

    @property
    def text(self):
        return " ".join(self.words)


def test_a_scene_shows_its_picture_and_its_numbers_with_units():
    shown = Parsed(load_scene("bar", {"title": "<b>5 % & more"})._repr_html_())
    assert "<b>5 % & more" in shown.text
    assert "grid" in shown.words and "materials.weak" in shown.words and "contact" not in shown.words
    assert shown.titles["cell = 2.5 mm"] == "side of a square cell, mm"
    assert "ft = 2.85 MPa" in shown.words and "nu = 0.2" in shown.words
    (picture,) = shown.images
    assert picture.shape[1] > 2 * picture.shape[0] and np.ptp(picture) > 0.5  # of a bar, not blank


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"grid.cell": 0.05}, "4000 × 4000 cells: too many"), ({"sets.top.inside.0.min": [0.0, 201.0], "sets.top.inside.0.max": [0.0, 201.0]}, "sets.top")],
)
def test_a_scene_that_cannot_be_drawn_says_why(changes, words):
    changes = changes if "grid.cell" not in changes else changes | {"materials.concrete.band.h": 0.01}
    shown = Parsed(load_scene("den", changes)._repr_html_())
    assert not shown.images and words in shown.text


def marks(name, changes=()):
    """The axes with the marks of a scene."""
    scene = load_scene(name, changes)
    axes = Figure().add_subplot()
    plot_scene.draw_loads(axes, scene, lay_out(scene))
    arrows = [(np.array(text.xyann), np.array(text.xy)) for text in axes.texts if text.arrow_patch]
    return {line.get_label(): line for line in axes.lines}, arrows


def test_marks_are_where_the_loads_are():
    held, arrows = marks("beam")
    assert held["held"].get_xydata().tolist() == [[25.0, 0.0]] and held["held in y"].get_xydata().tolist() == [[150.0, 0.0]]
    assert held["measured"].get_xydata().tolist() == [[86.0, 0.0], [89.0, 0.0]]
    ((start, end),) = arrows  # it presses: the arrow ends at the beam
    assert end == pytest.approx([87.5, 50.0]) and start == pytest.approx([87.5, 50.0 + 0.09 * 175])
    _, arrows = marks("den")
    ways = np.array([end - start for start, end in arrows]) / 18.0
    assert np.allclose(ways[:9], [0, 1]) and np.allclose(ways[9:], [-1, 0])  # up, and away from the plate
    _, arrows = marks("discs")
    assert np.allclose([(end - start) / np.hypot(*(end - start)) for start, end in arrows], np.array([[1, 1], [-1, -1]]) / 2**0.5)
    _, arrows = marks("rve", {"parameters.side": 12.5})
    assert [np.sign(end - start).tolist() for start, end in arrows] == [[1, 0], [-1, 0]]


def test_the_sheet_has_a_tile_for_every_scene(tmp_path, monkeypatch):
    kept = []
    monkeypatch.setattr(plot_scene, "save", lambda figure, path: kept.append(figure) or path)
    monkeypatch.setattr(plot_scene, "scene_names", lambda: {"bar": "A bar", "discs": "Two discs", "den": "A plate", "beam": "A beam"})
    plot_scene.plot_sheet(tmp_path / "sheet.png")
    tiles = [axes for axes in kept[0].axes if axes.collections]
    assert [axes.get_title() for axes in tiles] == ["A bar", "Two discs", "A plate", "A beam"]
    assert [axes.texts[-1].get_text() for axes in tiles] == ["bar", "discs", "den", "beam"]


@pytest.fixture
def run(tmp_path):
    """What a short run leaves, but for its frames."""
    columns = [("time", "s"), ("load", "N"), ("delta", "mm")]
    with results.History.create(tmp_path / "history.csv", columns) as history:
        for k in range(30):
            history.append([1e-3 * k, 100.0 * k, 1e-4 * k])
    summary = {
        "scene": "s", "title": "A <run>", "status": "completed", "response": {"load": "load", "displacement": "delta"},
        "load_unit": "N", "displacement_unit": "mm", "peak_load": 2900.0, "displacement_at_peak": 2.9e-3, "final_load": 2900.0,
        "final_displacement": 2.9e-3, "can_crack": True, "cracked": 3, "cells": 40, "energy_error": 1e-6,
    }  # fmt: skip
    results.write_summary(tmp_path, summary)
    return tmp_path


def test_a_run_shows_its_numbers_and_pictures(run):
    from jaxmpm.plot import plot_response

    plot_response(run)
    shown = Parsed(load_result(run)._repr_html_())
    assert "A <run>" in shown.text and "2.900 kN at delta = 0.0029 mm" in shown.words and "3 of 40" in shown.words
    assert len(shown.images) == 1
    plot_response(run, run / "response.pdf")
    assert "response.pdf" in Parsed(load_result(run)._repr_html_()).text  # no browser shows it inline


def test_a_history_shows_both_ends_with_units(run):
    shown = Parsed(load_result(run).history._repr_html_())
    assert shown.words[:3] == ["time [s]", "load [N]", "delta [mm]"] and shown.words.count("…") == 4
    assert {"0", "4", "25", "29", "2900"} <= set(shown.words) and "5" not in shown.words
    short = History({"a": np.arange(7.0)}, {"a": ""})
    assert Parsed(short._repr_html_()).words == ["a"] + [text for k in range(7) for text in 2 * [str(k)]]
    assert table([["<"]]) == '<table><tbody><tr><td style="text-align:left">&lt;</td></tr></tbody></table>'


def test_progress_in_a_notebook_is_one_output_that_changes(monkeypatch):
    shown = []
    handle = SimpleNamespace(update=lambda data, raw: shown.append(data))
    monkeypatch.setattr(IPython, "get_ipython", lambda: SimpleNamespace(kernel=1))
    monkeypatch.setattr(IPython.display, "display", lambda data, raw, display_id: shown.append(data) or handle)
    monkeypatch.setattr(progress, "PAUSE", 0.0)
    screen = progress.screen()
    screen.line("a plate <1>")
    for share in (0.25, 1.0):
        screen.bar(share, f"{share:4.0%}  done")
    screen.line("a word")
    screen.close()
    assert [re.findall(r'value="([\d.]+)"', data["text/html"]) for data in shown] == [[], ["0.2500"], ["1.0000"], ["1.0000"], ["1.0000"]]
    assert shown[-1]["text/plain"] == "a plate <1>\na word\n100%  done" and Parsed(shown[-1]["text/html"]).words[0] == "a plate <1>"
    stream = io.StringIO()
    lines = progress.screen(stream)  # asked for by name, it is that even here
    for share in np.linspace(0, 1, 101):
        lines.bar(share, f"{share:.2f}")
    assert len(stream.getvalue().splitlines()) == 11
    monkeypatch.setattr(IPython, "get_ipython", lambda: SimpleNamespace())  # the shell of a terminal
    assert isinstance(progress.screen(), progress.Lines)


def test_a_terminal_has_a_bar_in_one_line():
    stream = io.StringIO()
    stream.isatty = lambda: True
    bar = progress.screen(stream)
    bar.bar(0.5, "half")
    bar.line("a word")
    bar.close()
    assert stream.getvalue() == "\r\033[K" + "█" * 12 + "·" * 12 + " half\na word\n"
