"""`published`, stepped: the system of Lee, Shin and Cho (`core.estimation.published`) on readings as they come.

The same signals, substitution, reckoning and tracker, each going on from where it was left; what offline is told from
the whole run (gyro's noise at rest, rates) is that of `rhythm`. It sets out from a known start pose, or from the first
fixes where they have headings; ranges alone, or fixes without headings, need the whole run to be placed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.odometry import WheelPath, arcs, gyro_turns
from core.estimation.published.decisions import Decisions
from core.estimation.published.fixes import BeaconFixes
from core.estimation.published.navigate import FIRST_FIXES
from core.estimation.published.reckoning import Reckoning, motion
from core.estimation.published.signals import REST_MEMORY, Signals
from core.estimation.published.substitution import Steps, substituted
from core.estimation.published.tracker import Tracker
from core.geometry import compose, inverse, rotation, wrap_angle
from core.live.filtered import LowPass, Offset, PoseFilter
from core.live.intake import Taken
from core.live.rhythm import Rhythm
from core.run import RunMeta
from core.sensors import ImuLog
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]

CHOICE = Decisions()
KEEP = 2.0  # s of the reckoned path in which a fix may lie
LONGEST_WAIT = 60.0  # s of it before the filter has set out
USUAL_HZ = 0.1  # of the low-pass under the usual vibration
HEADLESS = "while live it needs a start pose, or fixes with headings"
WAITING = "waiting for fixes"


class Published:
    """The system of one run. `take` readings, then `step`."""

    def __init__(self, meta: RunMeta, numbers: Assumptions, rhythm: Rhythm) -> None:
        self._meta, self._numbers, self._rhythm = meta, numbers, rhythm
        self.reason: str | None = WAITING
        from core.estimation.published._substitute_numba import STATE

        hz, choice = max(rhythm.imu_rate, 1.0), CHOICE
        self._offsets = [Offset(math.exp(-1.0 / (REST_MEMORY * hz))) for _ in range(3)]  # gyro, ax, ay
        self._rate = LowPass(hz, choice.gyro_cutoff)
        self._smooth = [LowPass(hz, choice.accel_cutoff) for _ in range(5)]  # forward, left, speed, rate, gyro
        self._slow = [LowPass(hz, 1.0) for _ in range(2)]
        self._shocks = _Shocks(hz)
        self._back = max(1, round(choice.window / max(rhythm.hold / 5.0, 1e-6)))
        self._gained = np.zeros((0, 2))  # speed by encoders, by accelerometers since the start; as far as looked back
        self._state = np.zeros(STATE)
        self._waiting: list[Array] = []  # t, gz, ax, ay, rest, behind the row that is stepped from
        self._last: Array | None = None  # distance and turn by the wheels, rate there
        self._path = Reckoning(np.zeros(0), np.zeros((0, 12)))
        self._fixes = np.zeros((0, 6))
        self._pose = np.zeros(3)
        self._track: _Track | None = None

    def begin(self, pose: Array) -> None:
        """Where the wheels have the robot at the first IMU stamp."""
        self._pose = pose.copy()

    def take(self, taken: Taken) -> None:
        """New readings."""
        if len(taken.imu):
            self._waiting.append(np.column_stack((taken.imu, taken.inertial[:, 2])))
        if len(taken.fixes):
            self._fixes = np.concatenate((self._fixes, taken.fixes))

    def step(self, wheels: WheelPath, until: float) -> Trajectory | None:
        """Poses at the IMU's stamps up to `until`, given the wheels' path over the last seconds."""
        rows = np.concatenate((np.zeros((0, 5)), *self._waiting))
        end = int(np.searchsorted(rows[:, 0], until, "right"))
        begins = self._last is None
        if end < 2:
            self._waiting = [rows]
            return None
        self._waiting = [rows[end - 1 :]]
        signals = self._signals(rows[:end], wheels)
        new = slice(0 if begins else 1, None)
        self._reckon(signals, begins)
        self._shocks.take(signals, new)
        made = self._follow(signals.t[new])
        kept = self._path.t >= signals.t[-1] - (KEEP if self._track else LONGEST_WAIT)
        self._path = Reckoning(self._path.t[kept], self._path.table[kept])
        return made

    def _signals(self, rows: Array, wheels: WheelPath) -> Signals:
        """Signals at the rows' stamps; the first is the last one of the step before, or the run's first."""
        t, gz, ax, ay = (np.ascontiguousarray(rows[:, k]) for k in range(4))
        rest, begins = rows[:, 4] != 0, self._last is None
        step = np.diff(t, prepend=t[0])
        safe = np.where(step > 0, step, 1.0)
        turns = gyro_turns(ImuLog(t, gz), self._numbers, self._rhythm.hold)
        held = np.where(step > 0, turns.step / safe, 0.0)
        held[0] = held[1]
        way = np.column_stack([np.interp(t, wheels.t, column) for column in (wheels.d, wheels.turn)])
        if self._last is not None:
            way[0] = self._last[:2]  # what was counted up to there, whatever came since
        distance, wheel_turn = np.diff(way, axis=0, prepend=way[:1]).T
        new = slice(0 if begins else 1, None)
        fresh = rest[new]
        rate = np.zeros(len(t))
        rate[new] = self._rate(held[new] - self._offsets[0](held[new], fresh))
        rate[0] = rate[0] if self._last is None else self._last[2]
        body = np.zeros((len(t), 2))
        accel = np.column_stack([o(c[new], fresh) for o, c in zip(self._offsets[1:], (ax, ay), strict=True)])
        body[new] = self._to_axle(np.column_stack((ax, ay))[new] - accel, rate, safe, new)
        sources = (body[:, 0], body[:, 1], distance / safe, wheel_turn / safe, rate)
        smooth = np.zeros((5, len(t)))
        for k, (low, column) in enumerate(zip(self._smooth, sources, strict=True)):
            smooth[k, new] = low(column[new])
        sharp = np.zeros((len(t), 2))
        sharp[new] = body[new] - np.column_stack([low(body[new, k]) for k, low in enumerate(self._slow)])
        self._last = np.array((*way[-1], rate[-1]))
        return Signals(
            t=t, dt=np.minimum(step, self._rhythm.hold), rest=rest, distance=distance, speed=smooth[2], rate=smooth[3],
            gyro=smooth[4], turn=np.where(rest, 0.0, rate * step), turn_variance=np.where(rest, 0.0, turns.variance),
            forward=smooth[0], left=smooth[1], sharp=sharp, rested=bool(rest.any()),
        )  # fmt: skip

    def _to_axle(self, accel: Array, rate: Array, dt: Array, new: slice) -> Array:
        mount = self._meta.robot.imu
        cos, sin = math.cos(mount.yaw), math.sin(mount.yaw)
        ax, ay = cos * accel[:, 0] - sin * accel[:, 1], sin * accel[:, 0] + cos * accel[:, 1]
        w = rate[new]
        spin = (np.diff(rate, prepend=rate[0]) / dt)[new] if mount.x or mount.y else np.zeros(len(w))
        return np.column_stack((ax + spin * mount.y + w**2 * mount.x, ay - spin * mount.x + w**2 * mount.y))

    def _reckon(self, s: Signals, begins: bool) -> None:
        """The substitution over the new rows, and the path that its steps make."""
        new = slice(0 if begins else 1, None)
        before = self._gained[-1, 1] if len(self._gained) else 0.0
        gained = before + np.cumsum(s.forward[new] * s.dt[new])
        table = np.concatenate((self._gained, np.column_stack((s.speed[new], gained))))
        at = np.arange(len(self._gained), len(table))
        behind = table[np.maximum(at - self._back, 0)]
        change = (table[at, 0] - behind[:, 0]) - (table[at, 1] - behind[:, 1])
        self._gained = table[-self._back :]
        fresh = _rows(s, new)
        steps, _, _ = substituted(fresh, change, self._numbers, CHOICE, self._state)
        self._path = _extended(self._path, fresh.t, steps)

    def _follow(self, t: Array) -> Trajectory | None:
        """Through the fixes that lie on the path by now; poses at the stamps t."""
        track = self._track or self._set_out()
        if track is None:
            return None
        due = self._fixes[:, 0] <= self._path.t[-1]
        fixes, self._fixes = self._fixes[due], self._fixes[~due]
        if len(fixes):
            track.tracker.fixes = BeaconFixes(
                fixes[:, 0], fixes[:, 1:4], (self._numbers.fix_xy, self._numbers.fix_theta)
            )
            track.tracker.ends += self._shocks.ended()
            rows = np.vstack((track.rows[-1:], self._path.at(fixes[:, 0])))
            pose, P, _ = track.tracker.go_on(track.kf, fixes[:, 0], rows)
            track.tracker.events.clear()
            track = _Track(
                np.concatenate((track.t[-1:], fixes[:, 0])), np.vstack((track.pose[-1:], pose)),
                np.concatenate((track.covariance[-1:], P)), rows, track.tracker, track.kf,
            )  # fmt: skip
        self._track = track
        return self._between(track, t)

    def _between(self, track: _Track, t: Array) -> Trajectory:
        """Poses at the stamps: the last fix's, carried on by dead reckoning."""
        table = self._path.table[np.searchsorted(self._path.t, t)]
        last = np.maximum(np.searchsorted(track.t, t, "right") - 1, 0)
        moved, noise = motion(track.rows[last], table)
        base = track.pose[last]
        pose = compose(base, moved)
        J = np.broadcast_to(np.eye(3), noise.shape).copy()
        J[:, 0, 2], J[:, 1, 2] = -(pose[:, 1] - base[:, 1]), pose[:, 0] - base[:, 0]
        R = rotation(base[:, 2])
        P = J @ track.covariance[last] @ np.swapaxes(J, -1, -2) + R @ noise @ np.swapaxes(R, -1, -2)
        return Trajectory(t, pose[:, 0], pose[:, 1], pose[:, 2], P)

    def _set_out(self) -> _Track | None:
        """From the start pose, else from the first fixes with a heading."""
        numbers, path, robot = self._numbers, self._path, self._meta.robot
        fixes = self._fixes = self._fixes[self._fixes[:, 0] >= path.t[0]]
        if self._meta.start is not None:
            pose = self._pose
            P = np.diag(np.square((numbers.start_xy, numbers.start_xy, numbers.start_theta)))
        else:
            z = fixes[fixes[:, 0] <= path.t[-1]][:FIRST_FIXES, :4]
            headless = bool(np.isnan(z[:, 3]).any())
            self.reason = HEADLESS if headless else WAITING
            if headless or len(z) < FIRST_FIXES:
                return None
            body = compose(z[:, 1:], -np.broadcast_to(np.array((robot.tag.x, robot.tag.y, 0.0)), (len(z), 3)))
            starts = compose(body, inverse(path.at(z[:, 0])[:, :3]))
            starts[:, 2] = starts[0, 2] + wrap_angle(starts[:, 2] - starts[0, 2])
            pose = compose(np.median(starts, axis=0), path.table[0, :3])
            P = np.diag(np.square((numbers.fix_xy, numbers.fix_xy, numbers.fix_theta)))
            self._fixes = fixes[fixes[:, 0] > z[-1, 0]]
        self.reason = None
        tag = np.array((robot.tag.x, robot.tag.y))
        tracker = Tracker(BeaconFixes(np.zeros(0), np.zeros((0, 3)), (0.0, 0.0)), path, [], tag, numbers, CHOICE)
        tracker.begin(float(path.t[0]))
        return _Track(path.t[:1], pose[None], P[None], path.table[:1], tracker, PoseFilter(pose, P, tag))


