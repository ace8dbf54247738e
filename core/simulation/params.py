"""The packed parameter vector: one slot per physical constant of robot and effects, as the compiled kernels read it.

`pack` turns a robot and a set of effects into it; kernels index it by the names below. Composite slots (the true
wheels' scales, one over the track) are worked out here once, so that at neutral values they are exactly nominal.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS, check_effects, complete
from core.errors import MissingStreamError, ParameterError
from core.robot import EffectSet, Pose
from core.run import RunMeta

Array = npt.NDArray[np.float64]

(X0, Y0, TH0, RADIUS) = range(4)
(DELAY, WIDTH, GAIN, SAG, TAU, ITAU, A_MAX, V_MAX) = range(4, 12)
(SCALE_L, SCALE_R, IB, SLIP_K, SIDE_K) = range(12, 17)
(PATCH_X, PATCH_Y, PATCH_RADIUS, PATCH_SLIP) = range(17, 21)
(BUMP, BUMP_TIME, BUMP_DISTANCE, BUMP_TURN, TILT_X, TILT_Y) = range(21, 27)
(BIAS, DRIFT, DRIFT_TAU, TEMPERATURE, GYRO_SCALE, GYRO_CLIP, G_SENSITIVITY) = range(27, 34)
(ACCEL_BIAS_X, ACCEL_BIAS_Y, ACCEL_SCALE_X, ACCEL_SCALE_Y, IMU_YAW, IMU_X, IMU_Y) = range(34, 41)
(MISSED_LEFT, MISSED_RIGHT) = range(41, 43)
(FIX_DELAY, FIX_X, FIX_Y, FIX_ANGLE, FIX_SCALE, TAG_X, TAG_Y, TAG_Z) = range(43, 51)
(SHADOW_X, SHADOW_Y, SHADOW_RADIUS, ANCHOR, ANCHOR_X, ANCHOR_Y, RANGE_BIAS) = range(51, 58)
(CLOCK_OFFSET, CLOCK_RATE) = range(58, 60)
(GYRO_NOISE, WALK, VIBRATION, FIX_NOISE, OUTLIER_RATE, OUTLIER_SIZE) = range(60, 66)
SLOTS = 66
"""Length of the vector. The last row holds what only `_noise.py` reads."""

DIRECT: dict[int, tuple[str, str]] = {
    DELAY: ("command_delay", "delay"),
    WIDTH: ("deadband", "width"),
    GAIN: ("drive_gain", "gain"),
    SAG: ("battery_sag", "rate"),
    TAU: ("motor_lag", "tau"),
    A_MAX: ("accel_limit", "a_max"),
    V_MAX: ("speed_limit", "v_max"),
    SLIP_K: ("wheel_slip", "k"),
    SIDE_K: ("side_slip", "k"),
    PATCH_X: ("slip_patch", "x"),
    PATCH_Y: ("slip_patch", "y"),
    PATCH_RADIUS: ("slip_patch", "radius"),
    PATCH_SLIP: ("slip_patch", "slip"),
    BUMP_TIME: ("bump", "time"),
    BUMP_DISTANCE: ("bump", "distance"),
    BUMP_TURN: ("bump", "turn"),
    TILT_X: ("floor_tilt", "slope_x"),
    TILT_Y: ("floor_tilt", "slope_y"),
    BIAS: ("gyro_bias", "bias"),
    DRIFT: ("gyro_drift", "amplitude"),
    DRIFT_TAU: ("gyro_drift", "tau"),
    TEMPERATURE: ("gyro_temperature", "slope"),
    GYRO_SCALE: ("gyro_scale", "scale"),
    GYRO_CLIP: ("gyro_clip", "limit"),
    G_SENSITIVITY: ("gyro_g_sensitivity", "k"),
    ACCEL_BIAS_X: ("accel_bias", "x"),
    ACCEL_BIAS_Y: ("accel_bias", "y"),
    ACCEL_SCALE_X: ("accel_scale", "x"),
    ACCEL_SCALE_Y: ("accel_scale", "y"),
    MISSED_LEFT: ("missed_ticks", "left"),
    MISSED_RIGHT: ("missed_ticks", "right"),
    FIX_DELAY: ("beacon_delay", "delay"),
    FIX_X: ("beacon_shift", "x"),
    FIX_Y: ("beacon_shift", "y"),
    FIX_ANGLE: ("beacon_rotation", "angle"),
    FIX_SCALE: ("beacon_scale", "scale"),
    SHADOW_X: ("beacon_shadow", "x"),
    SHADOW_Y: ("beacon_shadow", "y"),
    SHADOW_RADIUS: ("beacon_shadow", "radius"),
    ANCHOR_X: ("anchor_moved", "x"),
    ANCHOR_Y: ("anchor_moved", "y"),
    RANGE_BIAS: ("range_bias", "bias"),
    CLOCK_OFFSET: ("imu_clock", "offset"),
    GYRO_NOISE: ("gyro_noise", "factor"),
    WALK: ("gyro_walk", "density"),
    VIBRATION: ("vibration", "k"),
    FIX_NOISE: ("beacon_noise", "factor"),
    OUTLIER_RATE: ("beacon_outliers", "rate"),
    OUTLIER_SIZE: ("beacon_outliers", "size"),
}
"""Slots that hold one parameter of one effect as it is."""

SHORTEST_LAG = 1e-6
"""Below this [s] a lag keeps its steady part and has no transient: an exponential that steep is a jump."""
DRIVE_NEUTRAL = {
    slot: float(EFFECTS[e].parameter(p).neutral) for slot, (e, p) in DIRECT.items() if DELAY <= slot <= V_MAX
}
"""Neutral values of the drive's slots."""


