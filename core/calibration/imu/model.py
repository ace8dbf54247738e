"""The error model of an IMU (Kolhoff & Kemper 2021, eq. 1 and 2) and its JSON, `calibration/1`.

    reading = matrix @ true + static_bias + drift_amplitude * (1 - exp(-t / drift_tau)) + noise

per sensor, t [s] from switching on, everything in the IMU's own axes. The accelerometer's true value is the specific
force (gravity included, +9.81 m/s^2 along the axis that points up), so its static bias is without gravity. What the
runs did not show is NaN here and null in the JSON.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from core.errors import FormatError

Floats = npt.NDArray[np.float64]

SCHEMA = "calibration/1"
SHAPES: dict[str, tuple[int, ...]] = {
    "static_bias": (3,),
    "drift_amplitude": (3,),
    "drift_tau": (3,),
    "matrix": (3, 3),
    "noise_sd": (3,),
}
SENSORS = ("gyro", "accel")


def _unknown() -> Floats:
    return np.full(3, np.nan)


def _unknown_matrix() -> Floats:
    return np.full((3, 3), np.nan)


@dataclass(frozen=True)
class SensorModel:
    """Errors of one triad, axes x, y, z; unit u is rad/s of a gyro, m/s^2 of an accelerometer; NaN where not known.

    static_bias (3,) [u] at switching on; drift_amplitude (3,) [u] asymptote less start; drift_tau (3,) [s];
    matrix (3, 3) [-] scale and misalignment, row by reading axis; noise_sd (3,) [u] of one reading.
    """

    static_bias: Floats = field(default_factory=_unknown)
    drift_amplitude: Floats = field(default_factory=_unknown)
    drift_tau: Floats = field(default_factory=_unknown)
    matrix: Floats = field(default_factory=_unknown_matrix)
    noise_sd: Floats = field(default_factory=_unknown)

    def __post_init__(self) -> None:
        for name, shape in SHAPES.items():
            value = np.array(getattr(self, name), np.float64)
            if value.shape != shape:
                raise FormatError(
                    f"{name}: expected shape {shape}; found {value.shape}",
                    key=name,
                    expected=shape,
                    found=value.shape,
                )
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    def bias(self, t: npt.ArrayLike) -> Floats:
        """(n, 3) [u] static and drifting bias at t (n,) [s] from switching on; an unknown part counts as none."""
        seconds = np.maximum(np.atleast_1d(np.asarray(t, np.float64)), 0.0)[:, None]
        static = np.nan_to_num(self.static_bias)
        known = self.drifts
        amplitude = np.where(known, self.drift_amplitude, 0.0)
        tau = np.where(known, self.drift_tau, 1.0)
        return np.asarray(static + amplitude * -np.expm1(-seconds / tau))

    @property
    def drifts(self) -> npt.NDArray[np.bool_]:
        """(3,) whether amplitude and time of the drifting bias are both known."""
        return np.asarray(np.isfinite(self.drift_amplitude) & np.isfinite(self.drift_tau))


@dataclass(frozen=True)
class SensorPair:
    """The same of both triads."""

    gyro: SensorModel = field(default_factory=SensorModel)
    accel: SensorModel = field(default_factory=SensorModel)


@dataclass(frozen=True)
class ImuCalibration:
    """Error models of gyro and accelerometer, and their standard deviations in the same shape."""

    gyro: SensorModel = field(default_factory=SensorModel)
    accel: SensorModel = field(default_factory=SensorModel)
    sd: SensorPair = field(default_factory=SensorPair)

    def to_json(self) -> dict[str, Any]:
        """Plain data in schema calibration/1; NaN becomes None."""
        values: dict[str, Any] = {name: _plain(getattr(self, name)) for name in SENSORS}
        return {"schema": SCHEMA, **values, "sd": {name: _plain(getattr(self.sd, name)) for name in SENSORS}}

    @classmethod
    def from_json(cls, data: object) -> ImuCalibration:
        """Read schema calibration/1: parsed JSON, or its text. Unknown keys are ignored, a missing `sd` is unknown.

        Raises FormatError that names the key, what was expected there and what was found.
        """
        table = _object(_parsed(data), "")
        if table.get("schema") != SCHEMA:
            _refuse("schema", repr(SCHEMA), table.get("schema"))
        models = {name: _sensor(table.get(name), name, sd=False) for name in SENSORS}
        if all(np.isnan(getattr(m, key)).all() for m in models.values() for key in SHAPES):
            _refuse("gyro, accel", "at least one number", None)
        sd = _object(table.get("sd") or {}, "sd")
        return cls(**models, sd=SensorPair(**{name: _sensor(sd.get(name), f"sd.{name}", sd=True) for name in SENSORS}))


def _parsed(data: object) -> object:
    if isinstance(data, str | bytes):
        try:
            return json.loads(data)
        except (ValueError, RecursionError) as error:
            raise FormatError(f"calibration: this is no JSON: {error}", expected="JSON") from None
    return data


def _plain(model: SensorModel) -> dict[str, Any]:
    return {f.name: _nulls(getattr(model, f.name).tolist()) for f in fields(model)}


def _nulls(value: Any) -> Any:
    if isinstance(value, list):
        return [_nulls(item) for item in value]
    return value if math.isfinite(value) else None


def _sensor(data: object, key: str, *, sd: bool) -> SensorModel:
    """One sensor's block; null or missing is all unknown. Deviations and noise are not negative, times positive."""
    table = _object(data or {}, key)
    arrays = {name: _array(table.get(name), f"{key}.{name}", shape) for name, shape in SHAPES.items()}
    for name, value in arrays.items():
        if (sd or name == "noise_sd") and (value < 0).any():
            _refuse(f"{key}.{name}", "no number below 0", float(np.nanmin(value)))
    if not sd:
        if (arrays["drift_tau"] <= 0).any():
            _refuse(f"{key}.drift_tau", "numbers over 0", float(np.nanmin(arrays["drift_tau"])))
        matrix = arrays["matrix"]
        if np.isfinite(matrix).all() and abs(np.linalg.det(matrix)) < 1e-6:
            _refuse(f"{key}.matrix", "a matrix that can be solved", "one whose determinant is 0")
    return SensorModel(**arrays)


def _array(data: object, key: str, shape: tuple[int, ...]) -> Floats:
    if data is None:
        return np.full(shape, np.nan)
    if not isinstance(data, list) or len(data) != shape[0]:
        _refuse(key, f"a list of {shape[0]}", data)
    if len(shape) > 1:
        return np.array([_array(item, f"{key}[{i}]", shape[1:]) for i, item in enumerate(data)])
    return np.array([_number(item, f"{key}[{i}]") for i, item in enumerate(data)])


def _number(value: object, key: str) -> float:
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > 1e12 or not math.isfinite(value):
        _refuse(key, "a finite number or null", value)
    return float(value)


def _object(data: object, key: str) -> Mapping[str, Any]:
    if not isinstance(data, Mapping):
        _refuse(key, "an object", data)
    return data


def _refuse(key: str, expected: str, found: object) -> NoReturn:
    shown = found if isinstance(found, str) else json.dumps(found, default=str)
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    place = f"calibration, {key}" if key else "calibration"
    raise FormatError(f"{place}: expected {expected}; found {shown}", key=key or None, expected=expected, found=shown)
