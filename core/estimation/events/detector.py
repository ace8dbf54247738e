"""`Detector`: the compiled walks put together, for a log that may come in pieces; `detect` for a whole run.

Causal: what is said at a stamp comes from readings up to that stamp. `alarm` of a disturbance is when it was known:
a blow LOOK s after it has crossed its threshold, a contradiction between wheels and IMU no sooner than WAIT s after the
wheel reading, as streams may lag behind each other by so much.
"""

from __future__ import annotations

import dataclasses
import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions, encoder_quantum
from core.estimation.cleaning import FARTHEST_ANGLE, FASTEST_TURN
from core.estimation.events.disturbances import Disturbance, Disturbances
from core.estimation.events.words import Blow, blow_disturbance, incident_disturbance
from core.run import Run, RunMeta
from core.sensors import ImuLog

Array = npt.NDArray[np.float64]

SHEET_ACCEL = 3e-3  # m/s^2/sqrt(Hz), where run.json is silent
SYSTEMATIC_TURN, SYSTEMATIC_SPEED = 2e-3, 0.01  # rad, m/s: smaller contradictions are nobody's business
TILT_WALK = 0.025  # m/s^2/sqrt(s): the floor is not level
TAIL = 1.25  # real noise has longer tails than Gauss: thresholds are higher by this
LEAST_BLOW, LEAST_PEAK, LEAST_HEAVE = 0.06, 4.0, 1.5  # m/s, m/s^2, m/s^2
MEMORY = 20.0  # s over which noise is learnt
FIRST_BLOWS = (0.12**2, 1.5**2, 0.15**2, 2.5**2)  # noise of blow, az, rates, plane before any is learnt
SEEN = 0.2  # s, weight of that first guess
DELAY_SD = 0.03  # s, between the streams
APART, SURELY = 0.01, 4.0  # s, sigma: a delay that is worth a sentence
LONG = 20_000  # IMU readings of a piece from which on a second thread is worth its while
STRONGEST = 1e3  # m/s^2: beyond it a reading is a fault
FLOOR_ACCEL, FLOOR_RATE = 0.05, 0.01  # m/s^2, rad/s: quieter is taken for this


def thresholds(false_alarms: float) -> tuple[float, float]:
    """Sigma of the point test, and of the CUSUM, at which Gaussian noise would raise so many alarms an hour.

    Point: two-sided, as many independent sums as there are base steps and window lengths. CUSUM: Siegmund's
    approximation of its run length, ARL = 2 (exp(b) - b - 1) for a drift of half a sigma, b = h + 1.166.
    """
    from scipy.special import ndtri

    steps = 3600.0 / 0.04
    point = -float(ndtri(min(0.5 * false_alarms / (2.0 * steps), 0.4)))
    arl = 2.0 * steps / false_alarms
    b = 1.0
    for _ in range(50):
        b = math.log(arl / 2.0 + b + 1.0)
    return TAIL * point, TAIL * max(b - 1.166, 1.0)


