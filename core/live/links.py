"""The live gap: each link of the chain commands -> wheels -> body -> sensors against its own noise floor.

Each link is predicted from the stream before it by the nominal model (run format, "The nominal simulator"), over
stretches of some tenths of a second; the residual is divided by what the sensors' noise alone would give. Offsets of
gyro and accelerometer are taken out as far as rests have shown them: those are a matter of calibration, and drawn as
bias. `excess` is the root mean square over the last seconds of driving, 1 at the floor.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions, encoder_quantum
from core.estimation.cleaning import forward_acceleration, gyro_readings
from core.estimation.odometry import WheelPath, arcs
from core.estimation.result import Curve
from core.live.disturbed import complete_until
from core.run import Run, RunMeta
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]

STRETCH = 0.5  # s over which a link is looked at
APART = 1.0  # s between two fixes, or two ranges of a beacon
SPAN = 20.0  # s that the excess is made of
FEWEST = 6  # residuals
CHANCE = 1e-4  # probability that noise alone leaves the level
STAYS = 1.5  # s for which it must stay out before it is a warning
STILL = 1e-3  # m/s, rad/s: slower is no driving
LEARN = 0.1  # weight of a stretch at rest in the accelerometer's offset
TURN_SHARE = 0.02  # of the way, across it: what the heading by the filter may be wrong by

COMMANDS, GYRO, ACCELEROMETER, BEACON, RANGES = LINKS = (
    "commands to wheels", "wheels to gyro", "wheels to accelerometer", "body to beacon", "body to ranges",
)  # fmt: skip
STREAMS = {
    COMMANDS: ("wheels.left", "wheels.right"),
    GYRO: ("imu.gz",),
    ACCELEROMETER: ("imu.ax",),
    BEACON: ("beacon.x", "beacon.y"),
    RANGES: ("ranges",),
}


@dataclass(frozen=True)
class LinkState:
    """excess: rms of the standardised residual, None without data; level: above it chance is no explanation; warn: it
    has stayed above; rows: residuals that it is made of."""

    link: str
    streams: tuple[str, ...]
    excess: float | None
    level: float
    warn: bool
    rows: int


class _Link:
    """Standardised residuals of the last seconds."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._rows: deque[tuple[float, float, int]] = deque()
        self._out_since: float | None = None
        self.seen = False

    def add(self, t: float, *standardised: float) -> None:
        values = [z for z in standardised if np.isfinite(z)]
        if values:
            self.seen = True
            self._rows.append((t, sum(z * z for z in values), len(values)))

    def state(self, now: float) -> LinkState:
        while self._rows and self._rows[0][0] < now - SPAN:
            self._rows.popleft()
        n = sum(row[2] for row in self._rows)
        level = _level(max(n, FEWEST))
        excess = float(np.sqrt(sum(row[1] for row in self._rows) / n)) if n >= FEWEST else None
        if excess is None or excess <= level:
            self._out_since = None
        elif self._out_since is None:
            self._out_since = now
        warn = self._out_since is not None and now - self._out_since >= STAYS
        return LinkState(self.name, STREAMS[self.name], excess, level, warn, n)


