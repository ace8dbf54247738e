"""Gyro bias by `best`, stepped: the blocks of `core.imu.bias`, a few at a time, through the same compiled filter.

Blocks lie on the same grid as offline, counted from the first reading. What a block says needs the readings of a few
blocks before it; those are cut again and thrown away.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError
from core.estimation.result import Curve
from core.imu.bias import FilterConfig
from core.imu.bias import _learn_numba as kernel
from core.imu.bias.blocks import WARMTH, Blocks, cut
from core.imu.bias.filtered import settings
from core.imu.bias.result import RATE
from core.live.recent import joined
from core.run import Run
from core.sensors import ImuLog

Array = npt.NDArray[np.float64]

BACK = 2 * kernel.WINDOW  # blocks that are cut again


class SteadyBias:
    """The filter of `best` and where its next block begins."""

    def __init__(self, config: FilterConfig | None = None) -> None:
        self._config = config or FilterConfig()
        self._state: kernel.State | None = None
        self._constants = np.zeros(0)
        self._origin, self._done, self._cells = 0.0, 0, 0
        self._warmth: tuple[float, float] | None = None  # first temperature, running mean

    def step(self, recent: Run) -> Curve | None:
        """Bias [rad/s] at the ends of the blocks that are new; None where there are none."""
        imu = _finite(recent.imu)
        if imu is None:
            return None
        back = max(0, self._done - BACK)
        if self._state is None:
            self._origin = float(imu.t[0])
        elif float(imu.t[-1]) < self._origin + (self._done + 1) * self._cells / RATE:
            return None
        window = imu if back == 0 else _from(imu, self._origin + back * self._cells / RATE)
        if len(window) < 2 * BACK:
            return None
        with _one_thread():
            try:
                blocks = cut(dataclasses.replace(recent, imu=window), window, self._config.block)
            except NotEnoughDataError:
                return None
            if self._state is None:
                self._begin(blocks, window)
            elif blocks.cells != self._cells:
                return None
            return self._run(blocks, window, self._done - back)

    def _begin(self, blocks: Blocks, imu: ImuLog) -> None:
        self._cells = blocks.cells
        self._constants = settings(self._config, blocks.length, imu.temperature is not None)
        self._state = kernel.new_state(self._constants)

    def _run(self, blocks: Blocks, imu: ImuLog, first: int) -> Curve | None:
        from core.imu.bias._best_numba import run as run_blocks

        count = len(blocks.t) - first
        if count <= 0 or self._state is None:
            return None
        start, given = np.ascontiguousarray(blocks.start[first:]), np.ascontiguousarray(blocks.given[first:])
        given[:, kernel.KELVIN] = self._kelvin(imu, start)
        gz = np.ascontiguousarray(imu.gz, np.float64)
        live, _, _ = run_blocks(self._state, self._constants, gz, start, given)
        self._done += count
        spread = np.sqrt(np.maximum(live[:, 3], 0.0) + live[:, 6])
        ends = self._origin + np.arange(self._done - count + 1, self._done + 1) * self._cells / RATE
        return Curve(ends, live[:, 2], spread)

    def _kelvin(self, imu: ImuLog, start: npt.NDArray[np.int64]) -> Array:
        """(K,) temperature over the first known one, a running mean that goes on."""
        out = np.zeros(len(start) - 1)
        if imu.temperature is None:
            return out
        from core.imu.bias._blocks_numba import moments

        for k, mean in enumerate(moments(imu.temperature, start)[:, 0].tolist()):
            if np.isfinite(mean):
                first, smooth = self._warmth or (mean, mean)
                self._latest = mean
                self._warmth = first, smooth + WARMTH * (mean - smooth)
            elif self._warmth is not None:
                first, smooth = self._warmth
                self._warmth = first, smooth + WARMTH * (self._latest - smooth)
            if self._warmth is not None:
                out[k] = self._warmth[1] - self._warmth[0]
        return out


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """A few blocks are not worth waking other threads for."""
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def _finite(imu: ImuLog | None) -> ImuLog | None:
    if imu is None or not len(imu):
        return None
    good = np.isfinite(imu.gz)
    if good.all():
        return imu
    columns: dict[str, Any] = {name: column[good] for name, column in imu.columns().items()}
    return ImuLog(**columns) if good.any() else None


def _from(imu: ImuLog, t: float) -> ImuLog:
    """The readings after a grid stamp, behind one that stands on it: so the grid begins there."""
    rest = imu.crop(float(np.nextafter(t + 1e-9, np.inf)), np.inf)
    if not len(rest):
        return rest
    head: dict[str, Any] = {name: column[:1].copy() for name, column in rest.columns().items()}
    head["t"] = np.array([t])
    made = joined(ImuLog(**head), rest)
    assert isinstance(made, ImuLog)
    return made
