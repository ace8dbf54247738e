"""A core Estimate as columns and plain data: what is stored of it, by which names, in which units."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from core.estimation.result import Estimate, Innovations
from core.metrics import Consistency, check_innovations, evaluate, nees
from core.metrics.pose_error import PoseErrors
from core.run import Run
from core.trajectory import Trajectory

Columns = dict[str, npt.NDArray[Any]]

TURNING = 0.02  # rad/s, below which a wheel stands


def outcome_of(run: Run, estimate: Estimate, runtime_s: float) -> dict[str, Any]:
    """Everything that is kept: method, columns, final, metrics, parameters, events, notes, runtime_s."""
    path = estimate.trajectory
    errors = evaluate(path, run.truth) if run.truth is not None and len(path) else None
    claim = claimed_consistency(run, path)
    columns = {**_path_columns(path), **_bias_columns(estimate), **_error_columns(errors)}
    sensors, at_rest = judged_innovations(run, estimate)
    return {
        "method": estimate.method,
        "columns": {**columns, **_nis(sensors), **_nees(claim)},
        "final": final_pose(path),
        "metrics": [
            {"name": name, "value": finite(value), "unit": unit}
            for name, (value, unit) in metrics(estimate, errors, claim).items()
        ],
        "parameters": {
            name: {"value": finite(p.value), "sd": finite(p.sd), "unit": p.unit}
            for name, p in estimate.parameters.items()
        },
        "events": [
            {"kind": e.kind, "t0": e.t0, "t1": e.t1, "evidence": e.evidence, "replaced": e.replaced}
            for e in estimate.events
        ],
        "notes": list(estimate.notes),
        "consistency": consistency(sensors, at_rest, claim),
        "runtime_s": runtime_s,
    }


def judged_innovations(run: Run, estimate: Estimate) -> tuple[dict[str, Innovations], dict[str, int]]:
    """Innovations per sensor without those of wheels that stand, and how many these are.

    A standing wheel reads what was predicted, exactly: it says nothing of the noise of a turning one.
    """
    kept, at_rest = {}, {}
    for name, i in estimate.innovations.items():
        rows = _turning(run, i.t) if name.startswith("wheels.") else np.ones(len(i.t), bool)
        score = None if i.score is None else i.score[rows]
        kept[name] = Innovations(i.t[rows], i.nis[rows], i.dof, i.accepted[rows], score)
        at_rest[name] = int(np.sum(~rows))
    return kept, at_rest


def _turning(run: Run, t: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    """Whether a wheel turned between the readings around t (N,)."""
    if run.wheels is None or len(run.wheels) < 2:
        return np.ones(len(t), bool)
    step = np.maximum(np.abs(np.diff(run.wheels.left)), np.abs(np.diff(run.wheels.right)))
    turns = step > TURNING * np.diff(run.wheels.t)
    found: npt.NDArray[np.bool_] = turns[np.clip(np.searchsorted(run.wheels.t, t) - 1, 0, len(turns) - 1)]
    return found


def consistency(
    innovations: dict[str, Innovations], at_rest: dict[str, int], claim: Consistency | None
) -> dict[str, Any]:
    """Whether the method knows its own errors: per sensor by its innovations, and by NEES where there is truth."""
    sensors = {n: {**_sensor(i), "at_rest": at_rest[n]} for n, i in innovations.items()}
    judged = None
    if claim is not None:
        judged = {"dof": claim.dof, "mean": finite(claim.mean), "band": list(claim.band), "inside": claim.inside}
    return {"sensors": sensors, "nees": judged}


def _sensor(i: Innovations) -> dict[str, Any]:
    check = check_innovations(i.nis, i.dof, i.accepted, i.score)
    white, advice = check.whiteness, check.advice
    return {
        "dof": check.dof,
        "readings": check.readings,
        "rejected": check.rejected,
        "mean": finite(check.mean),
        "band": list(check.band) if check.band else None,
        "whiteness": white
        and {
            "autocorrelation": [round(float(r), 5) for r in white.autocorrelation],
            "limit": white.limit,
            "p_value": finite(white.p_value),
            "effective": finite(white.effective),
        },
        "advice": advice
        and {
            **{name: finite(getattr(advice, name)) for name in ("factor", "low", "high", "wide")},
            "fits": advice.fits,
            "single": advice.single,
        },
    }


def finite(value: float | None) -> float | None:
    """A float for JSON: None for what is unknown."""
    return None if value is None or not math.isfinite(value) else float(value)


def final_pose(path: Trajectory) -> dict[str, float | None]:
    """The last pose: x, y [m], theta [rad]."""
    if not len(path):
        return {"x": None, "y": None, "theta": None}
    return {name: finite(float(getattr(path, name)[-1])) for name in ("x", "y", "theta")}


def metrics(
    estimate: Estimate, errors: PoseErrors | None, claim: Consistency | None
) -> dict[str, tuple[float | None, str]]:
    """Every figure by name, with its SI unit."""
    path = estimate.trajectory
    found: dict[str, tuple[float | None, str]] = {}
    if errors is not None:
        found |= errors.summary()
    if claim is not None:
        found |= {"nees": (claim.mean, ""), "nees_dof": (float(claim.dof), ""), "nees_inside": (claim.inside, "")}
    if len(path):
        steps = np.hypot(np.diff(path.x), np.diff(path.y))
        found["distance_m"] = (float(steps[np.isfinite(steps)].sum()), "m")
    bias = estimate.gyro_bias
    if bias is not None and len(bias.value):
        found["bias_drift_rad_s"] = (float(bias.value[-1] - bias.value[0]), "rad/s")
    for sensor, innovation in estimate.innovations.items():
        kept = innovation.nis[innovation.accepted]
        if kept.size:
            found[f"nis_{sensor}"] = (float(kept.mean()) / innovation.dof, "")
    return found


def claimed_consistency(run: Run, path: Trajectory) -> Consistency | None:
    """NEES of a path with a stated covariance against truth, whose own deviation counts; None where there is none."""
    if run.truth is None or path.covariance is None or not len(path):
        return None
    xy, theta = run.meta.noise.truth_xy or 0.0, run.meta.noise.truth_theta or 0.0
    return nees(path, run.truth, truth_sd=(xy, xy, theta))


def _path_columns(path: Trajectory) -> Columns:
    columns: Columns = {"t": path.t, "x": path.x, "y": path.y, "theta": path.theta}
    if path.covariance is not None:
        for i, name in enumerate(("sd_x", "sd_y", "sd_theta")):
            columns[name] = np.sqrt(np.maximum(path.covariance[:, i, i], 0.0)).astype(np.float32)
        columns["cov_xy"] = path.covariance[:, 0, 1].astype(np.float32)
    return columns


def _bias_columns(estimate: Estimate) -> Columns:
    bias = estimate.gyro_bias
    if bias is None:
        return {}
    columns: Columns = {"bias_t": bias.t, "bias": bias.value}
    return columns if bias.sd is None else {**columns, "bias_sd": bias.sd.astype(np.float32)}


def _error_columns(errors: PoseErrors | None) -> Columns:
    if errors is None or not len(errors.t):
        return {}
    names = ("error_xy", "error_along", "error_across", "error_theta")
    return {"error_t": errors.t, **{name: getattr(errors, name) for name in names}}


def _nis(sensors: dict[str, Innovations]) -> Columns:
    columns: Columns = {}
    for sensor, innovation in sensors.items():
        columns[f"nis_{sensor}_t"], columns[f"nis_{sensor}"] = innovation.t, innovation.nis.astype(np.float32)
        columns[f"nis_{sensor}_accepted"] = innovation.accepted.astype(np.uint8)
    return columns


def _nees(claim: Consistency | None) -> Columns:
    return {} if claim is None else {"nees_t": claim.t, "nees": claim.nees.astype(np.float32)}
