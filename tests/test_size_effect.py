"""The size effect: Bažant's law and its energy, and what bands and smeared cracks make of similar beams."""

import json
import math

import numpy as np
import pytest

from jaxmpm import cli_size, size_effect
from jaxmpm.laws.damage import Damage
from jaxmpm.laws.elastic import Elastic

HASTY = True  # see conftest.py


def test_a_fit_finds_bazants_law_and_the_energy_of_fracture_mechanics():
    depths = np.array([50.0, 100.0, 200.0, 400.0])
    found = size_effect.fit(depths, 2.6 / np.sqrt(1 + depths / 180.0))
    assert (found.plastic, found.transition) == pytest.approx((2.6, 180.0), rel=1e-6) and found.deviation < 1e-8
    # far above D₀ the beam breaks where K_I = σ_N sqrt(D) k reaches sqrt(E G_f)
    depth = 1e7
    K = found.at(depth) * math.sqrt(depth) * size_effect.intensity(size_effect.NOTCH)
    assert K**2 / size_effect.E == pytest.approx(found.energy, rel=1e-4)
    flat = size_effect.fit(depths, 2.0 * np.ones(4))
    assert flat.plastic == pytest.approx(2.0, rel=1e-3) and flat.energy == math.inf


def test_the_stress_intensity_for_a_span_of_four_is_that_of_the_standard():
    """ASTM E399, within half a per cent."""
    for a in (0.2, 0.35, 0.5, 0.65):
        f = 3 * math.sqrt(a) * (1.99 - a * (1 - a) * (2.15 - 3.93 * a + 2.7 * a**2)) / (2 * (1 + 2 * a) * (1 - a) ** 1.5)
        assert size_effect.intensity(a, 4.0) == pytest.approx(f / 1.5, rel=6e-3)


def test_smeared_laws_dissipate_the_fracture_energy_in_the_cell_they_were_fitted_to_only():
    energy = lambda band: float(Damage(*(band[name] for name in ("ft", "Ep", "n", "h"))).fracture_energy(Elastic(size_effect.E, size_effect.NU)))  # noqa: E731
    assert energy(size_effect.smeared(5.0)) == pytest.approx(energy(size_effect.DAMAGE), rel=1e-6)
    assert energy(size_effect.smeared(40.0, fitted_to=5.0)) == pytest.approx(8 * energy(size_effect.DAMAGE), rel=1e-6)


def test_bands_follow_the_size_of_the_beam_and_smeared_cracks_of_one_law_do_not():
    sizes = (50.0, 400.0)
    band, _, _, fixed = size_effect.series(sizes, rows=10)
    rows = list(size_effect.measure([band, fixed]))
    small, large, first, last = (row["strength"] for row in rows)
    assert last == pytest.approx(first, rel=1e-3)  # similar grids and no length in the law: no size effect
    assert 1 / math.sqrt(8) < large / small < 0.8  # between that of fracture mechanics and none
    assert small == pytest.approx(first, rel=0.02)  # on the cells that it was fitted to the smeared one is right as well


def test_the_command_writes_what_it_has_measured_and_draws_both_asymptotes(tmp_path, monkeypatch, capsys, figures):
    from jaxmpm import cli

    resumed = False

    def measure(many, known):
        assert bool(known) == resumed and all(row["strength"] > 0 for row in known)
        for one in many:
            for depth, rows in one.beams:
                strength = 2.0 if "smeared, as" in one.name else 2.6 / math.sqrt(1 + depth / 180.0)
                yield {"law": one.name, "depth": depth, "rows": rows, "cell": depth / rows, "strength": strength, "seconds": 0.1}

    size_effect_measure = size_effect.measure
    monkeypatch.setattr(size_effect, "measure", measure)
    assert cli.main(["size-effect", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "band, other cells" in out and "180" in out and "inf" in out
    found = json.loads((tmp_path / "size_effect.json").read_text())["fits"]
    assert found["band"]["transition"] == pytest.approx(180.0, rel=1e-5) and found["smeared, as for 1.09 mm"]["energy"] is None
    assert len((tmp_path / "size_effect.csv").read_text().splitlines()) == 1 + 4 * 5 + 4 + 4
    main, beside = figures[0].axes
    slopes = {tuple(np.round(np.diff(np.log(line.get_ydata()[[0, -1]])) / np.diff(np.log(line.get_xdata()[[0, -1]])), 3)) for line in main.lines if len(line.get_xdata()) == 200}
    assert (-0.5,) in slopes and (0.0,) in slopes  # of fracture mechanics; of the smeared law
    assert main.get_xscale() == main.get_yscale() == "log" and len(beside.lines) == 1
    resumed = True
    assert cli.main(["size-effect", "--out", str(tmp_path), "--resume"]) == 0
    (row,) = size_effect_measure([size_effect.Series("band", None, [(50.0, 46)])], cli_size.kept(tmp_path / "size_effect.csv"))
    assert row["strength"] == pytest.approx(2.6 / math.sqrt(1 + 50 / 180.0))  # taken over, not run
    (tmp_path / "size_effect.csv").write_text("law,depth\nband,50\n")
    assert cli.main(["size-effect", "--out", str(tmp_path), "--resume"]) == cli.BAD_INPUT
