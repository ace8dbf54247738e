"""NIS judged: draws whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from core.metrics import check_innovations, running_nis


def draws(n: int, dof: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).chisquare(dof, n)


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_bands_hold_95_percent_of_what_an_honest_filter_gives(dof: int) -> None:
    nis = draws(40_000, dof, 10 + dof)
    found = running_nis(np.arange(40_000) * 0.1, nis, dof, windows=2000)
    low, high = found.band
    assert found.window == 20
    assert np.mean((found.mean >= low) & (found.mean <= high)) == pytest.approx(0.95, abs=0.015)
    inside = 0
    for seed in range(200):
        check = check_innovations(draws(200, dof, 1000 + seed), dof, np.ones(200, bool))
        assert check.mean is not None and check.band is not None
        inside += check.band[0] <= check.mean <= check.band[1]
    assert 180 <= inside <= 200  # 190 expected, sd 3


def test_running_means_leave_no_reading_out() -> None:
    nis = draws(1037, 2, 1)
    found = running_nis(np.arange(1037.0), nis, 2, windows=50)
    assert len(found.t) == 50
    sizes = np.diff(np.linspace(0, 1037, 51).astype(int))
    assert float(np.sum(found.mean * sizes)) == pytest.approx(float(nis.sum()))
    assert len(running_nis(np.zeros(0), np.zeros(0), 2).t) == 0
    assert running_nis(np.arange(3.0), np.ones(3), 2).mean.tolist() == [1.0]


@given(st.floats(0.02, 50), st.integers(1, 3), st.integers(0, 1000))
def test_a_wrong_r_is_advised_back_whatever_the_outliers(truth: float, dof: int, seed: int) -> None:
    nis = truth * draws(8000, dof, seed)
    nis[::25] *= 1e6  # 4 % outliers
    accepted = nis < 1e4
    advice = check_innovations(nis, dof, accepted).advice
    assert advice is not None
    assert advice.low < advice.factor < advice.high
    assert advice.factor == pytest.approx(truth, rel=0.25)
    assert advice.single
    assert advice.fits or not 0.9 < truth < 1.1


def test_no_single_r_fits_a_sensor_that_is_mostly_fine_and_often_far_off() -> None:
    nis = draws(2000, 1, 3) * np.where(np.arange(2000) % 4 == 0, 100.0, 0.5)
    advice = check_innovations(nis, 1, np.ones(2000, bool)).advice
    assert advice is not None and not advice.single and not advice.fits
    assert advice.factor < 1.5 and advice.wide > 4 * advice.factor


def test_the_interval_of_the_advice_is_honest() -> None:
    held = 0
    for seed in range(200):
        advice = check_innovations(0.1 * draws(300, 2, seed), 2, np.ones(300, bool)).advice
        assert advice is not None
        held += advice.low <= 0.1 <= advice.high
    assert 180 <= held <= 200


def test_white_innovations_pass_and_correlated_ones_do_not() -> None:
    rng = np.random.default_rng(5)
    p = []
    for _ in range(200):
        white = check_innovations(rng.standard_normal(500) ** 2, 1, np.ones(500, bool)).whiteness
        assert white is not None
        p.append(white.p_value)
    assert 0.01 <= np.mean(np.array(p) < 0.05) <= 0.10
    series = lfilter([np.sqrt(1 - 0.49)], [1, -0.7], rng.standard_normal(2000))
    check = check_innovations(series**2, 1, np.ones(2000, bool))
    white = check.whiteness
    assert white is not None and check.band is not None
    assert white.p_value < 1e-6
    assert 0.25 < white.autocorrelation[0] < 0.5  # NIS shows somewhat less than the square of 0.7
    assert white.effective < 1200
    independent = check_innovations(draws(2000, 1, 6), 1, np.ones(2000, bool)).band
    assert independent is not None and np.ptp(check.band) > np.ptp(independent)


def test_refused_readings_are_counted_and_few_are_not_judged() -> None:
    nis = draws(20, 3, 2)
    check = check_innovations(nis, 3, np.arange(20) >= 5)
    assert (check.readings, check.rejected, check.dof) == (20, 5, 3)
    assert check.mean == pytest.approx(float(nis[5:].mean()))
    assert check.whiteness is None and check.advice is None
    nothing = check_innovations(nis, 3, np.zeros(20, bool))
    assert nothing.mean is None and nothing.rejected == 20


def test_whiteness_is_told_by_signs_where_they_are_known() -> None:
    """A correlation of 0.3 hides in the squares (0.09), not in the signed innovations; white ones stay white."""
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((2001, 2))
    lasting = 0.95 * noise[1:] + 0.31 * noise[:-1]
    for score, white in ((noise[1:], True), (lasting, False)):
        check = check_innovations(np.sum(score**2, axis=1), 2, np.ones(2000, bool), score)
        found = check.whiteness
        assert found is not None and (found.p_value > 0.01) is white
        assert found.autocorrelation[0] == pytest.approx(0.0 if white else 0.295, abs=0.04)
