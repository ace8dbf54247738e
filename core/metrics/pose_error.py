"""How far a path is from the truth: absolute (ATE, final, largest, heading) and relative (RPE per metre, per second).

Absolute errors are differences of poses in the map. The relative error of a pair (i, j) is
`inverse(between(truth_i, truth_j)) * between(path_i, path_j)`: the drift over that stretch, whatever came before.
Sources: Sturm et al., IROS 2012 (ATE, RPE); Kümmerle et al., Autonomous Robots 27, 2009 (relative errors).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.geometry import between, wrap_angle
from core.metrics.alignment import Alignment, align
from core.metrics.association import match
from core.sensors import TruthLog
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]

PAIR_TOLERANCE = 0.1  # a pair's stretch may miss its nominal length by this share


@dataclass(frozen=True)
class RelativeError:
    """RPE over all pairs that lie `delta` apart (`unit`: m along the truth, or s): rmse of position and heading."""

    delta: float
    unit: str
    translation_rmse_m: float
    rotation_rmse_rad: float
    pairs: int


@dataclass(frozen=True)
class PoseErrors:
    """Errors of a path. Scalars are None where truth or path lacks what they need; nothing is guessed.

    Series (N,), one row per matched truth stamp: `error_xy` distance [m]; `error_along`, `error_across` [m] in the
    truth's heading (NaN without it); `error_theta` wrapped [rad]. Path minus truth.
    """

    alignment: Alignment
    matched: int
    unmatched: int
    unmatched_outside: int
    unmatched_in_pauses: int
    ate_rmse_m: float | None
    final_m: float | None
    max_m: float | None
    mean_m: float | None
    heading_rmse_rad: float | None
    final_rad: float | None
    heading_max_rad: float | None
    rpe: Mapping[str, RelativeError]  # keys "m" and "s", absent where not computable
    t: Array
    error_xy: Array
    error_along: Array
    error_across: Array
    error_theta: Array

    def summary(self) -> dict[str, tuple[float | None, str]]:
        """Every scalar by name, with its SI unit."""
        per_m, per_s = self.rpe.get("m"), self.rpe.get("s")
        return {
            "ate_rmse_m": (self.ate_rmse_m, "m"),
            "final_m": (self.final_m, "m"),
            "max_m": (self.max_m, "m"),
            "mean_m": (self.mean_m, "m"),
            "heading_rmse_rad": (self.heading_rmse_rad, "rad"),
            "final_rad": (self.final_rad, "rad"),
            "heading_max_rad": (self.heading_max_rad, "rad"),
            "rpe_per_m_m": (per_m.translation_rmse_m if per_m else None, "m"),
            "rpe_per_m_rad": (per_m.rotation_rmse_rad if per_m else None, "rad"),
            "rpe_per_s_m": (per_s.translation_rmse_m if per_s else None, "m"),
            "rpe_per_s_rad": (per_s.rotation_rmse_rad if per_s else None, "rad"),
            "matched": (float(self.matched), ""),
            "unmatched": (float(self.unmatched), ""),
        }


def evaluate(trajectory: Trajectory, truth: TruthLog, alignment: str = "none") -> PoseErrors:
    """Every error of a path that truth and path allow, at the truth's stamps. Alignment: see `ALIGNMENTS`."""
    m = match(trajectory, truth)
    aligned = align(alignment, m.path, m.truth)
    path = aligned.apply(m.path)
    dx, dy = path[:, 0] - m.truth[:, 0], path[:, 1] - m.truth[:, 1]
    cos, sin = np.cos(m.truth[:, 2]), np.sin(m.truth[:, 2])
    distance, heading = np.hypot(dx, dy), wrap_angle(path[:, 2] - m.truth[:, 2])
    size = np.abs(heading)
    return PoseErrors(
        alignment=aligned,
        matched=len(m.t),
        unmatched=m.unmatched,
        unmatched_outside=m.outside,
        unmatched_in_pauses=m.in_pauses,
        ate_rmse_m=_rms(distance),
        final_m=_last(distance),
        max_m=_largest(distance),
        mean_m=_mean(distance),
        heading_rmse_rad=_rms(heading),
        final_rad=_last(size),
        heading_max_rad=_largest(size),
        rpe=relative_errors(m.t, path, m.truth),
        t=m.t,
        error_xy=distance,
        error_along=cos * dx + sin * dy,
        error_across=-sin * dx + cos * dy,
        error_theta=heading,
    )


def relative_errors(
    t: Array, path: Array, truth: Array, metres: float = 1.0, seconds: float = 1.0
) -> dict[str, RelativeError]:
    """RPE per stretch of `metres` along the truth ("m") and per `seconds` ("s"), over all pairs, by (N, 3) poses."""
    whole = np.isfinite(path).all(axis=1) & np.isfinite(truth).all(axis=1)
    t, path, truth = t[whole], path[whole], truth[whole]
    if len(t) < 2:
        return {}
    travelled = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(truth[:, 0]), np.diff(truth[:, 1])))))
    found = {}
    for unit, along, delta in (("m", travelled, metres), ("s", t, seconds)):
        i, j = pairs_apart(along, delta)
        if i.size:
            error = between(between(truth[i], truth[j]), between(path[i], path[j]))
            translation, rotation = np.hypot(error[:, 0], error[:, 1]), wrap_angle(error[:, 2])
            found[unit] = RelativeError(delta, unit, _root_mean(translation), _root_mean(rotation), int(i.size))
    return found


def pairs_apart(along: Array, delta: float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """For each index the later one that lies nearest to `delta` further along, if within PAIR_TOLERANCE of it.

    Indices with less than `delta` before them have no pair.
    """
    i = np.arange(along.size - 1)
    target = along[i] + delta
    after = np.clip(np.searchsorted(along, target, "left"), i + 1, along.size - 1)
    before = np.maximum(after - 1, i + 1)
    nearer = np.where(np.abs(along[before] - target) <= np.abs(along[after] - target), before, after)
    # The first of several poses at the same place, as where the robot stands still.
    nearer = np.maximum(np.searchsorted(along, along[nearer], "left"), i + 1)
    good = (np.abs(along[nearer] - target) <= PAIR_TOLERANCE * delta) & (target <= along[-1] + 1e-9 * delta)
    return i[good], nearer[good]


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]


def _root_mean(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _rms(values: Array) -> float | None:
    kept = _finite(values)
    return _root_mean(kept) if kept.size else None


def _last(values: Array) -> float | None:
    kept = _finite(values)
    return float(kept[-1]) if kept.size else None


def _largest(values: Array) -> float | None:
    kept = _finite(values)
    return float(kept.max()) if kept.size else None


def _mean(values: Array) -> float | None:
    kept = _finite(values)
    return float(kept.mean()) if kept.size else None
