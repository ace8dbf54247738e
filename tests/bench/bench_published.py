"""`published`: the paper's Table III again, what other readings of the paper would do, and its time. Prints figures.

`python tests/bench/bench_published.py [--part table|readings|time]`
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from core.estimation import estimate
from core.estimation.published import Decisions, navigate
from core.metrics import evaluate
from core.run import Run
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS, Rates, Scenario
from tests.plants.mujoco_worlds import VARIANTS, WORLDS, Sensors, world

PAPER = Sensors(fix_xy=0.05, fix_theta=0.0175)  # its ±10 cm and ±2°, read as two sigma
TABLE_III = ((270, 138, 4.7, 5), (132, 76, 5.3, -3), (219, -93, 5.0, 4), (98, 151, 3.8, 1), (103, 69, 4.9, -3))

READINGS = {
    "as chosen": Decisions(),
    "mean factor 1 (to the letter)": Decisions(mean_factor=1.0, floor_speed=0.0, floor_turn=0.0),
    "mean factor 1, with floors": Decisions(mean_factor=1.0),
    "mean factor 2": Decisions(mean_factor=2.0),
    "mean factor 8": Decisions(mean_factor=8.0),
    "never substitutes": Decisions(mean_factor=1e9),
    "window 0.2 s": Decisions(window=0.2),
    "window 0.8 s": Decisions(window=0.8),
    "bridge 2 s at most": Decisions(longest_bridge=2.0),
    "low-pass 2 Hz": Decisions(accel_cutoff=2.0),
    "low-pass 10 Hz": Decisions(accel_cutoff=10.0),
    "no shocks": Decisions(shock=1e9),
    "shock from 1.5 m/s²": Decisions(shock=1.5, shock_factor=4.0),
    "replaced by one fix": Decisions(fixes_to_replace=1, agreeing=1),
    "eq. (5) to the letter (increments)": Decisions(increments=True),
}


def table() -> None:
    """Distance [cm] and direction [deg] at rest after the obstacle, as Table III has them."""
    print("      paper: encoders    paper: all   ours: encoders       ours: published   events")
    for i, paper in enumerate(TABLE_III):
        run = world("obstacle", i, PAPER).run
        row = []
        for method in ("encoders", "published"):
            found = estimate(run, method)
            path, truth = found.trajectory, run.truth
            assert truth is not None and truth.x is not None and truth.y is not None and truth.theta is not None
            end = path.at(np.array([min(truth.t[-1], path.t[-1])]))[0]
            off = 100 * np.hypot(end[0] - truth.x[-1], end[1] - truth.y[-1])
            row += [off, np.degrees(np.remainder(end[2] - truth.theta[-1] + np.pi, 2 * np.pi) - np.pi)]
        kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(Counter(e.kind for e in found.events).items()))
        print(
            f"{i + 1}  {paper[0]:7d} cm {paper[1]:5d}°  {paper[2]:5.1f} cm {paper[3]:3d}°"
            f"  {row[0]:7.1f} cm {row[1]:6.1f}°  {row[2]:7.1f} cm {row[3]:6.2f}°   {kinds}"
        )


def readings() -> None:
    """Path rms [cm] in each world (mean of seeds), worst at rest, and how many decisions were taken, per reading."""
    names = list(WORLDS)
    print(f"{'reading':36s} " + " ".join(f"{n:>9s}" for n in names) + "   obstacle: rest, slips")
    for label, choice in READINGS.items():
        rms, rest, slips = [], 0.0, 0
        for name in names:
            errors = []
            for seed in range(VARIANTS):
                run = world(name, seed).run
                assert run.truth is not None
                found = navigate(run, None, choice)
                judged = evaluate(found.trajectory, run.truth)
                errors.append(judged.ate_rmse_m or np.nan)
                if name == "obstacle":
                    rest = max(rest, judged.final_m or np.nan)
                    slips += sum(e.kind == "slip" for e in found.events)
            rms.append(100 * float(np.mean(errors)))
        print(f"{label:36s} " + " ".join(f"{e:9.1f}" for e in rms) + f"   {100 * rest:.1f} cm, {slips}", flush=True)


def hour() -> Run:
    """An hour of missions with rests on the product's simulator."""
    legs = SCENARIOS["mission"].legs
    run = Scenario("hour", "hour", lambda: legs() * 28).run(Rates(ranges=0.0))
    return simulate(run, {"gyro_bias": {"bias": 4e-3}}, 1)


def timing() -> None:
    """Seconds of processor time for an hour with IMU 100 Hz, wheels 50 Hz, fixes 10 Hz; increments' drift there."""
    run = hour().crop(0, 3600)
    assert run.truth is not None
    navigate(run.crop(0, 30), None, Decisions())
    for label, choice in (("as chosen", Decisions()), ("increments", replace(Decisions(), increments=True))):
        t0 = time.process_time()
        found = navigate(run, None, choice)
        seconds = time.process_time() - t0
        errors = evaluate(found.trajectory, run.truth)
        print(
            f"{label:12s} {run.duration:.0f} s, {len(run.imu or ())} IMU rows: {seconds:.1f} s;"
            f" rms {100 * (errors.ate_rmse_m or 0):.1f} cm, last {100 * (errors.final_m or 0):.1f} cm,"
            f" {len(found.events)} events"
        )


PARTS = {"table": table, "readings": readings, "time": timing}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--part", choices=[*PARTS, "all"], default="all")
    part = parser.parse_args().part
    for name, job in PARTS.items():
        if part in (name, "all"):
            print(f"\n{name}: {(job.__doc__ or '').strip()}")
            job()


if __name__ == "__main__":
    main()
