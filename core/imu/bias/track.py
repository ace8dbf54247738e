"""Gyro bias of a run by a named method: checks what the record holds, then hands it to the method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from core.errors import MissingStreamError, NotEnoughDataError, ParameterError
from core.imu.bias.filtered import FilterConfig, best, smoothed
from core.imu.bias.integral import curve_stamps
from core.imu.bias.result import ACCEPTED, BiasEstimate, SegmentVerdicts
from core.imu.bias.segment_methods import SegmentConfig, method_a, method_b, method_c
from core.run import Run
from core.sensors import ImuLog

LARGEST = 35.0  # rad/s: 2000 deg/s, the widest range of a MEMS gyro
FAST = 6.0  # rad/s: more than robots turn
NOISIEST = 0.05  # rad/s, of a reading at rest; a MEMS gyro has a tenth of it
NOISIEST_DENSITY = 0.004  # rad/s/sqrt(Hz), of the same


@dataclass(frozen=True)
class BiasMethod:
    """One method: what it is called, whether it looks back only, where it comes from, its settings, and how it runs."""

    name: str
    label: str
    causal: bool
    source: str
    config: type[SegmentConfig] | type[FilterConfig]
    run: Callable[[Run, ImuLog, object], BiasEstimate]


def _by_segments(method: Callable[..., BiasEstimate]) -> Callable[[Run, ImuLog, object], BiasEstimate]:
    return lambda run, imu, config: method(imu.t, imu.gz, config)


CECHOWICZ = "Cechowicz, Acta Mechanica et Automatica 11(2), 2017"
METHODS: dict[str, BiasMethod] = {
    m.name: m
    for m in (
        BiasMethod("A", "bias of the start, kept", True, CECHOWICZ, SegmentConfig, _by_segments(method_a)),
        BiasMethod("B", "segments that pass the range test", True, CECHOWICZ, SegmentConfig, _by_segments(method_b)),
        BiasMethod("C", "range test and band", True, CECHOWICZ, SegmentConfig, _by_segments(method_c)),
        BiasMethod("best", "one filter, looking back only", True, "guide: imu", FilterConfig, best),  # type: ignore[arg-type]
        BiasMethod("smoothed", "the same with hindsight", False, "guide: imu", FilterConfig, smoothed),  # type: ignore[arg-type]
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
    imu, notes = _finite(run.imu)
    least, most = float(imu.gz.min()), float(imu.gz.max())
    if least == most:
        notes += (f"All {len(imu)} readings are {least:g} rad/s: the gyro may be dead. The bias is taken as that.",)
        return _constant(method, imu, least, notes)
    made = chosen.run(run, imu, config)
    return replace(made, notes=notes + made.notes + _oddities(imu.gz, least, most, made))


def _finite(imu: ImuLog) -> tuple[ImuLog, tuple[str, ...]]:
    good = np.isfinite(imu.gz)
    bad = len(good) - int(good.sum())
    if len(good) - bad < 8:
        raise NotEnoughDataError(
            f"{len(good) - bad} finite gyro readings are too few to find a bias from",
            stream="imu",
            column="gz",
            found=len(good) - bad,
            expected=8,
        )
    if not bad:
        return imu, ()
    kept = ImuLog(**{name: column[good] for name, column in imu.columns().items()})  # type: ignore[arg-type]
    return kept, (f"{bad} gyro readings are not finite; they are left out.",)


def _oddities(gz: npt.NDArray[np.floating], least: float, most: float, made: BiasEstimate) -> tuple[str, ...]:
    """What the size of the readings says about them."""
    from core.imu.bias._blocks_numba import at_limit

    notes: tuple[str, ...] = ()
    largest = max(abs(least), abs(most))
    noisy = made.figures.get("sigma_sr", 0.0) > NOISIEST and largest > FAST
    dense = made.figures.get("N", 0.0) > NOISIEST_DENSITY and float((made.segments.verdict == ACCEPTED).mean()) > 0.1
    if largest > LARGEST or noisy or dense:
        notes += (
            f"The readings reach {largest:.4g} rad/s: are they in deg/s? "
            f"Wanted are rad/s, {180 / np.pi:.4g} times less.",
        )
    stuck = at_limit(gz, least, most)
    if stuck >= 3 and most - least > 0.2:
        notes += (
            f"{stuck} readings sit at the record's limits, {least:.4g} and {most:.4g} rad/s: "
            "the gyro was saturated, and what it turned meanwhile is lost.",
        )
    return notes


def _constant(method: str, imu: ImuLog, value: float, notes: tuple[str, ...]) -> BiasEstimate:
    out = curve_stamps(imu.t)
    full = np.full(len(out), value)
    unknown = np.full(len(out), np.nan)
    one = SegmentVerdicts(out[:1], full[:1], np.array([ACCEPTED], np.int8))
    return BiasEstimate(
        method, out, np.zeros(len(out)), full, unknown, None, np.ones(len(out), np.bool_), one, {}, notes
    )