def pack(meta: RunMeta, effects: EffectSet, *, start: Pose | None = None) -> Array:
    """(SLOTS,) parameters of the robot with the effects that its simulator already models, overlaid by `effects`.

    An effect in both takes all its parameters from `effects`. Raises ParameterError (unknown effect, parameter or
    beacon, value out of range) and MissingStreamError (the robot lacks its wheel radius or track width).
    """
    check_effects(meta.effects)
    check_effects(effects)
    values = complete({**meta.effects, **effects})
    robot = meta.robot
    radius, track = _dimensions(meta)
    par = np.zeros(SLOTS)
    for slot, (effect, name) in DIRECT.items():
        par[slot] = values[effect][name]
    pose = start or meta.start or Pose()
    par[X0], par[Y0], par[TH0], par[RADIUS] = pose.x, pose.y, pose.theta, radius
    par[ITAU] = 1.0 / par[TAU] if par[TAU] >= SHORTEST_LAG else 0.0
    scale, ratio = float(values["wheel_radius"]["scale"]), float(values["unequal_wheels"]["ratio"])
    par[SCALE_L], par[SCALE_R] = scale * 2.0 / (1.0 + ratio), scale * 2.0 * ratio / (1.0 + ratio)
    par[IB] = 1.0 / (float(values["track_width"]["scale"]) * track)
    par[CLOCK_RATE] = 1.0 / (1.0 + float(values["clock_drift"]["skew"]))
    par[BUMP] = float(par[BUMP_DISTANCE] != 0.0 or par[BUMP_TURN] != 0.0)
    par[IMU_YAW] = robot.imu.yaw + float(values["imu_yaw"]["angle"])
    par[IMU_X] = robot.imu.x + float(values["imu_offset"]["x"])
    par[IMU_Y] = robot.imu.y + float(values["imu_offset"]["y"])
    par[TAG_X] = robot.tag.x + float(values["tag_offset"]["x"])
    par[TAG_Y] = robot.tag.y + float(values["tag_offset"]["y"])
    par[TAG_Z] = robot.tag.z
    par[ANCHOR] = _anchor(meta, values["anchor_moved"])
    return par


def _dimensions(meta: RunMeta) -> tuple[float, float]:
    """Nominal wheel radius and track width [m]; a robot that stays at rest needs neither."""
    names = ("wheel_radius", "track_width")
    missing = [name for name in names if getattr(meta.robot, name) is None]
    at_rest = meta.procedure is not None and meta.procedure.kind in ("rest", "six_position")
    if missing and not at_rest:
        raise MissingStreamError(
            f"the simulator needs the robot's {' and '.join(missing)}; add it to run.json",
            method="simulate",
            missing=[f"robot.{name}" for name in missing],
        )
    return meta.robot.wheel_radius or 1.0, meta.robot.track_width or 1.0


def _anchor(meta: RunMeta, moved: Mapping[str, float | str]) -> float:
    """Index of the moved beacon among the run's, -1 for none."""
    if moved["x"] == 0.0 and moved["y"] == 0.0:
        return -1.0
    names = list(meta.beacons)
    if moved["beacon"] not in names:
        raise ParameterError(
            f"anchor_moved: beacon is {moved['beacon']!r}; the run has {', '.join(names) or 'no beacons'}",
            parameter="anchor_moved.beacon",
            expected=names,
            found=moved["beacon"],
        )
    return float(names.index(str(moved["beacon"])))
