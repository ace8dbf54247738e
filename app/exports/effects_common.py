"""What no physics engine or controller has, and the nearest thing to do: shared by the targets."""

from __future__ import annotations

BEACONS = "it has no beacons: pass your fixes or ranges through this effect where you make them"
OUTSIDE: dict[str, str] = {
    "command_delay": "hold each command back by the delay before it is sent",
    "motor_lag": "send the commands through a first-order low-pass with this time constant",
    "deadband": "set wheel speeds smaller than the width to zero before they are sent",
    "battery_sag": "multiply the wheel speeds by exp(-rate*t) before they are sent",
    "side_slip": "move the body sideways by -k*v*w each step, or lower the sideways friction of the tyres",
    "slip_patch": "lower the friction of a disc of the floor",
    "bump": "push the body once, at the time, so that it jumps by distance and turn",
    "gyro_drift": "add amplitude*(1 - exp(-t/tau)) to gz where you read it",
    "gyro_walk": "add a random walk of this density to gz where you read it",
    "gyro_temperature": "add slope*(temperature - first temperature) to gz where you read it",
    "gyro_bias": "add the bias to gz where you read it",
    "gyro_scale": "multiply gz by the scale where you read it",
    "gyro_clip": "clip gz where you read it",
    "gyro_g_sensitivity": "add k*ay to gz where you read it",
    "gyro_noise": "multiply the gyro's noise by the factor where you read it",
    "accel_bias": "add the bias to ax and ay where you read them",
    "accel_scale": "multiply ax and ay by the scale where you read them",
    "imu_yaw": "turn the IMU's frame by the angle",
    "imu_offset": "move the IMU in the body",
    "vibration": "add white noise of standard deviation k*|v| to ax and ay where you read them",
    "missed_ticks": "multiply each encoder's angle by (1 - share) and round down to ticks where you read it",
    "beacon_delay": BEACONS,
    "beacon_shift": BEACONS,
    "beacon_rotation": BEACONS,
    "beacon_scale": BEACONS,
    "tag_offset": BEACONS,
    "beacon_noise": BEACONS,
    "beacon_outliers": BEACONS,
    "beacon_shadow": BEACONS,
    "anchor_moved": BEACONS,
    "range_bias": BEACONS,
    "imu_clock": "add the offset to the IMU's stamps",
    "clock_drift": "stretch the IMU's stamps by (1 + skew)",
    "wheel_slip": "lower the friction of the tyres",
    "floor_tilt": "turn gravity by the slopes",
    "speed_limit": "clip each wheel's rim speed to the limit before it is sent",
    "accel_limit": "limit the rate of change of each wheel's rim speed before it is sent",
    "drive_gain": "multiply the wheel speeds by the gain before they are sent",
    "wheel_radius": "build the wheels with this radius",
    "unequal_wheels": "build the wheels with unequal radii",
    "track_width": "build the robot with this track",
}


def outside(but: set[str]) -> dict[str, str]:
    """The advice for every effect but those that the target knows."""
    return {effect: advice for effect, advice in OUTSIDE.items() if effect not in but}
