"""The picture of a scene's phases: written by the command, in the colours and with the numbers of the scene."""

import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from meso_scene import STONES, scene

from jaxmpm import cli, plot_phases
from jaxmpm.layout import lay_out


def drawn(monkeypatch, tmp_path, one):
    """The axes of the picture of a scene."""
    kept = []
    monkeypatch.setattr(plot_phases, "save", lambda figure, path: kept.append(figure) or path)
    plot_phases.plot_phases(one, tmp_path / "p.png")
    (figure,) = kept
    assert isinstance(figure, Figure)
    return figure.axes


@pytest.mark.parametrize("edges", ["inside", "periodic"])
def test_the_map_the_shares_and_the_grading(monkeypatch, tmp_path, edges):
    one = scene(mesostructure={"inclusions": STONES | {"edges": edges, "shape": {"kind": "polygon"}}})
    main, bars, curve = drawn(monkeypatch, tmp_path, one)
    layout = lay_out(one)
    colours = main.collections[0].to_rgba(np.arange(3.0))
    assert colours.tolist() == [list(to_rgba(c)) for c in plot_phases.COLOURS[:3]]
    assert (main.collections[0].get_array().T == layout.material).all()  # here in the order of the colours
    assert [bar.get_width() for bar in bars.patches] == pytest.approx([100 * s for s in layout.shares().values()])
    words = [text.get_text() for text in bars.texts]
    assert words[1].startswith("stone  ") and words[1].endswith("(placed 40.0%)")
    asked, placed = curve.lines
    assert asked.get_ydata()[[0, -1]] == pytest.approx([0.0, 100.0])
    middle = np.interp(4.0, *asked.get_data())
    assert middle == pytest.approx(100 * (2 - 2**0.5) / (6**0.5 - 2**0.5), rel=1e-3)
    assert abs(np.interp(4.0, *placed.get_data()) - middle) < 8


def test_a_map_of_what_scatters(monkeypatch, tmp_path):
    one = scene(scatter={"mortar": {"modulus": 8.0, "length": 3.0}})
    *_, strength = drawn(monkeypatch, tmp_path, one)
    layout = lay_out(one)
    values = strength.collections[0].get_array().T
    assert (values.mask == (layout.material != 0)).all()
    assert values.compressed() == pytest.approx(layout.local.strength[layout.material == 0])


def test_the_command(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["phases", "den", "--set", "grid.cell=5"]) == 0
    assert capsys.readouterr().out.strip() == "den_phases.png"
    assert (tmp_path / "den_phases.png").stat().st_size > 500
    assert cli.main(["phases", "den", "--out", "in/p.svg"]) == 0 and (tmp_path / "in" / "p.svg").exists()
    assert cli.main(["phases", "den", "--out", "p.jpg"]) == cli.BAD_INPUT
    assert "--out = p.jpg: expected a file whose name ends in .png" in capsys.readouterr().err
    assert cli.main(["phases", "dne"]) == cli.BAD_INPUT
