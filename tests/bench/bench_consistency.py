"""Are the claimed covariances right? NEES and ellipse coverage, simulated and recorded. By hand.

`python -m tests.bench.bench_consistency [--part simulated,examples,real] [--seeds 5] [--methods fused,smoothed]`

Simulated: five drives with three sets of sensors in turn, `seeds` of each, once without flaws and once with ordinary
ones, drawn one sigma each: fifty runs by default. NEES is over its dimension, at the end of each run, where runs are
independent of each other: the band holds its mean in 95 of 100 such sets. `in band` is the share of stamps (each taken
as a share of its run) at which the mean over all runs is within it. `joint`, `position` and `heading` are the shares of
stamps whose 95 % ellipse or interval holds the truth.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from core.estimation import available, estimate
from core.estimation.assumptions import Assumptions
from core.formats import read_run
from core.metrics import chi2_band, nees
from core.robot import EffectSet, Pose
from core.run import Run
from core.sensors import TruthLog
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS, Rates
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
DRIVES = ("figure-eight", "mission", "square-ccw", "slalom", "stop-go")
SETUPS = (Rates(ranges=0.0), Rates(ranges=0.0), Rates(beacon=0.0, ranges=20.0))
HEADLESS = (False, True, False)  # fixes without heading in the second
GRID = np.linspace(0.05, 1.0, 100)
REFERENCE_SD = {"optiodom": (0.002, 0.002, 0.005), "husky": (0.02, 0.02, 0.01), "plaza": (0.05, 0.05, 0.02)}  # m, rad
MOST_LAG, OWN_CLOCK = 0.3, 0.02  # s: largest lag of a reference that is looked for, and what is left of its clock then
REFERENCE_CLOCK = {"husky": 0.055}  # s: its lidar's headings against the gyro, step by step (1.48 of the median lag)


def flaws(seed: int) -> EffectSet:
    """Ordinary ones: tyres 0.3 %, track 0.8 %, gyro 4 mrad/s and 0.5 %, accelerometers 0.04 m/s^2, IMU turned by
    10 mrad, a gyro warming up by 2 mrad/s, a beacon system 20 ms late and 0.1 m off, a fix in a hundred 0.4 m off."""
    n = np.random.default_rng((7, seed)).standard_normal(11)
    return {
        "wheel_radius": {"scale": 1 + 0.003 * n[0]},
        "unequal_wheels": {"ratio": 1 + 0.003 * n[1]},
        "track_width": {"scale": 1 + 0.008 * n[2]},
        "gyro_bias": {"bias": 0.004 * n[3]},
        "gyro_drift": {"amplitude": 0.002 * n[4], "tau": 120.0},
        "gyro_scale": {"scale": 1 + 0.005 * n[5]},
        "accel_bias": {"x": 0.04 * n[6], "y": 0.04 * n[7]},
        "imu_yaw": {"angle": 0.010 * n[8]},
        "vibration": {"k": 0.15},
        "beacon_delay": {"delay": 0.02 * abs(n[9])},
        "range_bias": {"bias": 0.1 * n[10]},
        "beacon_outliers": {"rate": 0.01, "size": 0.4},
    }


@dataclass(frozen=True)
class Claim:
    """Of one run: NEES over its dimension at the end and at GRID, their dimension, shares inside."""

    last: float
    grid: Array
    dof: int
    joint: float
    position: float
    heading: float
    mean: float


def own_time(truth: TruthLog, path: Trajectory) -> TruthLog:
    """The reference with its stamps moved by the one lag at which its headings fit the path's best (least squares)."""
    assert truth.theta is not None
    theta = np.unwrap(np.asarray(truth.theta, np.float64))
    inside = np.isfinite(theta) & (truth.t > path.t[0] + MOST_LAG) & (truth.t < path.t[-1] - MOST_LAG)
    if inside.sum() < 10:
        return truth
    t, seen, mine = truth.t[inside], theta[inside], np.unwrap(path.theta)
    lags = np.arange(-MOST_LAG, MOST_LAG + 0.005, 0.01)
    apart = [seen - np.interp(t - lag, path.t, mine) for lag in lags]
    miss = [np.sum((d - 2 * np.pi * np.round(np.median(d) / (2 * np.pi))) ** 2) for d in apart]
    return dataclasses.replace(truth, t=truth.t - lags[int(np.argmin(miss))])


def claim(run: Run, method: str, sd: tuple[float, float, float], clock: float = 0.0, own_clock: bool = False) -> Claim:
    """What a method claims of its errors on a run with truth."""
    assert run.truth is not None
    path = estimate(run, method).trajectory
    if own_clock:
        run, clock = dataclasses.replace(run, truth=own_time(run.truth, path)), OWN_CLOCK
        assert run.truth is not None
    whole = nees(path, run.truth, truth_sd=sd, truth_clock=clock)
    place = nees(path, dataclasses.replace(run.truth, theta=None), truth_sd=sd, truth_clock=clock)
    nowhere = np.full(len(run.truth), np.nan)
    turned = nees(path, dataclasses.replace(run.truth, x=nowhere, y=nowhere), truth_sd=sd, truth_clock=clock)
    assert whole is not None
    at = np.searchsorted(whole.t, whole.t[0] + GRID * (whole.t[-1] - whole.t[0])).clip(max=len(whole.t) - 1)
    return Claim(
        float(whole.nees[-1]) / whole.dof, whole.nees[at] / whole.dof, whole.dof, whole.inside,
        place.inside if place else np.nan, turned.inside if turned else np.nan, whole.mean / whole.dof,
    )  # fmt: skip


