"""Random fields of strength: distribution, correlation, the same on every grid."""

import numpy as np
import pytest
from scipy import stats
from scipy.special import gamma

from jaxmpm.mesostructure.scatter import gaussian_field, strength_factor, weibull
from jaxmpm.mesostructure.tables import Scatter


def field(length, modulus=8.0, seed=0, cells=150, cell=1.0, name="mortar"):
    line = (np.arange(cells) + 0.5) * cell
    return strength_factor(Scatter(modulus=modulus, length=length, seed=seed), name, line, line)


@pytest.mark.parametrize("modulus", [1.0, 4.0, 12.0])
def test_weibulls_distribution_of_mean_1(modulus):
    values = field(0.0, modulus).reshape(-1)
    assert stats.kstest(values, stats.weibull_min(modulus, scale=1 / gamma(1 + 1 / modulus)).cdf).pvalue > 0.01
    variation = np.sqrt(gamma(1 + 2 / modulus) / gamma(1 + 1 / modulus) ** 2 - 1)
    assert values.mean() == pytest.approx(1.0, abs=4 * variation / 150)
    assert values.std() == pytest.approx(variation, rel=0.05)


def test_a_correlated_field_has_the_same_distribution():
    # places many lengths apart are as good as independent
    values = np.concatenate([field(0.5, 6.0, seed, cells=60, cell=3.0).reshape(-1) for seed in range(4)])
    assert stats.kstest(values, stats.weibull_min(6.0, scale=1 / gamma(1 + 1 / 6)).cdf).pvalue > 0.01
    assert values.mean() == pytest.approx(1.0, abs=0.01)


def test_the_correlation_falls_to_1_over_e_at_the_length():
    line = np.arange(120) * 0.5
    fields = np.stack([gaussian_field(np.random.default_rng(k), 2.0, line, line) for k in range(12)])
    assert (fields**2).mean() == pytest.approx(1.0, abs=0.05)
    for steps in (0, 2, 4, 6):
        expected = np.exp(-((steps * 0.5 / 2.0) ** 2))
        along_x = (fields[:, : 120 - steps] * fields[:, steps:]).mean()
        along_y = (fields[:, :, : 120 - steps] * fields[:, :, steps:]).mean()
        assert [along_x, along_y] == pytest.approx([expected, expected], abs=0.05)
    diagonal = (fields[:, :-2, :-2] * fields[:, 2:, 2:]).mean()  # √2 mm
    assert diagonal == pytest.approx(np.exp(-0.5), abs=0.05)


def test_a_finer_grid_samples_the_same_field():
    coarse, fine = field(2.0, cells=20, cell=0.6), field(2.0, cells=60, cell=0.2)
    assert fine[1::3, 1::3] == pytest.approx(coarse, rel=1e-9)


def test_seeds_and_names():
    assert (field(2.0) == field(2.0)).all() and (field(0.0) == field(0.0)).all()
    assert (field(2.0) != field(2.0, seed=1)).any()
    assert abs(np.corrcoef(field(0.0).reshape(-1), field(0.0, name="stone").reshape(-1))[0, 1]) < 0.03


def test_far_out_in_the_tails():
    assert np.isfinite(weibull(np.array([-8.0, 8.0]), 2.0)).all() and (weibull(np.array([-8.0]), 2.0) > 0).all()
