"""What every robot has a little of: flaws below their tolerance in effects.md, its own rates, rounded readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Effects = Mapping[str, Mapping[str, float | str]]


@dataclass(frozen=True)
class Rig:
    """Rates [1/s], steps that readings are rounded to, warming up of the IMU."""

    commands: float = 50.0
    wheels: float = 50.0
    imu: float = 100.0
    fixes: float = 10.0
    ranges: float = 20.0
    truth: float = 50.0
    gyro_step: float = 0.0
    accel_step: float = 0.0
    warm: float = 6.0
    warm_tau: float = 80.0


def drawn_rig(seed: int) -> Rig:
    """What a robot's electronics are like, by chance."""
    rng = np.random.default_rng([seed, 8])
    return Rig(
        commands=float(rng.choice([10.0, 20.0, 50.0])),
        wheels=float(rng.choice([25.0, 50.0, 100.0])),
        imu=float(rng.choice([50.0, 100.0, 200.0], p=[0.2, 0.6, 0.2])),
        fixes=float(rng.choice([4.0, 10.0, 20.0])),
        ranges=float(rng.choice([10.0, 20.0, 40.0])),
        truth=float(rng.choice([20.0, 50.0, 100.0])),
        gyro_step=float(rng.choice([0.0, 1.3e-4, 1.1e-3])),
        accel_step=float(rng.choice([0.0, 0.0012, 0.0096])),
        warm=float(rng.uniform(3.0, 12.0)),
        warm_tau=float(rng.uniform(40.0, 200.0)),
    )


def ordinary(seed: int, beacons: Sequence[str]) -> Effects:
    """What every robot has a little of, each below its tolerance in effects.md."""
    rng = np.random.default_rng([seed, 9])

    def some(small: float, signed: bool = True) -> float:
        size = small * float(rng.uniform(0.0, 0.7))
        return size * float(rng.choice([-1.0, 1.0])) if signed else size

    return {
        "command_delay": {"delay": some(0.004, False)},
        "motor_lag": {"tau": some(0.005, False)},
        "drive_gain": {"gain": 1.0 + some(0.001)},
        "battery_sag": {"rate": some(6e-6, False)},
        "wheel_radius": {"scale": 1.0 + some(0.001)},
        "unequal_wheels": {"ratio": 1.0 + some(6e-4)},
        "track_width": {"scale": 1.0 + some(0.002)},
        "wheel_slip": {"k": some(0.004, False)},
        "side_slip": {"k": some(0.003, False)},
        "floor_tilt": {"slope_x": some(4e-4), "slope_y": some(4e-4)},
        "gyro_bias": {"bias": some(1e-4)},
        "gyro_scale": {"scale": 1.0 + some(0.002)},
        "gyro_g_sensitivity": {"k": some(4e-4)},
        "gyro_temperature": {"slope": some(2e-5)},
        "accel_bias": {"x": some(0.0014), "y": some(0.0014)},
        "accel_scale": {"x": 1.0 + some(0.01), "y": 1.0 + some(0.01)},
        "imu_yaw": {"angle": some(0.007)},
        "imu_offset": {"x": some(0.007), "y": some(0.007)},
        "vibration": {"k": some(0.012, False)},
        "beacon_delay": {"delay": some(0.025, False)},
        "beacon_shift": {"x": some(0.007), "y": some(0.007)},
        "beacon_rotation": {"angle": some(0.003)},
        "beacon_scale": {"scale": 1.0 + some(0.002)},
        "tag_offset": {"x": some(0.007), "y": some(0.007)},
        "anchor_moved": {"beacon": str(rng.choice(beacons)), "x": some(0.01), "y": some(0.01)},
        "range_bias": {"bias": some(0.008)},
        "imu_clock": {"offset": some(0.001)},
        "clock_drift": {"skew": some(2e-5)},
    }


def rounded(values: Floats, step: float) -> Floats:
    """To the steps of a converter, if it has any."""
    return values if step == 0.0 else step * np.round(values / step)