def _integral(t: Array, y: Array) -> Array:
    """(N,) from the first stamp on, by trapezoids."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))))


def _level(n: int) -> float:
    from scipy.special import chdtri

    return float(np.sqrt(chdtri(n, CHANCE) / n))


class Links:
    """All links of a run."""

    def __init__(self, meta: RunMeta, numbers: Assumptions) -> None:
        self._meta, self._numbers = meta, numbers
        self._links = {name: _Link(name) for name in LINKS}
        self._at: float | None = None
        self._offset: float | None = None  # of the accelerometer, m/s^2
        self._bias: tuple[float, float] | None = None  # of the gyro and its sd, rad/s
        self._path: Trajectory | None = None
        self._fix: tuple[float, float, float] | None = None
        self._range: dict[str, tuple[float, float]] = {}

    def know(self, bias: Curve | None, fused: Trajectory | None) -> None:
        """The newest bias, and new poses that bring fixes and ranges into the body's frame."""
        if bias is not None and bias.sd is not None:
            self._bias = float(bias.value[-1]), float(bias.sd[-1])
        if fused is not None:
            old = self._path
            if old is not None:
                kept = old.t > fused.t[0] - 3 * APART
                kept &= old.t < fused.t[0]
                columns = (np.concatenate((getattr(old, k)[kept], getattr(fused, k))) for k in ("t", "x", "y", "theta"))
                self._path = Trajectory(*columns)
            else:
                self._path = fused

    def step(self, recent: Run, rolled: WheelPath) -> tuple[LinkState, ...]:
        """Take the stretches that are complete by now."""
        until = min(complete_until(recent), float(rolled.t[-1]) if len(rolled.t) else -np.inf)
        if len(rolled.t) > 2:
            if self._at is None:
                self._at = float(rolled.t[0])
            self._at = max(self._at, float(rolled.t[0]))
            while until - self._at >= STRETCH:
                i, j = np.searchsorted(rolled.t, (self._at, self._at + STRETCH))
                last = int(j + (j - i) // 5)  # speeds are told from readings on both sides
                if j - i < 2 or last >= len(rolled.t) or rolled.t[last] > until:
                    break
                self._stretch(recent, rolled, int(i), int(j))
                self._at = float(rolled.t[j])
            self._fixes(recent, rolled)
            self._ranges(recent, rolled)
        now = recent.span[1]
        return tuple(link.state(now) for link in self._links.values() if link.seen)

    def _stretch(self, recent: Run, rolled: WheelPath, i: int, j: int) -> None:
        a, b = float(rolled.t[i]), float(rolled.t[j])
        d, turn = float(rolled.d[j] - rolled.d[i]), float(rolled.turn[j] - rolled.turn[i])
        driving = abs(d) + abs(np.nan_to_num(turn)) > STILL * (b - a)
        quantum = encoder_quantum(recent, self._numbers)
        if recent.commands is not None:
            self._commands(recent, a, b, d, turn, quantum, driving)
        if recent.imu is not None and len(recent.imu) > 2:
            self._gyro(recent, a, b, turn, quantum, driving)
            self._accelerometer(recent, rolled, i, j, quantum, driving)

    def _commands(self, recent: Run, a: float, b: float, d: float, turn: float, q: float, driving: bool) -> None:
        commands, robot = recent.commands, self._meta.robot
        assert commands is not None
        if not robot.wheel_radius or not robot.track_width or commands.t[0] > a:
            return
        t = np.unique(np.concatenate(((a, b), commands.t[(commands.t > a) & (commands.t < b)])))
        v, w = (np.interp(t, commands.t, np.nan_to_num(column)) for column in (commands.v, commands.w))
        asked_d, asked_turn = float(np.trapezoid(v, t)), float(np.trapezoid(w, t))
        if not driving and abs(asked_d) + abs(asked_turn) < STILL * (b - a):
            return
        half = robot.track_width / 2
        sd = q * robot.wheel_radius / np.sqrt(6)
        left, right = d - asked_d - half * (turn - asked_turn), d - asked_d + half * (turn - asked_turn)
        self._links[COMMANDS].add(b, left / sd, right / sd)

    def _gyro(self, recent: Run, a: float, b: float, turn: float, q: float, driving: bool) -> None:
        robot, imu = self._meta.robot, recent.imu
        assert imu is not None
        if not driving or not robot.track_width or not robot.wheel_radius or self._bias is None or imu.t[0] > a:
            return
        t, gz = gyro_readings(imu)
        total = _integral(t, gz)
        bias, sd = self._bias
        turned = float(np.interp(b, t, total) - np.interp(a, t, total)) - bias * (b - a)
        quantum = q * robot.wheel_radius / robot.track_width
        variance = self._numbers.gyro_density**2 / 2 * (b - a) + quantum**2 / 3 + (sd * (b - a)) ** 2
        self._links[GYRO].add(b, (turned - turn) / np.sqrt(variance))

    def _accelerometer(self, recent: Run, rolled: WheelPath, i: int, j: int, q: float, driving: bool) -> None:
        imu, radius = recent.imu, self._meta.robot.wheel_radius
        assert imu is not None and radius
        a, b = float(rolled.t[i]), float(rolled.t[j])
        forward = forward_acceleration(imu, self._meta.robot.imu)
        if forward is None or imu.t[0] > a:
            return
        k = max(1, (j - i) // 5)
        if not driving:
            inside = (imu.t >= a) & (imu.t <= b)
            mean = float(np.mean(forward[inside])) if inside.any() else 0.0
            self._offset = mean if self._offset is None else self._offset + LEARN * (mean - self._offset)
            return
        if self._offset is None or i < k or imu.t[0] > rolled.t[i - k]:
            return
        # both say the mean speed over the same short windows: what changes inside them is no difference
        windows = [(rolled.t[m - k], rolled.t[m + k], rolled.d[m + k] - rolled.d[m - k]) for m in (i, j)]
        way = _integral(imu.t, _integral(imu.t, forward - self._offset))
        by_wheels, by_imu = (
            [change / (t1 - t0) for t0, t1, change in rows]
            for rows in (
                windows,
                [(t0, t1, np.interp(t1, imu.t, way) - np.interp(t0, imu.t, way)) for t0, t1, _ in windows],
            )
        )
        width = float(rolled.t[j + k] - rolled.t[j - k])
        of_wheels = (q * radius / width) ** 2 / 6  # two speeds, each of two readings of two wheels
        sheet = self._meta.noise.accel_density or self._numbers.accel_density
        variance = sheet**2 / 2 * (b - a) + of_wheels
        residual = by_imu[1] - by_imu[0] - by_wheels[1] + by_wheels[0]
        self._links[ACCELEROMETER].add(b, float(residual / np.sqrt(variance)))

    def _tag(self, rolled: WheelPath, a: float, b: float) -> tuple[Array, Array] | None:
        """The tag in the map at both stamps: where the filter says it was at `a`, and on by the wheels."""
        path, robot = self._path, self._meta.robot
        if path is None or not np.isfinite(rolled.turn).all() or not path.t[0] <= a <= path.t[-1]:
            return None
        if a < rolled.t[0] or b > rolled.t[-1]:
            return None
        inside = rolled.t[(rolled.t > a) & (rolled.t < b)]
        t = np.concatenate(((a,), inside, (b,)))
        start = path.at(np.array([a]))[0]
        pose = arcs(np.interp(t, rolled.t, rolled.d), np.interp(t, rolled.t, rolled.turn), tuple(start))[[0, -1]]
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        tag = robot.tag
        at = np.column_stack((pose[:, 0] + c * tag.x - s * tag.y, pose[:, 1] + s * tag.x + c * tag.y))
        return at[0], at[1]

    def _fixes(self, recent: Run, rolled: WheelPath) -> None:
        if recent.beacon is None:
            return
        log, end = recent.beacon, float(rolled.t[-1])
        for t, x, y in zip(log.t.tolist(), np.asarray(log.x).tolist(), np.asarray(log.y).tolist(), strict=True):
            if t > end or (self._fix is not None and t < self._fix[0] + APART) or not np.isfinite(x + y):
                continue
            before, self._fix = self._fix, (t, x, y)
            moved = self._tag(rolled, before[0], t) if before is not None else None
            if before is None or moved is None:
                continue
            by_wheels = moved[1] - moved[0]
            far = float(np.hypot(*by_wheels))
            if far < STILL * APART:
                continue
            sd = np.sqrt(2 * self._numbers.fix_xy**2 + (TURN_SHARE * far) ** 2)
            self._links[BEACON].add(t, (x - before[1] - by_wheels[0]) / sd, (y - before[2] - by_wheels[1]) / sd)

    def _ranges(self, recent: Run, rolled: WheelPath) -> None:
        log = recent.ranges
        if log is None:
            return
        end = float(rolled.t[-1])
        for t, code, found in zip(log.t.tolist(), log.beacon.tolist(), np.asarray(log.range).tolist(), strict=True):
            name = log.names[code]
            before = self._range.get(name)
            if t > end or name not in self._meta.beacons or not np.isfinite(found):
                continue
            if before is not None and t < before[0] + APART:
                continue
            self._range[name] = (t, found)
            moved = self._tag(rolled, before[0], t) if before is not None else None
            if before is None or moved is None or np.hypot(*(moved[1] - moved[0])) < STILL * APART:
                continue
            bx, by, bz = self._meta.beacons[name]
            far = [
                float(np.sqrt((p[0] - bx) ** 2 + (p[1] - by) ** 2 + (self._meta.robot.tag.z - bz) ** 2)) for p in moved
            ]
            sd = np.sqrt(2 * self._numbers.range**2 + (TURN_SHARE * np.hypot(*(moved[1] - moved[0]))) ** 2)
            self._links[RANGES].add(t, (found - before[1] - far[1] + far[0]) / sd)
