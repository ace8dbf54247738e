"""Why a number of a calibration is null, in words with advice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from core.calibration.imu.algorithm1 import AXES
from core.calibration.imu.fit import AxisFit
from core.calibration.imu.model import ImuCalibration
from core.calibration.imu.stretches import Stretch

Floats = npt.NDArray[np.float64]

SENSOR_PLACE = {"accel": 0, "gyro": 3}
ADVICE = {
    "gyro": "a rate table that turns both ways about each axis shows it",
    "accel": "a run of six positions shows it",
}


def null_reasons(
    calibration: ImuCalibration, fits: Mapping[int, AxisFit], kept: Mapping[str, Sequence[Stretch]]
) -> list[str]:
    """A note for everything that is null."""
    notes: list[str] = []
    for sensor, first in SENSOR_PLACE.items():
        model = getattr(calibration, sensor)
        absent = [AXES[first + k] for k in range(3) if first + k not in fits]
        if len(absent) == 3:
            notes.append(f"{sensor}: null, the runs hold no readings of it in a segment that can be used")
            continue
        if absent:
            notes.append(f"{', '.join(absent)}: null, the runs hold no readings of it that can be used")
        have = np.array([first + k in fits for k in range(3)])
        names = np.array(AXES[first : first + 3])
        lost = np.isnan(model.matrix) & have[:, None]
        if lost.any():
            columns = ", ".join("xyz"[j] for j in np.flatnonzero(lost.any(axis=0)))
            notes.append(f"{sensor}.matrix: null along {columns}, the segments do not show it; {ADVICE[sensor]}")
        lost_bias = np.isnan(model.static_bias) & have
        if lost_bias.any():
            notes.append(
                f"{', '.join(names[lost_bias])}: static bias is null, it cannot be told from scale and misalignment; "
                f"{ADVICE[sensor]}"
            )
        for k in np.flatnonzero(have):
            notes += [f"{names[k]}: {text}" for text in fits[first + int(k)].notes]
            if np.isnan(model.noise_sd[k]):
                notes.append(f"{names[k]}: noise is null, the readings at rest are all equal")
    return notes


def turn_on_note(turn_on_sd: Floats, calibration: ImuCalibration, kept: Mapping[str, Sequence[Stretch]]) -> list[str]:
    """What a stored calibration cannot remove: the scatter from one switching on to the next."""
    notes = []
    for sensor, first in SENSOR_PLACE.items():
        sd = turn_on_sd[first : first + 3]
        if not kept[sensor]:
            continue
        if np.isnan(sd).all():
            notes.append(
                f"{sensor}: the runs do not show the scatter from one switching on to the next; biases and their "
                "deviations hold for these runs"
            )
        elif np.nanmax(sd) > 3 * np.nanmax(np.append(getattr(calibration.sd, sensor).static_bias, 0.0)):
            unit = "rad/s" if sensor == "gyro" else "m/s²"
            notes.append(f"{sensor}: the static bias scatters by {np.nanmax(sd):.2g} {unit} from run to run")
    return notes
