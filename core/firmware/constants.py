"""What the generated header holds: each constant with its C text, its unit and where it came from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.calibration.imu import AXES, Constants, ImuCalibration, SensorModel, constants
from core.errors import FormatError, ParameterError
from core.imu.bias import BiasNoise, SegmentConfig
from core.imu.bias.drift import usual
from core.imu.segments import RANGE_FACTOR

Floats = npt.NDArray[np.float64]

SLOWEST, FASTEST = 10.0, 10_000.0  # Hz, of an IMU
USUAL_DENSITY = math.radians(0.011)  # rad/s/sqrt(Hz) two-sided, of the L3GD20H that Cechowicz measured
WORST_CONDITION = 1e3  # of a matrix; a real sensor's is near 1, and float32 has seven digits
LARGEST = np.array([320.0] * 3 + [70.0] * 3)  # m/s^2, rad/s: no MEMS sensor reads more, so no bias of one is more
MICRO = 1e6


@dataclass(frozen=True)
class Noise:
    """How noisy the gyro about z is. sd [rad/s] of one reading at rest; drift of its bias. What is None is taken from
    the calibration's noise, and where that is silent, from a usual MEMS gyro's."""

    sd: float | None = None
    drift: BiasNoise | None = None

    def __post_init__(self) -> None:
        if self.sd is not None and not (math.isfinite(self.sd) and 0 < self.sd < 1):
            raise ParameterError(
                f"the noise of a reading is {self.sd} rad/s, expected over 0 and below 1",
                parameter="noise.sd",
                found=self.sd,
            )


def noise_of_allan(data: object) -> Noise:
    """Noise of an allan/1 object of imu.gz: N, K and, as the Gauss-Markov deviation, B. Where K or B is null, a usual
    gyro's of that N. Raises FormatError for what is no such object or has no N."""
    if not isinstance(data, Mapping) or data.get("schema") != "allan/1":
        raise FormatError("expected the JSON of `allan`, schema allan/1", expected="allan/1")
    if data.get("axis") != "imu.gz":
        raise FormatError(f"these are figures of {data.get('axis')!r}, expected imu.gz", found=data.get("axis"))
    N, B, K = (_figure(data, name) for name in ("N", "B", "K"))
    if N is None:
        raise FormatError("N is null: the record does not show the white noise", column="N")
    typical = usual(N)
    return Noise(drift=BiasNoise(N, typical.K if K is None else K, typical.sd if B is None else B, typical.tau))


def _figure(data: Mapping[str, object], name: str) -> float | None:
    value = data.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not (math.isfinite(value) and value > 0):
        raise FormatError(f"{name} is {value!r}, expected a number over 0 or null", column=name, found=repr(value))
    return float(value)


@dataclass(frozen=True)
class Constant:
    """One #define: its C text, unit ("" where it has none) and what it is and comes from. An array has one text and
    one origin per row."""

    name: str
    text: str | tuple[str, ...]
    unit: str
    note: str
    origins: tuple[str, ...] = ()


def algorithm1(calibration: ImuCalibration) -> tuple[Constants, list[Constant]]:
    """Algorithm 1's numbers, and their part of the header. Raises ParameterError for those no sensor has."""
    made = constants(calibration)
    _plausible(calibration, made)
    unit = "m/s^2, rad/s"
    bias, drift = _origins(calibration, "static_bias"), _origins(calibration, "drift_amplitude")
    tau = _origins(calibration, "drift_tau")
    rows = [
        Constant("DS_STATIC_BIAS", vector(made.static), unit, "bias at switching on", bias),
        Constant("DS_DRIFT_AMPLITUDE", vector(made.drift), unit, "bias that builds up while warming", drift),
        Constant("DS_DRIFT_RATE", vector(made.rate), "1/s", "1 / time in which it does; 0: it does not", tau),
        Constant("DS_ACCEL_INVERSE", matrix(made.inverse[0]), "", "inverse of M", _matrix_origins(calibration.accel)),
        Constant("DS_GYRO_INVERSE", matrix(made.inverse[1]), "", "inverse of M", _matrix_origins(calibration.gyro)),
        Constant("DS_MA_LENGTH", f"{made.window}U", "samples", "moving average; Kolhoff & Kemper's"),
    ]
    return made, rows


def _plausible(calibration: ImuCalibration, made: Constants) -> None:
    for name, values in (("static_bias", made.static), ("drift_amplitude", made.drift)):
        j = int(np.argmax(np.abs(values) / LARGEST))
        if abs(values[j]) > LARGEST[j]:
            raise ParameterError(
                f"{name} of {AXES[j]} is {values[j]:g}, more than any such sensor reads; expected SI units",
                parameter=name,
                found=float(values[j]),
                expected=float(LARGEST[j]),
            )
    for name, inverse in zip(("accel", "gyro"), made.inverse, strict=True):
        condition = float(np.linalg.cond(inverse))
        if not condition < WORST_CONDITION:
            raise ParameterError(
                f"{name}.matrix is singular or nearly so (condition {condition:.3g}): float32 cannot undo it",
                parameter=f"{name}.matrix",
                found=condition,
                expected=WORST_CONDITION,
            )