def simulated(name: str, seed: int, flawed: bool) -> Run:
    """One drive; its sensors go by the seed. Where it began is known as well as the filter assumes, not exactly."""
    setup, own = seed % len(SETUPS), 1000 * DRIVES.index(name) + seed + 500 * flawed
    run = simulate(SCENARIOS[name].run(SETUPS[setup]), flaws(own) if flawed else {}, own)
    n, a, at = np.random.default_rng((8, own)).standard_normal(3), Assumptions(), SCENARIOS[name].start
    start = Pose(at.x + a.start_xy * n[0], at.y + a.start_xy * n[1], at.theta + a.start_theta * n[2])
    run = dataclasses.replace(run, meta=dataclasses.replace(run.meta, start=start))
    if HEADLESS[setup] and run.beacon is not None:
        run = dataclasses.replace(run, beacon=dataclasses.replace(run.beacon, theta=None))
    return run


def row(label: str, claims: list[Claim]) -> str:
    """A line of the table."""
    low, high = chi2_band(claims[0].dof, len(claims))
    grid = np.mean([c.grid for c in claims], axis=0) * claims[0].dof
    means = [np.mean([getattr(c, k) for c in claims]) for k in ("last", "mean", "joint", "position", "heading")]
    return (
        f"{label:34s} {len(claims):4d} {means[0]:6.2f} [{low / claims[0].dof:.2f}, {high / claims[0].dof:.2f}]"
        f" {np.mean((grid > low) & (grid < high)):7.0%} {means[1]:6.2f} {means[2]:7.1%} {means[3]:8.1%} {means[4]:7.1%}"
    )


HEAD = (
    f"{'runs':34s} {'many':>4s} {'NEES at the end':>19s} {'in band':>7s} {'mean':>6s} {'joint':>7s} {'position':>8s}"
    f" {'heading':>7s}"
)


def sets(part: str, seeds: int) -> Iterator[tuple[str, list[Callable[[], Run]]]]:
    """Named sets of runs, made one at a time."""
    if part == "simulated":
        for flawed in (False, True):
            for name in DRIVES:
                yield (
                    f"{name}, {'flaws' if flawed else 'nominal'}",
                    [lambda n=name, s=s, f=flawed: simulated(n, s, f) for s in range(seeds)],  # type: ignore[misc]
                )
        return
    folder = ROOT / "app" / "examples" if part == "examples" else ROOT.parent / "shared" / "data" / "real"
    found: dict[str, list[Path]] = {}
    for file in sorted(folder.rglob("run.json")):
        name = file.parent.relative_to(folder).parts
        found.setdefault("/".join(name) if len(name) == 1 or name[0].startswith("plaza") else name[0], []).append(
            file.parent
        )
    for label, paths in found.items():
        yield label, [lambda p=p: read_run(p) for p in paths]  # type: ignore[misc]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--part", default="simulated,examples,real")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--methods", default="fused,smoothed")
    parser.add_argument("--own-clocks", action="store_true", help="take each Husky step's own lag of its reference out")
    parser.add_argument("--each", action="store_true", help="a line per run too")
    args = parser.parse_args()
    print(HEAD)
    for part in args.part.split(","):
        every: dict[str, list[Claim]] = {}
        for label, makers in sets(part, args.seeds):
            claims: dict[str, list[Claim]] = {}
            for make in makers:
                run = make()
                if run.truth is None:
                    continue
                stated = (run.meta.noise.truth_xy or 0.0,) * 2 + (run.meta.noise.truth_theta or 0.0,)
                if part == "simulated":
                    stated = (0.0, 0.0, 0.0)  # the simulator's truth is exact
                sd = next((v for k, v in REFERENCE_SD.items() if label.startswith(k)), stated)
                clock = next((v for k, v in REFERENCE_CLOCK.items() if label.startswith(k)), 0.0)
                own = args.own_clocks and clock > 0
                for method in args.methods.split(","):
                    if available(run)[method] is None:
                        claims.setdefault(method, []).append(claim(run, method, sd, clock, own))
                        if args.each:
                            print(row(f"  {run.meta.name} {method}"[:34], claims[method][-1:]))
            for method, mine in claims.items():
                print(row(f"{label} {method}", mine), flush=True)
                every.setdefault(f"{method}, all {label.rsplit(', ')[-1] if part == 'simulated' else part}", []).extend(
                    mine
                )
                if part == "simulated":
                    every.setdefault(f"{method}, all simulated", []).extend(mine)
        for label, mine in every.items():
            print(row(label, mine))


if __name__ == "__main__":
    main()
