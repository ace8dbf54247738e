"""Odometry calibration: claimed sd against spread over seeds and Cramer-Rao bound; recorded squares and circles.

`python tests/bench/bench_odometry_calibration.py [--part spread|umbmark|real] [--seeds 20]`
The recorded part needs the larger sets beside the project.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from core.calibration.odometry import NAMES, calibrate_odometry, corrected, umbmark
from core.calibration.odometry.chain import Noise
from core.calibration.odometry.model import SHARED, TABLE
from core.calibration.odometry.simultaneous import _chains, _linearise, _present, _reduced
from core.estimation import estimate
from core.formats import read_run
from core.metrics import evaluate
from core.robot import TagMount
from core.run import Run
from core.simulation import simulate as own
from core.simulation.scenarios import Rates, Scenario, drive, stop, turn
from tests.core.estimation.world import ROBOT, Flaws, Sensors, simulate

FLAWS = Flaws(
    bias=0.004, gyro_scale=0.006, distance_scale=0.008, inequality=0.004, track_scale=0.012, slip=0.004, side_slip=0.002
)
# The world says what wheels tell of the body's motion: d (1 - s), turn (1 + k) - e d / b. Solved for the robot:
LEFT, RIGHT = (
    1 / (1 - FLAWS.distance_scale + FLAWS.inequality / 2),
    1 / (1 - FLAWS.distance_scale - FLAWS.inequality / 2),
)
TRACK = (1 + FLAWS.track_scale) * (LEFT + RIGHT) / 2
TRUE = {
    "left_radius": 0.075 * LEFT, "right_radius": 0.075 * RIGHT, "track_width": 0.32 * TRACK,
    "gyro_scale": 1 + FLAWS.gyro_scale, "tag_x": 0.1, "tag_y": 0.05, "tag_yaw": 0.0,
    "imu_clock": 0.0, "reference_delay": 0.0,
}  # fmt: skip
SETUPS = {"poses": Sensors(), "positions": Sensors(fix_theta=None), "ranges": Sensors(fixes=0, ranges=10)}


def a_run(seed: int, sensors: Sensors, seconds: float = 90.0) -> Run:
    """A minute and a half of curves; run.json has the tag in the middle of the axle, 11 cm from where it is."""
    run = simulate(seed, seconds, FLAWS, sensors).run
    nominal = dataclasses.replace(ROBOT, tag=TagMount(0.0, 0.0, 0.4))
    return dataclasses.replace(run, truth=None, meta=dataclasses.replace(run.meta, robot=nominal))


def bound(run: Run, reference: str) -> np.ndarray:
    """Square roots (9,) of the Cramer-Rao bound: the information at the true unknowns and noise."""
    chains, unknowns = _chains([run], reference, own_clocks=False)
    shared = np.zeros(unknowns)
    shared[:SHARED] = [LEFT - 1, RIGHT - 1, TRACK - 1, FLAWS.gyro_scale, 0.1, 0.05, 0.0, 0.0, 0.0]
    free, _ = _present(chains, unknowns)
    noise = Noise(slip=FLAWS.slip, side=FLAWS.side_slip)
    for _ in range(4):
        _linearise(chains, shared)
        _, parts = _reduced(chains, noise)
        for chain, (_, eliminated, _) in zip(chains, parts, strict=True):
            chain.pose = chain.pose + eliminated.poses(np.zeros(unknowns))
    _linearise(chains, shared)
    information, _ = _reduced(chains, noise)
    found = np.full(unknowns, np.nan)
    found[free] = np.sqrt(np.diag(np.linalg.inv(information[np.ix_(free, free)])))
    r, b = 0.075, 0.32
    return found[:SHARED] * (r, r, b, 1, 1, 1, 1, 1, 1)


def spread(seeds: int) -> None:
    """Mean error, spread over seeds, mean claimed sd, Cramer-Rao bound; rms of error over claimed sd."""
    for label, sensors in SETUPS.items():
        found: dict[str, list[tuple[float, float]]] = {name: [] for name in TRUE}
        hidden = 0
        t0 = time.perf_counter()
        for seed in range(seeds):
            run = a_run(seed, sensors)
            calibration = calibrate_odometry([run])
            for name, true in TRUE.items():
                value = calibration.parameters[name]
                if value is None or value.sd is None:
                    hidden += 1
                else:
                    found[name].append((value.value - true, value.sd))
        each = (time.perf_counter() - t0) / seeds
        least = bound(a_run(0, sensors), "ranges" if label == "ranges" else "beacon")
        print(f"\n{label}: {seeds} seeds of 90 s, {each:.1f} s each, {hidden} not shown")
        print(f"{'':16s} {'mean error':>12s} {'spread':>12s} {'claimed sd':>12s} {'bound':>12s} {'rms z':>6s}")
        for i, (name, pairs) in enumerate(found.items()):
            if len(pairs) < 2:
                print(f"{name:16s} not shown")
                continue
            e, sd = np.array(pairs).T
            z = np.sqrt(np.mean((e / sd) ** 2))
            print(f"{name:16s} {e.mean():12.2e} {e.std(ddof=1):12.2e} {sd.mean():12.2e} {least[i]:12.2e} {z:6.2f}")


def squares(ratio: float, scale: float, seeds: int = 2) -> list[Run]:
    """Squares of 4 m both ways on the product's simulator."""

    def legs(sign: float) -> list:
        return [stop(1.0), *([drive(4.0, 0.5), stop(0.3), turn(sign * np.pi / 2), stop(0.3)] * 4), stop(1.0)]

    effects = {"unequal_wheels": {"ratio": ratio}, "track_width": {"scale": scale}}
    rates = Rates(beacon=0.0, ranges=0.0)
    ways = (Scenario(f"square {s}", "", lambda s=s: legs(s)).run(rates) for s in (1.0, -1.0) for _ in range(seeds))
    return [own(run, effects, k) for k, run in enumerate(ways)]


