"""Ranges: the straight 3D distance from the tag to a named beacon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.sensors.base import Column, Floats, Log, StreamSpec


@dataclass(frozen=True)
class RangeLog(Log):
    """range (N,) [m]; beacon (N,) int16, the index into `names`."""

    beacon: npt.NDArray[np.int16]
    range: Floats
    names: tuple[str, ...] = ()


RANGES = StreamSpec(
    name="ranges",
    label="distances to beacons",
    columns=(
        Column("t", "s", "time"),
        Column("beacon", "", "beacon name"),
        Column("range", "m", "distance from tag to beacon"),
    ),
    log=RangeLog,
    text_columns=("beacon",),
)
