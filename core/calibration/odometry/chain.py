"""One run as a chain of poses: what wheels, gyro and reference say of them, as residuals with Jacobians.

Poses stand at the reference's stamps. Between two of them the wheels' arcs (left and right radius, track) and the
gyro's turn (scale, bias, clock) are measurements of the motion, with process noise from slip; the reference measures
each pose or the tag on it, as it was `reference_delay` before.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from core.calibration.odometry.arrow import Arrow
from core.calibration.odometry.model import DELAY, GYRO, IMU_CLOCK, LEFT, RIGHT, TAG_X, TAG_Y, TAG_YAW, TRACK
from core.calibration.odometry.reference import Reference
from core.estimation.cleaning import gyro_readings, wheel_readings
from core.estimation.odometry import arcs
from core.geometry import between, wrap_angle
from core.run import Run

Array = npt.NDArray[np.float64]

BIAS_EVERY = 300.0  # s between nodes of the gyro's bias
BIAS_SD, BIAS_WALK = 0.05, 1e-5  # rad/s at the first node, rad/s/sqrt(s) from node to node
DELAY_SD = 0.1  # s, of each run's own delay
SPEED_SPAN = 0.1  # s either side, over which speeds at the knots are taken


@dataclass(frozen=True)
class Noise:
    """slip, side [m/sqrt(m)] of wheels; of the reference: by how much its stated sd of places and of headings is too
    small, and the jitter [s] of its stamps against the wheels'."""

    slip: float = 0.003
    side: float = 0.001
    places: float = 1.0
    headings: float = 1.0
    jitter: float = 0.0


