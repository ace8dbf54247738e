"""How many of the injected slips could anything find? An oracle beside the detectors of bench_events. By hand.

`python -m tests.bench.bench_events_bound [--first 3000] [--seeds 14]`

The oracle knows each slip's onset, end and exact shape in the two residuals that show it (wheels' turn against the
gyro's, wheels' change of speed against the accelerometer's), and all constants of robot and sensors. Against the noise
that the same plant's sensors and floor have, with its covariance from step to step, it runs the likelihood-ratio test,
which is the most powerful one (Neyman, Pearson), at one false alarm per hour of 40 ms steps: found with probability
Phi(sqrt(s' C^-1 s) - z). `sure`: the share of slips for which that is over 99 %.
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_toeplitz
from scipy.stats import norm

from core.estimation.events import detect
from tests.bench.bench_events import SIZES, judge, numbers
from tests.plants.fault_missions import DT, TRACK
from tests.plants.faults import RADIUS, FaultRun, Flaws, Label, fault_run

Array = npt.NDArray[np.float64]

STEP, LAGS, LONGEST = 2, 24, 60  # wheel readings of a step; steps
AFTER = 0.2  # s behind a slip's end, in which the body follows
SPEEDS = (0.05, 0.15, 0.5)  # m/s, edges of the bins in which noise is alike
THRESHOLD = float(norm.isf(1.0 / (3600.0 / 0.04)))
KNOWN = Flaws(tyre=0.0, track=0.0, gyro_bias=0.0, gyro_scale=0.0, accel_bias=0.0, mount=0.0, delay=0.0)


def residuals(made: FaultRun) -> tuple[Array, Array]:
    """Speed (K,) and residuals (K, 2) [rad, m/s] per step of a run without flaws or faults: noise alone."""
    run = made.run
    assert run.wheels is not None and run.imu is not None and run.imu.ax is not None
    t = run.wheels.t[::STEP]
    left, right = (np.asarray(c, np.float64)[::STEP] * RADIUS for c in (run.wheels.left, run.wheels.right))
    imu = run.imu.t - 0.005  # a reading is the mean of the 10 ms before its stamp
    forward = np.asarray(run.imu.ax, np.float64) + 0.05 * np.asarray(run.imu.gz, np.float64) ** 2
    turned, sped = (_integral(imu, c, t) for c in (np.asarray(run.imu.gz, np.float64), forward))
    travelled = _integral(imu, np.interp(imu, t, sped), t)  # mean speed by the accelerometer, over each step
    h = np.diff(t)
    v = np.diff(left + right) / 2 / h
    turn = np.diff(right - left) / TRACK - np.diff(turned)
    along = np.diff(v - np.diff(travelled) / h, prepend=v[0])
    return np.abs(v) + np.abs(np.diff(right - left)) / 2 / h, np.column_stack((turn, along))


def _integral(t: Array, rate: Array, at: Array) -> Array:
    total = np.concatenate(([0.0], np.cumsum(np.diff(t) * (rate[1:] + rate[:-1]) / 2)))
    return np.asarray(np.interp(at, t, total), np.float64)


def covariances(runs: list[FaultRun]) -> Array:
    """(bins, 2, LAGS) autocovariance of both residuals by speed."""
    found = np.zeros((len(SPEEDS) + 1, 2, LAGS))
    weight = np.zeros((len(SPEEDS) + 1, LAGS))
    for made in runs:
        speed, r = residuals(made)
        place = np.searchsorted(SPEEDS, speed)
        for k in range(LAGS):
            for b in range(len(SPEEDS) + 1):
                rows = np.flatnonzero(place[: len(r) - k] == b)
                found[b, :, k] += np.sum(r[rows] * r[rows + k], axis=0)
                weight[b, k] += len(rows)
    return found / np.maximum(weight, 1.0)[:, None, :]


def power(label: Label, made: FaultRun, noise: Array) -> float:
    """Probability that the oracle finds a slip."""
    width = round(0.04 / DT)
    begin = int(label.t0 / DT) - width
    edges = np.arange(begin, min(int((label.t1 + AFTER) / DT) + width, len(made.motion) - 1), width)[: LONGEST + 1]
    gone = np.vstack((np.zeros(2), np.cumsum(made.motion[begin : edges[-1] + 1, 8:10], axis=0) * DT))
    left, right = np.diff(gone[edges - begin], axis=0).T
    ahead = (left + right) / 2 / 0.04
    signal = np.column_stack(((right - left) / TRACK, np.diff(ahead, prepend=0.0)))
    b = int(np.searchsorted(SPEEDS, float(np.max(np.abs(made.motion[edges[0] : edges[-1], 6:8])))))
    total = 0.0
    for k in range(2):
        column = np.zeros(len(signal))
        column[: min(LAGS, len(signal))] = noise[b, k, : len(signal)] * np.linspace(1, 0, LAGS)[: len(signal)]
        total += float(signal[:, k] @ solve_toeplitz(column, signal[:, k]))
    return float(norm.cdf(np.sqrt(max(total, 0.0)) - THRESHOLD))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--first", type=int, default=3000)
    options.add_argument("--seeds", type=int, default=14)
    chosen = options.parse_args()
    noise = covariances([fault_run(seed, 900.0, (), KNOWN) for seed in range(3500, 3504)])
    rows: list[tuple[float, float, bool]] = []
    for seed in range(chosen.first, chosen.first + chosen.seeds):
        made = fault_run(seed, 600.0)
        found = detect(made.run, numbers(made.run, 1.0))
        for label in made.labels:
            if label.kind == "slip":
                rows.append((label.size, power(label, made, noise), judge(label, found.events, found).found))
    size, oracle, ours = (np.array(column) for column in zip(*rows, strict=True))
    print(f"{'slip of':>16s} {'faults':>6s} {'oracle':>7s} {'sure':>7s} {'found':>7s} {'of the sure':>11s}")
    for low, high in [*itertools.pairwise(SIZES["slip"]), (0.0, np.inf)]:
        mine = (size >= low) & (size < high)
        sure = mine & (oracle > 0.99)
        print(
            f"{f'{low:g} to {high:g} m':>16s} {mine.sum():6d} {oracle[mine].mean():7.1%} {sure.sum() / mine.sum():7.1%}"
            f" {ours[mine].mean():7.1%} {ours[sure].mean():11.1%}"
        )


if __name__ == "__main__":
    main()
