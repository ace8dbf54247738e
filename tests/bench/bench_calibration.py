"""Calibration of sensors drawn over Kolhoff & Kemper's Table 1: errors, errors over claimed sd, and what correction
reaches on a later run of the same sensor. Seeds are those of the rig; `--only` picks sets by a part of their names.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from core.calibration.imu import ImuCalibration, SensorModel, calibrate, judge_correction
from core.run import Run
from tests.plants.imu_rig import DEG, G, Rig, draw_rig, rate_table_run, rest_run, six_position_run

WHITE = {"flicker": (0.0, 0.0), "outliers": (0.0, 0.0), "quantum": (0.0, 0.0)}


def usual(rig: Rig, seed: int) -> list[Run]:
    return [rest_run(rig, seed + 1), six_position_run(rig, seed + 2), rate_table_run(rig, seed + 3)]


def one_each_way(rig: Rig, seed: int) -> list[Run]:
    """The paper's way: a record at rest in each position, each from a cold start, and the table."""
    rests = [rest_run(rig, seed + k, 1200.0, up=k) for k in range(6)]
    return [*rests, rate_table_run(rig, seed + 7)]


def twice(rig: Rig, seed: int) -> list[Run]:
    return [*usual(rig, seed), *(rest_run(rig, seed + k, 1800.0) for k in (4, 5)), six_position_run(rig, seed + 6)]


SETS: dict[str, tuple[dict[str, object], Callable[[Rig, int], list[Run]]]] = {
    "rest, six positions, table": ({}, usual),
    "the same, white noise only": (WHITE, usual),
    "six rests of 20 min, table": ({}, one_each_way),
    "rest of 20 min alone": ({}, lambda rig, seed: [rest_run(rig, seed + 1, 1200.0)]),
    "six positions and table": ({}, lambda rig, seed: usual(rig, seed)[1:]),
    "turn-on scatter, six runs": ({"turn_on": (0.02 * DEG, 0.01)}, twice),
    "fixture of 0.1 deg": ({"fixture": 0.1 * DEG}, usual),
}
NUMBERS = ("static_bias", "drift_amplitude", "drift_tau", "matrix", "noise_sd")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seeds", type=int, default=10)
    options.add_argument("--first", type=int, default=100)
    options.add_argument("--only", default="")
    options.add_argument("--no-correction", action="store_true")
    options.add_argument("--limit", action="store_true", help="only what a perfect calibration would leave")
    chosen = options.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.seeds)
    print(f"seeds {seeds[0]} to {seeds[-1]}; error: median of |error|, SI; z: error over claimed sd")
    for name, (settings, make) in SETS.items():
        if chosen.only in name and chosen.limit:
            judge_perfect(name, settings, seeds)
        elif chosen.only in name:
            judge_set(name, settings, make, seeds, correction=not chosen.no_correction)


def judge_perfect(name: str, settings: dict[str, object], seeds: range) -> None:
    """Mean error left on the later hour by the true parameters, and by them with the column that gravity stands on off
    by what tilted positions cannot tell: three of them show it, each with its own tilt, about two axes (Cramer-Rao)."""
    print(f"\n{name}")
    for seed in seeds:
        rig = draw_rig(seed, **settings)
        truth = ImuCalibration(
            **{s: SensorModel(**{n: getattr(getattr(rig, s), n) for n in NUMBERS}) for s in ("gyro", "accel")}
        )
        judged = judge_correction(rest_run(rig, 1000 * seed + 99, 3000.0), truth)
        raw = float(np.linalg.norm(judged.raw.mean[:3]))
        tilt = G * rig.fixture * np.sqrt(2 / 3)
        left = judged.mean_left_sensor
        print(
            f"  seed {seed}: accelerometer off by {raw:.3f} m/s2; left by the truth {left[0]:.1%}, gyro {left[1]:.1%}; "
            f"with tilts {np.hypot(left[0], tilt / raw):.1%}",
            flush=True,
        )


def judge_set(
    name: str, settings: dict[str, object], make: Callable[[Rig, int], list[Run]], seeds: range, *, correction: bool
) -> None:
    errors: dict[tuple[str, str], list[tuple[float, float]]] = {}
    taus: list[tuple[float, float]] = []
    reached: list[tuple[float, ...]] = []
    spent = 0.0
    for seed in seeds:
        rig = draw_rig(seed, **settings)
        runs = make(rig, 1000 * seed)
        began = time.process_time()
        report = calibrate(runs)
        spent += time.process_time() - began
        made = report.calibration
        for sensor in ("gyro", "accel"):
            for number in NUMBERS:
                true = np.ravel(getattr(getattr(rig, sensor), number))
                if number == "noise_sd":  # of a reading: rounding is part of it
                    true = np.hypot(true, rig.quantum[sensor == "accel"] / np.sqrt(12))
                found = np.ravel(getattr(getattr(made, sensor), number))
                sd = np.ravel(getattr(getattr(made.sd, sensor), number))
                errors.setdefault((sensor, number), []).extend(zip(found - true, sd, strict=True))
        for axis in report.axes.values():
            true_tau = (rig.accel if axis.axis[0] == "a" else rig.gyro).drift_tau["xyz".index(axis.axis[1])]
            if np.isfinite(axis.fit.tau):
                taus += [(p.tau / true_tau, axis.fit.tau / true_tau) for p in axis.paper]
        if correction:
            judged = judge_correction(rest_run(rig, 1000 * seed + 99, 3000.0), made)
            parts = (judged.noise_factor, judged.mean_left_sensor, judged.mean_left[3:], judged.correlation)
            reached.append((parts[0].min(), *parts[1], parts[2].max(), parts[3].min()))
    print(f"\n{name} ({spent / len(seeds):.1f} s of CPU a calibration)")
    for (sensor, number), pairs in errors.items():
        error, sd = np.array(pairs).T
        known = np.isfinite(error)
        if not known.any():
            print(f"  {sensor:5} {number:16} null")
            continue
        z = error[known] / sd[known]
        print(
            f"  {sensor:5} {number:16} shown {known.mean():4.0%}  error {np.median(np.abs(error[known])):9.2e}"
            f"  z rms {np.sqrt(np.mean(z**2)):5.2f}  mean {z.mean():5.2f}  largest {np.abs(z).max():5.1f}"
        )
    if taus:
        paper, ours = np.array(taus).T
        print(f"  tau over true: 1/e rule {np.nanmedian(paper):.2f}, joint fit {np.median(ours):.3f} (medians)")
    if reached:
        table = np.array(reached)
        print(
            f"  correction of a later hour at rest: sd down {table[:, 0].min():.2f} times at least; mean error left "
            f"accel {table[:, 1].max():.1%}, gyro {table[:, 2].max():.1%} at most (worst single gyro axis "
            f"{table[:, 3].max():.1%}); online to offline {table[:, 4].min():.2%} at least",
            flush=True,
        )


if __name__ == "__main__":
    main()