@dataclass(frozen=True)
class _Track:
    """The filter after fixes: stamps, poses, covariances, rows of the reckoned path there; the last are the newest."""

    t: Array
    pose: Array
    covariance: Array
    rows: Array
    tracker: Tracker
    kf: PoseFilter


class _Shocks:
    """When shocks ended, told once they have."""

    def __init__(self, hz: float) -> None:
        self._usual = LowPass(hz, USUAL_HZ)
        self._before = math.nan  # usual vibration at the row before
        self._peak = -math.inf
        self._ends: list[float] = []

    def take(self, s: Signals, new: slice) -> None:
        size = np.hypot(s.sharp[new, 0], s.sharp[new, 1])
        usual = np.sqrt(np.maximum(self._usual(np.minimum(size, CHOICE.shock) ** 2), 0.0))
        before = np.concatenate(((usual[0] if math.isnan(self._before) else self._before,), usual[:-1]))
        self._before = float(usual[-1])
        peaks = s.t[new][size > np.maximum(CHOICE.shock, CHOICE.shock_factor * before)]
        for peak in peaks.tolist():  # few
            if peak - self._peak > CHOICE.quiet and math.isfinite(self._peak):
                self._ends.append(self._peak + CHOICE.quiet)
            self._peak = peak
        if s.t[-1] - self._peak > CHOICE.quiet and math.isfinite(self._peak):
            self._ends.append(self._peak + CHOICE.quiet)
            self._peak = -math.inf

    def ended(self) -> list[float]:
        ends, self._ends = self._ends, []
        return ends


