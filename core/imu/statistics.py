"""Descriptive statistics of a stretch of readings, its histogram and its normal probability plot (Cechowicz 2017,
Tab. 2, Fig. 3 and 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError, ParameterError

Floats = npt.NDArray[np.float64]

MOST_BINS = 1000
SAMPLE = 100_000  # readings that a quantum is looked for in


@dataclass(frozen=True)
class Description:
    """What Tab. 2 lists, in the readings' unit u.

    Quartiles interpolate linearly between the ordered readings (R's type 7); sd divides by n - 1. skewness m3/m2^1.5
    and kurtosis m4/m2^2 are of the central moments over n: 0 and 3 for a Gaussian (not the excess). NaN where all
    readings are equal. count: readings that are finite; left_out: those that are not.
    """

    count: int
    left_out: int
    minimum: float
    quartile_1: float
    median: float
    quartile_3: float
    maximum: float
    mean: float
    sd: float
    skewness: float
    kurtosis: float

    @property
    def range(self) -> float:
        """Maximum less minimum [u], the paper's Rx."""
        return self.maximum - self.minimum


@dataclass(frozen=True)
class Histogram:
    """edges (m + 1,) [u]; counts (m,); gaussian (m,), the counts expected of a Gaussian of the readings' mean and
    sd."""

    edges: Floats
    counts: npt.NDArray[np.int64]
    gaussian: Floats


@dataclass(frozen=True)
class ProbabilityPlot:
    """quantiles (k,), of the standard Gaussian; ordered (k,) [u], the readings there; slope [u], intercept [u] and
    correlation r of the straight line through all readings (as scipy.stats.probplot)."""

    quantiles: Floats
    ordered: Floats
    slope: float
    intercept: float
    correlation: float


def describe(values: npt.ArrayLike) -> Description:
    """Statistics of readings (n,); those not finite are left out. Raises NotEnoughDataError under two readings."""
    from core.imu._segments_numba import describe as table

    finite, left_out = _finite(values, 2)
    row = table(finite, np.array([0, len(finite)], np.int64))[0]
    return Description(len(finite), left_out, *(float(value) for value in row))


def histogram(values: npt.ArrayLike, bins: int | None = None) -> Histogram:
    """Counts of readings (n,) in equal bins from the least to the greatest.

    Without `bins`: of Freedman and Diaconis' width. Readings that a converter has rounded lie on a lattice; there
    each bin holds the same number of its steps, lest bins differ by what they happen to hold: `bins` is then a wish.
    Raises NotEnoughDataError under two readings or where all are equal, ParameterError for bins outside 1 to
    MOST_BINS.
    """
    if bins is not None and not 1 <= bins <= MOST_BINS:
        raise ParameterError(
            f"bins is {bins}, expected 1 to {MOST_BINS}", parameter="bins", found=bins, expected=f"1 to {MOST_BINS}"
        )
    finite, _ = _finite(values, 2)
    least, most = float(finite.min()), float(finite.max())
    if least == most:
        raise NotEnoughDataError(f"all {len(finite)} readings are {least:g}: there is no spread to draw")
    width = (most - least) / bins if bins else _width(finite, most - least)
    quantum = _quantum(finite)
    if quantum:
        width = max(1.0, np.ceil(width / quantum - 1e-6)) * quantum
        least, most = least - quantum / 2, most + quantum / 2
    count = max(1, int(np.ceil((most - least) / width - 1e-6)))
    even = least + width * np.arange(count + 1)
    edges = np.asarray(even if quantum or not bins else np.linspace(least, most, count + 1), np.float64)
    edges[-1] = max(edges[-1], most)
    counts = np.histogram(finite, edges)[0].astype(np.int64)
    return Histogram(edges, counts, _expected(edges, finite))


def probability_plot(values: npt.ArrayLike, points: int = 500) -> ProbabilityPlot:
    """Ordered readings (n,) against the quantiles that a Gaussian would have (Filliben's medians), at most `points`
    of them: the ends in full, the middle thinned evenly in quantile. Raises NotEnoughDataError under three readings
    or where all are equal, ParameterError under ten points."""
    from scipy.special import ndtri

    if points < 10:
        raise ParameterError(f"points is {points}, expected at least 10", parameter="points", found=points)
    finite, _ = _finite(values, 3)
    ordered = np.sort(finite)
    n = len(ordered)
    if ordered[0] == ordered[-1]:
        raise NotEnoughDataError(f"all {n} readings are {ordered[0]:g}: there is no spread to draw")
    place = (np.arange(1, n + 1) - 0.3175) / (n + 0.365)
    place[-1] = 0.5 ** (1 / n)
    place[0] = 1 - place[-1]
    quantiles = ndtri(place)
    mean = float(ordered.mean())
    across = float(np.dot(quantiles, ordered - mean))
    slope = across / float(np.dot(quantiles, quantiles))
    correlation = across / np.sqrt(float(np.dot(quantiles, quantiles)) * float(np.sum((ordered - mean) ** 2)))
    kept = _thinned(quantiles, points)
    return ProbabilityPlot(quantiles[kept], ordered[kept], slope, mean, float(correlation))


def _finite(values: npt.ArrayLike, fewest: int) -> tuple[Floats, int]:
    given = np.asarray(values, np.float64)
    if given.ndim != 1:
        raise ParameterError(f"readings have shape {given.shape}; expected (n,)", found=list(given.shape))
    good = np.isfinite(given)
    finite = given if good.all() else given[good]
    if len(finite) < fewest:
        raise NotEnoughDataError(
            f"{len(finite)} finite readings are too few to describe: at least {fewest}",
            found=len(finite),
            expected=fewest,
        )
    return np.ascontiguousarray(finite), len(given) - len(finite)


def _width(values: Floats, span: float) -> float:
    """Freedman and Diaconis' bin width, of MOST_BINS at the finest."""
    low, high = np.quantile(values, (0.25, 0.75))
    width = 2 * (high - low) / len(values) ** (1 / 3)
    return float(max(width, span / MOST_BINS)) if width > 0 else span / max(1.0, np.sqrt(min(len(values), 400)))


def _quantum(values: Floats) -> float:
    """The converter's step, where all readings lie on a lattice; else 0."""
    levels = np.unique(values[:SAMPLE])
    if len(levels) < 3 or len(levels) > len(values[:SAMPLE]) / 4:
        return 0.0
    steps = np.diff(levels)
    step = float(steps[steps > 1e-9 * (levels[-1] - levels[0])].min())
    share = steps / step
    return step if bool((np.abs(share - np.round(share)) < 0.02 * np.maximum(share, 1)).all()) else 0.0


def _expected(edges: Floats, values: Floats) -> Floats:
    from scipy.special import ndtr

    return np.asarray(len(values) * np.diff(ndtr((edges - values.mean()) / values.std(ddof=1))), np.float64)


def _thinned(quantiles: Floats, points: int) -> npt.NDArray[np.int64]:
    """Which of the rising quantiles to keep: nearest to an even grid, each once."""
    n = len(quantiles)
    if n <= points:
        return np.arange(n)
    nearest = np.searchsorted(quantiles, np.linspace(quantiles[0], quantiles[-1], points))
    return np.unique(np.minimum(nearest, n - 1)).astype(np.int64)