class Detector:
    """State of the walks. `feed` pieces in order of time, each with all streams of its span; then `finish`."""

    def __init__(self, meta: RunMeta, numbers: Assumptions, first: Run) -> None:
        from core.estimation.events import _impact_numba as impact
        from core.estimation.events import _incident_numba as incident
        from core.estimation.events import _residual_numba as residual

        self._meta, self._numbers = meta, numbers
        self._r, self._i, self._c = residual, impact, incident
        imu = first.imu
        self._accel = imu is not None and imu.ax is not None and imu.ay is not None
        self._limits, self._blow_limits = self._residual_limits(), self._impact_limits()
        self._s = np.zeros(residual.SCALARS)
        self._s[residual.STEPS] = -1.0
        self._s[residual.PA] = self._s[residual.PS] = 0.3**2
        self._s[residual.UNASKED] = 10.0
        self._ring, self._queue = np.zeros((residual.RING, 8)), np.zeros((residual.QUEUE, 3))
        self._p, self._P = np.zeros(4), self._prior()
        self._ch, self._past = np.zeros((3, 13)), np.zeros((3, residual.HISTORY, 5))
        self._noise, self._weight = self._first_noise()
        self._calm = np.array((self._limits.still_gyro, self._limits.still_accel, 0.0, 0.0, 0.0))
        self._bs, self._bring = np.zeros(impact.STATE), np.zeros((impact.RING, 6))
        self._bs[9] = -1e9
        self._bnoise = np.tile(FIRST_BLOWS, (impact.BINS, 1)) * np.array((0.1, 0.5, 1, 2))[:, None]
        self._bweight = np.full((impact.BINS, impact.NOISES), SEEN)
        self._cs = np.zeros(incident.STATE)
        self._cs[incident.LAST_MIS] = -1e9
        self._last_blow, self._speed = -1e9, np.zeros(2)
        self._wheels = np.zeros((0, 3))  # the last reading before the piece: stamp, both angles
        self._rows: list[Array] = []

    def feed(self, piece: Run) -> tuple[Disturbance, ...]:
        """What came to its end within the piece."""
        return self._walk(piece, False)

    def finish(self) -> tuple[Disturbance, ...]:
        """What was still going on at the end."""
        return self._walk(Run(self._meta), True)

    @property
    def learnt(self) -> dict[str, float]:
        """Noise and constants as known by now: SI, named with their units."""
        r = self._r
        return {
            "delay [s]": float(self._p[3]),
            "track scale": float(self._p[1]),
            "still gyro [rad/s]": float(np.sqrt(self._calm[0])),
            "still accelerometer [m/s²]": float(np.sqrt(self._calm[1] / 2)),
            "turn per step, driving [rad]": float(np.sqrt(self._noise[r.TURN, 2, 0])),
            "speed per step, driving [m/s]": float(np.sqrt(self._noise[r.ALONG, 2, 0])),
            "vertical, driving [m/s²]": float(np.sqrt(self._bnoise[2, 1])),
        }

    def clocks(self) -> tuple[str, ...]:
        """A sentence where the IMU's stamps and the wheels' have shown to be apart."""
        delay, sd = float(self._p[3]), float(np.sqrt(self._P[3, 3]))
        if abs(delay) < APART or abs(delay) < SURELY * sd or sd > 0.5 * DELAY_SD:
            return ()
        way = "late" if delay > 0 else "early"
        return (f"The IMU's stamps are {1e3 * abs(delay):.0f} ± {1e3 * sd:.0f} ms {way} against the wheels'.",)

    def _walk(self, piece: Run, flush: bool) -> tuple[Disturbance, ...]:
        if piece.imu is not None and len(piece.imu) > LONG:
            with ThreadPoolExecutor(1) as aside:
                felt = aside.submit(self._blows, piece, flush)
                rows = self._residuals(piece, flush)
                blows, stamps, last = felt.result()
        else:
            blows, stamps, last = self._blows(piece, flush)
            rows = self._residuals(piece, flush)
        known = rows[:, self._r.R_KNOWN]
        place = np.searchsorted(stamps, known, "right")
        blow = np.concatenate(([self._last_blow], last))[place] if len(known) else np.zeros(0)
        if len(last):
            self._last_blow = float(last[-1])
        found = np.zeros((4 * len(rows) + 8, self._c.SIZE + 1))
        track = self._limits.track
        n = self._c.walk(rows, blow, self._cs, found, track, self._accel, flush)
        incidents = [incident_disturbance(row, track) for row in found[:n]]
        return tuple(incidents) + tuple(blow_disturbance(row) for row in blows)

    def _blows(self, piece: Run, flush: bool) -> tuple[list[Blow], Array, Array]:
        imu = piece.imu
        if not self._accel or (imu is None and not flush):
            return [], np.zeros(0), np.zeros(0)
        t = imu.t if imu is not None else np.zeros(0)
        data = np.full((len(t), 5), np.nan)
        if imu is not None:
            data[:, :2] = self._force(imu)
            for k, column in enumerate((imu.az, imu.gx, imu.gy)):
                if column is not None:
                    data[:, 2 + k] = _plausible(column)
        last, found = np.zeros(len(t)), np.zeros((len(t) + 4, self._i.SIZE))
        n = self._i.walk(
            t, data, self._rim_speed(piece, t), self._bs, self._bring, self._bnoise, self._bweight, last, found, flush,
            self._blow_limits,
        )  # fmt: skip
        up = self._i.UP
        return [Blow.of(row, bool(row[11] == up)) for row in found[:n]], t, last

    def _rim_speed(self, piece: Run, t: Array) -> Array:
        """(N, 2) speed [m/s] of the faster wheel, and of both on average, by the newest readings at each IMU stamp."""
        radius, w = self._meta.robot.wheel_radius, piece.wheels
        if w is None or not radius or not len(w):
            return np.tile(self._speed, (len(t), 1))
        angles = np.column_stack([_plausible(c, FARTHEST_ANGLE) for c in (w.left, w.right)])
        stamps, angles = np.concatenate((self._wheels[:, 0], w.t)), np.vstack((self._wheels[:, 1:], angles))
        self._wheels = np.concatenate((stamps[-1:], angles[-1]))[None, :]
        rims = np.diff(angles, axis=0) * radius / np.diff(stamps)[:, None]
        if not len(rims):
            return np.tile(self._speed, (len(t), 1))
        speed = np.vstack((self._speed, np.column_stack((np.abs(rims).max(axis=1), rims.mean(axis=1)))))
        self._speed = speed[-1]
        return np.ascontiguousarray(speed[np.searchsorted(stamps[1:], t, "right")])

    def _residuals(self, piece: Run, flush: bool) -> Array:
        t, kind, data = self._merged(piece)
        rows = np.zeros((int(np.sum(kind == self._r.WHEEL)) + self._r.QUEUE + 1, self._r.ROW))
        n = self._r.walk(
            t, kind, data, self._s, self._ring, self._queue, self._p, self._P, self._ch, self._past, self._noise,
            self._weight, self._calm, rows, flush, self._limits,
        )  # fmt: skip
        return rows[:n]

    def _merged(self, piece: Run) -> tuple[Array, npt.NDArray[np.int64], Array]:
        parts: list[tuple[Array, int, Array]] = []
        radius = self._meta.robot.wheel_radius
        if piece.imu is not None:
            data = np.zeros((len(piece.imu), 4))
            data[:, 0] = _plausible(piece.imu.gz, FASTEST_TURN)
            if self._accel:
                data[:, 1:3] = self._force(piece.imu)
            parts.append((piece.imu.t, self._r.IMU, data))
        if piece.wheels is not None and radius:
            both = (piece.wheels.left, piece.wheels.right)
            angles = np.column_stack([_plausible(column, FARTHEST_ANGLE) for column in both]) * radius
            good = np.isfinite(angles).all(axis=1)
            parts.append((piece.wheels.t[good], self._r.WHEEL, np.pad(angles[good], ((0, 0), (0, 2)))))
        if piece.commands is not None:
            asked = np.nan_to_num(np.column_stack((piece.commands.v, piece.commands.w)).astype(np.float64))
            parts.append((piece.commands.t, self._r.COMMAND, np.pad(asked, ((0, 0), (0, 2)))))
        if not parts:
            return np.zeros(0), np.zeros(0, np.int64), np.zeros((0, 4))
        t = np.concatenate([p[0] for p in parts])
        kind = np.concatenate([np.full(len(p[0]), p[1], np.int64) for p in parts])
        order = np.argsort(t, kind="stable")  # kinds stand in their order already
        return t[order], kind[order], np.ascontiguousarray(np.concatenate([p[2] for p in parts])[order])

    def _force(self, imu: ImuLog) -> Array:
        """Specific force (N, 2) in the body's axes; readings beyond 1000 m/s^2 are none."""
        assert imu.ax is not None and imu.ay is not None
        c, s = math.cos(self._meta.robot.imu.yaw), math.sin(self._meta.robot.imu.yaw)
        ax, ay = _plausible(imu.ax), _plausible(imu.ay)
        return np.column_stack((c * ax - s * ay, s * ax + c * ay))

    def _residual_limits(self) -> Any:
        numbers, robot, noise = self._numbers, self._meta.robot, self._meta.noise
        point, cusum = thresholds(numbers.event_false_alarms)
        accel = noise.accel_density or SHEET_ACCEL
        values = self._r.Limits(
            track=robot.track_width or 0.0,
            arm_x=robot.imu.x,
            arm_y=robot.imu.y,
            has_accel=float(self._accel),
            point=point,
            cusum=cusum,
            quantum=encoder_quantum(Run(self._meta), numbers) * (robot.wheel_radius or 0.0),
            q_gyro=numbers.gyro_density**2 / 2,
            q_bias=numbers.bias_walk**2,
            q_tilt=TILT_WALK**2,
            sd_turn=SYSTEMATIC_TURN,
            sd_along=SYSTEMATIC_SPEED,
            memory=MEMORY,
            still_gyro=numbers.gyro_density**2 * 50.0,
            still_accel=2.0 * accel**2 * 50.0,
        )
        return self._r.Limits(*(float(v) for v in values))

    def _impact_limits(self) -> Any:
        point, _ = thresholds(self._numbers.event_false_alarms)
        values = self._i.Limits(
            blow=point,
            heave=0.75 * point,
            least_blow=LEAST_BLOW,
            least_peak=LEAST_PEAK,
            least_heave=LEAST_HEAVE,
            memory=MEMORY,
            floor_accel=FLOOR_ACCEL,
            floor_rate=FLOOR_RATE,
        )
        return self._i.Limits(*(float(v) for v in values))

    def _prior(self) -> Array:
        n = self._numbers
        track = self._meta.robot.track_width or 1.0
        sd = (n.bias_sd, n.track_scale_sd, n.inequality_sd / track, DELAY_SD)
        return np.diag(np.square(sd))

    def _first_noise(self) -> tuple[Array, Array]:
        """Noise before anything is learnt: wide, and soon forgotten."""
        r = self._r
        span = np.array(r.LENGTHS) * r.STEP
        speed = np.array((0.0, 0.1, 0.4, 0.8))[:, None]
        track = self._meta.robot.track_width or 0.3
        noise = np.empty((3, r.BINS, r.WINDOWS))
        noise[r.TURN] = 4e-3**2 + (0.5 * self._numbers.slip / track) ** 2 * speed * span
        noise[r.ALONG] = noise[r.SIDE] = 0.02**2 + (0.02**2 + (0.2 * speed) ** 2) * span
        return noise, np.full(noise.shape, SEEN)