def _rows(s: Signals, new: slice) -> Signals:
    """Signals of some rows, contiguous."""
    columns: dict[str, Any] = {
        name: np.ascontiguousarray(value[new]) if isinstance(value, np.ndarray) else value
        for name, value in vars(s).items()
    }
    return Signals(**columns)


def _extended(path: Reckoning, t: Array, steps: Steps) -> Reckoning:
    """The path with the steps behind it, as `Reckoning.of` over all steps."""
    if not len(path.t):
        return Reckoning.of(t, steps)
    last = path.table[-1]
    d, turn = (np.concatenate(((0.0,), np.cumsum(column))) for column in (steps.distance, steps.turn))
    pose = arcs(d, turn, (float(last[0]), float(last[1]), float(last[2])))
    middle, qt, qd = (pose[1:] + pose[:-1]) / 2, steps.var_turn, steps.var_distance
    x, y, cos, sin = middle[:, 0], middle[:, 1], np.cos(middle[:, 2]), np.sin(middle[:, 2])
    grown = (qt, qt * x, qt * y, qt * x * x, qt * y * y, qt * x * y, qd * cos * cos, qd * sin * sin, qd * sin * cos)
    sums = last[3:] + np.cumsum(np.column_stack(grown), axis=0)
    return Reckoning(np.concatenate((path.t, t)), np.vstack((path.table, np.column_stack((pose[1:], sums)))))
