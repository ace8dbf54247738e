"""The raw integral of a gyro at chosen stamps, each reading lasting since the one before it (the paper's eq. 4)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.imu.bias.result import RATE

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


def curve_stamps(t: Floats) -> Floats:
    """(M,) stamps at RATE from the first reading on, to the last."""
    return np.arange(0.0, t[-1] - t[0] + 1e-6, 1 / RATE) + t[0]


def integral_at(t: Floats, gz: npt.NDArray[np.floating], out: Floats) -> tuple[Floats, Ints]:
    """Integral (M,) [rad] of gz (n,) from t[0] to each of the rising stamps `out` (M,) inside the record, and how many
    readings came up to each."""
    from core.imu.bias._blocks_numba import angles

    edges = np.searchsorted(t, out + 1e-9, "right").astype(np.int64)
    whole = np.cumsum(angles(t, gz, np.concatenate(([0], edges))))
    following = np.asarray(gz[np.minimum(edges, len(t) - 1)], np.float64)
    return whole + following * np.maximum(0.0, out - t[edges - 1]), edges
