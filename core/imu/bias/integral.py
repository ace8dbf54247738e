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


def integral_behind(
    t: Floats, gz: npt.NDArray[np.floating], pauses: Floats, step: float
) -> tuple[Floats, Floats, Ints, Floats]:
    """The curve's stamps (M,) and, from the readings up to each alone: the integral (M,) [rad], how many readings came
    (M,), and the variance (M,) [rad^2] that `pauses` (P, 2) [s] hide up to there.

    Since the last reading it goes on for at most two of the sampling `step` [s]. Over a pause the rate is the middle
    between those beside it, known as if it lay anywhere between them.
    """
    from core.imu.bias._blocks_numba import angles

    out = curve_stamps(t)
    edges = np.searchsorted(t, out + 1e-9, "right").astype(np.int64)
    whole = np.cumsum(angles(t, gz, np.concatenate(([0], edges))))
    lost = np.zeros(len(out))
    for low, high in pauses:
        i, j = np.searchsorted(t, (low, high))
        place = int(np.searchsorted(out + 1e-9, high))  # where the pause is known to be over
        stop = max(j + 1, int(edges[place])) if place < len(out) else j + 1
        before = float(np.mean(gz[max(0, i - 9) : i + 1]))
        after = float(np.mean(gz[j : min(stop, j + 10)]))
        whole[place:] += ((before + after) / 2 - float(gz[j])) * (high - low)
        lost[place:] += ((high - low) * (after - before)) ** 2 / 12
    last = np.maximum(edges - 1, 0)
    since = np.clip(out - t[last], 0.0, 2 * step)
    return out, whole + np.asarray(gz[last], np.float64) * since, edges, lost
