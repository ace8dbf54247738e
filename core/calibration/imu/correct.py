"""Runs corrected by Algorithm 1 or its offline counterpart, and judged as Kolhoff & Kemper 2021 judge (section 5).

Offline, the whole record is at hand: the drift is the exponential itself, and the smoothing is the two-sided moving
average of eq. 6, of the same 40 readings (the two end ones halved, 41 in all), which delays nothing. Online values
come (window - 1) / 2 readings later than offline ones; they are aligned by window // 2 before they are correlated.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.calibration.imu.algorithm1 import AXES, WINDOW, Constants, constants, online
from core.calibration.imu.model import ImuCalibration
from core.calibration.imu.stretches import Stretch, readings, stretches
from core.errors import MissingStreamError, NotEnoughDataError
from core.run import Run
from core.sensors import ImuLog

Floats = npt.NDArray[np.float64]

EDGE = 0.05  # of a stretch: its start, and its end as the asymptote
PIECE = 60.0  # s, about whose lines the noise scatters: slower wander is bias, no noise


def correct(run: Run, calibration: ImuCalibration, online: bool = True, *, window: int = WINDOW) -> Run:
    """The run with its IMU corrected: sample by sample as a microcontroller would (`online`), or with hindsight.

    t = 0 of the run is switching on. Readings that are not finite stay gaps offline; online the average of before is
    held. Raises MissingStreamError without an IMU, ParameterError where a matrix cannot be solved.
    """
    imu, made = _constants(run, calibration, window)
    values = _values(imu, made, online=online)
    columns = {name: values[:, j] for j, name in enumerate(AXES) if getattr(imu, name) is not None}
    return dataclasses.replace(run, imu=dataclasses.replace(imu, **columns))


def correction_notes(run: Run, calibration: ImuCalibration) -> tuple[str, ...]:
    """What of the correction cannot be done with this calibration, for this run's axes."""
    return _constants(run, calibration, WINDOW)[1].notes


def _constants(run: Run, calibration: ImuCalibration, window: int) -> tuple[ImuLog, Constants]:
    if run.imu is None or not len(run.imu):
        raise MissingStreamError("the run has no IMU readings", method="correct", missing="imu")
    present = [name for name in AXES if getattr(run.imu, name) is not None]
    return run.imu, constants(calibration, axes=present, window=window)


def _values(imu: ImuLog, made: Constants, *, online: bool) -> Floats:
    values = readings(imu)
    t = np.asarray(imu.t, np.float64)
    out = _online(made, t, values) if online else offline(made, t, values)
    out[:, [getattr(imu, name) is None for name in AXES]] = np.nan
    return out


_online = online


def offline(made: Constants, t: Floats, values: Floats) -> Floats:
    """(n, 6) readings (n, 6) by AXES with stamps t (n,) [s] from switching on, corrected with hindsight."""
    since = np.maximum(t, 0.0)[:, None]
    smooth = np.column_stack(
        [
            _smoothed(column, made.window)
            for column in (values - made.static - made.drift * -np.expm1(-since * made.rate)).T
        ]
    )
    out = np.empty_like(values)
    for s in range(2):
        place = slice(3 * s, 3 * s + 3)
        used = np.abs(made.inverse[s]).max(axis=0) > 0
        out[:, place] = smooth[:, place][:, used] @ made.inverse[s][:, used].T
    return out


def _smoothed(column: Floats, window: int) -> Floats:
    """Two-sided moving average; at the ends and at gaps over what is there, NaN where nothing is."""
    known = np.isfinite(column)
    if not known.any():
        return np.full_like(column, np.nan)
    taps = np.ones(window + 1 - window % 2)
    if window % 2 == 0:
        taps[[0, -1]] = 0.5
    # About the middle of the readings, so that sums keep their digits.
    middle = float(np.median(column[known]))
    half = len(taps) // 2
    total = np.convolve(np.where(known, column - middle, 0.0), taps)[half : half + len(column)]
    weight = np.convolve(known.astype(np.float64), taps)[half : half + len(column)]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(known & (weight > 0), middle + total / weight, np.nan)


@dataclass(frozen=True)
class Judged:
    """One state of the signal, arrays (6,) by AXES in the axis' unit: mean error at the start, at the asymptote (the
    last twentieth) and over all, NaN where the true value is not declared; sd of the noise, about a line through each
    minute."""

    start: Floats
    asymptote: Floats
    mean: Floats
    sd: Floats


