"""The IMU's errors as SDF `<noise>` blocks, one per axis, for Gazebo."""

from __future__ import annotations

import math
from xml.sax.saxutils import escape

import numpy as np

from app.exports.imu_figures import Allan, axis_noise, drive
from core.calibration.imu import ImuCalibration

PARTS = (("angular_velocity", "g"), ("linear_acceleration", "a"))
HEAD = """\
  <!-- {name}: errors of an IMU read at {rate:g} Hz. rad/s and m/s^2.
       stddev: of one reading. bias_mean, bias_stddev: static bias and its deviation; Gazebo gives it either sign at
       random. dynamic_bias_stddev: of the noise that drives a Gauss-Markov process, per root of a second, as Gazebo
       takes it: the process' own deviation is that times sqrt(correlation_time / 2).
       Scale and misalignment have no place in SDF. Unknown figures are left out. -->"""


def sdf_noise(calibration: ImuCalibration, *, name: str, rate: float, allan: Allan | None = None) -> str:
    """A `<sensor type="imu">` with its noise, to stand in a link of a model."""
    # a comment may not hold two hyphens
    title = escape(" ".join(name.split()).replace("--", "- -"))
    head = HEAD.format(name=title, rate=rate)
    lines = ['<sensor name="imu" type="imu">', head, f"  <update_rate>{rate:g}</update_rate>", "  <imu>"]
    for part, letter in PARTS:
        lines.append(f"    <{part}>")
        for axis in "xyz":
            lines += _axis(calibration, letter + axis, rate, allan)
        lines.append(f"    </{part}>")
    return "\n".join([*lines, "  </imu>", "</sensor>", ""])


def _axis(calibration: ImuCalibration, axis: str, rate: float, allan: Allan | None) -> list[str]:
    gyro = axis[0] == "g"
    model, sd = (calibration.gyro, calibration.sd.gyro) if gyro else (calibration.accel, calibration.sd.accel)
    k = "xyz".index(axis[1])
    figures = {
        "mean": 0.0,
        "stddev": axis_noise(calibration, axis, rate, allan).sd,
        "bias_mean": float(model.static_bias[k]),
        "bias_stddev": float(sd.static_bias[k]),
        "dynamic_bias_stddev": drive(_number(model.drift_amplitude[k]), _number(model.drift_tau[k])),
        "dynamic_bias_correlation_time": float(model.drift_tau[k]),
    }
    if figures["dynamic_bias_stddev"] is None:
        del figures["dynamic_bias_correlation_time"]
    known = {name: value for name, value in figures.items() if value is not None and math.isfinite(value)}
    rows = [f"          <{name}>{value:.9g}</{name}>" for name, value in known.items()]
    return [f"      <{axis[1]}>", '        <noise type="gaussian">', *rows, "        </noise>", f"      </{axis[1]}>"]


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
