"""Heading error of every bias method on simulated 12 h runs: median and worst of seeds, every scenario.

`--rate 384` is the paper's sampling (slower, and what A, B and C are judged at); the filters see block means, for
which a lower rate of the same noise density is as good.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from core.imu.bias import FilterConfig, heading_errors, known_rests, track_bias
from core.imu.bias.result import BiasEstimate
from tests.plants.gyro import DEG, DEG_H, SCENARIOS, VARIATIONS, GyroPlant, gyro_plant

ALL = ("A", "B", "C", "best", "smoothed", "known", "known, hindsight")
HOUR = 3600.0
WARM_UP = 600.0  # s, before which no bias is judged


def estimate(plant: GyroPlant, method: str) -> BiasEstimate:
    run = plant.run()
    if method.startswith("known"):
        assert run.imu is not None
        return known_rests(run, run.imu, plant.resting, FilterConfig(), hindsight="hindsight" in method)
    return track_bias(run, method)


def judge(plant: GyroPlant, method: str) -> dict[str, float]:
    """Largest error [deg], net and worst hourly rate [deg/h], final heading error and bias errors over claimed sd."""
    made = estimate(plant, method)
    errors = heading_errors(made, plant.run().truth)
    assert errors is not None
    out = {"max": errors.max_rad / DEG, "net": abs(errors.net_rate) / DEG_H, "hourly": errors.hourly_rate / DEG_H}
    out["minutes"] = float(np.append(errors.t[np.abs(errors.error) > 20 * DEG], np.inf)[0] / 60)
    if made.theta_sd is not None:
        out["z"] = float(errors.error[-1] / np.interp(errors.t[-1], made.t, made.theta_sd))
        hours = np.arange(0.0, errors.t[-1] - errors.t[0], HOUR) + errors.t[0]
        grown = np.diff(np.interp(hours, errors.t, errors.error))
        out["z_hour"] = float(
            np.sqrt(np.mean(grown**2) * (len(hours) - 1)) / np.interp(hours[-1], made.t, made.theta_sd)
        )
        late = made.t > WARM_UP
        true = np.interp(made.t[late], plant.t, plant.bias)
        out["z_bias"] = float(np.sqrt(np.mean(((true - made.bias[late]) / made.sd[late]) ** 2)))
    return out


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seeds", type=int, default=6)
    options.add_argument("--first", type=int, default=100)
    options.add_argument("--rate", type=float, default=48.0)
    options.add_argument("--methods", default="best,smoothed,known")
    options.add_argument("--only", help="scenarios by name, else by a part of it; several with ; between")
    chosen = options.parse_args()
    print("max [deg], net [deg/h]: median / worst of seeds; hourly [deg/h]: worst; 20 deg are passed at [min]; z, root")
    print("mean squares over claimed sd: the final heading error, its growth by the hour, and the bias error")
    print(
        "scenario               method                      max             net  hourly   20 deg       z z hour z bias"
    )
    plants = SCENARIOS | VARIATIONS
    for name, scenario in plants.items():
        if chosen.only and not any(p == name if p in plants else p in name for p in chosen.only.split(";")):
            continue
        rows: dict[str, list[dict[str, float]]] = {}
        for seed in range(chosen.first, chosen.first + chosen.seeds):
            plant = gyro_plant(seed, dataclasses.replace(scenario, rate=chosen.rate))
            for method in ALL:
                if method in chosen.methods.split(","):
                    rows.setdefault(method, []).append(judge(plant, method))
        for method, found in rows.items():
            column = {key: np.array([row[key] for row in found]) for key in found[0]}
            z = [
                f"{np.sqrt(np.mean(column[k] ** 2)):6.2f}" if k in column else "     -"
                for k in ("z", "z_hour", "z_bias")
            ]
            print(
                f"{name:22} {method:17} {np.median(column['max']):7.2f} /{column['max'].max():6.2f} "
                f"{np.median(column['net']):7.3f} /{column['net'].max():6.3f} {column['hourly'].max():7.2f} "
                f"{np.median(column['minutes']):8.0f} {z[0]} {z[1]} {z[2]}",
                flush=True,
            )


if __name__ == "__main__":
    main()
