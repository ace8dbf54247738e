"""Speed of the simulator: steps a second for the full chain, all effects compiled in. A step is one IMU sample.

Times of one core are that thread's own, so that others on the machine disturb them less; those of all cores are the
clock's, and beside it what their own time gives: what the clock shows where nobody else is at work. MuJoCo drives the
same run with the same robot (the MJCF export), one core each, physics alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np
from mujoco.rollout import rollout
from numba import get_num_threads

from app.examples.mujoco_robot import model_of, set_points
from core.robot import EffectSet
from core.run import Run
from core.simulation import params as P
from core.simulation import simulate, simulate_many, warm
from core.simulation.inputs import prepare
from core.simulation.scenarios import SCENARIOS, Rates
from core.simulation.simulate import simulate_sets

ALL_OF_THE_PLANT: EffectSet = {
    "command_delay": {"delay": 0.05},
    "motor_lag": {"tau": 0.08},
    "speed_limit": {"v_max": 0.65},
    "accel_limit": {"a_max": 0.4},
    "deadband": {"width": 0.02},
    "drive_gain": {"gain": 0.98},
    "battery_sag": {"rate": 1e-4},
    "wheel_radius": {"scale": 1.01},
    "unequal_wheels": {"ratio": 1.005},
    "track_width": {"scale": 1.02},
    "wheel_slip": {"k": 0.05},
    "side_slip": {"k": 0.05},
    "slip_patch": {"x": 4.0, "y": 4.0, "radius": 1.0, "slip": 0.3},
    "bump": {"time": 40.0, "distance": 0.02, "turn": 0.05},
    "floor_tilt": {"slope_x": 0.01},
    "gyro_drift": {"amplitude": 0.01, "tau": 60.0},
}
ALL: EffectSet = {
    **ALL_OF_THE_PLANT,
    "gyro_bias": {"bias": 0.004},
    "gyro_walk": {"density": 1e-4},
    "gyro_temperature": {"slope": 1e-4},
    "gyro_scale": {"scale": 1.01},
    "gyro_noise": {"factor": 2.0},
    "gyro_clip": {"limit": 1.0},
    "gyro_g_sensitivity": {"k": 1e-3},
    "accel_bias": {"x": 0.05, "y": -0.05},
    "accel_scale": {"x": 1.02, "y": 0.98},
    "imu_yaw": {"angle": 0.02},
    "imu_offset": {"x": 0.03, "y": 0.01},
    "vibration": {"k": 0.1},
    "missed_ticks": {"left": 0.01, "right": 0.0},
    "beacon_delay": {"delay": 0.1},
    "beacon_shift": {"x": 0.1, "y": 0.1},
    "beacon_rotation": {"angle": 0.02},
    "beacon_scale": {"scale": 1.01},
    "tag_offset": {"x": 0.02, "y": 0.02},
    "beacon_noise": {"factor": 2.0},
    "beacon_outliers": {"rate": 0.05, "size": 0.5},
    "beacon_shadow": {"x": 4.0, "y": 4.0, "radius": 0.5},
    "anchor_moved": {"beacon": "B1", "x": 0.2, "y": 0.0},
    "range_bias": {"bias": 0.1},
    "imu_clock": {"offset": 0.004},
    "clock_drift": {"skew": 1e-4},
}
CASES: dict[str, EffectSet] = {
    "nominal": {},
    "motor lag": {"motor_lag": {"tau": 0.08}},
    "track width + gyro drift": {"track_width": {"scale": 1.02}, "gyro_drift": {"amplitude": 0.01, "tau": 60.0}},
    "16 plant and IMU effects at once": ALL_OF_THE_PLANT,
    "all 41 effects at once": ALL,
}


def best(work: Callable[[], object], clock: Callable[[], float], repeats: int = 9) -> float:
    """Shortest time of several [s]."""
    times = []
    for _ in range(repeats):
        t = clock()
        work()
        times.append(clock() - t)
    return min(times)


def mujoco_seconds(run: Run, step: float) -> float:
    """One core's time for MuJoCo's rollout of the run's robot under its commands, nothing read but its sensors [s]."""
    model = model_of(run, {})
    model.opt.timestep = step
    data, full = mujoco.MjData(model), mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, state, full)
    control = set_points(run, np.arange(0.0, run.duration, step))[None]
    return best(lambda: rollout(model, data, state[None], control), time.thread_time, 3)


def against_mujoco(run: Run) -> None:
    """The same run by both, seconds of driving a second."""
    inputs, sets = prepare(run), P.pack(run.meta, {})[None]
    every = P.pack(run.meta, ALL_OF_THE_PLANT)[None]
    ours = best(lambda: simulate_sets(inputs, sets, parallel=False), time.thread_time, 50)
    full = best(lambda: simulate_sets(inputs, every, parallel=False), time.thread_time, 50)
    for step in (0.002, 0.001):
        theirs = mujoco_seconds(run, step)
        print(
            f"  MuJoCo, steps of {1e3 * step:.0f} ms: {run.duration / theirs:.0f} s of driving a second, ours"
            f" {run.duration / ours:.0f} ({theirs / ours:.0f} times as fast; with 16 effects {theirs / full:.0f} times)"
        )


def main() -> None:
    t = time.perf_counter()
    warm()
    print(f"warm start (compiled, or loaded from numba's cache): {time.perf_counter() - t:.1f} s")
    run = SCENARIOS["mission"].run(Rates(commands=20.0))
    inputs, steps = prepare(run), len(run.imu.t)  # type: ignore[union-attr]
    streams = ", ".join(f"{name} {log.rate:.0f} Hz" for name, log in run.logs().items())
    print(f"{run.duration:.0f} s of driving, every stream ({streams}), without noise")
    for name, effects in CASES.items():
        sets = np.stack([P.pack(run.meta, effects)] * 16)
        sets[:, P.X0] += 1e-6 * np.arange(16)  # no two drive alike: paths that are equal are driven once
        simulate_sets(inputs, sets)
        one = best(lambda sets=sets: simulate_sets(inputs, sets, parallel=False), time.thread_time)
        both = best(lambda sets=sets: simulate_sets(inputs, sets), time.perf_counter)
        spent = best(lambda sets=sets: simulate_sets(inputs, sets), time.process_time) / get_num_threads()
        print(
            f"  {name:34s} one core {16 * steps / one / 1e6:5.2f} M steps/s, {get_num_threads()} cores"
            f" {16 * steps / both / 1e6:5.2f} by the clock, {16 * steps / spent / 1e6:5.2f} by their own time"
        )
    sets20: list[EffectSet] = [{"track_width": {"scale": 1.0 + 1e-3 * i}} for i in range(20)]
    print(f"  20 effect sets as one call: {1e3 * best(lambda: simulate_many(run, sets20), time.perf_counter):.0f} ms")
    print(f"  one run with noise: {1e3 * best(lambda: simulate(run, ALL_OF_THE_PLANT, 1), time.perf_counter):.0f} ms")
    against_mujoco(run)


if __name__ == "__main__":
    main()
