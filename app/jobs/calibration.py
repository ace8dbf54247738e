"""Calibrations in a worker: an IMU error model out of runs, and a run corrected by one. No database here."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from app.jobs.imu import Made, plain
from app.jobs.tasks import Progress

if TYPE_CHECKING:
    from core.calibration.imu import ImuCalibration

Floats = npt.NDArray[np.float64]

AXES = ("ax", "ay", "az", "gx", "gy", "gz")  # the order of core.calibration
POINTS = 400  # of each curve of a report
CHUNK = 1 << 18  # readings that are corrected at a time


def calibrate(data: Path, progress: Progress, *, manifests: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The error model that these runs show, with its report, as `app.store.calibrations` keeps it."""
    from app.store import arrays
    from app.store.provenance import code_version
    from core.calibration.imu import calibrate as fit

    began = time.perf_counter()
    runs = [arrays.run_from_manifest(data, manifest) for manifest in manifests]
    made = fit(runs, progress)
    return {
        "result": made.calibration.to_json(),
        "report": plain(_report(made, manifests)),
        "notes": list(made.notes),
        "config": {},
        "runtime_s": time.perf_counter() - began,
        "code_version": code_version(),
    }


def _report(made: Any, manifests: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Curves and figures of a CalibrationReport as plain data, each curve of at most POINTS."""
    return {
        "axes": {name: _axis(axis) for name, axis in made.axes.items()},
        "lines": [
            {
                "axis": line.axis,
                "real": line.real.tolist(),
                "measured": line.measured.tolist(),
                "corrected": line.corrected.tolist(),
                "line_real": line.line_real.tolist(),
                "line_measured": line.line_measured.tolist(),
            }
            for line in made.lines
        ],
        "used": len(made.used),
        "left_out": [str(item) for item in made.left_out],
        "turn_on_sd": dict(zip(AXES, made.turn_on_sd.tolist(), strict=True)),
        "runs": [
            {
                "id": manifest["id"],
                "name": manifest["name"],
                "kind": (manifest["meta"].get("procedure") or {}).get("kind"),
                "rate_hz": next((mean_rate(s) for s in manifest["streams"] if s["name"] == "imu"), None),
            }
            for manifest in manifests
        ],
    }


def judge(
    data: Path, progress: Progress, *, manifest: Mapping[str, Any], calibration: Mapping[str, Any], calibration_id: str
) -> dict[str, Any]:
    """How good a calibration is on a run (Fig. 13 and 14), as a part of the run's IMU analysis."""
    from app.jobs.imu import Case, stored_part
    from app.store import arrays
    from core.calibration.imu import ImuCalibration, judge_correction

    progress(0.1, "raw, online and offline values")
    run, model = arrays.run_from_manifest(data, manifest), ImuCalibration.from_json(calibration)

    def part(case: Case) -> Made:
        report = judge_correction(case.run, model)
        figures: dict[str, Any] = {"axes": list(AXES), "t0": report.t0, "t1": report.t1, "delay": report.delay}
        for state in ("raw", "online", "offline"):
            one = getattr(report, state)
            figures[state] = {name: getattr(one, name).tolist() for name in ("start", "asymptote", "mean", "sd")}
        for name in ("noise_factor", "mean_left", "mean_left_sensor", "correlation", "correlation_all"):
            figures[name] = getattr(report, name).tolist()
        return Made({}, figures, report.notes)

    case = Case(run, {"calibration": calibration_id})
    made = stored_part(data, case, f"calibration.{calibration_id}", part)
    return {"parts": [made]}


def correct(
    data: Path,
    progress: Progress,
    *,
    manifest: Mapping[str, Any],
    calibration: Mapping[str, Any],
    provenance: Mapping[str, Any],
) -> dict[str, Any]:
    """The manifest of a new run: the same, its IMU corrected by Algorithm 1 sample by sample, in pieces."""
    from app.ingest import check_room, run_hash
    from core.calibration.imu import ImuCalibration
    from core.errors import MissingStreamError

    imu = next((s for s in manifest["streams"] if s["name"] == "imu"), None)
    if imu is None:
        raise MissingStreamError("the run has no IMU readings to correct", missing="imu")
    check_room(data, int(imu["rows"]) * 8 * len(imu["columns"]))
    columns, notes = _corrected(data, progress, imu, ImuCalibration.from_json(calibration))
    streams = [
        {**s, "columns": {**s["columns"], **columns}} if s["name"] == "imu" else dict(s) for s in manifest["streams"]
    ]
    sha256 = run_hash(manifest["meta"], streams)
    return {
        **manifest,
        "id": sha256[:16],
        "sha256": sha256,
        "name": f"{manifest['name'][:188]} (corrected)",
        "tags": sorted({*manifest["tags"], "corrected"}),
        "source": {**manifest["source"], "corrected": {**provenance, "method": "Algorithm 1, online"}},
        "warnings": [*manifest["warnings"], *(f"Correction: {note}." for note in notes)],
        "streams": streams,
    }


def _corrected(
    data: Path, progress: Progress, imu: Mapping[str, Any], calibration: ImuCalibration
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Keys of the corrected columns, and what the calibration leaves in."""
    from app.store import arrays
    from core.calibration.imu import advance, constants, initial_state

    present = [name for name in AXES if name in imu["columns"]]
    raw = {name: arrays.open(data, imu["columns"][name]) for name in present}
    t = arrays.open(data, imu["columns"]["t"])
    made = constants(calibration, axes=present)
    state = initial_state(made, float(t[0]) if len(t) else 0.0)
    with contextlib.ExitStack() as stack:
        writers = {name: stack.enter_context(arrays.Writer(data)) for name in present}
        for first in range(0, len(t), CHUNK):
            rows = slice(first, min(first + CHUNK, len(t)))
            dt = np.diff(t[rows], prepend=t[max(first - 1, 0)])
            values = np.full((len(dt), len(AXES)), np.nan)
            for name in present:
                values[:, AXES.index(name)] = raw[name][rows]
            state, out = advance(made, state, values, dt)
            for name in present:
                kind = raw[name].dtype if raw[name].dtype.kind == "f" else np.dtype(np.float64)
                writers[name].append(np.ascontiguousarray(out[:, AXES.index(name)], kind))
            progress(rows.stop / len(t), f"{rows.stop:,} of {len(t):,} readings")
        return {name: writer.commit() for name, writer in writers.items()}, made.notes


def mean_rate(stream: Mapping[str, Any]) -> float | None:
    """Readings over time [Hz]: what densities go by, however the stamps jitter."""
    span = stream["t1"] - stream["t0"]
    return (stream["rows"] - 1) / span if span > 0 else None


def _axis(axis: Any) -> dict[str, Any]:
    fit = axis.fit
    kept = _even(len(axis.t))
    return {
        "fit": {
            name: getattr(fit, name)
            for name in ("static", "static_sd", "amplitude", "amplitude_sd", "tau", "tau_sd", "drift_gain")
        },
        "t": axis.t[kept].tolist(),
        "run": axis.run[kept].tolist(),
        "bias": axis.bias[kept].tolist(),
        "curve": axis.curve[kept].tolist(),
        "blocks": len(axis.t),
        "paper": [_paper(record) for record in axis.paper],
    }


def _paper(record: Any) -> dict[str, Any]:
    kept = _even(len(record.lag))
    figures = ("run", "start", "asymptote", "amplitude", "tau", "amplitude_sd", "tau_sd", "expected")
    return {
        **{name: getattr(record, name) for name in figures},
        "lag": record.lag[kept].tolist(),
        "correlation": record.correlation[kept].tolist(),
    }


def _even(n: int) -> npt.NDArray[np.int64]:
    return np.unique(np.linspace(0, n - 1, min(n, POINTS)).astype(np.int64)) if n else np.zeros(0, np.int64)
