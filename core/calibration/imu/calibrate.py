"""Calibration of an IMU from rest, six-position and rate-table runs, all fitted together. The story, one screen.

runs -> steady stretches -> contradictions named and left out -> one joint fit per axis -> model with deviations
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.calibration.imu.algorithm1 import AXES
from core.calibration.imu.columns import axis_data
from core.calibration.imu.contradictions import contradictions, dead_axes
from core.calibration.imu.curves import CharacteristicLine, characteristic_lines
from core.calibration.imu.fit import AxisFit, fit_triad
from core.calibration.imu.model import ImuCalibration, SensorModel, SensorPair
from core.calibration.imu.paper import PaperDrift, paper_drift
from core.calibration.imu.reasons import null_reasons, turn_on_note
from core.calibration.imu.stretches import LeftOut, Stretch, stretches, without
from core.errors import MissingStreamError, NotEnoughDataError
from core.run import Run

Floats = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

SENSOR_AXES = {"accel": (0, 1, 2), "gyro": (3, 4, 5)}


@dataclass(frozen=True)
class AxisReport:
    """One axis: the joint fit, the paper's way per rest record, and what was fitted to, per block (n,): t [s] from
    switching on, run number, bias (reading less matrix @ declared) and its fitted curve, in the axis' unit."""

    axis: str
    fit: AxisFit
    paper: tuple[PaperDrift, ...]
    t: Floats
    run: npt.NDArray[np.int64]
    bias: Floats
    curve: Floats


@dataclass(frozen=True)
class CalibrationReport:
    """A calibration and what it stands on.

    axes by name; used and left_out segments; lines as of Fig. 8 and 9; turn_on (runs, 6) static bias of each run
    against the mean, by AXES, NaN where unknown, and turn_on_sd (6,), its scatter between runs (NaN from one run).
    """

    calibration: ImuCalibration
    axes: dict[str, AxisReport]
    used: tuple[Stretch, ...]
    left_out: tuple[LeftOut, ...]
    lines: tuple[CharacteristicLine, ...]
    turn_on: Floats
    turn_on_sd: Floats
    notes: tuple[str, ...] = ()


def calibrate(runs: Sequence[Run], progress: Progress | None = None) -> CalibrationReport:
    """Error model of an IMU from calibration runs, each from a cold start at its t = 0.

    Raises MissingStreamError where no run has an IMU, NotEnoughDataError where no segment can be used. What single
    segments contradict, or what the runs do not show, is told in `left_out` and `notes`; the rest is given.
    """
    tell = progress or (lambda fraction, message: None)
    if all(run.imu is None for run in runs):
        raise MissingStreamError("none of the runs has IMU readings", method="calibrate", missing="imu")
    tell(0.0, "steady stretches")
    found, left, notes = stretches(runs)
    if not found:
        reasons = [str(item) for item in left] + notes
        raise NotEnoughDataError("no segment can be used: " + "; ".join(reasons[:4]), method="calibrate")
    dead = dead_axes(found)
    notes += [f"{AXES[j]}: all readings are equal: the axis is dead, or its steps hide everything; null" for j in dead]
    found = [without(s, dead) for s in found] if dead else found
    fits: dict[int, AxisFit] = {}
    kept: dict[str, list[Stretch]] = {}
    done = [0.1]
    for sensor, axes in SENSOR_AXES.items():
        kept[sensor], out, told = contradictions(found, sensor)
        left, notes = left + out, notes + told

        def advance(share: float, sensor: str = sensor) -> None:
            done[0] += 0.4 * share
            tell(min(done[0], 0.9), f"fitting the {sensor}")

        fits |= fit_triad(kept[sensor], axes, advance)
    if not fits:
        reasons = [str(item) for item in left] + notes
        raise NotEnoughDataError("no segment can be used: " + "; ".join(reasons[:4]), method="calibrate")
    calibration = _calibration(fits, found)
    notes += null_reasons(calibration, fits, kept)
    turn_on, turn_on_sd = _turn_on(fits, kept, len(runs))
    notes += turn_on_note(turn_on_sd, calibration, kept)
    axes_reports = {AXES[a]: _axis(a, f, kept["accel" if a < 3 else "gyro"]) for a, f in fits.items()}
    lines = characteristic_lines(found, calibration)
    tell(1.0, "done")
    used = tuple({id(s): s for parts in kept.values() for s in parts}.values())
    return CalibrationReport(
        calibration, axes_reports, used, tuple(left), lines, turn_on, turn_on_sd, tuple(dict.fromkeys(notes))
    )


