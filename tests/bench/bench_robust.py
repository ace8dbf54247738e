"""Robots and sensors of many kinds: is any method better than `fused`, and are its ellipses right? By hand.

`python -m tests.bench.bench_robust [--first 2000] [--runs 40] [--each]`. Each run is a drive of the plant of
tests/plants/faults.py (tyres with grip, floors that shake, streams late by up to 5 ms), a third of them with faults.
Drawn: rates of IMU, wheels and fixes, ranges to 3 to 6 beacons in place of fixes, whether fixes have headings, noise
and whether run.json states it, 2 % outliers up to metres, an outage, a beacon system late by 100 ms, wheels 1 % wrong,
an IMU tilted by degrees, a gyro bias of 20 mrad/s, no accelerometer, an unknown start (dead reckoning then begins at
the true one by chance, and is not compared). Truth is exact, no alignment.
"""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from core.estimation import available, estimate
from core.metrics import evaluate, nees
from core.robot import Noise, TagMount
from core.run import Run
from core.sensors import BeaconLog, RangeLog
from tests.plants.faults import FAULTS, FaultRun, Flaws, fault_run

Array = npt.NDArray[np.float64]

SECONDS, DT = 150.0, 1e-3
DELAY = 0.005  # s by which streams may be late, each by its own: a path can be no better than its stamps
CLEARLY, LITTLE = 1.15, 0.005  # a method is better if its error is smaller by that factor and that many metres
NARROW = 0.85  # of the truth inside 95 % ellipses: less is a claim too bold


def drawn(seed: int) -> tuple[Run, dict[str, Any]]:
    """A run and what was drawn for it."""
    r = np.random.default_rng((11, seed))

    def sometimes(share: float) -> bool:
        return bool(r.random() < share)

    what: dict[str, Any] = {
        "imu": int(r.choice((50, 100, 200, 250, 500))), "wheels": int(r.choice((5, 10, 20, 50, 100))),
        "ranges": int(r.choice((3, 4, 5, 6))) if sometimes(0.4) else 0, "rate": float(r.choice((1, 2, 5, 10, 20))),
        "headed": sometimes(0.3), "sd": float(r.choice((0.01, 0.03, 0.1))), "stated": sometimes(0.6),
        "outliers": sometimes(0.4), "outage": sometimes(0.3), "late": sometimes(0.3), "start": sometimes(0.6),
        "wheel_off": sometimes(0.3), "tilted": sometimes(0.3), "biased": sometimes(0.3), "accel": sometimes(0.8),
        "faults": sometimes(0.33),
    }  # fmt: skip
    flaws = Flaws(
        tyre=0.01 if what["wheel_off"] else 0.003, mount=0.035 if what["tilted"] else 0.01,
        gyro_bias=0.02 if what["biased"] else 0.004, delay=DELAY,
    )  # fmt: skip
    made = fault_run(
        seed, SECONDS, FAULTS if what["faults"] else (), flaws, imu_rate=what["imu"], wheel_rate=what["wheels"]
    )
    run, tag = made.run, TagMount(0.1, -0.05, 0.4)
    t, xy, theta = _tag(made, what, r, tag)
    noise = run.meta.noise if what["stated"] else Noise()
    meta = dataclasses.replace(
        run.meta, robot=dataclasses.replace(run.meta.robot, tag=tag), start=run.meta.start if what["start"] else None
    )
    if what["ranges"]:
        run, meta = _ranged(run, meta, t, xy, what, r)
        noise = dataclasses.replace(noise, range=what["sd"]) if what["stated"] else noise
    else:
        xy = xy + what["sd"] * r.standard_normal(xy.shape) + _wild(len(t), what, r)
        log = BeaconLog(t, *xy.T.copy(), theta + 0.03 * r.standard_normal(len(t)) if what["headed"] else None)
        run = dataclasses.replace(run, beacon=log)
        noise = dataclasses.replace(noise, beacon_xy=what["sd"], beacon_theta=0.03) if what["stated"] else noise
    if not what["accel"]:
        run = dataclasses.replace(run, imu=type(run.imu)(run.imu.t, run.imu.gz))
    return dataclasses.replace(run, meta=dataclasses.replace(meta, noise=noise)), what


def _tag(made: FaultRun, what: dict[str, Any], r: np.random.Generator, tag: TagMount) -> tuple[Array, Array, Array]:
    """Stamps, places (M, 2) and headings of the readings that come through."""
    rate = what["rate"] * (2 if what["ranges"] else 1)
    rows = np.arange(int(r.integers(50, 500)), len(made.motion), round(1 / rate / DT))
    if what["outage"]:
        begin = r.uniform(0.3, 0.6) * len(made.motion)
        rows = rows[(rows < begin) | (rows > begin + r.uniform(20, 40) / DT)]
    x, y, theta = made.motion[rows, :3].T
    cos, sin = np.cos(theta), np.sin(theta)
    xy = np.column_stack((x + cos * tag.x - sin * tag.y, y + sin * tag.x + cos * tag.y))
    return rows * DT + (0.1 if what["late"] else 0.02) + 0.002 * r.random(len(rows)), xy, theta


