"""Allan and Hadamard deviation, overlapping, with confidence from the equivalent degrees of freedom of the noise type.

For a rate y sampled every tau0 with running integral x, the overlapping Allan variance at tau = m tau0 is

    avar(tau) = 1 / (2 tau^2 (n - 2m)) * sum_i (x[i+2m] - 2 x[i+m] + x[i])^2

(IEEE Std 952-1997 annex C; Riley, NIST SP 1065, eq. 11; Hadamard eq. 22). Densities: an angle random walk N
[rad/s/sqrt(Hz)] is the two-sided density; a data sheet's one-sided figure is sqrt(2) times larger.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Literal

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError, ParameterError
from core.imu.grid import Record, to_grid

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Kind = Literal["allan", "hadamard"]

BLOCK = 4096  # samples of x that stay in the first-level cache while all factors pass over them
GRID = 2_000  # terms of a sum over lags
LEAST_COVERAGE = 0.9  # of what the record holds on average; a cluster with less is left out


@dataclass(frozen=True)
class AllanCurve:
    """Deviation over averaging time.

    tau (k,) [s]; deviation (k,) in the reading's unit; lo, hi (k,) its confidence interval; pairs (k,) how many
    differences entered; edf (k,) equivalent degrees of freedom; alpha (k,) noise type as the exponent of the rate's
    spectrum (2 quantisation, 0 white, -1 flicker, -2 random walk).
    """

    kind: Kind
    tau0: float
    tau: Floats
    deviation: Floats
    lo: Floats
    hi: Floats
    pairs: Ints
    edf: Floats
    alpha: Ints
    duration: float
    notes: tuple[str, ...] = ()


def default_factors(n: int, order: int, count: int = 60) -> Ints:
    """At most `count` averaging factors, evenly spaced in log, from 1 to a third (Hadamard: quarter) of the record."""
    top = max(1, n // (order + 1))
    return np.unique(np.round(np.geomspace(1, top, count)).astype(np.int64))


def allan(
    t: Floats,
    values: npt.NDArray[np.floating],
    *,
    taus: Floats | None = None,
    kind: Kind = "allan",
    confidence: float = 0.683,
) -> AllanCurve:
    """Overlapping Allan (or Hadamard) deviation of readings `values` (n,) with stamps `t` (n,) [s].

    Gaps and jitter are handled (`core.imu.grid`). `taus` [s] are rounded to multiples of the step; those the record
    is too short for are left out with a note. Raises NotEnoughDataError where none is left or all readings are equal.
    """
    return allan_of(to_grid(t, values), taus=taus, kind=kind, confidence=confidence)


def allan_of(
    record: Record, *, taus: Floats | None = None, kind: Kind = "allan", confidence: float = 0.683
) -> AllanCurve:
    """As `allan`, of a record already on its grid."""
    if kind not in ("allan", "hadamard"):
        raise ParameterError(f"kind is {kind!r}, expected 'allan' or 'hadamard'", parameter="kind")
    order = 2 if kind == "allan" else 3
    if np.ptp(record.values) == 0:
        raise NotEnoughDataError(f"all {len(record.values)} readings are equal: there is no noise to describe")
    places = len(record.values) + record.lost
    factors, notes = _factors(record, taus, order, places)
    if record.place is None:
        sums, pairs = _complete(record, factors, order)
    else:
        sums, pairs = _thinned(record, factors, order)
    kept = pairs > 0
    if not kept.all():
        notes.append(f"{int((~kept).sum())} averaging times are left out: no stretch without gaps is long enough")
    if not kept.any():
        raise NotEnoughDataError("gaps leave no stretch that is long enough for any averaging time")
    factors, sums, pairs = factors[kept], sums[kept], pairs[kept]
    variance = np.asarray(sums / (pairs * (2.0 if order == 2 else 6.0)), dtype=np.float64)
    tau = np.asarray(factors * record.tau0, dtype=np.float64)
    alpha = noise_type(tau, variance, record.duration)
    edf = np.array(
        [degrees_of_freedom(int(a), int(m), int(p), order) for a, m, p in zip(alpha, factors, pairs, strict=True)]
    )
    lo, hi = _interval(np.sqrt(variance), edf, confidence)
    return AllanCurve(
        kind,
        record.tau0,
        tau,
        np.sqrt(variance),
        lo,
        hi,
        pairs,
        edf,
        alpha,
        record.duration,
        record.notes + tuple(notes),
    )


def _factors(record: Record, taus: Floats | None, order: int, places: int) -> tuple[npt.NDArray[np.int64], list[str]]:
    if taus is None:
        return default_factors(places, order), []
    wanted = np.unique(np.maximum(1, np.round(np.asarray(taus, float) / record.tau0)).astype(np.int64))
    if not len(wanted) or not np.isfinite(np.asarray(taus, float)).all():
        raise ParameterError("taus must be finite and at least one", parameter="taus")
    fits = wanted[wanted * order < places]
    if not len(fits):
        raise NotEnoughDataError(
            f"the record of {record.duration:.4g} s is too short for any of the averaging times: the shortest, "
            f"{wanted[0] * record.tau0:.4g} s, needs more than {order} times itself"
        )
    dropped = len(wanted) - len(fits)
    return fits, [f"{dropped} averaging times are too long for a record of {record.duration:.4g} s"] if dropped else []


def _complete(record: Record, factors: npt.NDArray[np.int64], order: int) -> tuple[Floats, Ints]:
    """Sums over a record without missing samples: from its running integral, the mean taken out to keep digits."""
    from core.imu import _allan_numba as kernel

    n = len(record.values)
    phase = kernel.integral(record.values, float(record.values.mean()))
    run = kernel.sums_allan if order == 2 else kernel.sums_hadamard
    sums = run(phase, factors, BLOCK)
    return sums / factors.astype(float) ** 2, n + 1 - order * factors


def _thinned(record: Record, factors: npt.NDArray[np.int64], order: int) -> tuple[Floats, Ints]:
    """Sums over a record with empty places: means over what is present."""
    from core.imu import _allan_numba as kernel

    assert record.place is not None
    places = len(record.values) + record.lost
    total, count = np.zeros(places + 1), np.zeros(places + 1, np.int64)
    total[record.place + 1] = record.values - record.values.mean()
    count[record.place + 1] = 1
    np.cumsum(total, out=total)
    np.cumsum(count, out=count)
    least = LEAST_COVERAGE * len(record.values) / places
    sums, pairs = kernel.sums_with_gaps(total, count, factors, order, least)
    return sums, pairs


def noise_type(tau: Floats, variance: Floats, duration: float) -> Ints:
    """The spectrum's exponent at each tau, by the local slope of the variance over a factor of about four in tau.

    Beyond a thirtieth of the record the slope is mostly chance: the last sound type is kept. Quantisation shows at
    the short end or nowhere.
    """
    if len(tau) < 3:
        return np.zeros(len(tau), np.int64)
    x, y = np.log(tau), np.log(np.maximum(variance, 1e-300))
    reach = max(np.log(2.1), float(np.diff(x).max()) * 1.01)
    slope = np.array([np.polyfit(x[near], y[near], 1)[0] for near in np.abs(x[:, None] - x) <= reach])
    # Slopes of the variance: -2 quantisation, -1 white, 0 flicker, +1 random walk.
    alpha = np.choose(np.clip(np.round(slope), -2, 1).astype(np.int64) + 2, [2, 0, -1, -2])
    start = int(np.argmax(alpha != 2)) if (alpha != 2).any() else len(alpha)
    alpha[start:] = np.minimum(alpha[start:], 0)
    sound = np.flatnonzero(tau <= duration / 30)
    if len(sound) and sound[-1] + 1 < len(alpha):
        alpha[sound[-1] + 1 :] = min(alpha[sound[-1]], 0)
    return np.asarray(alpha, np.int64)


def degrees_of_freedom(alpha: int, m: int, pairs: int, order: int) -> float:
    """Equivalent degrees of freedom of the overlapping estimate: exact second moments of power-law noise.

    With R(k) the autocovariance of the differences, edf = M R(0)^2 / sum_k (1 - |k|/M) R(k)^2 (Greenhall & Riley,
    PTTI 2003, eq. 6 to 9). Longer sums than GRID are taken on that many grid points.
    """
    if pairs < 2:
        return 1.0
    j = np.arange(-order, order + 1)
    weight = np.array([(-1.0) ** abs(i) * comb(2 * order, order + i) for i in j])
    if alpha == 2:  # white phase: R lives on multiples of m
        lags = np.abs(j) * m
        r = weight
        inside = lags < pairs
        return float(pairs * weight[order] ** 2 / np.sum((1 - lags[inside] / pairs) * r[inside] ** 2))
    reach = min(pairs - 1, 40 * m)
    k = np.arange(reach + 1.0) if reach <= GRID else np.linspace(0.0, reach, GRID + 1)
    step = 1.0 if reach <= GRID else reach / GRID
    r = (weight[:, None] * _structure(alpha, (k[None, :] + j[:, None] * m) / m)).sum(axis=0)
    terms = (1 - k / pairs) * r**2
    total = step * (2 * terms.sum() - terms[0]) if step == 1.0 else 2 * float(np.trapezoid(terms, dx=step))
    return max(1.0, float(pairs * r[0] ** 2 / total))


def _structure(alpha: int, u: Floats) -> Floats:
    """Generalised autocovariance of the integral x of power-law rate noise, up to a factor (Greenhall & Riley, eq.
    4)."""
    a = np.abs(u)
    if alpha == 0:
        return -a
    if alpha == -1:
        return np.where(a > 0, a**2 * np.log(np.maximum(a, 1e-300)), 0.0)
    return a**3


def _interval(deviation: Floats, edf: Floats, confidence: float) -> tuple[Floats, Floats]:
    """Chi-square interval of the deviation at the given confidence."""
    from scipy.stats import chi2

    if not 0 < confidence < 1:
        raise ParameterError(f"confidence is {confidence}, expected between 0 and 1", parameter="confidence")
    tail = (1 - confidence) / 2
    return deviation * np.sqrt(edf / chi2.ppf(1 - tail, edf)), deviation * np.sqrt(edf / chi2.ppf(tail, edf))
