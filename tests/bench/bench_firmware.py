"""The firmware on an emulated Cortex-M7: instructions per sample, flash, RAM, and how far it is from Python.

QEMU counts instructions, not cycles: it knows nothing of caches, wait states or dual issue. Needs what
`tests/core/firmware/install.py` installs.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from core.calibration.imu import AXES, ImuCalibration
from core.firmware import TRACKERS, Noise, generate
from core.formats import read_run
from core.imu.bias import BiasEstimate, track_bias
from core.run import Run, RunMeta
from core.sensors import ImuLog
from tests.core.firmware.board import Replay, build, microseconds, records, run, size, write
from tests.core.firmware.logs import alike, bias_by, corrected, driving_log, live_heading, random_calibration, wrapped
from tests.plants.gyro import SCENARIOS, gyro_plant

EXAMPLE = Path(__file__).resolve().parents[2] / "app" / "examples" / "simulated-mission"
CLOCK = 480e6  # Hz, of the paper's Cortex-M7
NOTHING = {"schema": "calibration/1", "gyro": {"static_bias": [0, 0, 0]}, "accel": {}}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=3600.0, help="of the simulated log")
    options.add_argument("--seed", type=int, default=0)
    chosen = options.parse_args()
    print("Cortex-M7, gcc -O2: instructions per sample (median, mean, most), most at one a cycle and 480 MHz,")
    print("flash, RAM of a state, stack at most [bytes]. The paper's algorithm took 1.9 ms a sample, 912000 cycles.")
    print("tracker   rate   median     mean     most   most [us]   flash     RAM   stack")
    for bias in TRACKERS:
        for rate in (100.0, 400.0):
            cost(bias, rate, min(chosen.seconds, 1200.0), chosen.seed)
    print("\nLargest difference from Python on the same log: heading [rad], bias over its claimed sd, six axes")
    print("[m/s^2, rad/s]; labels of rest that differ; smallest correlation of six axes with offline processing.")
    print("tracker   log                heading    bias   accel    gyro   labels   correlation")
    for bias in TRACKERS:
        simulated(bias, chosen.seconds, chosen.seed)
        example(bias)
    print("\n12 h after Cechowicz 2017 at 48 Hz, on this machine: largest heading error [deg], firmware and Python")
    for bias in TRACKERS:
        for name in ("paper", "lively"):
            half_a_day(bias, name)


def cost(bias: str, rate: float, seconds: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    calibration = random_calibration(rng)
    t, readings = driving_log(rng, calibration, seconds, rate)
    with tempfile.TemporaryDirectory() as name:
        folder = write(generate(calibration, rate_hz=rate, bias=bias), Path(name))
        spent = run(build(folder, "m7"), records(t, readings)).instructions
        flash, ram, stack = size(folder)
    most = int(spent.max())
    print(
        f"{bias:8} {rate:5.0f} {np.median(spent):8.0f} {spent.mean():8.0f} {most:8d} {most / CLOCK * 1e6:11.1f}"
        f" {flash:7d} {ram:7d} {stack:7d}"
    )


def simulated(bias: str, seconds: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    calibration = random_calibration(rng)
    compare(bias, "simulated", calibration, *driving_log(rng, calibration, seconds, 100.0), 100.0)


def example(bias: str) -> None:
    imu = read_run(EXAMPLE).imu
    assert imu is not None
    t = microseconds(imu.t) / 1e6
    readings = np.column_stack([np.float32(getattr(imu, axis)) for axis in AXES]).astype(float)
    compare(bias, "simulated-mission", ImuCalibration.from_json(NOTHING), t, readings, 100.0)


def compare(bias: str, log: str, calibration: ImuCalibration, t: np.ndarray, readings: np.ndarray, rate: float) -> None:
    axes = corrected(calibration, t, readings, window=1)
    found = bias_by(bias, t, axes)
    noise = Noise(sd=found.figures["sigma_sr"]) if bias == "C" else Noise()
    with tempfile.TemporaryDirectory() as name:
        folder = write(generate(calibration, rate_hz=rate, bias=bias, noise=noise), Path(name))
        made = run(build(folder, "m7"), records(t, readings))
    heading, over_sd, labels = tracked(bias, made, found, t, axes)
    online = corrected(calibration, t, readings)
    off = [np.abs(made.values[axis] - online[:, j]).max() for j, axis in enumerate(AXES)]
    least = alike(calibration, t, readings, made.values).min()
    print(
        f"{bias:8} {log:18} {heading:9.1e} {over_sd:7.0e} {max(off[:3]):7.0e} {max(off[3:]):7.0e} {labels:8d}"
        f" {least:13.4f}"
    )


def half_a_day(bias: str, name: str) -> None:
    plant = gyro_plant(100, dataclasses.replace(SCENARIOS[name], rate=48.0))
    t = microseconds(plant.t - plant.t[0]) / 1e6
    readings = np.zeros((len(t), 6))
    readings[:, 5] = np.float32(plant.gz)
    found = track_bias(Run(RunMeta(name=name), imu=ImuLog(t, readings[:, 5])), bias)
    noise = Noise(sd=found.figures["sigma_sr"]) if bias == "C" else Noise()
    files = generate(ImuCalibration.from_json(NOTHING), rate_hz=48.0, bias=bias, noise=noise)
    with tempfile.TemporaryDirectory() as folder:
        made = run(build(write(files, Path(folder)), "host"), records(t, readings))
    heading = np.unwrap(made.values["heading"].astype(float))
    errors = []
    # Every 3 s, where blocks and segments end: between, both are live, each at its own stamps.
    every = found.t[30::30]
    place = np.searchsorted(t, every)
    for stamps, theta in ((t[place], heading[place]), (every, found.theta[30::30])):
        off = np.interp(stamps, plant.truth_t - plant.t[0], plant.truth_theta) - theta
        errors.append(np.degrees(np.abs(off - off[0]).max()))
    print(f"{bias:8} {name:18} {errors[0]:8.3f} {errors[1]:8.3f}")


def tracked(bias: str, made: Replay, found: BiasEstimate, t: np.ndarray, axes: np.ndarray) -> tuple[float, float, int]:
    """Heading [rad], bias over sd, labels that differ."""
    if bias == "C":
        heading, value = live_heading(found, t, axes[:, 5])
        off = np.abs(made.values["bias"] - value).max() / np.median(found.sd)
        return float(np.abs(wrapped(made.values["heading"] - heading)).max()), float(off), 0
    cells = round(found.figures["length"] * 10)
    stamps = found.t[cells::cells]
    place = np.searchsorted(t, stamps - 1e-9)
    place = place[place < len(t)]
    stamps, rows = stamps[: len(place)], slice(cells, cells * len(place) + 1, cells)
    rests = found.accepted[rows]
    # A stamp between readings is known with the next, and in movement the heading has gone on by then.
    compared = rests | (np.abs(t[place] - stamps) < 1e-9)
    turned = np.abs(wrapped(made.values["heading"][place] - found.theta[rows]))[compared]
    known = rests.cumsum() > 0
    off = np.abs(made.values["bias"][place] - found.bias[rows])[known] / found.sd[rows][known]
    return float(turned.max()), float(off.max()), int((made.at_rest[place] != rests).sum())


if __name__ == "__main__":
    main()
