"""Does a path know its own errors? NEES: squared error over claimed covariance, chi-square where the claim is right.

Along one run the errors are correlated, so the mean NEES of a run scatters far more than independent samples would:
judge `inside` (the share of stamps whose 95 % ellipse holds the truth), and the mean over several runs against
`chi2_band(dof, runs)`. Source: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications", 2001, section 5.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.geometry import wrap_angle
from core.metrics.association import match
from core.sensors import TruthLog
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Consistency:
    """t, nees (N,) at matched stamps; `dof` error components; their mean; one sample's 95 % band; share under 95 %."""

    t: Array
    nees: Array
    dof: int
    mean: float
    band: tuple[float, float]
    inside: float


def chi2_band(dof: int, samples: int = 1, probability: float = 0.95) -> tuple[float, float]:
    """Two-sided band of the mean of `samples` independent chi-square values with `dof` degrees of freedom each."""
    from scipy.stats import chi2

    tail = (1 - probability) / 2
    low, high = chi2.ppf((tail, 1 - tail), dof * samples) / samples
    return float(low), float(high)


def nees(
    trajectory: Trajectory,
    truth: TruthLog,
    *,
    truth_sd: tuple[float, float, float] = (0.0, 0.0, 0.0),
    truth_clock: float = 0.0,
) -> Consistency | None:
    """NEES over the components that truth has; None without covariance or truth. `truth_sd` (x, y, theta) is added, and
    what an error of truth's stamps by `truth_clock` [s, one sigma] does while the robot moves.

    The claimed covariance is that of the path's pose nearest in time.
    """
    if trajectory.covariance is None:
        return None
    m = match(trajectory, truth)
    parts = np.flatnonzero(np.isfinite(m.truth).any(axis=0) & np.isfinite(m.path).any(axis=0))
    rows = np.isfinite(m.truth[:, parts]).all(axis=1) & np.isfinite(m.path[:, parts]).all(axis=1)
    if not parts.size or not rows.any():
        return None
    error = (m.path - m.truth)[rows]
    error[:, 2] = wrap_angle(error[:, 2])
    t, e = m.t[rows], error[:, parts]
    claimed = trajectory.covariance[_nearest(trajectory.t, t)] + np.diag(np.square(truth_sd))
    if truth_clock > 0 and len(t) > 1:
        reference = np.nan_to_num(m.truth[rows])
        reference[:, 2] = np.unwrap(reference[:, 2])
        moved = truth_clock * np.gradient(reference, t, axis=0)
        claimed = claimed + moved[:, :, None] * moved[:, None, :]
    P = claimed[:, parts[:, None], parts[None, :]]
    usable = np.linalg.cond(P) < 1e12
    if not usable.any():
        return None
    t, e, P = t[usable], e[usable], P[usable]
    values = np.einsum("ni,ni->n", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])
    band = chi2_band(int(parts.size))
    from scipy.stats import chi2

    limit = float(chi2.ppf(0.95, parts.size))
    return Consistency(t, values, int(parts.size), float(values.mean()), band, float(np.mean(values <= limit)))


def _nearest(stamps: Array, t: Array) -> npt.NDArray[np.intp]:
    after = np.clip(np.searchsorted(stamps, t), 1, max(1, len(stamps) - 1))
    after = np.minimum(after, len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(t - stamps[before] < stamps[after] - t, before, after)