@dataclass
class Chain:
    """t (K,) of the knots; pose (K, 3), the current estimate; columns, delay: where the nodes of its gyro bias and its
    own delay (None: it has none) stand among the shared unknowns."""

    run: Run
    reference: Reference
    pose: Array
    columns: slice
    weight_steps: Array
    weight_reference: Array
    delay: int | None = None
    ends: tuple[float, float] | None = None  # of the whole run, where this is a part of one

    @property
    def t(self) -> Array:
        """(K,) stamps."""
        return self.reference.t

    def path(self, shared: Array, t: Array) -> tuple[Array, Array]:
        """Poses (M, 3) at stamps t by the wheels alone, and the distance (M,) that a wheel rolled on average."""
        wheels, robot = self.run.wheels, self.run.meta.robot
        assert wheels is not None and robot.wheel_radius and robot.track_width
        left, right = wheel_readings(wheels)
        left = robot.wheel_radius * (1 + shared[LEFT]) * (left - left[0])
        right = robot.wheel_radius * (1 + shared[RIGHT]) * (right - right[0])
        track = robot.track_width * (1 + shared[TRACK])
        pose = arcs((left + right) / 2, (right - left) / track)
        rolled = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(left)) + np.abs(np.diff(right))))) / 2
        rows = np.column_stack([np.interp(t, wheels.t, column) for column in (*pose.T, rolled)])
        return rows[:, :3], rows[:, 3]

    def steps(self, shared: Array) -> tuple[Array, Array, Array]:
        """Motions (K - 1, 3) between knots, derivatives (K - 1, 3, 3) by left, right, track; rolled (K - 1,)."""
        pose, rolled = self.path(shared, self.t)
        step = between(pose[:-1], pose[1:])
        J = np.empty((len(step), 3, 3))
        for i in (LEFT, RIGHT, TRACK):
            ends = []
            for sign in (1, -1):
                moved = shared.copy()
                moved[i] += sign * 1e-4
                there, _ = self.path(moved, self.t)
                ends.append(between(there[:-1], there[1:]))
            J[:, :, i] = (ends[0] - ends[1]) / 2e-4
        return step, J, np.diff(rolled)

    def speeds(self, shared: Array) -> tuple[Array, Array]:
        """Forward speed and turn rate (K,) at the knots, by the wheels."""
        ahead, _ = self.path(shared, self.t + SPEED_SPAN)
        behind, _ = self.path(shared, self.t - SPEED_SPAN)
        moved = between(behind, ahead) / (2 * SPEED_SPAN)
        return moved[:, 0], moved[:, 2]

    def nodes(self) -> Array:
        """Stamps of the gyro bias's nodes."""
        begin, end = self.ends or (float(self.t[0]), float(self.t[-1]))
        return np.linspace(begin, end, 1 + max(1, int(np.ceil((end - begin) / BIAS_EVERY))))

    def head(self, count: int) -> Chain:
        """The first `count` knots, where `linearise` was last called: enough to learn noise from."""
        k = min(count, len(self.t))
        if k == len(self.t):
            return self
        part, r = copy.copy(self), self.reference
        part.reference = replace(r, t=r.t[:k], z=r.z[:k], places=None if r.places is None else r.places[:k])
        part.weight_steps, part.weight_reference = self.weight_steps[: k - 1], self.weight_reference[:k]
        z, Az, Jz, swept = self._seen
        part._seen = (z[:k], Az[:k], Jz[:k], swept[:k])
        e, A, B, J, rolled = (rows[: k - 1] for rows in self._steps)
        part._steps = (e, A, B, J, rolled)
        if self._gyro is not None:
            e, A, J, variance = (rows[: k - 1] for rows in self._gyro)
            part._gyro = (e, A, J, variance)
        part.ends = self.ends
        return part

    def linearise(self, shared: Array) -> None:
        """Residuals and Jacobians at the current poses and this (n,) of shared unknowns."""
        v, w = self.speeds(shared)
        own = 0.0 if self.delay is None else float(shared[self.delay])
        z, Az, J4 = self.reference.residuals(self.pose, v, w, shared, own)
        Jz = np.zeros((*z.shape, len(shared)))
        Jz[..., [TAG_X, TAG_Y, TAG_YAW, DELAY]] = J4
        if self.delay is not None:
            Jz[..., self.delay] = J4[..., 3]
        theta = self.pose[:, 2]
        swept = np.einsum("kij,kj->ki", Az, np.column_stack((v * np.cos(theta), v * np.sin(theta), w)))
        self._at = shared
        self._steps = self._step_rows(shared)
        self._seen = (z, Az, Jz, swept)
        self._gyro = self._gyro_rows(shared) if self.run.imu is not None else None

    def normal(self, noise: Noise) -> tuple[Arrow, float]:
        """The normal equations where `linearise` was last called, and the sum of log determinants of covariances."""
        arrow = Arrow.empty(len(self.t), len(self._at))
        e, A, B, J, rolled = self._steps
        variance = self.step_variance(rolled, noise)
        W = np.zeros((len(e), 3, 3))
        W[:, range(3), range(3)] = self.weight_steps[:, None] / variance
        self._steps_misfit = np.sqrt(np.sum(e**2 / variance, axis=1))
        arrow.add(e, W, A, J, B)
        logdet = float(np.sum(np.log(variance))) + self._add_reference(arrow, noise)
        if self._gyro is not None:
            logdet += self._add_gyro(arrow)
        return arrow, logdet

    def _step_rows(self, shared: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Residuals (K - 1, 3) of left wheel, right wheel [m of nominal rolling] and sideways motion [m]; Jacobians by
        each pose, by the next and by the shared; rolled (K - 1,).

        In the wheels' own readings, since these carry the noise: a residual of the body's motion would have noise in
        its derivative too, and draw the track width away from the truth.
        """
        step, by, rolled = self.steps(shared)
        body, A, B = self._motion()
        body = body - step
        body[:, 2] = wrap_angle(body[:, 2])
        nominal = self.run.meta.robot.track_width
        assert nominal
        left, right, half = 1 + shared[LEFT], 1 + shared[RIGHT], nominal * (1 + shared[TRACK]) / 2
        T = np.array(((1 / left, 0.0, -half / left), (1 / right, 0.0, half / right), (0.0, 1.0, 0.0)))
        e = body @ T.T
        J = np.zeros((len(e), 3, len(shared)))
        J[:, :, [LEFT, RIGHT, TRACK]] = -T @ by
        J[:, 0, LEFT] -= e[:, 0] / left
        J[:, 1, RIGHT] -= e[:, 1] / right
        J[:, 0, TRACK] -= nominal / 2 / left * body[:, 2]
        J[:, 1, TRACK] += nominal / 2 / right * body[:, 2]
        return e, T @ A, T @ B, J, rolled

    def step_variance(self, rolled: Array, noise: Noise) -> Array:
        """(K - 1, 3) variances of left, right, sideways: slip, and the encoder's step at both ends."""
        robot = self.run.meta.robot
        assert robot.wheel_radius
        tick = 2 * np.pi / robot.ticks_per_rev if robot.ticks_per_rev else 0.01
        read = (robot.wheel_radius * tick) ** 2 / 6
        wheel = noise.slip**2 * rolled + read
        return np.column_stack((wheel, wheel, noise.side**2 * rolled + read / 2))

    def _motion(self) -> tuple[Array, Array, Array]:
        """Motions (K - 1, 3) between the estimated poses, Jacobians by each pose and by the next."""
        a, b = self.pose[:-1], self.pose[1:]
        e = between(a, b)
        cos, sin = np.cos(a[:, 2]), np.sin(a[:, 2])
        B = np.zeros((len(a), 3, 3))
        B[:, 0, 0], B[:, 0, 1], B[:, 1, 0], B[:, 1, 1], B[:, 2, 2] = cos, sin, -sin, cos, 1.0
        A = -B
        A[:, 0, 2], A[:, 1, 2] = e[:, 1], -e[:, 0]
        return e, A, B

    def _gyro_rows(self, shared: Array) -> tuple[Array, Array, Array, Array]:
        """Residuals (K - 1,), Jacobians by the first pose and by the shared, variances."""
        imu = self.run.imu
        assert imu is not None
        t, gz = gyro_readings(imu)
        dt = np.diff(self.t)
        turned = np.concatenate(([0.0], np.cumsum((gz[1:] + gz[:-1]) / 2 * np.diff(t))))
        at = np.interp(self.t + shared[IMU_CLOCK], t, turned)
        rate = np.interp(self.t + shared[IMU_CLOCK], t, gz)
        theta = np.diff(self.pose[:, 2])
        nodes = self.nodes()
        share = np.array([np.interp((self.t[1:] + self.t[:-1]) / 2, nodes, row) for row in np.eye(len(nodes))]).T
        e = theta * (1 + shared[GYRO]) + share @ shared[self.columns] * dt - np.diff(at)
        J = np.zeros((len(e), 1, len(shared)))
        J[:, 0, GYRO], J[:, 0, IMU_CLOCK] = theta, -np.diff(rate)
        J[:, 0, self.columns] = share * dt[:, None]
        A = np.zeros((len(e), 1, 3))
        A[:, 0, 2] = -(1 + shared[GYRO])
        density = self.run.meta.noise.gyro_density or 3.5e-4
        # Trapezoids between the samples miss what turns within one; half a sample of the rate's change is its size.
        missed = (0.05 * np.diff(rate) / max(imu.rate, 1.0)) ** 2
        return e, A, J, density**2 / 2 * dt + missed

    def _add_gyro(self, arrow: Arrow) -> float:
        assert self._gyro is not None
        e, A, J, variance = self._gyro
        arrow.add(e[:, None], (1 / variance)[:, None, None], A, J, -A)
        nodes = self.nodes()
        D = np.diff(np.eye(len(nodes)), axis=0) / (BIAS_WALK * np.sqrt(np.diff(nodes)))[:, None]
        D = np.vstack((D, np.eye(1, len(nodes)) / BIAS_SD))
        arrow.corner[self.columns, self.columns] += D.T @ D
        arrow.shared[self.columns] -= D.T @ D @ self._at[self.columns]
        return float(np.sum(np.log(variance)))

    def _add_reference(self, arrow: Arrow, noise: Noise) -> float:
        e, A, J, swept = self._seen
        seen = np.isfinite(e)
        d = e.shape[1]
        covariance = noise.jitter**2 * swept[:, :, None] * swept[:, None, :]
        times = np.array((noise.places, noise.places, noise.headings))[:d]
        covariance[:, range(d), range(d)] += (self.reference.sd * times) ** 2
        # What was not read gets a variance without end.
        covariance[:, range(d), range(d)] += np.where(seen, 0.0, 1e12)
        e = np.where(seen, e, 0.0)
        W = np.linalg.inv(covariance)
        self._reference_misfit = np.sqrt(np.einsum("ki,kij,kj->k", e, W, e))
        arrow.add(e, self.weight_reference[:, None, None] * W, A, J)
        if self.delay is not None:
            arrow.corner[self.delay, self.delay] += 1 / DELAY_SD**2
            arrow.shared[self.delay] -= self._at[self.delay] / DELAY_SD**2
        return float(np.sum(np.linalg.slogdet(covariance)[1]))

    def reweigh(self, limit: float = 3.0) -> None:
        """What lies beyond `limit` sigma counts less, the less the farther: slips, wild fixes."""
        for name, misfit in (("weight_steps", self._steps_misfit), ("weight_reference", self._reference_misfit)):
            setattr(self, name, np.minimum(1.0, (limit / np.maximum(misfit, 1e-9)) ** 2))
