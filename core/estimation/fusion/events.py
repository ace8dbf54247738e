"""All sensors of a run as one time-sorted list of events, made by whole columns: what the compiled filter walks over.

Causal: nothing in an event comes from a later stamp. Between two gyro readings the last one holds; when the next one is
in, its step is completed to the trapezoid. Over a pause of the gyro the turn is unknown, and the wheels tell it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.cleaning import finite_rows, gyro_readings
from core.estimation.odometry import WheelPath, longest_hold, pauses, wheel_path
from core.estimation.rest import Rest
from core.run import Run

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

WHEEL, FIX, RANGE, OUT = range(4)  # as in _filter_numba, which is imported only where it runs
SILENCE = 0.3  # s
FARTHEST = 1e6  # m: a fix or range beyond it is no reading


@dataclass(frozen=True)
class Events:
    """E events: t [s], kind, data (E, 4), raw gyro turn [rad], extra variance of the turn [rad^2], flags (E, 3) of
    rest, of a counter's jump and of silent wheels, as `_filter_numba.run_filter` takes them; `out` (M,) stamps of the
    rows to come; notes on readings left out."""

    t: Array
    kind: npt.NDArray[np.int64]
    data: Array
    raw: Array
    q_extra: Array
    flags: Flags
    out: Array
    notes: tuple[str, ...] = ()

    @property
    def dt(self) -> Array:
        """Seconds since the event before, 0 for the first."""
        return np.diff(self.t, prepend=self.t[:1])


def merge(run: Run, numbers: Assumptions, rest: Rest | None) -> Events:
    """Events of wheels, fixes, ranges to surveyed beacons, and of the stamps where a pose is asked for."""
    wheels, robot = run.wheels, run.meta.robot
    assert wheels is not None and robot.wheel_radius
    path = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    out = run.imu.t if rest is not None and run.imu is not None else wheels.t
    wheel_data, jump, moved = _wheel_rows(path, numbers, robot.track_width)
    fix_t, fix_data = _fix_rows(run)
    range_t, range_data, notes = _range_rows(run)
    gz = gyro_readings(run.imu)[1] if rest is not None and run.imu is not None else np.zeros(len(out))
    out_data = np.column_stack((gz, np.zeros((len(out), 3))))
    parts = ((path.t, WHEEL, wheel_data), (fix_t, FIX, fix_data), (range_t, RANGE, range_data), (out, OUT, out_data))
    t = np.concatenate([p[0] for p in parts])
    kind = np.concatenate([np.full(len(p[0]), p[1], np.int64) for p in parts])
    order = np.lexsort((kind, t))
    t, kind = t[order], kind[order]
    jumps = np.concatenate((jump, np.zeros(len(t) - len(jump), bool)))[order]
    moves = np.concatenate((moved, np.zeros(len(t) - len(moved), bool)))[order]
    raw, q_extra, still = _turns(run, numbers, rest, t)
    data = np.concatenate([p[2] for p in parts])[order]
    flags = np.column_stack((still & ~moves, jumps, _silent(path.t, t)))
    return Events(t, kind, data, raw, q_extra, flags, out, notes)


def _wheel_rows(path: WheelPath, numbers: Assumptions, track: float | None) -> tuple[Array, Flags, Flags]:
    since = np.diff(path.t, prepend=path.t[0])
    step, turn = np.abs(np.diff(path.d, prepend=0.0)), np.abs(np.diff(path.turn, prepend=path.turn[:1]))
    rim = step + (track or 0.0) / 2 * np.nan_to_num(turn)
    jump = rim > numbers.top_speed * np.maximum(since, 0.01)
    return np.column_stack((path.d, path.turn, since, np.zeros(len(since)))), jump, rim > 0


def _silent(wheel_t: Array, t: Array) -> Flags:
    """Per event: the wheel reading before it is older than the wheels' rhythm explains."""
    before = np.searchsorted(wheel_t, t, "left") - 1
    age = np.where(before >= 0, t - wheel_t[np.maximum(before, 0)], 0.0)
    return age > max(SILENCE, 5.0 * float(np.median(np.diff(wheel_t))))


def _fix_rows(run: Run) -> tuple[Array, Array]:
    if run.beacon is None:
        return np.zeros(0), np.zeros((0, 4))
    fixes = run.beacon
    x, y = np.asarray(fixes.x, np.float64), np.asarray(fixes.y, np.float64)
    theta = np.full(len(x), np.nan) if fixes.theta is None else np.asarray(fixes.theta, np.float64)
    kept = (np.abs(x) <= FARTHEST) & (np.abs(y) <= FARTHEST)
    theta = np.where(np.abs(theta) <= FARTHEST, theta, np.nan)
    return fixes.t[kept], np.column_stack((x, y, theta, np.zeros(len(x))))[kept]


def _range_rows(run: Run) -> tuple[Array, Array, tuple[str, ...]]:
    log = run.ranges
    if log is None:
        return np.zeros(0), np.zeros((0, 4)), ()
    nowhere = (np.nan, np.nan, np.nan)
    where = np.array([run.meta.beacons.get(name, nowhere) for name in log.names], np.float64).reshape(-1, 3)
    ranges = np.asarray(log.range, np.float64)
    rows = np.column_stack((where[log.beacon], ranges))
    kept = finite_rows(rows) & (ranges > 0) & (ranges <= FARTHEST)
    unknown = sorted(name for name in log.names if name not in run.meta.beacons)
    notes = (f"Ranges to unsurveyed beacons were ignored: {', '.join(unknown)}.",) if unknown else ()
    return log.t[kept], rows[kept], notes


def _turns(run: Run, numbers: Assumptions, rest: Rest | None, t: Array) -> tuple[Array, Array, Flags]:
    """Per event: the gyro's raw turn since the event before, extra variance where it paused, rest flag."""
    if rest is None or run.imu is None:
        return np.zeros(len(t)), np.zeros(len(t)), np.zeros(len(t), bool)
    stamps, gz = gyro_readings(run.imu)
    dt = np.diff(stamps, prepend=stamps[0])
    hold, pause = longest_hold(dt), pauses(dt)
    before = np.concatenate((gz[:1], gz[:-1]))
    full = np.cumsum(np.where(pause, before * np.minimum(dt, hold), 0.5 * (gz + before) * dt))
    newest = np.searchsorted(stamps, t, "right") - 1
    known = np.maximum(newest, 0)
    age = np.where(newest >= 0, t - stamps[known], 0.0)
    turned = np.where(newest >= 0, full[known] + gz[known] * np.minimum(age, hold), 0.0)
    blind = np.where(age > 2 * hold, age - hold, 0.0) if hold > 0 else np.zeros(len(t))
    unseen = np.cumsum(np.where(pause, np.maximum(dt - hold, 0.0), 0.0))[known] + blind
    early = np.where(newest < 0, t - stamps[0], 0.0)  # before the first reading
    ignorance = numbers.pause_rate**2 * np.maximum(np.diff(unseen + early, prepend=(unseen + early)[:1]), 0.0)
    return np.diff(turned, prepend=turned[:1]), ignorance, rest.flags[known] & (newest >= 0)