def _calibration(fits: dict[int, AxisFit], found: Sequence[Stretch]) -> ImuCalibration:
    noise, noise_sd = _noise(found)
    models: dict[str, SensorModel] = {}
    sds: dict[str, SensorModel] = {}
    absent = np.full(3, np.nan)
    for sensor, axes in SENSOR_AXES.items():
        made = [fits.get(a) for a in axes]
        place = slice(axes[0], axes[-1] + 1)
        models[sensor] = SensorModel(
            static_bias=np.array([np.nan if f is None else f.static for f in made]),
            drift_amplitude=np.array([np.nan if f is None else f.amplitude for f in made]),
            drift_tau=np.array([np.nan if f is None else f.tau for f in made]),
            matrix=np.array([absent if f is None else f.row for f in made]),
            noise_sd=noise[place],
        )
        sds[sensor] = SensorModel(
            static_bias=np.array([np.nan if f is None else f.static_sd for f in made]),
            drift_amplitude=np.array([np.nan if f is None else f.amplitude_sd for f in made]),
            drift_tau=np.array([np.nan if f is None else f.tau_sd for f in made]),
            matrix=np.array([absent if f is None else f.row_sd for f in made]),
            noise_sd=noise_sd[place],
        )
    return ImuCalibration(**models, sd=SensorPair(**sds))


def _noise(found: Sequence[Stretch]) -> tuple[Floats, Floats]:
    """(6,) sd of a reading and its deviation, from stretches at rest (where there are none, from all)."""
    parts = [s for s in found if s.still] or list(found)
    weight = np.array([s.count.sum() for s in parts])[:, None]
    variance = np.array([s.noise for s in parts])
    own = np.array([s.noise_sd for s in parts])
    mean = (weight * variance).sum(axis=0) / weight.sum()
    error = np.sqrt(((weight * own) ** 2).sum(axis=0)) / weight.sum()
    if len(parts) > 1:
        # Stretches that differ by more than their own errors (a shaking table) widen it.
        with np.errstate(divide="ignore", invalid="ignore"):
            chi = (((variance - mean) / own) ** 2).sum(axis=0) / (len(parts) - 1)
        error = error * np.sqrt(np.fmax(chi, 1.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(mean > 0, np.sqrt(mean), np.nan), np.where(mean > 0, error / (2 * np.sqrt(mean)), np.nan)


def _turn_on(fits: dict[int, AxisFit], kept: dict[str, list[Stretch]], runs: int) -> tuple[Floats, Floats]:
    offsets, sd = np.full((runs, 6), np.nan), np.full(6, np.nan)
    for axis, made in fits.items():
        data = axis_data(kept["accel" if axis < 3 else "gyro"], axis)
        present = np.unique(data.run) if data is not None else np.zeros(0, np.int64)
        if made.scatter:
            offsets[present, axis] = made.offsets
            sd[axis] = np.sqrt(made.levels.turn_on)
    return offsets, sd


def _axis(axis: int, made: AxisFit, kept: list[Stretch]) -> AxisReport:
    data = axis_data(kept, axis)
    assert data is not None
    rest = [s for s in kept if s.kind == "rest" and s.still]
    papers = tuple(p for s in rest if (p := paper_drift(s, axis, made)) is not None)
    turned = data.u @ np.nan_to_num(made.row)
    return AxisReport(
        AXES[axis], made, papers, (data.lo + data.hi) / 2, data.run, data.value - turned, made.model - turned
    )
