"""Dead reckoning: the path from the wheels alone (`encoders`), and from wheels and gyro (`encoders+gyro`).

Given: cumulative wheel angles, nominal wheel radius r and track width b, optionally the gyro. Done: each interval is an
exact circular arc of length d = r (dR + dL)/2 and turn r (dR - dL)/b (Borenstein, Everett, Feng 1996, eq. 1.6), its
covariance grows by the encoder's step and by a share of the distance; nothing is corrected by beacons or truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions, Config, assume, encoder_quantum
from core.estimation.cleaning import gyro_readings, wheel_readings
from core.estimation.events import detect
from core.estimation.rest import at_rest
from core.estimation.result import Curve, Estimate
from core.run import Run
from core.sensors import ImuLog, WheelLog
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class WheelPath:
    """What the wheels tell, cumulative from the first stamp: t [s], distance d [m], turn [rad] (NaN without b)."""

    t: Array
    d: Array
    turn: Array


def wheel_path(wheels: WheelLog, radius: float, track: float | None) -> WheelPath:
    """Cumulative distance of the axle's midpoint and turn of the body, both 0 at the first stamp."""
    left, right = wheel_readings(wheels)
    left, right = radius * (left - left[0]), radius * (right - right[0])
    turn = (right - left) / track if track else np.full(len(wheels), np.nan)
    return WheelPath(wheels.t, (left + right) / 2, turn)