def _plausible(column: npt.NDArray[np.floating], most: float = STRONGEST) -> Array:
    """float64, NaN for what no sensor reads."""
    values = np.asarray(column, np.float64)
    return np.where(np.abs(values) <= most, values, np.nan)


def detect(run: Run, numbers: Assumptions) -> Disturbances:
    """All disturbances of a run, by onset, with the noise that was learnt and notes on what could not be seen."""
    detector = Detector(run.meta, numbers, run)
    found = (*detector.feed(run), *detector.finish())
    return dataclasses.replace(gather(found), noise=detector.learnt, notes=_notes(run), clocks=detector.clocks())


def gather(found: tuple[Disturbance, ...]) -> Disturbances:
    """Found disturbances by onset, each named by its cause."""
    from core.estimation.events.causes import by_cause

    return Disturbances(by_cause(found))


def _notes(run: Run) -> tuple[str, ...]:
    """What this run cannot show."""
    notes = []
    imu = run.imu
    if run.wheels is None or not run.meta.robot.wheel_radius:
        notes.append("Events: no wheels in metres, so only blows can be seen; a hard stop passes for a collision.")
    if imu is None:
        notes.append("Events: no IMU, so only wheels that are asked to turn and do not can be seen.")
        return tuple(notes)
    if imu.ax is None or imu.ay is None:
        notes.append("Events: no accelerometer; collisions, bounces and slip of both wheels alike cannot be seen.")
    elif imu.az is None:
        notes.append("Events: no vertical accelerometer; bounces are seen by pitch and roll alone, if at all.")
    if run.wheels is not None and not run.meta.robot.track_width:
        notes.append("Events: no track width, so slip in turns cannot be seen.")
    return tuple(notes)
