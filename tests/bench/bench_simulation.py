"""Speed of the simulator: steps a second for the full chain, all effects compiled in. A step is one IMU sample.

Times of one core are that thread's own, so that others on the machine disturb them less; those of all cores are the
clock's.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numba import get_num_threads

from core.robot import EffectSet
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
CASES: dict[str, EffectSet] = {
    "nominal": {},
    "motor lag": {"motor_lag": {"tau": 0.08}},
    "track width + gyro drift": {"track_width": {"scale": 1.02}, "gyro_drift": {"amplitude": 0.01, "tau": 60.0}},
    "16 plant and IMU effects at once": ALL_OF_THE_PLANT,
}


def best(work: Callable[[], object], clock: Callable[[], float], repeats: int = 9) -> float:
    """Shortest time of several [s]."""
    times = []
    for _ in range(repeats):
        t = clock()
        work()
        times.append(clock() - t)
    return min(times)


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
        simulate_sets(inputs, sets)
        one = best(lambda sets=sets: simulate_sets(inputs, sets, parallel=False), time.thread_time)
        both = best(lambda sets=sets: simulate_sets(inputs, sets), time.perf_counter)
        print(
            f"  {name:34s} one core {16 * steps / one / 1e6:5.2f} M steps/s,"
            f" {get_num_threads()} cores {16 * steps / both / 1e6:5.2f} M steps/s"
        )
    sets20: list[EffectSet] = [{"track_width": {"scale": 1.0 + 1e-3 * i}} for i in range(20)]
    print(f"  20 effect sets as one call: {1e3 * best(lambda: simulate_many(run, sets20), time.perf_counter):.0f} ms")
    print(f"  one run with noise: {1e3 * best(lambda: simulate(run, ALL_OF_THE_PLANT, 1), time.perf_counter):.0f} ms")


if __name__ == "__main__":
    main()
