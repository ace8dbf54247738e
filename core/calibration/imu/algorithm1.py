"""Algorithm 1 of Kolhoff & Kemper 2021: errors of an IMU reduced sample by sample, and its offline counterpart.

Per sample and axis j (the print has lost its minus signs; signs as the paper's results need them):

    g_i = (1 - T / Tc_j) g_(i-1),  g = 1 at switching on        Gauss-Markov recursion, forward Euler of eq. 3
    x_temp = reading - drift_j (1 - g_i) - static_j             drifting and static bias removed
    x_MA = mean of the last 40 x_temp                           one-sided moving average, eq. 6
    M x = x_MA                                                  misalignment solved, per sensor

Choices: while fewer than 40 readings have come, the average is over those that are there. T is the time since the
sample before, so a pause ages the drift rightly. A reading that is not finite ages g, enters no average, and the
average of before is given again. M is solved by its inverse, made once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.calibration.imu.model import ImuCalibration, SensorModel
from core.errors import ParameterError

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

AXES = ("ax", "ay", "az", "gx", "gy", "gz")
"""Order of the six axes (the paper's j = 1 to 6)."""
WINDOW = 40
"""Readings of the moving average (the paper's choice)."""


@dataclass(frozen=True)
class Constants:
    """What Algorithm 1 computes with, in the order of AXES; also what firmware writes into its header.

    static (6,), drift (6,) in the axis' unit; rate (6,) [1/s] = 1 / Tc, 0 where no drift is known; inverse (2, 3, 3)
    of the accelerometer's and of the gyro's matrix; rows and columns of absent axes are 0; window readings.
    """

    static: Floats
    drift: Floats
    rate: Floats
    inverse: Floats
    window: int = WINDOW
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class State:
    """Where Algorithm 1 stands: g (6,) what is left of the drift, from 1 to 0; ring (window, 6) of bias-free readings,
    slot count % window is next; count (6,) readings so far. Never changed in place."""

    g: Floats
    ring: Floats
    count: Ints


def constants(calibration: ImuCalibration, *, axes: Sequence[str] = AXES, window: int = WINDOW) -> Constants:
    """What Algorithm 1 needs of a calibration. Unknown biases count as none, unknown matrix elements as the
    identity's; the notes say which. `axes`: those that the IMU has; the true value along absent ones is taken as 0.

    Raises ParameterError for a window below 1 or a matrix that cannot be solved.
    """
    if window < 1:
        raise ParameterError(f"the moving average needs a window of at least 1; found {window}", parameter="window")
    pair = (calibration.accel, calibration.gyro)
    present = np.array([name in axes for name in AXES])
    known = np.concatenate([m.drifts for m in pair])
    drift = np.where(known, np.concatenate([m.drift_amplitude for m in pair]), 0.0)
    tau = np.where(known, np.concatenate([m.drift_tau for m in pair]), 1.0)
    inverse = np.zeros((2, 3, 3))
    for s, model in enumerate(pair):
        inverse[s] = _inverse(model, present[3 * s : 3 * s + 3], ("accel", "gyro")[s])
    return Constants(
        static=np.nan_to_num(np.concatenate([m.static_bias for m in pair])),
        drift=drift,
        rate=np.where(known, 1.0 / tau, 0.0),
        inverse=inverse,
        window=window,
        notes=_notes(pair, present),
    )


def initial_state(made: Constants, t: float = 0.0) -> State:
    """The state before a first reading `t` [s] after switching on."""
    g = np.exp(-max(t, 0.0) * made.rate)
    return State(g, np.zeros((made.window, len(AXES))), np.zeros(len(AXES), np.int64))


def advance(made: Constants, state: State, readings: npt.ArrayLike, dt: npt.ArrayLike) -> tuple[State, Floats]:
    """Algorithm 1 on readings (n, 6) by AXES, dt (n,) [s] since the reading before each (0 for the very first).

    Gives the state behind them and the corrected readings (n, 6). Any split of a record gives the same bits.
    """
    from core.calibration.imu._algorithm1_numba import advance as kernel

    values = np.ascontiguousarray(readings, np.float64)
    steps = np.ascontiguousarray(dt, np.float64)
    if values.ndim != 2 or values.shape != (len(steps), len(AXES)):
        raise ParameterError(
            f"readings have shape {values.shape}; expected ({steps.size}, 6) for {steps.size} time steps",
            found=values.shape,
        )
    g, ring, count, out = state.g.copy(), state.ring.copy(), state.count.copy(), np.empty_like(values)
    kernel(values, steps, made.static, made.drift, made.rate, made.inverse, g, ring, count, out)
    return State(g, ring, count), out


def step(made: Constants, state: State, reading: npt.ArrayLike, dt: float) -> tuple[State, Floats]:
    """One sample: `advance` of a single reading (6,); for live use. Gives the new state and the value (6,)."""
    state, out = advance(made, state, np.asarray(reading, np.float64)[None, :], np.array([dt]))
    return state, out[0]


def online(made: Constants, t: Floats, readings: npt.ArrayLike) -> Floats:
    """(n, 6) Algorithm 1 over a whole record with stamps t (n,) [s] from switching on."""
    dt = np.diff(t, prepend=t[:1])
    return advance(made, initial_state(made, float(t[0]) if len(t) else 0.0), readings, dt)[1]


def _inverse(model: SensorModel, present: npt.NDArray[np.bool_], name: str) -> Floats:
    matrix = np.where(np.isfinite(model.matrix), model.matrix, np.eye(3))
    inside = np.ix_(present, present)
    if present.any() and abs(np.linalg.det(matrix[inside])) < 1e-6:
        raise ParameterError(f"the {name} matrix cannot be solved: its determinant is 0", parameter=f"{name}.matrix")
    out = np.zeros((3, 3))
    out[inside] = np.linalg.inv(matrix[inside])
    return out


def _notes(pair: tuple[SensorModel, SensorModel], present: npt.NDArray[np.bool_]) -> tuple[str, ...]:
    notes = []
    for s, model in enumerate(pair):
        have = present[3 * s : 3 * s + 3]
        names = np.array(AXES[3 * s : 3 * s + 3])
        checks = {
            "static bias is unknown and left in": np.isnan(model.static_bias),
            "drifting bias is unknown and left in": ~model.drifts,
            "matrix row is not wholly known; the identity's elements stand in": np.isnan(model.matrix).any(axis=1),
        }
        for text, missing in checks.items():
            if (missing & have).any():
                notes.append(f"{', '.join(names[missing & have])}: {text}")
    return tuple(notes)
