"""Does a filter expect its sensors to be as noisy as they are? Running NIS, whiteness, and what R should be.

NIS (normalised innovation squared) is chi-square with the reading's degrees of freedom where the filter is right, and
one tells nothing of the next. Sources: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications", 2001, section 5.4;
Ljung, Box, Biometrika 65(2), 1978; van der Waerden 1952 (normal scores).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from core.metrics.consistency import chi2_band

Array = npt.NDArray[np.float64]

LAGS = 30
FEWEST = 30  # readings, below which nothing is said of whiteness or noise
SHORTEST = 10  # readings of a running mean's window
NORMAL_95 = 1.959964
WIDE = 0.9  # quantile of NIS that tells of its tail, as the median does of its bulk
APART = 4.0  # factor between what the two call for, beyond which no single R fits


@dataclass(frozen=True)
class Running:
    """Means of NIS over consecutive windows of `window` readings (or one more): t (W,) [s] of their middles, mean (W,).

    `band` holds 95 % of them where the filter is right.
    """

    t: Array
    mean: Array
    window: int
    band: tuple[float, float]


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation (L,) at lags 1 to L; white: 95 % of them within +-`limit`. Ljung-Box statistic and its p-value.

    `effective`: how many independent readings the record is worth.
    """

    autocorrelation: Array
    limit: float
    statistic: float
    p_value: float
    effective: float


@dataclass(frozen=True)
class NoiseAdvice:
    """R should be about `factor` times what it is, with its 95 % interval. `fits`: no change is called for.

    `factor` is what half of the readings call for, `wide` what the widest tenth does: where the two are far apart, no
    single R fits (`single`).
    """

    factor: float
    low: float
    high: float
    wide: float

    @property
    def fits(self) -> bool:
        """Whether the interval holds 1, or the factor is too near to it to matter."""
        return self.single and (self.low <= 1.0 <= self.high or 0.8 <= self.factor <= 1.25)

    @property
    def single(self) -> bool:
        """Whether the readings are spread as one Gaussian would spread them, whatever its size."""
        return self.factor > 0 and 1 / APART < self.wide / self.factor < APART


@dataclass(frozen=True)
class InnovationCheck:
    """One sensor: its readings and how many of them were refused, the mean NIS of the accepted and its 95 % band.

    `whiteness` and `advice` are None for fewer than FEWEST readings.
    """

    dof: int
    readings: int
    rejected: int
    mean: float | None
    band: tuple[float, float] | None
    whiteness: Whiteness | None
    advice: NoiseAdvice | None


def check_innovations(
    nis: Array, dof: int, accepted: npt.NDArray[np.bool_], score: Array | None = None
) -> InnovationCheck:
    """Everything said of one sensor over a whole run, from its NIS and acceptance (M,); whiteness by the signed
    innovations `score` (M, k) where they are given.

    The mean is over accepted readings; its band counts as many readings as these are worth, correlated as they are.
    """
    known = np.isfinite(nis)
    values, good = nis[known], accepted[known]
    taken = values[good]
    white = whiteness(values) if values.size >= FEWEST else None
    effective = max(1, round(white.effective * taken.size / values.size)) if white else taken.size
    advice = noise_advice(values, dof, white.effective) if white else None
    if white and score is not None:
        white = replace(_white_together(score[known]), effective=white.effective)
    return InnovationCheck(
        dof=dof,
        readings=int(values.size),
        rejected=int(values.size - taken.size),
        mean=float(taken.mean()) if taken.size else None,
        band=chi2_band(dof, int(effective)) if taken.size else None,
        whiteness=white,
        advice=advice,
    )


def running_nis(t: Array, nis: Array, dof: int, windows: int = 200) -> Running:
    """Running mean of NIS (M,) at t (M,) in at most `windows` windows of SHORTEST readings or more, none left out."""
    n = len(nis)
    count = max(1, min(windows, n // SHORTEST))
    if n == 0:
        return Running(np.zeros(0), np.zeros(0), 0, chi2_band(dof))
    edges = np.linspace(0, n, count + 1).astype(np.intp)
    sizes = np.diff(edges)
    mean = np.add.reduceat(np.asarray(nis, np.float64), edges[:-1]) / sizes
    middle = (t[edges[:-1]] + t[edges[1:] - 1]) / 2
    window = int(sizes.min())
    return Running(np.asarray(middle, np.float64), mean, window, chi2_band(dof, window))


def whiteness(values: Array, lags: int = LAGS) -> Whiteness:
    """Is one reading's value independent of the next? By normal scores of ranks: outliers and a wrong R don't count.

    Of NIS, which has no sign, a correlation rho of the innovations shows as somewhat less than its square.
    """
    from scipy.special import ndtri
    from scipy.stats import chi2, rankdata

    n = len(values)
    score = ndtri(rankdata(values) / (n + 1))
    score -= score.mean()
    lags = min(lags, n // 5)
    power = float(score @ score)
    if power <= 0:  # all alike
        return Whiteness(np.zeros(lags), 2 / np.sqrt(n), 0.0, 1.0, float(n))
    r = np.array([score[k:] @ score[:-k] for k in range(1, lags + 1)]) / power
    statistic = n * (n + 2) * float(np.sum(r**2 / (n - np.arange(1, lags + 1))))
    limit = 2 / float(np.sqrt(n))
    small = np.flatnonzero(r < limit)
    clear = r[: small[0] if small.size else lags]
    return Whiteness(r, limit, statistic, float(chi2.sf(statistic, lags)), n / (1 + 2 * float(clear.sum())))


def _white_together(score: Array) -> Whiteness:
    """Of k signed innovations at once: their mean autocorrelation, their statistics as one."""
    from scipy.stats import chi2

    parts = [whiteness(column[np.isfinite(column)]) for column in score.T]
    lags = min(len(p.autocorrelation) for p in parts)
    r = np.mean([p.autocorrelation[:lags] for p in parts], axis=0)
    statistic = float(sum(p.statistic for p in parts))
    limit = float(np.mean([p.limit for p in parts])) / np.sqrt(len(parts))
    p_value = float(chi2.sf(statistic, sum(len(p.autocorrelation) for p in parts)))
    return Whiteness(r, limit, statistic, p_value, min(p.effective for p in parts))


def noise_advice(nis: Array, dof: int, effective: float | None = None) -> NoiseAdvice:
    """By how much to scale R: the median of NIS over that of chi-square, so that outliers don't count.

    The interval is the median's by order statistics, for `effective` independent readings. Exact where R makes up most
    of the innovation's covariance; else R has to change by more, in the same direction: estimate again and look.
    """
    from scipy.stats import chi2

    half = 0.5 * NORMAL_95 / np.sqrt(max(effective or len(nis), 1.0))
    shares = np.clip((0.5, 0.5 - half, 0.5 + half), 0.0, 1.0)
    factor, low, high = np.quantile(nis, shares) / float(chi2.median(dof))
    wide = float(np.quantile(nis, WIDE)) / float(chi2.ppf(WIDE, dof))
    return NoiseAdvice(float(factor), float(low), float(high), wide)
