"""All sensors of a run as one time-sorted list of raw readings, by whole columns: what the compiled filter walks over.

Each event stands for itself: nothing in it comes from another stamp, so a late one can be put in at its place. Kinds,
columns and flags are described in `layout`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.beacon import unsurveyed_note
from core.estimation.cleaning import finite_rows, forward_acceleration, gyro_readings
from core.estimation.fusion.layout import BR, FIX, JUMP, KR, OUT, RANGE, REST, STILL, WHEEL, N, Readings
from core.estimation.odometry import WheelPath, longest_hold, wheel_path
from core.estimation.rest import Rest, wheels_still
from core.run import Run

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

SILENCE = 0.3  # s
STANDING = 0.15  # s for which no wheel has turned
FARTHEST = 1e6  # m: a fix or range beyond it is no reading


@dataclass(frozen=True)
class Events:
    """E events: t [s], kind, data (E, 5), flags (bits), as `layout` says; `out` (M,) stamps of the rows to come; names
    of the beacons whose lasting errors are states, from `first_offset` on; notes on readings left out; how long an
    IMU reading lasts [s] and their rate [Hz], where known already."""

    t: Array
    kind: npt.NDArray[np.int64]
    data: Array
    flags: npt.NDArray[np.int64]
    out: Array
    first_offset: int = KR
    lasting: tuple[str, ...] = ()
    silence: float = SILENCE
    notes: tuple[str, ...] = ()
    hold: float | None = None
    rate: float | None = None

    @property
    def readings(self) -> Readings:
        """As the compiled filter takes them."""
        return Readings(self.t, self.kind, self.data, self.flags)

    def of(self, *kinds: int) -> Flags:
        """(E,) whether an event is of one of these kinds."""
        return np.isin(self.kind, kinds)

    def kept(self, rows: Flags | slice) -> Events:
        """Only these events; rows of OUT are never dropped by callers."""
        return dataclasses.replace(
            self, t=self.t[rows], kind=self.kind[rows], data=self.data[rows], flags=self.flags[rows]
        )

    def leading(self, count: int) -> Events:
        """The first `count` events with their rows."""
        head = self.kept(np.arange(len(self.t)) < count)
        return dataclasses.replace(head, out=self.out[: int(np.sum(head.kind == OUT))])


def merge(run: Run, numbers: Assumptions, rest: Rest | None) -> Events:
    """Events of wheels, fixes, ranges to surveyed beacons, and of the stamps where a pose is asked for."""
    wheels, robot = run.wheels, run.meta.robot
    assert wheels is not None and robot.wheel_radius
    path = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    out_t, out_data, out_flags = _out_rows(run, rest, wheels.t)
    wheel_data, wheel_flags = _wheel_rows(path, numbers, robot.track_width)
    range_t, range_data, names, notes = _range_rows(run)
    first = KR if not names else BR + 1
    last_fix = first + len(names)
    fix_t, fix_data = _fix_rows(run, last_fix if numbers.lasting_fix > 0 and last_fix + 1 < N else 0)
    if numbers.lasting_range > 0 and names and first + len(names) < N:
        range_data[:, 4] += first
    else:
        range_data[:, 4] = 0.0
    parts = (
        (path.t, WHEEL, wheel_data, wheel_flags),
        (fix_t, FIX, fix_data, np.zeros(len(fix_t), np.int64)),
        (range_t, RANGE, range_data, np.zeros(len(range_t), np.int64)),
        (out_t, OUT, out_data, out_flags),
    )
    t = np.concatenate([p[0] for p in parts])
    kind = np.concatenate([np.full(len(p[0]), p[1], np.int64) for p in parts])
    order = np.argsort(t, kind="stable")  # kinds stand in their order already
    data = np.concatenate([p[2] for p in parts])[order]
    flags = np.concatenate([p[3] for p in parts])[order]
    flags |= np.where(wheels_still(wheels, t[order], STANDING), STILL, 0)
    silence = max(SILENCE, 5.0 * float(np.median(np.diff(path.t))))
    hold, rate = (longest_hold(np.diff(out_t, prepend=out_t[0])), run.imu.rate) if rest and run.imu else (None, None)
    return Events(t[order], kind[order], data, flags, out_t, first, names, silence, notes, hold, rate)


def _out_rows(run: Run, rest: Rest | None, wheel_t: Array) -> tuple[Array, Array, npt.NDArray[np.int64]]:
    if rest is None or run.imu is None:
        return wheel_t, np.zeros((len(wheel_t), 5)), np.zeros(len(wheel_t), np.int64)
    t, gz = gyro_readings(run.imu)
    forward = forward_acceleration(run.imu, run.meta.robot.imu)
    data = np.zeros((len(t), 5))
    data[:, 0] = gz
    if forward is not None:
        data[:, 1] = forward
    return t, data, np.where(rest.flags, REST, 0)


def _wheel_rows(path: WheelPath, numbers: Assumptions, track: float | None) -> tuple[Array, npt.NDArray[np.int64]]:
    since = np.diff(path.t, prepend=path.t[0])
    step, turn = np.abs(np.diff(path.d, prepend=0.0)), np.abs(np.diff(path.turn, prepend=path.turn[:1]))
    rim = step + (track or 0.0) / 2 * np.nan_to_num(turn)
    jump = rim > numbers.top_speed * np.maximum(since, 0.01)
    data = np.zeros((len(since), 5))
    data[:, 0], data[:, 1] = path.d, path.turn
    return data, np.where(jump, JUMP, 0)


def _fix_rows(run: Run, offset: int) -> tuple[Array, Array]:
    if run.beacon is None:
        return np.zeros(0), np.zeros((0, 5))
    fixes = run.beacon
    x, y = np.asarray(fixes.x, np.float64), np.asarray(fixes.y, np.float64)
    theta = np.full(len(x), np.nan) if fixes.theta is None else np.asarray(fixes.theta, np.float64)
    kept = (np.abs(x) <= FARTHEST) & (np.abs(y) <= FARTHEST)
    theta = np.where(np.abs(theta) <= FARTHEST, theta, np.nan)
    columns = (x, y, theta, np.full(len(x), float(offset)), np.zeros(len(x)))
    return fixes.t[kept], np.column_stack(columns)[kept]


def _range_rows(run: Run) -> tuple[Array, Array, tuple[str, ...], tuple[str, ...]]:
    log = run.ranges
    if log is None:
        return np.zeros(0), np.zeros((0, 5)), (), ()
    nowhere = (np.nan, np.nan, np.nan)
    where = np.array([run.meta.beacons.get(name, nowhere) for name in log.names], np.float64).reshape(-1, 3)
    ranges = np.asarray(log.range, np.float64)
    rows = np.column_stack((where[log.beacon], ranges, log.beacon.astype(np.float64)))
    kept = finite_rows(rows) & (ranges > 0) & (ranges <= FARTHEST)
    unknown = sorted(name for name in log.names if name not in run.meta.beacons)
    notes = (unsurveyed_note(unknown),) if unknown else ()
    return log.t[kept], rows[kept], tuple(log.names), notes
