"""Colours are told apart by any kind of colour vision.

Colour blindness as G.M. Machado, M.M. Oliveira and L.A.F. Fernandes (IEEE Trans. Vis. Comput. Graph. 15 (2009)
1291-1298) simulate it: a matrix on linear RGB for each kind, at its full severity. Distances are those of CIELAB, in which
about 2 is just noticed side by side.
"""

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from jaxmpm import particles_per_cell, plot_ensemble, plot_scene, plot_style, stability_plot
from jaxmpm.plot_fields import FIELDS, opening_colours
from jaxmpm.plot_style import ACCENT, BAND, FAINT, INK, PHASES, shades

VISION = {
    "normal": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def lab(colours, vision):
    """CIELAB (N, 3) of colours as somebody sees them."""
    rgb = np.array([to_rgb(colour) for colour in colours])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.transpose(VISION[vision]), 0.0, 1.0)
    x, y, z = (seen @ XYZ.T / (0.9505, 1.0, 1.089)).T
    x, y, z = (np.where(t > 0.008856, np.cbrt(t), 7.787 * t + 16 / 116) for t in (x, y, z))
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize(
    ("colours", "least"),
    [
        (PHASES, 7.0),  # pale areas side by side, with an outline
        (plot_scene.COLOURS, 10.0),
        (plot_scene.COLOURS[:3], 40.0),  # matrix, inclusion, interface
        (stability_plot.COLOURS, 15.0),
        ((INK, ACCENT, FAINT, "white"), 35.0),  # lines on paper
        ((INK, ACCENT, plot_ensemble.SAMPLE, plot_ensemble.SHADE), 17.0),
        ((INK, ACCENT, BAND), 40.0),
        (particles_per_cell.COLOURS, 25.0),
    ],
)
def test_colours_differ(colours, least, vision):
    seen = lab(colours, vision)
    apart = np.linalg.norm(seen[:, None] - seen, axis=2)
    assert apart[~np.eye(len(colours), dtype=bool)].min() > least


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize(
    "colours",
    [opening_colours(), opening_colours(PHASES[0]), FIELDS["stress"].colours(), shades("viridis", 0.0, 1.0), shades("inferno_r", 0.2, 0.95)],
    ids=lambda colours: colours.name,
)
def test_maps_go_from_light_to_dark(colours, vision):
    lightness = lab(colours(np.linspace(0, 1, 65))[:, :3], vision)[:, 0]
    steps = np.diff(lightness)
    assert abs(lightness[-1] - lightness[0]) > 35 and ((steps < 0).all() or (steps > 0).all())


def test_text_stays_text(tmp_path):
    with plot_style.styled_figure() as figure:
        figure.text(0.5, 0.5, "opening [mm]")
        plot_style.save(figure, tmp_path / "a.pdf")
        plot_style.save(figure, tmp_path / "a.svg")
    assert "opening [mm]</text>" in (tmp_path / "a.svg").read_text()
    written = (tmp_path / "a.pdf").read_bytes()
    assert b"/FontFile2" in written and b"/Type3" not in written  # the font itself is inside, as TrueType
