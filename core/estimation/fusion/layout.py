"""What the compiled filter's arrays mean: states, numbers of a run, kinds and flags of events, memory, records.

State (n of N are in use, always the first n): x, y [m], theta [rad] of the body in the map; v [m/s], the wheels' mean
rim speed; b [rad/s], gyro bias, or minus the wheels' turn rate where there is no gyro; s [m], phi [rad], what wheels
should have told by now of distance and turn; kd distance scale, ke wheel inequality, kb track scale, kg gyro scale; ba
[m/s^2], what the accelerometer reads too much along x (bias and tilt); dt [s], delay of the beacon system; then where
there are ranges kr, their scale, and br [m], their bias; then lasting errors [m] of the beacon system: of fixes along x
and y, of each beacon's ranges. Scales are errors, 0 is perfect.

Between events   with a gyro     w = (gyro turn - b dt)(1 - kg),    phi' = w (1 + kb) - ke d / track
                 without         w = (ke d / track - b dt)(1 - kb), phi' = -b dt
                 d = (v + dv/2) dt, dv = accelerometer's - ba dt,   s' = d,   v' = v + dv
                 theta' = w, and the body moves d (1 + kd) along the arc
Scales stand on the body's side of the wheels, so that wheels alone say nothing of them, linearised or not.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

X, Y, TH, V, B, S, PHI, KD, KE, KB, KG, BA, DT, KR, BR = range(15)
N = 32  # most states
MOVING = 7  # the first states change between events; the others are constants of the robot

PARTS = 22  # numbers that a step's Jacobian is made of, see `spread`
(UX, UY, DX, DY, PX, PY, KX, KY, CD, HB, CBA, F, FB, W_B, W_KG, W_D, W_KE, W_KB, PHI_W, PHI_D, PHI_KE, PHI_KB) = range(
    PARTS
)


class Constants(NamedTuple):
    """Numbers of one run, SI; q_ are variances per second or per metre, r_ of one reading."""

    has_gyro: float
    has_accel: float
    inverse_track: float  # 1/m, 0 where the track width is unknown
    tag_x: float
    tag_y: float
    tag_z: float
    tau: float  # s, memory of speed and turn rate while the wheels are silent
    silence: float  # s without wheels, after which they are
    hold: float  # s that a gyro reading is taken to last
    q_pause: float  # turn while the gyro is silent
    q_speed: float  # of the speed, where nothing but the wheels tells it
    q_accel: float  # of the speed, where the accelerometer tells it
    q_tilt: float  # of ba
    q_turn: float
    q_gyro: float
    q_bias: float
    q_scale: float
    q_slip: float
    q_side: float
    q_skid: float  # of the position, of turning squared
    q_slide: float  # of the position, while a wheel slips
    q_carried: float  # of the position, while something moves the robot
    q_carried_turn: float
    r_distance: float
    r_turn: float
    r_rate: float
    r_still: float
    r_fix: float
    r_fix_theta: float
    r_range: float
    offset_var: float  # of a lasting error of the beacon system
    offset_tau: float  # s, how long it lasts
    first_offset: float  # first state of one
    gate1: float
    gate2: float
    gate3: float
    patience: float  # rejections in a row
    patience_rest: float
    stubborn: float  # s for which fixes that leapt without reason are not believed
    leap: float  # m/s: a robot that fixes move faster than that has not moved
    coast: float  # s without trusted wheels, for which the accelerometer carries the speed
    clock_var: float = 0.0  # s^2 of the stamps that poses are given for


(
    HAS_GYRO, HAS_ACCEL, INVERSE_TRACK, TAG_X, TAG_Y, TAG_Z, TAU, SILENCE, HOLD, Q_PAUSE, Q_SPEED, Q_ACCEL,
    Q_TILT, Q_TURN, Q_GYRO, Q_BIAS, Q_SCALE, Q_SLIP, Q_SIDE, Q_SKID, Q_SLIDE, Q_CARRIED, Q_CARRIED_TURN,
    R_DISTANCE, R_TURN, R_RATE, R_STILL, R_FIX, R_FIX_THETA, R_RANGE, OFFSET_VAR, OFFSET_TAU, FIRST_OFFSET,
    GATE1, GATE2, GATE3, PATIENCE, PATIENCE_REST, STUBBORN, LEAP, COAST, CLOCK_VAR,
) = range(42)  # fmt: skip
"""Places of the constants in the array that the compiled filter takes."""

WHEEL, FIX, RANGE, OUT = range(4)
"""Kinds of event, in the order they are taken at equal stamps. Their data (5,): WHEEL distance [m], turn [rad] (NaN:
unknown), both cumulative; FIX x, y, theta or NaN, state of its lasting error in x (0: none); RANGE beacon's x, y, z,
range, state of its lasting error; OUT, where a pose is asked for: gyro [rad/s], acceleration forward [m/s^2],
variance [m^2] of a leap of the robot just after it that hindsight has shown (0: none)."""
LEAP_VAR = 2

REST, JUMP, LEFT, RIGHT, TURN, ACCEL, STOPPED, CARRIED, STILL = (1 << i for i in range(9))
"""Flags of an event: at rest; the counter has jumped; left, right wheel, their difference, accelerometer not to be
believed; the body stands still whatever the wheels say; something else than the wheels moves the robot; no
wheel has turned for a while."""
SLIPPING = LEFT | RIGHT | TURN | STOPPED
STRANGE = LEFT | RIGHT | TURN | ACCEL | STOPPED | CARRIED

NONE, ACCEPTED, REJECTED, RELOCATED = range(4)
"""Status of a reading; after RELOCATED the filter has given up its pose for what many refused fixes agree on."""

MEMORY = 37 + N
(
    T, T_IMU, GZ, AX, TURNED, SPED, UNSEEN, T_WHEEL, T_TRUST, STARTED, RESTING, REFUSED_REST, SLIP_LEFT, SLIP_RIGHT,
    SLIP_TURN, T_FIX, REFUSED, ONSET, LEAPT, T_STRANGE, T_OFFSET, REFUSED_RANGES, DRIVEN, AGREED, DISTANCE,
    STOP_SINCE, STOP_OK, WASH_IMU, WASH_WHEELS, WHEEL_SPEED, LOST_SPEED, T_LOST, HIDDEN,
    T_RANGE, RANGE_ONSET, RANGE_LEAPT, RANGE_FROM,
) = range(37)  # fmt: skip
"""What the filter remembers beside its state: stamps, what of the gyro's step is used up, counters. The last N are the
rejections in a row of each lasting error's beacon. Stamps are -1 before there is one."""

