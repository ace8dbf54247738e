"""Descriptive statistics, histogram and probability plot against scipy and known answers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from core.errors import NotEnoughDataError, ParameterError
from core.imu.statistics import describe, histogram, probability_plot


def test_known_answer() -> None:
    found = describe([1.0, 2.0, 3.0, 4.0, 10.0])
    assert (found.minimum, found.quartile_1, found.median, found.quartile_3, found.maximum) == (1, 2, 3, 4, 10)
    assert (found.count, found.left_out, found.range) == (5, 0, 9)
    assert found.mean == 4
    assert found.sd == pytest.approx(np.sqrt(12.5))
    assert found.skewness == pytest.approx(36 / 10**1.5)  # m3 = (-27 - 8 - 1 + 0 + 216) / 5
    assert found.kurtosis == pytest.approx(278.8 / 100)  # m4 = (81 + 16 + 1 + 0 + 1296) / 5


@settings(max_examples=40, deadline=None)
@given(arrays(np.float64, st.integers(3, 200), elements=st.floats(-1e3, 1e3)))
def test_agrees_with_scipy(values: np.ndarray) -> None:
    found = describe(values)
    assert found.mean == pytest.approx(values.mean(), abs=1e-9)
    assert found.sd == pytest.approx(values.std(ddof=1), rel=1e-9, abs=1e-9)
    quartiles = np.quantile(values, (0.25, 0.5, 0.75))
    assert (found.quartile_1, found.median, found.quartile_3) == pytest.approx(quartiles, abs=1e-9)
    if np.ptp(values) > 1e-3:
        assert found.skewness == pytest.approx(stats.skew(values), rel=1e-6, abs=1e-6)
        assert found.kurtosis == pytest.approx(stats.kurtosis(values, fisher=False), rel=1e-6)


def test_readings_that_are_not_finite_are_counted() -> None:
    found = describe([1.0, np.nan, 2.0, np.inf, 3.0])
    assert (found.count, found.left_out, found.median) == (3, 2, 2.0)


def test_equal_readings_have_no_shape() -> None:
    found = describe(np.full(9, 0.1))
    assert found.sd == pytest.approx(0.0, abs=1e-15)
    assert found.range == 0
    assert np.isnan(found.skewness)
    assert np.isnan(found.kurtosis)
    with pytest.raises(NotEnoughDataError, match="no spread"):
        histogram(np.full(9, 0.1))
    with pytest.raises(NotEnoughDataError, match="no spread"):
        probability_plot(np.full(9, 0.1))


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 3000), st.sampled_from([0.0, 0.25, 1e-4]), st.sampled_from([None, 7, 40]), st.integers(0, 9))
def test_every_reading_is_in_one_bin(n: int, quantum: float, bins: int | None, seed: int) -> None:
    values = np.random.default_rng(seed).standard_normal(n)
    values = np.round(values / quantum) * quantum if quantum else values
    values[0] += 5.0
    found = histogram(values, bins)
    assert found.counts.sum() == n
    assert len(found.counts) == len(found.gaussian) == len(found.edges) - 1
    assert (np.diff(found.edges) > 0).all()
    assert found.edges[0] <= values.min() <= values.max() <= found.edges[-1]


def test_gaussian_readings_fill_their_bins_also_where_they_are_rounded() -> None:
    values = -52 + 11 * np.random.default_rng(0).standard_normal(200_000)
    for given_values in (values, np.round(values)):
        found = histogram(given_values)
        full = found.gaussian > 50
        chi2 = np.sum((found.counts - found.gaussian)[full] ** 2 / found.gaussian[full])
        assert chi2 < full.sum() + 5 * np.sqrt(2 * full.sum())
    even = histogram(values, 30)
    assert len(even.counts) == 30
    np.testing.assert_array_equal(even.counts, np.histogram(values, 30)[0])


def test_probability_plot_is_scipys() -> None:
    values = np.random.default_rng(1).gamma(3.0, size=300)
    (quantiles, ordered), (slope, intercept, r) = stats.probplot(values)
    whole = probability_plot(values)
    np.testing.assert_allclose(whole.quantiles, quantiles)
    np.testing.assert_allclose(whole.ordered, ordered)
    assert (whole.slope, whole.intercept, whole.correlation) == pytest.approx((slope, intercept, r))
    few = probability_plot(values, 40)
    assert len(few.quantiles) <= 40
    assert (few.ordered[0], few.ordered[-1]) == (values.min(), values.max())
    assert (few.slope, few.correlation) == (whole.slope, whole.correlation)


def test_refusals_name_what_is_wrong() -> None:
    with pytest.raises(NotEnoughDataError, match="too few"):
        describe([1.0, np.nan])
    with pytest.raises(ParameterError, match="shape"):
        describe(np.ones((2, 2)))
    with pytest.raises(ParameterError, match="bins is 0"):
        histogram([1.0, 2.0], 0)
    with pytest.raises(ParameterError, match="points is 3"):
        probability_plot([1.0, 2.0, 3.0], 3)
