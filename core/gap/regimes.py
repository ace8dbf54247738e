"""In which regime a cause shows, by its equation: listed effects, and shapes that no listed effect has."""

from __future__ import annotations

SIGNATURES = {
    "command_delay": "accelerating", "motor_lag": "accelerating", "speed_limit": "fast", "accel_limit": "accelerating",
    "deadband": "slow", "drive_gain": "moving", "battery_sag": "early to late", "wheel_radius": "moving",
    "unequal_wheels": "moving", "track_width": "turning", "wheel_slip": "accelerating",
    "side_slip": "turning while moving", "slip_patch": "place", "bump": "time", "floor_tilt": "heading",
    "gyro_bias": "always", "gyro_drift": "early to late", "gyro_walk": "early to late",
    "gyro_temperature": "early to late", "gyro_scale": "turning", "gyro_noise": "always", "gyro_clip": "fast turning",
    "gyro_g_sensitivity": "turning while moving", "accel_bias": "always", "accel_scale": "accelerating",
    "imu_yaw": "accelerating", "imu_offset": "turning", "vibration": "moving", "missed_ticks": "moving",
    "beacon_delay": "moving", "beacon_shift": "always", "beacon_rotation": "always", "beacon_scale": "always",
    "tag_offset": "heading", "beacon_noise": "always", "beacon_outliers": "always", "beacon_shadow": "place",
    "anchor_moved": "place", "range_bias": "always", "imu_clock": "accelerating", "clock_drift": "early to late",
}  # fmt: skip
"""Where each effect shows."""
PLACED, INSTANT = ("slip_patch", "beacon_shadow"), ("bump",)
"""Effects of a disc in the map, and of an instant."""


def of_shape(channel: str, regressor: str, text: str) -> str | None:
    """The regime of a generic shape; None where the data must say."""
    if regressor == "t" or "·t" in text or regressor == "temperature":
        return "early to late"
    if regressor == "w":
        return "fast turning" if text in ("w³", "w²", "w|w|") else "turning"
    if regressor == "v":
        if "w" in text:
            return "turning while moving"
        return "fast" if text in ("v²", "v|v|", "v³", "speed³", "speed·|speed|") else "moving"
    if regressor in ("a", "alpha"):
        return "accelerating"
    if regressor == "theta":
        return "always" if text == "constant" else "heading"
    if regressor.startswith("wheels."):
        return "moving"
    if regressor in ("x", "y"):
        return "place"
    return "always" if channel.startswith("ranges") else None
