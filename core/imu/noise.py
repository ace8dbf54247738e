"""Noise parameters out of an Allan curve: quantisation Q, angle random walk N, bias instability B, rate random walk K,
and a first-order Gauss-Markov process where the record shows one; each with its standard deviation.

Model (IEEE Std 952-1997, annex C):

    avar(tau) = 3 Q^2/tau^2 + N^2/tau + (2 ln2/pi) B^2 + K^2 tau/3
              + s^2 (2T/tau) (1 - T/(2 tau) (3 - 4 exp(-tau/T) + exp(-2 tau/T)))     Gauss-Markov of sd s and time T

The logarithms of the variances are fitted: their errors are those of log chi-square, whatever the size. Variances at
different tau share data; their correlation is the one that the fitted noise implies, from the integral of the squared
cross-spectrum of the two differences. That is what makes the deviations honest. A term enters only where leaving it
out costs too much chi-square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError
from core.imu.allan import AllanCurve

Floats = npt.NDArray[np.float64]

FLICKER = 2 * np.log(2) / np.pi  # avar of B: the floor is 0.664 B
COST_OF_TERM = 6.25  # chi-square that a term must save: 2.5 deviations
COST_OF_MARKOV = 14.0  # that a Gauss-Markov process must save, against the best model without one
POOR = 3.0  # chi-square by its degrees of freedom beyond which the model does not describe the curve
ORDER = ("Q", "N", "B", "K", "s")


@dataclass(frozen=True)
class Term:
    """One parameter: value and standard deviation; None for both where the record does not show it."""

    value: float | None = None
    sd: float | None = None


@dataclass(frozen=True)
class NoiseFit:
    """Fitted noise, SI of the reading's unit u: Q [u s], N [u sqrt(s)], B [u], K [u/sqrt(s)], markov_sd [u],
    markov_tau [s].

    For a gyro: N in rad/sqrt(s) = rad/s/sqrt(Hz), two-sided (a data sheet's one-sided density is sqrt(2) N), B in
    rad/s, K in rad/s/sqrt(s). model (k,) is the fitted deviation at the curve's tau.
    """

    Q: Term
    N: Term
    B: Term
    K: Term
    markov_sd: Term
    markov_tau: Term
    model: Floats
    chi2: float
    dof: int
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Data:
    """What is fitted: log variances at tau, their own variances, and what the covariance model needs."""

    tau: Floats
    log_variance: Floats
    own: Floats
    tau0: float
    duration: float


@dataclass(frozen=True)
class _Model:
    """A fitted set of terms: amplitudes p (by ORDER), the Gauss-Markov time, chi-square, covariance of (p, log T)."""

    terms: tuple[int, ...]
    p: Floats
    markov_tau: float
    chi2: float
    covariance: Floats


def fit_noise(curve: AllanCurve) -> NoiseFit:
    """Fit the model to an Allan curve. Raises NotEnoughDataError with fewer than four usable averaging times."""
    if curve.kind != "allan":
        raise NotEnoughDataError("noise is fitted to an Allan curve, not to a Hadamard curve")
    data = _data(curve)
    correlation = np.eye(len(data.tau))
    best = _select(data, correlation)
    for _ in range(2):
        correlation = _correlation(data, best)
        best = _select(data, correlation)
    markov = _with_markov(data, correlation, best)
    return _describe(curve, data, markov or best)


def _data(curve: AllanCurve) -> _Data:
    """About three taus an octave, up to a quarter of the record: closer ones say the same, longer ones little."""
    from scipy.special import digamma, polygamma

    chosen: list[int] = []
    for i in np.flatnonzero((curve.tau <= curve.duration / 4) & (curve.edf >= 2) & (curve.deviation > 0)):
        if not chosen or curve.tau[i] >= curve.tau[chosen[-1]] * 2 ** (1 / 3) * 0.999:
            chosen.append(int(i))
    if len(chosen) < 4:
        raise NotEnoughDataError(f"{len(chosen)} averaging times are too few to fit noise to; at least 4", expected=4)
    half = curve.edf[chosen] / 2
    bias = digamma(half) - np.log(half)  # mean of log(chi-square / edf)
    log_variance = 2 * np.log(curve.deviation[chosen]) - bias
    return _Data(curve.tau[chosen], log_variance, polygamma(1, half), curve.tau0, curve.duration)


def _basis(tau: Floats, markov_tau: float) -> Floats:
    """(k, 5) Allan variance of each term at unit amplitude, by ORDER."""
    markov = _markov(tau, markov_tau) if markov_tau > 0 else np.zeros_like(tau)
    return np.column_stack([3 / tau**2, 1 / tau, np.full_like(tau, FLICKER), tau / 3, markov])


def _markov(tau: Floats, time: float) -> Floats:
    """Allan variance of a unit Gauss-Markov process; by its series where the closed form loses its digits."""
    u = tau / time
    small = u < 1e-2
    safe = np.where(small, 1.0, u)
    full = 2 / safe * (1 - (3 - 4 * np.exp(-safe) + np.exp(-2 * safe)) / (2 * safe))
    return np.where(small, 2 * u * (1 / 3 - u / 4), full)


def _markov_slope(tau: Floats, time: float) -> Floats:
    """Its derivative by the logarithm of the time."""
    u = tau / time
    small = u < 1e-2
    safe = np.where(small, 1.0, u)
    one, two = np.exp(-safe), np.exp(-2 * safe)
    full = -2 / safe**2 - (4 * one - 2 * two) / safe**2 + 2 * (3 - 4 * one + two) / safe**3
    return -u * np.where(small, 2 / 3 - u, full)


def _fit(data: _Data, correlation: Floats, terms: Sequence[int], markov_tau: float = 0.0) -> _Model:
    """Least squares over the amplitudes of the terms (and log T where 4 is among them), logarithms inside."""
    from scipy.linalg import solve_triangular
    from scipy.optimize import least_squares

    terms = tuple(terms)
    root = np.sqrt(data.own)
    factor = np.linalg.cholesky((correlation + 0.01 * np.eye(len(root))) * np.outer(root, root))
    whiten = solve_triangular(factor, np.eye(len(root)), lower=True)
    timed = 4 in terms
    variance = np.exp(data.log_variance)
    # Start where each term alone would touch the data from below.
    start = np.log([np.sqrt(np.min(variance / _basis(data.tau, markov_tau or 1.0)[:, j])) for j in terms])
    first = np.append(start, np.log(markov_tau)) if timed else start

    def residual(q: Floats) -> Floats:
        basis = _basis(data.tau, float(np.exp(q[-1])) if timed else 0.0)[:, terms]
        model = basis @ np.exp(2 * q[: len(terms)])
        return np.asarray(whiten @ (np.log(model) - data.log_variance))

    def slopes(q: Floats) -> Floats:
        squares = np.exp(2 * q[: len(terms)])
        columns = 2 * _basis(data.tau, float(np.exp(q[-1])) if timed else 0.0)[:, terms] * squares
        model = columns.sum(axis=1, keepdims=True) / 2
        if timed:
            columns = np.column_stack([columns, _markov_slope(data.tau, float(np.exp(q[-1]))) * squares[-1]])
        return np.asarray(whiten @ (columns / model))

    low, high = first - 25.0, first + 12.0
    if timed:
        low[-1], high[-1] = np.log(2 * data.tau0), np.log(data.duration)
    found = least_squares(residual, first, slopes, bounds=(low, high), x_scale=1.0, max_nfev=200)
    p = np.zeros(5)
    p[list(terms)] = np.exp(found.x[: len(terms)])
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    return _Model(terms, p, float(np.exp(found.x[-1])) if timed else 0.0, float(2 * found.cost), covariance)


def _select(data: _Data, correlation: Floats, markov_tau: float = 0.0, terms: Sequence[int] = (0, 1, 2, 3)) -> _Model:
    """Backward elimination: drop the term whose absence costs least, while that is less than COST_OF_TERM. White noise,
    which every sensor has, goes only where no other term may."""
    best = _fit(data, correlation, terms, markov_tau)
    while len(best.terms) > 1:
        trials = [
            _fit(data, correlation, [j for j in best.terms if j != k], best.markov_tau) for k in best.terms if k != 4
        ]
        spared = [m for m in trials if 1 in m.terms and m.chi2 - best.chi2 <= COST_OF_TERM]
        cheapest = min(spared or trials, key=lambda m: m.chi2)
        if cheapest.chi2 - best.chi2 > COST_OF_TERM:
            break
        best = cheapest
    return best


def _with_markov(data: _Data, correlation: Floats, plain: _Model) -> _Model | None:
    """The best model with a Gauss-Markov process, if it saves enough chi-square and its time lies inside the record."""
    starts = np.geomspace(8 * data.tau0, data.duration / 8, 5)
    trials = [_fit(data, correlation, (1, 2, 3, 4), float(s)) for s in starts]
    start = min(trials, key=lambda m: m.chi2)
    if plain.chi2 - start.chi2 < COST_OF_MARKOV:
        return None
    # Its own correlation, then judge both by the same.
    own = _correlation(data, start)
    best = _select(data, own, start.markov_tau, (0, 1, 2, 3, 4))
    rival = _select(data, own)
    inside = 4 * data.tau0 < best.markov_tau < data.duration / 4
    return best if inside and rival.chi2 - best.chi2 >= COST_OF_MARKOV else None


def _correlation(data: _Data, model: _Model) -> Floats:
    """(k, k) correlation of the overlapping variances of a long record with this noise (Gaussian readings)."""
    f = np.geomspace(0.02 / data.duration, 0.5 / data.tau0, 6000)
    w = 2 * np.pi * f
    q2, n2, b2, k2, s2 = model.p**2
    spectrum = (
        2 * n2 + b2 / (np.pi * f) + 2 * k2 / w**2 + q2 * data.tau0 * 4 * (np.sin(w * data.tau0 / 2) / data.tau0) ** 2
    )
    if model.markov_tau:
        spectrum += 4 * s2 * model.markov_tau / (1 + (w * model.markov_tau) ** 2)
    m = np.round(data.tau / data.tau0)
    response = np.sin(np.pi * np.outer(data.tau, f)) ** 2 / (m[:, None] * np.sin(np.pi * f * data.tau0))
    power = response**2 * spectrum
    raw = (power * np.gradient(f)) @ power.T
    root = np.sqrt(np.maximum(np.diag(raw), 1e-300))
    return np.asarray(raw / np.outer(root, root))


def _describe(curve: AllanCurve, data: _Data, best: _Model) -> NoiseFit:
    dof = len(data.tau) - len(best.terms) - (best.markov_tau > 0)
    poor = best.chi2 > POOR * dof > 0
    wider = np.sqrt(best.chi2 / dof) if poor else 1.0
    sd = wider * np.sqrt(np.maximum(np.diag(best.covariance), 0.0))
    shown = {ORDER[j]: Term(float(best.p[j]), float(best.p[j] * sd[i])) for i, j in enumerate(best.terms)}
    markov_tau = Term(best.markov_tau, best.markov_tau * float(sd[-1])) if best.markov_tau else Term()
    notes: tuple[str, ...] = (_doubt(best.chi2, dof, float(wider)),) if poor else ()
    notes += tuple(f"{name} is not identifiable from this record" for name in ("N", "B", "K") if name not in shown)
    if not best.markov_tau:
        notes += ("a Gauss-Markov process is not identifiable from this record",)
    model = np.sqrt(_basis(curve.tau, best.markov_tau) @ best.p**2)
    absent = Term()
    return NoiseFit(
        Q=shown.get("Q", absent),
        N=shown.get("N", absent),
        B=shown.get("B", absent),
        K=shown.get("K", absent),
        markov_sd=shown.get("s", absent),
        markov_tau=markov_tau,
        model=model,
        chi2=best.chi2,
        dof=dof,
        notes=notes,
    )


def _doubt(chi2: float, dof: int, wider: float) -> str:
    return (
        f"The fitted noise does not describe this curve (chi-square {chi2:.3g} over {dof} degrees of freedom): it has "
        "bumps that no sum of these noises makes, as vibration, coarse steps or a changing mean do. Take N, B and K "
        f"with care; their deviations are widened {wider:.2g} times for it."
    )