PAST = 64  # refused fixes that are kept
SEEN = 6  # of each: x, y, theta of the robot as believed, and the fix


class Records(NamedTuple):
    """What the smoother needs of a stretch of K events, R rows and U corrections; of one element where it is not kept.

    parts (K, PARTS + 1): of each step's Jacobian, NaN in the first where no time passed; last, the fade of lasting
    errors. marks (K + 1, 2): corrections before each event; bits of the states that were anchored after the step.
    which (U, ROOM + 1): states of row h, last how many. corrections (U, N + ROOM + 2): P h, values of h, innovation,
    its variance.
    rows (R, 4, N): P of x, y, theta, b.
    """

    parts: Any
    marks: Any
    which: Any
    corrections: Any
    rows: Any


INNOVATION, NOISE, ROW, VARIANCES = 3, 4, 5, 8  # rows of the scratch array (9, N); the first three are P h
ROOM = 8  # most states that one reading is about
VALUES, NU, VARIANCE = N, N + ROOM, N + ROOM + 1  # columns of corrections


def records(events: int, rows: int) -> Records:
    """Room for the records of a stretch, or of none."""
    k, r, u = max(events, 1), max(rows, 1), max(5 * events, 1)
    return Records(
        np.zeros((k, PARTS + 1)), np.zeros((k + 1, 2), np.int64), np.zeros((u, ROOM + 1), np.int64),
        np.zeros((u, N + ROOM + 2)),
        np.zeros((r, 4, N)),
    )  # fmt: skip


def scratch() -> tuple[Any, Any, Any]:
    """What the compiled filter computes in: rows of readings, their states, the parts of a step's Jacobian."""
    return np.zeros((9, N)), np.zeros((3, ROOM + 1), np.int64), np.zeros(PARTS + 1)


class Tracks(NamedTuple):
    """What the filter writes: nis, status (E, 2) per event; rows (M, 5) of x, y, theta, bias and its variance, and
    covariance (M, 3, 3) per OUT event; score (E, 2), signed innovations over their own sd: WHEEL distance and turn, FIX
    x and y, RANGE."""

    nis: Any
    status: Any
    rows: Any
    covariance: Any
    score: Any


class Readings(NamedTuple):
    """E events: t, kind, data (E, 5), flags."""

    t: Any
    kind: Any
    data: Any
    flags: Any