def _wild(n: int, what: dict[str, Any], r: np.random.Generator) -> Array:
    hit = r.random((n, 1)) < (0.02 if what["outliers"] else 0.0)
    return np.where(hit, r.uniform(-3, 3, (n, 2)), 0.0)


def _ranged(run: Run, meta: Any, t: Array, xy: Array, what: dict[str, Any], r: np.random.Generator) -> tuple[Run, Any]:
    low, high = xy.min(axis=0) - 1.0, xy.max(axis=0) + 1.0
    angle = np.arange(what["ranges"]) * 2 * np.pi / what["ranges"] + r.uniform(0, 1)
    round_about = np.column_stack((np.cos(angle), np.sin(angle))) * 0.75 * (high - low) + (low + high) / 2
    places = np.column_stack((round_about, r.uniform(1.5, 3.0, len(angle))))
    which = np.arange(len(t)) % len(angle)
    far = np.sqrt(np.sum((xy - places[which, :2]) ** 2, axis=1) + (0.4 - places[which, 2]) ** 2)
    ranges = np.maximum(far + what["sd"] * r.standard_normal(len(t)) + np.abs(_wild(len(t), what, r)[:, 0]), 0.05)
    names = tuple(f"B{k + 1}" for k in range(len(angle)))
    meta = dataclasses.replace(meta, beacons={n: tuple(map(float, p)) for n, p in zip(names, places, strict=True)})
    return dataclasses.replace(run, ranges=RangeLog(t, which.astype(np.int32), ranges, names)), meta


def judged(run: Run) -> dict[str, tuple[float, float, float, float]]:
    """Per method: ATE [m], rms heading error [rad], shares inside of position and heading."""
    found = {}
    assert run.truth is not None
    nowhere = np.full(len(run.truth), np.nan)
    for method, reason in available(run).items():
        if reason is not None:
            continue
        path = estimate(run, method).trajectory
        errors = evaluate(path, run.truth)
        place = nees(path, dataclasses.replace(run.truth, theta=None), truth_sd=(1e-3, 1e-3, 1e-3))
        turned = nees(path, dataclasses.replace(run.truth, x=nowhere, y=nowhere), truth_sd=(1e-3, 1e-3, 1e-3))
        heading = errors.heading_rmse_rad if errors.heading_rmse_rad is not None else np.nan
        found[method] = (
            errors.ate_rmse_m or np.nan, heading, place.inside if place else np.nan, turned.inside if turned else np.nan
        )  # fmt: skip
    return found


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--first", type=int, default=2000)
    options.add_argument("--runs", type=int, default=40)
    options.add_argument("--each", action="store_true", help="a line for each run")
    chosen = options.parse_args()
    every: dict[str, list[tuple[float, float, float, float]]] = {}
    worse: dict[str, list[int]] = {"fused": [], "smoothed": []}
    bold: dict[str, list[int]] = {"fused": [], "smoothed": []}
    for seed in range(chosen.first, chosen.first + chosen.runs):
        run, what = drawn(seed)
        found = judged(run)
        others = [m for m in found if m not in worse and (what["start"] or m in ("beacon", "published"))]
        simple = min(found[m][0] for m in others if np.isfinite(found[m][0]))
        for method in worse:
            mine = found[method]
            if mine[0] > CLEARLY * simple and mine[0] > simple + LITTLE:
                worse[method].append(seed)
            if min(mine[2], mine[3]) < NARROW:
                bold[method].append(seed)
        for method, row in found.items():
            every.setdefault(method, []).append(row)
        if chosen.each:
            said = " ".join(f"{k}={v:g}" for k, v in what.items())
            cells = " ".join(
                f"{m}: {e:.3f} m {np.degrees(h):.1f}° {p:.0%}/{t:.0%};" for m, (e, h, p, t) in found.items()
            )
            print(f"{seed} {said}\n     {cells}", flush=True)
    print("| method | runs | median ATE m | 90 % | largest | heading rms, median | inside: position | heading |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for method, rows in every.items():
        e, h, p, t = np.array(rows).T
        print(
            f"| `{method}` | {len(rows)} | {np.median(e):.3f} | {np.quantile(e, 0.9):.3f} | {e.max():.3f} | "
            f"{np.degrees(np.nanmedian(h)):.2f}° | {np.nanmean(p):.1%} | {np.nanmean(t):.1%} |"
        )
    for method in worse:
        print(f"{method}: a simpler method was better in {worse[method]}; under {NARROW:.0%} inside in {bold[method]}")


if __name__ == "__main__":
    main()