def arcs(d: Array, turn: Array, start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Array:
    """(N, 3) poses along circular arcs, from cumulative distance d (N,) [m] and turn (N,) [rad].

    The chord of an arc of length s and turn w is s sin(w/2)/(w/2), at the heading of the arc's middle.
    """
    theta = start[2] + turn - turn[0]
    step, half = np.diff(d), np.diff(turn) / 2
    chord, middle = step * np.sinc(half / np.pi), theta[:-1] + half
    x = start[0] + np.concatenate(([0.0], np.cumsum(chord * np.cos(middle))))
    y = start[1] + np.concatenate(([0.0], np.cumsum(chord * np.sin(middle))))
    return np.column_stack((x, y, theta))


def growth(pose: Array, var_d: Array, var_turn: Array, start: Array) -> Array:
    """(N, 3, 3) covariance of dead reckoning along `pose` (N, 3), in closed form, without a loop over steps.

    var_d, var_turn (N - 1,): variances of each step's distance [m^2] and turn [rad^2], independent of each other;
    start (3, 3): of the first pose. An error in a step's turn swings all that follows about that place.
    """
    x, y, theta = pose[:, 0], pose[:, 1], pose[:, 2]
    middle = (theta[1:] + theta[:-1]) / 2
    cos, sin = np.cos(middle), np.sin(middle)

    def total(steps: Array) -> Array:
        return np.concatenate(([0.0], np.cumsum(steps)))

    mx, my = (x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2
    w, wx, wy = total(var_turn), total(var_turn * mx), total(var_turn * my)
    P = np.empty((len(pose), 3, 3))
    P[:, 0, 0] = y * y * w - 2 * y * wy + total(var_turn * my * my) + total(var_d * cos * cos)
    P[:, 1, 1] = x * x * w - 2 * x * wx + total(var_turn * mx * mx) + total(var_d * sin * sin)
    P[:, 0, 1] = -(x * y * w - y * wx - x * wy + total(var_turn * mx * my)) + total(var_d * sin * cos)
    P[:, 0, 2] = wy - y * w
    P[:, 1, 2] = x * w - wx
    P[:, 2, 2] = w
    P[:, 1, 0], P[:, 2, 0], P[:, 2, 1] = P[:, 0, 1], P[:, 0, 2], P[:, 1, 2]
    if start.any():
        J = np.broadcast_to(np.eye(3), P.shape).copy()
        J[:, 0, 2], J[:, 1, 2] = -(y - y[0]), x - x[0]
        P += np.einsum("nij,jk,nlk->nil", J, start, J, optimize=False)
    return P


def start_pose(run: Run) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    """Where dead reckoning begins, with a note where run.json does not say."""
    if run.meta.start is None:
        return (0.0, 0.0, 0.0), ("Start pose unknown: the path begins at x = y = 0, heading 0.",)
    return (run.meta.start.x, run.meta.start.y, run.meta.start.theta), ()


def start_covariance(run: Run, numbers: Assumptions) -> Array:
    """(3, 3) covariance of the start pose; zero where the path's own start defines the map."""
    if run.meta.start is None:
        return np.zeros((3, 3))
    return np.diag((numbers.start_xy**2, numbers.start_xy**2, numbers.start_theta**2))


def encoders(run: Run, config: Config | None = None) -> Estimate:
    """Path by the wheels alone, one pose per wheel stamp."""
    numbers, _ = assume(run, config)
    wheels, robot = run.wheels, run.meta.robot
    assert wheels is not None and robot.wheel_radius and robot.track_width  # the pipeline has checked
    path = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    start, notes = start_pose(run)
    pose = arcs(path.d, path.turn, start)
    var_d, var_turn = step_noise(path, robot.track_width, numbers)
    covariance = growth(pose, var_d, var_turn, start_covariance(run, numbers))
    covariance += reading_noise(pose[:, 2], encoder_quantum(run, numbers) * robot.wheel_radius, robot.track_width)
    covariance += geometry_error(pose, path.d, robot.track_width, numbers)
    return Estimate("encoders", Trajectory(path.t, pose[:, 0], pose[:, 1], pose[:, 2], covariance), notes=notes)


def step_noise(path: WheelPath, track: float, numbers: Assumptions) -> tuple[Array, Array]:
    """Variances (N - 1,) of each step's distance and turn from slip that differs between the wheels."""
    rolled = numbers.slip**2 * (np.abs(np.diff(path.d)) + track / 2 * np.abs(np.diff(path.turn)))
    return rolled / 2, 2 * rolled / track**2


def geometry_error(pose: Array, d: Array, track: float | None, numbers: Assumptions) -> Array:
    """(N, 3, 3) what errors of mean wheel radius, of their ratio and of track width do; they are the same all along."""
    x, y = pose[:, 0] - pose[0, 0], pose[:, 1] - pose[0, 1]
    scale = np.column_stack((x, y, np.zeros(len(x))))
    P = numbers.distance_scale_sd**2 * scale[:, :, None] * scale[:, None, :]
    if track:
        for turned, sd in ((d / track, numbers.inequality_sd), (pose[:, 2] - pose[0, 2], numbers.track_scale_sd)):
            swing = _swing(x, y, turned)
            P += sd**2 * swing[:, :, None] * swing[:, None, :]
    return P


def _swing(x: Array, y: Array, turned: Array) -> Array:
    """(N, 3) derivative of a path by a parameter that turns it by `turned` (N,) more at each place."""
    middle = (turned[1:] + turned[:-1]) / 2
    along_x = np.concatenate(([0.0], np.cumsum(-middle * np.diff(y))))
    along_y = np.concatenate(([0.0], np.cumsum(middle * np.diff(x))))
    return np.column_stack((along_x, along_y, turned))


def reading_noise(theta: Array, quantum_m: float, track: float | None) -> Array:
    """(N, 3, 3) what the encoder's step adds at each stamp; it does not add up, as readings are cumulative."""
    along = quantum_m**2 / 24
    cos, sin = np.cos(theta), np.sin(theta)
    P = np.zeros((len(theta), 3, 3))
    P[:, 0, 0], P[:, 1, 1] = along * cos**2, along * sin**2
    P[:, 0, 1] = P[:, 1, 0] = along * sin * cos
    P[:, 2, 2] = quantum_m**2 / 6 / track**2 if track else 0.0
    return P


def encoders_gyro(run: Run, config: Config | None = None) -> Estimate:
    """Distance by the wheels, heading by the gyro; its bias is learnt wherever the robot rests and held between.

    One pose per IMU stamp; distance is linear between wheel readings, heading trapezoidal between gyro readings.
    """
    from core.estimation._gyro_numba import N, walk

    numbers, notes = assume(run, config)
    imu, wheels, robot = run.imu, run.wheels, run.meta.robot
    assert imu is not None and wheels is not None and robot.wheel_radius
    path = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    begin, start_notes = _pose_at_first_imu_stamp(run, path)
    rest = at_rest(run, numbers)
    turns = gyro_turns(imu, numbers)
    distance = np.diff(np.interp(imu.t, path.t, path.d), prepend=np.interp(imu.t[0], path.t, path.d))
    n = len(imu)
    x, P = np.concatenate((begin, (0.0, 0.0))), np.zeros((N, N))
    P[:3, :3] = start_covariance(run, numbers)
    P[3, 3], P[4, 4] = numbers.bias_sd**2, numbers.gyro_scale_sd**2
    pose, covariance, bias, bias_var = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty(n), np.empty(n)
    walk(
        np.diff(imu.t, prepend=imu.t[0]), turns.step, distance, gyro_readings(imu)[1], rest.flags,
        turns.variance, numbers.slip**2 / 2 * np.abs(distance), numbers.bias_walk**2, rest.gyro_sd**2,
        chi2_gate(1, numbers), int(numbers.reaccept * imu.rate / 2), np.zeros(1, np.int64), x, P, pose,
        covariance, bias, bias_var,
    )  # fmt: skip
    covariance += reading_noise(pose[:, 2], encoder_quantum(run, numbers) * robot.wheel_radius, None)
    covariance += geometry_error(pose, np.cumsum(distance), None, numbers)
    if not rest.flags.any():
        notes = (*notes, f"The robot never rests: the gyro's bias stays 0 ± {numbers.bias_sd:.2g} rad/s.")
    return Estimate(
        "encoders+gyro",
        Trajectory(imu.t, pose[:, 0], pose[:, 1], pose[:, 2], covariance),
        gyro_bias=Curve(imu.t, bias, np.sqrt(bias_var)),
        events=tuple(replace(event, replaced="") for event in detect(run, numbers).events),  # seen, not acted upon
        notes=(*start_notes, *notes),
    )


@dataclass(frozen=True)
class GyroTurns:
    """Per IMU stamp: raw turn since the one before [rad], and its variance by noise or, over a pause, by ignorance."""

    step: Array
    variance: Array


def gyro_turns(imu: ImuLog, numbers: Assumptions, hold: float | None = None) -> GyroTurns:
    """Trapezoidal turns; over a pause of the gyro each end's rate holds for a few samples (`hold` [s], told from the
    stamps where None), and the rest is unknown."""
    dt = np.diff(imu.t, prepend=imu.t[0])
    _, gz = gyro_readings(imu)
    hold = longest_hold(dt) if hold is None else hold
    pause = dt > 2 * hold
    covered = np.where(pause, np.minimum(dt, 2 * hold), dt)
    step = 0.5 * (gz + np.concatenate((gz[:1], gz[:-1]))) * covered
    return GyroTurns(step, numbers.gyro_density**2 / 2 * dt + np.where(pause, numbers.pause_rate**2 * dt, 0.0))


def longest_hold(dt: Array) -> float:
    """How long a gyro reading is taken to last [s]: five typical steps."""
    return 5.0 * float(np.median(dt[1:])) if len(dt) > 1 else 0.0


def chi2_gate(dof: int, numbers: Assumptions) -> float:
    """Largest squared normalised innovation that passes."""
    from scipy.special import chdtri

    return float(chdtri(dof, 1 - numbers.gate))


def _pose_at_first_imu_stamp(run: Run, path: WheelPath) -> tuple[Array, tuple[str, ...]]:
    assert run.imu is not None
    start, notes = start_pose(run)
    before = arcs(path.d, np.nan_to_num(path.turn), start)
    return np.array([np.interp(run.imu.t[0], path.t, column) for column in before.T]), notes
