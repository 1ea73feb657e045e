"""Sizes drawn from a curve follow it, fill the area, and depend on the seed alone."""

import numpy as np
import pytest

from jaxmpm.mesostructure.grading import draw_sizes, measured
from jaxmpm.mesostructure.tables import Fuller, Sieve

FULLER = Fuller(kind="fuller", smallest=1.0, largest=16.0)
STEEP = Fuller(kind="fuller", smallest=2.0, largest=8.0, exponent=1.4)
SIEVE = Sieve(kind="sieve", size=[1.0, 2.0, 4.0, 8.0], passing=[0.0, 0.5, 0.5, 1.0])
CURVES = [FULLER, STEEP, SIEVE]


def drawn(grading, area=1e4, seed=0):
    return draw_sizes(grading, area, np.random.default_rng(seed))


@pytest.mark.parametrize("grading", CURVES)
@pytest.mark.parametrize("seed", range(4))
def test_the_curve_that_was_drawn_is_the_one_asked_for(grading, seed):
    area = 2e4
    sizes, share = measured(drawn(grading, area, seed))
    # never off by more than about the share of one inclusion of that size
    assert (np.abs(share - grading.share_below(sizes)) < 1.6 * np.pi / 4 * sizes**2 / area + 1e-3).all()


@pytest.mark.parametrize("grading", CURVES)
def test_the_area_is_met_exactly_and_sizes_stay_in_range(grading):
    sizes = drawn(grading)
    assert np.pi / 4 * (sizes**2).sum() == pytest.approx(1e4, rel=1e-12)
    assert (np.diff(sizes) <= 0).all()
    assert sizes[-1] > 0.99 * grading.smallest and sizes[0] < 1.01 * grading.largest


def test_no_size_where_the_curve_is_flat():
    sizes = drawn(SIEVE)
    assert not ((sizes > 2.02) & (sizes < 3.96)).any()


def test_fullers_curve_and_its_inverse():
    assert FULLER.share_below(4.0) == pytest.approx((2 - 1) / (4 - 1))  # square roots of 4, 1 and 16
    size = np.linspace(1.0, 16.0, 7)
    assert FULLER.size_at(FULLER.share_below(size)) == pytest.approx(size)
    one = Fuller(kind="fuller", smallest=3.0, largest=3.0)
    assert (np.abs(drawn(one) - 3.0) < 0.01).all()


def test_seeds():
    assert (drawn(FULLER) == drawn(FULLER)).all()
    assert len(drawn(FULLER)) != len(drawn(FULLER, seed=1)) or (drawn(FULLER) != drawn(FULLER, seed=1)).any()
