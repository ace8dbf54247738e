"""The IMU's noise as Kalibr's YAML has it (`imu.yaml`): densities two-sided, in continuous time."""

from __future__ import annotations

from app.exports.imu_figures import Allan, axis_noise
from core.calibration.imu import ImuCalibration

SENSORS = (("accelerometer", "a", "m/s^2"), ("gyroscope", "g", "rad/s"))


def kalibr_yaml(calibration: ImuCalibration, *, name: str, rate: float, allan: Allan | None = None) -> str:
    """One density and one walk per sensor, the largest of its axes: Kalibr knows no axes.

    What is not known is left out, in a comment: Kalibr then asks for it rather than taking a number from nowhere.
    """
    lines = [
        f"# IMU noise for Kalibr, from the calibration {_plain(name)!r}.",
        "# Densities are two-sided and in continuous time: sd of a reading = noise_density * sqrt(update_rate).",
        "# The largest of the three axes. Double them for a filter with a rough model, as is usual with Kalibr.",
        "# Bias, scale and misalignment are not in this file: correct the readings first (Algorithm 1).",
    ]
    for sensor, letter, unit in SENSORS:
        axes = {f"{letter}{k}": axis_noise(calibration, f"{letter}{k}", rate, allan) for k in "xyz"}
        density = {axis: (found.density, found.density_origin) for axis, found in axes.items()}
        walk = {axis: (found.walk, found.walk_origin) for axis, found in axes.items()}
        lines += ["", *_line(f"{sensor}_noise_density", density, f"{unit}/sqrt(Hz)")]
        lines += _line(f"{sensor}_random_walk", walk, f"{unit}/s/sqrt(Hz)")
    lines += ["", "rostopic: /imu", f"update_rate: {rate:g}  # Hz", ""]
    return "\n".join(lines)


def _line(key: str, values: dict[str, tuple[float | None, str]], unit: str) -> list[str]:
    known = {axis: value for axis, (value, _) in values.items() if value is not None}
    if not known:
        return [f"# {key}: not known; run an Allan deviation of a long rest  # [{unit}]"]
    worst = max(known, key=lambda axis: known[axis])
    # YAML 1.1 takes 1e-4 for text: a mantissa with a point, and a sign, make it a number
    return [f"{key}: {known[worst]:.6e}  # [{unit}], {worst}; {values[worst][1]}"]


def _plain(text: str) -> str:
    return " ".join(text.split())