def _origins(calibration: ImuCalibration, key: str) -> tuple[str, ...]:
    """By AXES: from the calibration, with its deviation, or what stands in for it."""
    out = []
    for name in ("accel", "gyro"):
        model, sd = getattr(calibration, name), getattr(getattr(calibration.sd, name), key)
        known = np.isfinite(model.static_bias) if key == "static_bias" else model.drifts
        stated = [f", sd {s:.2g}{' s' if key == 'drift_tau' else ''}" if np.isfinite(s) else "" for s in sd]
        out += [
            f"calibration{text}" if k else "NOT SHOWN by the calibration: 0"
            for k, text in zip(known, stated, strict=True)
        ]
    return tuple(f"{axis}: {text}" for axis, text in zip(AXES, out, strict=True))


def _matrix_origins(model: SensorModel) -> tuple[str, ...]:
    texts = {3: "calibration", 0: "NOT SHOWN by the calibration: identity"}
    counts = np.isfinite(model.matrix).sum(axis=1)
    return tuple(texts.get(int(n), "calibration, and identity where NOT SHOWN") for n in counts)


def common() -> list[Constant]:
    """What does not depend on calibration or tracker."""
    return [
        Constant("DS_LARGEST", "1000.0f", "rad/s, m/s^2", "from here on it is no reading, but a fault of the bus"),
        Constant("DS_UNKNOWN", "(-1.0f)", "", "a deviation that is not known"),
        Constant("DS_NO_TEMPERATURE", "(-1000.0f)", "deg C", "where the IMU gives no temperature"),
    ]


def check_rate(rate_hz: float) -> None:
    """Raises ParameterError for a rate that no IMU has."""
    if not (math.isfinite(rate_hz) and SLOWEST <= rate_hz <= FASTEST):
        raise ParameterError(
            f"the IMU's rate is {rate_hz:g} Hz, expected {SLOWEST:g} to {FASTEST:g}",
            parameter="rate_hz",
            found=rate_hz,
            expected=[SLOWEST, FASTEST],
        )


def white(made: Constants, calibration: ImuCalibration, rate_hz: float, noise: Noise) -> tuple[float, str]:
    """[rad/s] Standard deviation of one corrected reading about z at rest, and where it came from."""
    if noise.sd is not None:
        return noise.sd, "as given"
    sd = calibration.gyro.noise_sd
    if np.isfinite(sd[2]) and sd[2] > 0:
        spread = np.nan_to_num(sd) * made.inverse[1][2]
        return float(np.sqrt(np.sum(spread**2))), "calibration (noise_sd through the matrix)"
    if noise.drift is not None:
        return noise.drift.N * math.sqrt(rate_hz), "N sqrt(rate) of the noise given"
    return USUAL_DENSITY * math.sqrt(rate_hz), "NOT KNOWN: a usual MEMS gyro's 0.011 deg/s/sqrt(Hz), times sqrt(rate)"


def method_c(sigma: float, origin: str, rate_hz: float, config: SegmentConfig) -> list[Constant]:
    """The header's part for method C: sigma [rad/s], the standard deviation of a reading at rest."""
    per_segment = config.length * rate_hz
    return [
        Constant("DS_C_SEGMENT_US", integer(config.length * MICRO), "us", "a segment (the paper's Fig. 5)"),
        Constant("DS_C_HALF_STEP_US", integer(0.5 * MICRO / rate_hz), "us", "half a sample: segments begin so early"),
        Constant("DS_C_FEWEST", integer(math.ceil(per_segment / 2)), "samples", "a segment with fewer is left out"),
        Constant("DS_C_SIGMA", number(sigma), "rad/s", f"sigma_sr of (5) and (7); {origin}"),
        Constant("DS_C_RANGE", number(RANGE_FACTOR * sigma), "rad/s", f"{RANGE_FACTOR:g} sigma_sr, test (5)"),
        Constant("DS_C_BEFORE", f"{config.n}U", "segments", "n of (7)"),
    ]


def number(value: float) -> str:
    """A float32 literal that reads back as the nearest float32."""
    text = f"{float(np.float32(value)):.9g}"
    text = text if any(c in text for c in ".en") else text + ".0"
    return f"({text}f)" if text.startswith("-") else f"{text}f"


def integer(value: float) -> str:
    return f"{round(value)}U"


def vector(values: Floats) -> tuple[str, ...]:
    return tuple(number(float(v)) for v in values)


def matrix(values: Floats) -> tuple[str, ...]:
    return tuple("{" + ", ".join(vector(row)) + "}" for row in values)
