"""Gyro bias of a run by a named method: checks what the record holds, then hands it to the method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from core.errors import MissingStreamError, NotEnoughDataError, ParameterError
from core.imu.bias.filtered import FilterConfig, best, smoothed
from core.imu.bias.integral import curve_stamps
from core.imu.bias.result import ACCEPTED, BiasEstimate, SegmentVerdicts
from core.imu.bias.segment_methods import SegmentConfig, method_a, method_b, method_c
from core.imu.oddities import saturated
from core.imu.stamps import onward, told
from core.imu.units import degrees
from core.run import Run
from core.sensors import ImuLog

DEAD = 3.0  # s without a change
SLOWEST = 1.5  # s from reading to reading


@dataclass(frozen=True)
class BiasMethod:
    """One method: what it is called, whether it looks back only, where it comes from, its settings, and how it runs."""

    name: str
    label: str
    causal: bool
    source: str
    config: type[SegmentConfig] | type[FilterConfig]
    run: Callable[[Run, ImuLog, Any], BiasEstimate]


def _by_segments(method: Callable[..., BiasEstimate]) -> Callable[[Run, ImuLog, Any], BiasEstimate]:
    return lambda run, imu, config: method(imu.t, imu.gz, config)


CECHOWICZ = "Cechowicz, Acta Mechanica et Automatica 11(2), 2017"
METHODS: dict[str, BiasMethod] = {
    m.name: m
    for m in (
        BiasMethod("A", "bias of the start, kept", True, CECHOWICZ, SegmentConfig, _by_segments(method_a)),
        BiasMethod("B", "segments that pass the range test", True, CECHOWICZ, SegmentConfig, _by_segments(method_b)),
        BiasMethod("C", "range test and band", True, CECHOWICZ, SegmentConfig, _by_segments(method_c)),
        BiasMethod("best", "one filter, looking back only", True, "guide: imu", FilterConfig, best),
        BiasMethod("smoothed", "the same with hindsight", False, "guide: imu", FilterConfig, smoothed),
    )
}


def track_bias(run: Run, method: str, config: SegmentConfig | FilterConfig | None = None) -> BiasEstimate:
    """Gyro bias and heading of a run by one of METHODS.

    Uses run.imu, and for `best` and `smoothed` also wheels and commands where there are any. Readings that are not
    finite are left out. Raises ParameterError for an unknown method or another method's config, MissingStreamError
    without gyro readings, NotEnoughDataError where the record is too short. What is odd about the record (saturation,
    a size that looks like degrees, no rest) is said in `notes`.
    """
    if method not in METHODS:
        raise ParameterError(
            f"there is no bias method {method!r}; expected one of {', '.join(METHODS)}",
            parameter="method",
            found=method,
            expected=list(METHODS),
        )
    chosen = METHODS[method]
    config = config or chosen.config()
    if not isinstance(config, chosen.config):
        raise ParameterError(
            f"method {method} takes a {chosen.config.__name__}, not a {type(config).__name__}", parameter="config"
        )
    if run.imu is None or not len(run.imu):
        raise MissingStreamError("the run has no gyro readings", method=method, missing="imu.gz")
    imu, notes = _usable(run.imu)
    # one type of array, whatever was recorded or is mapped from disk: the kernels are compiled once
    imu = replace(imu, gz=np.array(imu.gz, dtype=np.float64))
    least, most = float(imu.gz.min()), float(imu.gz.max())
    if least == most:
        notes += (f"All {len(imu)} readings are {least:g} rad/s: the gyro may be dead. The bias is taken as that.",)
        return _constant(method, imu, least, notes)
    made = chosen.run(run, imu, config)
    return replace(made, notes=notes + made.notes + _oddities(imu, made))


def _usable(imu: ImuLog) -> tuple[ImuLog, tuple[str, ...]]:
    """Readings that are finite and whose stamps go on."""
    kept = onward(imu.t)
    notes = told(imu.t, kept)
    bad = ~np.isfinite(imu.gz) | ~np.isfinite(imu.t)
    if bad.any():
        notes += (f"{int(bad.sum())} gyro readings are not finite; they are left out.",)
    kept &= ~bad
    left = int(kept.sum())
    if left < 8:
        raise NotEnoughDataError(
            f"{left} finite gyro readings are too few to find a bias from",
            stream="imu",
            column="gz",
            found=left,
            expected=8,
        )
    if left == len(kept):
        return imu, ()
    columns = {name: column[kept] for name, column in imu.columns().items()}
    return ImuLog(**columns), notes  # type: ignore[arg-type]  # columns() says its names only at run time


def _oddities(imu: ImuLog, made: BiasEstimate) -> tuple[str, ...]:
    """What the readings' size, limits, repeats and stamps say about them."""
    from core.imu.bias._blocks_numba import longest_repeat

    notes: tuple[str, ...] = ()
    step = float(imu.t[-1] - imu.t[0]) / (len(imu.t) - 1)
    rested = float((made.segments.verdict == ACCEPTED).mean()) > 0.1 and step < SLOWEST
    notes += degrees(imu.t, imu.gz, rested=rested)
    notes += saturated(imu.gz, "gz")
    repeats = longest_repeat(imu.gz)
    if repeats * step > DEAD and repeats > 100:
        notes += (f"For {repeats * step:.3g} s all readings are equal: the gyro may have been dead.",)
    if step > SLOWEST:
        notes += (f"Readings come every {step:.3g} s: are the stamps in milliseconds? Wanted are seconds.",)
    return notes


def _constant(method: str, imu: ImuLog, value: float, notes: tuple[str, ...]) -> BiasEstimate:
    out = curve_stamps(imu.t)
    full = np.full(len(out), value)
    unknown = np.full(len(out), np.nan)
    one = SegmentVerdicts(out[:1], full[:1], np.array([ACCEPTED], np.int8))
    return BiasEstimate(
        method, out, np.zeros(len(out)), full, unknown, None, np.ones(len(out), np.bool_), one, {}, notes
    )
