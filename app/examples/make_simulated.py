"""Makes `app/examples/simulated-mission`: one drive with every stream on it. Same seed, same bytes of readings.

Run it from anywhere: `python app/examples/make_simulated.py`. It replaces the folder.
"""

from __future__ import annotations

import dataclasses
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from core.formats import write_run
from core.robot import EffectSet, Pose
from core.run import Run
from core.sensors import Log
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS, Leg, Rates, Scenario, drive, stop, turn

SEED = 20260
FOLDER = Path(__file__).resolve().parent / "simulated-mission"

EFFECTS: EffectSet = {
    "motor_lag": {"tau": 0.06},
    "wheel_radius": {"scale": 1.006},
    "unequal_wheels": {"ratio": 1.004},
    "track_width": {"scale": 1.02},
    "slip_patch": {"x": 4.6, "y": 2.0, "radius": 0.7, "slip": 0.25},
    "gyro_bias": {"bias": 0.004},
    "gyro_drift": {"amplitude": 0.006, "tau": 90.0},
    "gyro_walk": {"density": 3e-5},
    "vibration": {"k": 0.08},
    "beacon_delay": {"delay": 0.08},
    "beacon_outliers": {"rate": 0.03, "size": 0.6},
    "beacon_shadow": {"x": 7.2, "y": 5.5, "radius": 0.9},
}
"""What this robot has and its simulator lacks."""


def legs() -> list[Leg]:
    """The library's mission, then one more round the other way: about five minutes with rests at every station."""
    quarter = math.pi / 2
    round_trip = [drive(4.0, 0.6), stop(8.0), turn(quarter), drive(3.0, 0.5, curvature=0.3), stop(5.0), turn(quarter)]
    round_trip += [drive(3.5, 0.7), stop(6.0), turn(quarter), drive(3.0, 0.4), stop(5.0), turn(quarter)]
    return [*SCENARIOS["mission"].legs(), *round_trip, *round_trip, stop(20.0)]


def temperature(t: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Die temperature [deg C]: warms up by 9 K with the gyro's own time constant, read in steps of 1/16 K."""
    return np.round((23.5 + 9.0 * (1.0 - np.exp(-t / 90.0))) * 16.0) / 16.0


def as_recorded(log: Log) -> Log:
    """Stamps to the microsecond, readings in single precision, as a logger writes them."""
    columns: dict[str, Any] = {
        k: v.astype(np.float32) if v.dtype == np.float64 else v for k, v in log.columns().items()
    }
    return dataclasses.replace(log, **{**columns, "t": np.round(log.t, 6)})


def make() -> Run:
    """The simulated run."""
    scenario = Scenario("simulated-mission", "mission", legs, Pose(1.5, 2.0, 0.0))
    blank = scenario.run(Rates(commands=20.0, wheels=50.0, imu=100.0, beacon=10.0, ranges=8.0, truth=20.0))
    assert blank.imu is not None
    imu = dataclasses.replace(blank.imu, temperature=temperature(blank.imu.t))
    meta = dataclasses.replace(blank.meta, name="Simulated mission with stops")
    run = simulate(dataclasses.replace(blank, meta=meta, imu=imu), EFFECTS, SEED)
    return dataclasses.replace(run, **{name: as_recorded(log) for name, log in run.logs().items()})  # type: ignore[arg-type]


if __name__ == "__main__":
    if FOLDER.exists():
        shutil.rmtree(FOLDER)
    write_run(make(), FOLDER, "folder-parquet")