@dataclass(frozen=True)
class CorrectionReport:
    """A correction judged on the run's longest stretch at rest (Fig. 13 and 14); arrays (6,) by AXES.

    t0, t1 [s] the stretch; noise_factor raw sd over online sd; mean_left share of the raw mean error that is left
    online (meaningless where the raw error is near zero: read it beside the units); mean_left_sensor (2,), of
    accelerometer and gyro, the same of the errors' lengths over the three axes; correlation of online with offline at
    rest, where there is nothing but noise to agree on, and correlation_all over the whole run; delay, readings by
    which they were aligned.
    """

    t0: float
    t1: float
    raw: Judged
    online: Judged
    offline: Judged
    noise_factor: Floats
    mean_left: Floats
    mean_left_sensor: Floats
    correlation: Floats
    correlation_all: Floats
    delay: int
    notes: tuple[str, ...] = ()


def judge_correction(run: Run, calibration: ImuCalibration, *, window: int = WINDOW) -> CorrectionReport:
    """Raw, online and offline values of a calibration run against what its procedure declares.

    Raises MissingStreamError without an IMU, NotEnoughDataError where no stretch rests.
    """
    imu, made = _constants(run, calibration, window)
    found, left, notes = stretches([run])
    resting = [s for s in found if s.still]
    if not resting:
        reasons = "; ".join([str(item) for item in left[:3]] + notes[:2]) or "every segment turns"
        raise NotEnoughDataError(f"no stretch of the run rests: {reasons}", method="correct")
    longest = max(resting, key=lambda s: float(s.count.sum()))
    t = np.asarray(imu.t, np.float64)
    states = {
        "raw": readings(imu),
        "online": _values(imu, made, online=True),
        "offline": _values(imu, made, online=False),
    }
    inside = (t >= longest.lo[0]) & (t <= longest.hi[-1])
    true = _true(longest)
    judged = {name: _judged(t[inside], values[inside], true) for name, values in states.items()}
    delay = window // 2
    with np.errstate(divide="ignore", invalid="ignore"):
        return CorrectionReport(
            t0=float(longest.lo[0]),
            t1=float(longest.hi[-1]),
            raw=judged["raw"],
            online=judged["online"],
            offline=judged["offline"],
            noise_factor=judged["raw"].sd / judged["online"].sd,
            mean_left=np.abs(judged["online"].mean) / np.abs(judged["raw"].mean),
            mean_left_sensor=_length(judged["online"].mean) / _length(judged["raw"].mean),
            correlation=_correlation(states["online"][inside], states["offline"][inside], delay),
            correlation_all=_correlation(states["online"], states["offline"], delay),
            delay=delay,
            notes=made.notes,
        )


def _true(s: Stretch) -> Floats:
    force = np.full(3, np.nan) if s.force is None else s.force
    return np.concatenate([force, s.rate])


def _judged(t: Floats, values: Floats, true: Floats) -> Judged:
    edge = max(1, round(EDGE * len(t)))
    return Judged(
        start=_mean(values[:edge]) - true,
        asymptote=_mean(values[-edge:]) - true,
        mean=_mean(values) - true,
        sd=_noise(t, values),
    )


def _noise(t: Floats, values: Floats) -> Floats:
    """(6,) sd about a line through each minute."""
    size = max(8, min(len(t), round(PIECE * (len(t) - 1) / (t[-1] - t[0]))))
    pieces = values[len(t) % size :].reshape(-1, size, values.shape[1])
    place = np.linspace(-1, 1, size)[None, :, None]
    centred = pieces - pieces.mean(axis=1, keepdims=True)
    slope = (place * centred).sum(axis=1, keepdims=True) / (place**2).sum()
    return np.asarray(np.sqrt(((centred - slope * place) ** 2).mean(axis=(0, 1))))


def _mean(values: Floats) -> Floats:
    known = np.isfinite(values)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0))


def _length(errors: Floats) -> Floats:
    return np.linalg.norm(errors.reshape(2, 3), axis=1)


def _correlation(late: Floats, early: Floats, delay: int) -> Floats:
    """(6,) correlation of `late` with `early` moved back by `delay` rows."""
    a, b = late[delay:], early[: len(early) - delay]
    out = np.full(6, np.nan)
    for j in range(6):
        known = np.isfinite(a[:, j]) & np.isfinite(b[:, j])
        if known.sum() > 2 and np.ptp(a[known, j]) > 0 and np.ptp(b[known, j]) > 0:
            out[j] = np.corrcoef(a[known, j], b[known, j])[0, 1]
    return out
