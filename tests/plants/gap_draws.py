"""What to draw for the gap's worlds: each effect with a size between a few and many times its tolerance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.plants.gap_plant import OUTSIDE, Effects, Plan

TOLERANCES = {
    "command_delay.delay": 0.004, "motor_lag.tau": 0.005, "deadband.width": 0.003, "drive_gain.gain": 0.001,
    "battery_sag.rate": 6e-6, "wheel_radius.scale": 0.001, "unequal_wheels.ratio": 6e-4, "track_width.scale": 0.002,
    "wheel_slip.k": 0.004, "side_slip.k": 0.003, "gyro_bias.bias": 1e-4, "gyro_walk.density": 2e-5,
    "gyro_temperature.slope": 4e-5, "gyro_scale.scale": 0.002, "gyro_g_sensitivity.k": 4e-4, "imu_yaw.angle": 0.007,
    "vibration.k": 0.012, "beacon_delay.delay": 0.025, "beacon_rotation.angle": 0.003, "beacon_scale.scale": 0.002,
    "range_bias.bias": 0.008, "imu_clock.offset": 0.001, "clock_drift.skew": 2e-5, "gyro_drift.amplitude": 2e-4,
    "slip_patch.slip": 0.03,
}  # fmt: skip
ONE_SIDED = (
    "command_delay",
    "motor_lag",
    "deadband",
    "battery_sag",
    "wheel_slip",
    "gyro_walk",
    "vibration",
    "beacon_delay",
    "slip_patch",
)
PAIRS = {
    "floor_tilt": ("slope_x", "slope_y", 6e-4),
    "accel_bias": ("x", "y", 0.002),
    "accel_scale": ("x", "y", 0.01),
    "imu_offset": ("x", "y", 0.01),
    "missed_ticks": ("left", "right", 6e-4),
    "beacon_shift": ("x", "y", 0.01),
    "tag_offset": ("x", "y", 0.01),
    "anchor_moved": ("x", "y", 0.015),
}
NAMES = (
    *(key.split(".")[0] for key in TOLERANCES), *PAIRS, "speed_limit", "accel_limit", "gyro_clip", "gyro_noise",
    "beacon_noise", "beacon_outliers", "beacon_shadow", "bump",
)  # fmt: skip


def draw(name: str, times: float, rng: np.random.Generator) -> Effects:
    """One effect of so many times its tolerance."""
    sign = 1.0 if name in ONE_SIDED else float(rng.choice([-1.0, 1.0]))
    for key, small in TOLERANCES.items():
        effect, parameter = key.split(".")
        if effect == name:
            neutral = 1.0 if parameter in ("scale", "gain", "ratio") else 0.0
            size = min(
                small * times,
                {"slip": 0.5, "skew": 5e-4, "delay": 0.4, "tau": 0.2, "angle": 0.2, "width": 0.05}.get(
                    parameter, np.inf
                ),
            )
            values: dict[str, float | str] = {parameter: neutral + sign * size}
            if name == "gyro_drift":
                values["tau"] = float(rng.uniform(25.0, 90.0))
            if name == "slip_patch":
                values |= {
                    "x": float(rng.uniform(2.0, 3.0)),
                    "y": float(rng.uniform(1.5, 2.5)),
                    "radius": float(rng.uniform(0.5, 1.0)),
                }
            return {name: values}
    if name in PAIRS:
        a, b, small = PAIRS[name]
        angle = float(rng.uniform(0.0, 2.0 * np.pi))
        size = min(small * times, 0.3)
        x, y = size * np.cos(angle), size * np.sin(angle)
        if name == "missed_ticks":
            x, y = abs(x), abs(y)
        base = 1.0 if name == "accel_scale" else 0.0
        values = {a: base + x, b: base + y}
        if name == "anchor_moved":
            values["beacon"] = str(rng.choice(["A", "B", "C", "D"]))
        return {name: values}
    more = min(times / 20.0, 1.0)
    others: dict[str, dict[str, float | str]] = {
        "speed_limit": {"v_max": 0.75 - 0.35 * more},
        "accel_limit": {"a_max": 0.8 - 0.4 * more},
        "gyro_clip": {"limit": 0.85 - 0.35 * more},
        "gyro_noise": {"factor": 1.0 + 0.06 * min(times, 15.0)},
        "beacon_noise": {"factor": 1.0 + 0.1 * min(times, 15.0)},
        "beacon_outliers": {"rate": min(0.015 * times, 0.2), "size": 0.5},
        "beacon_shadow": {"x": 2.5, "y": 2.0, "radius": min(0.1 * times, 0.7)},
        "bump": {"time": float(rng.uniform(8.0, 30.0)), "distance": sign * 0.002 * times, "turn": 0.005 * times},
    }
    return {name: others[name]}


SEES = {
    "imu": ("gyro", "accel_bias", "accel_scale", "imu_", "vibration", "clock_drift", "floor_tilt", "bump"),
    "commands": ("command_delay", "motor_lag", "_limit", "deadband", "drive_gain", "battery_sag", "missed_ticks"),
}
"""Effects that show only, or chiefly, in a stream (parts of their names)."""


POSES = ("truth", "fix", "ranges", "both", "none")
STREAMS = [(c, i, p) for p in POSES for c in (True, False) for i in (True, False) if c or i or p != "none"]
"""(commands, IMU, what tells the pose): every combination of streams that says anything."""


def _shown(commands: bool, imu: bool, pose: str) -> list[str]:
    """Effects that these streams can show."""
    blind = [*(() if imu else SEES["imu"]), *(() if commands else SEES["commands"])]
    if pose == "none":  # dead reckoning: the wheels against the commands, the IMU against the wheels
        blind += [*BEACONS, "slip_patch", "wheel_radius", *(() if imu else BODY)]
    if pose in ("truth", "fix"):
        blind += ["range_bias", "anchor_moved"]
    if pose in ("truth", "ranges"):
        blind += ["beacon_shift", "beacon_rotation"]
    if pose == "truth":
        blind += list(BEACONS)
    return [name for name in sorted(set(NAMES)) if not any(part in name for part in blind)]


BEACONS = ("beacon_", "range_bias", "anchor_moved", "tag_offset")
BODY = ("unequal_wheels", "track_width", "wheel_slip", "side_slip")


KINDS = {"small": 5, "pair": 11, "no truth": 19, "no imu": 23, "no commands": 29}
"""Where each kind of case begins in the list of effects: together they draw all."""


def _names_for(kind: str) -> list[str]:
    """Effects that the streams of this kind of case can show."""
    blind = {"no imu": SEES["imu"], "no commands": SEES["commands"]}.get(kind, ())
    return [name for name in sorted(set(NAMES)) if not any(part in name for part in blind)]


def plans(kind: str, seed: int, ordinary: bool = True) -> tuple[list[Plan], Plan, Effects, str]:
    """(fit runs, held-out run, answer, label) of one case.

    kind: null, noise (sheet off by 1.5), small (2.5 tolerances), single (6 to 30), pair, no truth, no imu, no commands,
    open (a cause that no list has), streams and streams null (each combination of streams in turn).
    """
    if kind.startswith("streams"):
        return _of_streams(seed, kind == "streams null", ordinary)
    rng = np.random.default_rng([seed, 7])
    names = _names_for(kind)
    times = float(np.exp(rng.uniform(np.log(6.0), np.log(30.0)))) if kind != "small" else 2.5
    chosen = [] if kind in ("null", "noise", "open") else [names[(seed * 17 + KINDS.get(kind, 0)) % len(names)]]
    if kind == "pair":
        chosen.append(str(rng.choice([n for n in names if n not in chosen])))
    effects: dict[str, dict[str, float | str]] = {}
    for name in chosen:
        effects |= {k: dict(v) for k, v in draw(name, times, rng).items()}
    outside = {}
    if kind == "open":
        name = sorted(OUTSIDE)[seed % len(OUTSIDE)]
        outside = {name: OUTSIDE[name] * float(rng.uniform(0.7, 2.0))}
        chosen = [name]
    plan = Plan(
        seed,
        effects=effects,
        outside=outside,
        truth=kind != "no truth",
        imu=kind != "no imu",
        commands=kind != "no commands",
        stated=float(rng.choice([1 / 1.5, 1.5])) if kind == "noise" else 1.0,
        sensors="both" if any(of_poses(n) for n in chosen) else str(rng.choice(["fix", "ranges", "both"])),
        ordinary=ordinary,
    )
    fit = [replace(plan, profile="mixed", seconds=45.0), replace(plan, profile="turns", seconds=35.0)]
    return fit, replace(plan, profile="stops", seconds=40.0), effects, "+".join(chosen)


def _of_streams(seed: int, clean: bool, ordinary: bool) -> tuple[list[Plan], Plan, Effects, str]:
    """A case whose robot has one combination of streams, by the seed."""
    rng = np.random.default_rng([seed, 7])
    commands, imu, pose = STREAMS[seed % len(STREAMS)]
    names = _shown(commands, imu, pose)
    name = names[(seed * 17) % len(names)]
    effects = {} if clean else draw(name, float(np.exp(rng.uniform(np.log(6.0), np.log(30.0)))), rng)
    plan = Plan(
        seed,
        effects=effects,
        truth=pose == "truth",
        imu=imu,
        commands=commands,
        sensors="none" if pose in ("truth", "none") else pose,
        ordinary=ordinary,
    )
    fit = [replace(plan, profile="mixed", seconds=45.0), replace(plan, profile="turns", seconds=35.0)]
    told = f"{'commands, ' if commands else ''}{'imu, ' if imu else ''}{pose}: {'' if clean else name}"
    return fit, replace(plan, profile="stops", seconds=40.0), effects, told


def of_poses(name: str) -> bool:
    """Whether fixes and ranges are needed to see this."""
    return any(part in name for part in ("fix", "beacon", "range", "anchor", "tag", "heading_echo"))