def squares_table(seeds: int) -> None:
    """UMBmark and everything at once, on the same simulated squares."""
    for ratio, scale in ((1.01, 1.0), (1.0, 1.02), (1.005, 0.99), (0.995, 1.01)):
        runs = squares(ratio, scale)
        mark, whole = umbmark(runs), calibrate_odometry(runs)
        left, right, track = (whole.value(n) or np.nan for n in NAMES[:3])
        print(
            f"true E_d {ratio:.4f} E_b {scale:.4f}   UMBmark {mark.E_d:.4f} {mark.E_b:.4f}"
            f"   at once {right / left:.4f} {track / 0.32:.4f}"
        )


def recorded(seeds: int) -> None:
    """OptiOdom: calibrated on one set, judged on all: largest distance, distance at the end [m], largest turn [deg]."""
    folder = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
    sets = {
        n: [read_run(p) for p in sorted((folder / f"optiodom-{n}-a").glob("run-*"))]
        for n in ("circle", "square", "free")
    }
    mark = umbmark(sets["square"])
    print(f"UMBmark on the squares: E_d {mark.E_d:.5f} ± {mark.E_d_sd:.5f}, E_b {mark.E_b:.5f} ± {mark.E_b_sd:.5f}")
    for label, runs in sets.items():
        t0 = time.perf_counter()
        found = calibrate_odometry(runs, own_clocks=True)
        values = [found.parameters[n] for n in NAMES[:3]]
        print(
            f"\non {label} ({time.perf_counter() - t0:.0f} s): "
            + ", ".join(
                f"{p.name} {1e3 * v.value:.3f} ± {1e3 * (v.sd or 0):.3f} mm"
                for p, v in zip(TABLE, values, strict=False)
                if v
            )
        )
        for name, judged in sets.items():
            row = []
            for put in (lambda run, _: run, corrected):
                errors = [evaluate(estimate(put(r, found), "encoders").trajectory, r.truth) for r in judged]
                row.append(
                    (
                        max(e.max_m for e in errors),
                        np.mean([e.final_m for e in errors]),
                        np.degrees(max(e.heading_max_rad for e in errors)),
                    )
                )
            print(f"  judged on {name:8s} " + "   ".join(f"{a:.3f} -> {b:.3f}" for a, b in zip(*row, strict=True)))


PARTS = {"spread": spread, "umbmark": squares_table, "real": recorded}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--part", choices=[*PARTS, "all"], default="all")
    parser.add_argument("--seeds", type=int, default=20)
    options = parser.parse_args()
    for name, job in PARTS.items():
        if options.part in (name, "all"):
            print(f"\n{name}: {(job.__doc__ or '').strip()}")
            job(options.seeds)


if __name__ == "__main__":
    main()
