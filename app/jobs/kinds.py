"""The kinds of jobs: what a worker gets, what it runs, what the dashboard then stores. To add one: a row in KINDS."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from app.db.tables import Job
from app.errors import NotFoundError
from app.figures.gap_sentence import headline
from app.jobs import calibration, diagnose, imu, odometry, tasks
from app.jobs import live as live_job
from app.settings import Settings
from app.store import calibrations, diagnoses, jobs, results, runs
from app.store import imu as imu_store
from app.store import live as live_store
from app.store import odometry as odometry_store
from app.store.provenance import code_version


@dataclass(frozen=True)
class Saved:
    """What a finished job made (`result`, ids), in a sentence, and the jobs that it queued."""

    result: dict[str, Any]
    message: str
    run_id: str | None = None
    follow: Sequence[Job] = ()


@dataclass(frozen=True)
class Kind:
    """`arguments` reads from the database what `task` needs in a worker; `save` writes what comes back."""

    label: str
    task: Callable[..., Any]
    arguments: Callable[[Session, Settings, Job], dict[str, Any]]
    save: Callable[[Session, Settings, Job, Any], Saved]


def _ingest_arguments(session: Session, settings: Settings, job: Job) -> dict[str, Any]:
    """`path` of an upload, relative to the data folder, or of any file or folder on this machine."""
    path = job.params["path"]
    if not (settings.data / path).exists():
        raise NotFoundError("the uploaded file is gone: send it again", what="upload", id=job.params.get("upload"))
    return {"path": path, "options": job.params["options"]}


def _ingest_save(session: Session, settings: Settings, job: Job, manifest: dict[str, Any]) -> Saved:
    run = runs.add_run(session, manifest, is_example=bool(job.params.get("is_example")))
    following = jobs.first_jobs(session, run.id)
    shown = job.params.get("is_example") and "commands" in run.stream_names.split()
    if shown and not diagnoses.list_diagnoses(session, run=run.id, limit=1):  # so that there is a report to look at
        following.append(jobs.create(session, "diagnose", run.id, diagnosis_params([run.id])))
    return Saved({"run_id": run.id}, f"stored as {run.name}", run.id, following)


def _estimate_arguments(session: Session, settings: Settings, job: Job) -> dict[str, Any]:
    assert job.run_id is not None
    manifest = runs.manifest(session, job.run_id)
    return {"manifest": manifest, "methods": job.params.get("methods"), "config": job.params.get("config") or {}}


def _estimate_save(session: Session, settings: Settings, job: Job, made: dict[str, Any]) -> Saved:
    assert job.run_id is not None
    ids = results.save_estimates(session, settings.data, job.run_id, job.id, made["estimates"])
    if not ids:
        return Saved({"run_id": job.run_id, "estimates": []}, "no method can run on this run", job.run_id)
    message = ", ".join(e["method"] for e in made["estimates"])
    if made["failed"]:
        message += "; failed: " + "; ".join(f"{f['method']}: {f['detail']}" for f in made["failed"])
    return Saved({"run_id": job.run_id, "estimates": ids, "failed": made["failed"]}, message, job.run_id)


def _imu_arguments(session: Session, settings: Settings, job: Job) -> dict[str, Any]:
    assert job.run_id is not None
    asked = {"axes": job.params.get("axes"), "methods": job.params.get("methods")}
    return {"manifest": runs.manifest(session, job.run_id), **asked, "config": job.params.get("config") or {}}


def _imu_save(session: Session, settings: Settings, job: Job, made: dict[str, Any]) -> Saved:
    assert job.run_id is not None
    parts = imu_store.save_parts(session, job.run_id, job.id, made["parts"])
    failed = [p["part"] for p in made["parts"] if p["error"]]
    message = f"{len(parts) - len(failed)} parts" + (f"; not possible: {', '.join(failed)}" if failed else "")
    return Saved({"run_id": job.run_id, "parts": parts, "not_possible": failed}, message, job.run_id)


def _calibrate_arguments(session: Session, settings: Settings, job: Job) -> dict[str, Any]:
    return {"manifests": [runs.manifest(session, run_id) for run_id in job.params["runs"]]}


def _calibrate_save(session: Session, settings: Settings, job: Job, made: dict[str, Any]) -> Saved:
    asked = {"name": job.params.get("name"), "robot": job.params.get("robot")}
    row = calibrations.add_made(session, job.params["runs"], made, job_id=job.id, **asked)
    return Saved({"calibration_id": row.id}, f"stored as {row.name}", job.run_id)


def _with_calibration(session: Session, job: Job) -> tuple[dict[str, Any], dict[str, Any], str]:
    """The manifest of the job's run, its calibration as calibration/1, and that one's id."""
    assert job.run_id is not None
    row = calibrations.get_calibration(session, job.params["calibration"])
    return runs.manifest(session, job.run_id), row.result, row.id


def _judge_arguments(session: Session, settings: Settings, job: Job) -> dict[str, Any]:
    manifest, model, calibration_id = _with_calibration(session, job)
    return {"manifest": manifest, "calibration": model, "calibration_id": calibration_id}


def _correct_arguments(session: Session, settings: Settings, job: Job) -> dict[str, Any]:
    manifest, model, calibration_id = _with_calibration(session, job)
    row = calibrations.get_calibration(session, calibration_id)
    provenance = {
        "from_run": manifest["id"],
        "from_sha256": manifest["sha256"],
        "calibration": calibration_id,
        "calibration_name": row.name,
        "code_version": code_version(),
    }
    return {"manifest": manifest, "calibration": model, "provenance": provenance}


def _correct_save(session: Session, settings: Settings, job: Job, manifest: dict[str, Any]) -> Saved:
    run = runs.add_run(session, manifest)
    following = jobs.first_jobs(session, run.id)
    return Saved({"run_id": run.id}, f"stored as {run.name}", job.run_id, following)


def diagnosis_params(
    fitted: Sequence[str],
    held_out: Sequence[str] = (),
    *,
    tolerances: Mapping[str, float] | None = None,
    seed: int = 0,
    simulator: str | None = None,
    name: str | None = None,
) -> dict[str, Any]:
    """Parameters of a job `diagnose`: ids of runs, tolerances by "effect.parameter", a registered simulator."""
    return {
        "runs": list(fitted), "held_out": list(held_out), "tolerances": dict(tolerances or {}), "seed": seed,
        "simulator": simulator, "name": name,
    }  # fmt: skip


def _diagnose_arguments(session: Session, settings: Settings, job: Job) -> dict[str, Any]:
    asked, path = job.params, settings.simulators
    return {
        "simulators": str(path.resolve()) if path else None,
        "manifests": [runs.manifest(session, run_id) for run_id in asked["runs"]],
        "held_out": [runs.manifest(session, run_id) for run_id in asked["held_out"]],
        **{key: asked[key] for key in ("tolerances", "seed", "simulator")},
    }


def _diagnose_save(session: Session, settings: Settings, job: Job, made: dict[str, Any]) -> Saved:
    asked = job.params
    row = diagnoses.add_diagnosis(
        session, asked["runs"], asked["held_out"], made, job_id=job.id, name=asked.get("name")
    )
    told = headline(row.result)
    return Saved({"diagnosis_id": row.id, "verdict": row.verdict}, f"{row.name}: {told}", job.run_id)


def _odometry_arguments(session: Session, settings: Settings, job: Job) -> dict[str, Any]:
    asked = job.params
    manifests = [runs.manifest(session, run_id) for run_id in asked["runs"]]
    return {"manifests": manifests, "reference": asked["reference"], "own_clocks": asked["own_clocks"]}


def _odometry_save(session: Session, settings: Settings, job: Job, made: dict[str, Any]) -> Saved:
    config = {name: job.params[name] for name in ("reference", "own_clocks")}
    row = odometry_store.save(session, job.params["runs"], made, job_id=job.id, config=config)
    values = row.result["parameters"].values()
    shown = sum(value is not None for value in values)
    return Saved({"run_id": row.run_id}, f"{shown} of {len(values)} parameters shown", row.run_id)


def _live_arguments(session: Session, settings: Settings, job: Job) -> dict[str, Any]:
    return {"manifest": runs.manifest(session, job.params["live"])}


def _live_save(session: Session, settings: Settings, job: Job, manifest: dict[str, Any] | None) -> Saved:
    run = runs.add_run(session, manifest) if manifest is not None else None
    live_store.stored(session, job.params["live"], run)
    if run is None:
        return Saved({}, "the robot had sent no readings: nothing was stored")
    following = jobs.first_jobs(session, run.id)
    return Saved({"run_id": run.id}, f"stored as {run.name}", run.id, following)


KINDS: dict[str, Kind] = {
    "ingest": Kind("store an upload", tasks.ingest, _ingest_arguments, _ingest_save),
    "live": Kind("store a live run", live_job.store, _live_arguments, _live_save),
    "estimate": Kind("estimate paths", tasks.estimate, _estimate_arguments, _estimate_save),
    "imu": Kind("analyse the IMU", imu.analyse, _imu_arguments, _imu_save),
    "calibrate": Kind("calibrate an IMU", calibration.calibrate, _calibrate_arguments, _calibrate_save),
    "judge": Kind("judge a calibration", calibration.judge, _judge_arguments, _imu_save),
    "correct": Kind("correct a run", calibration.correct, _correct_arguments, _correct_save),
    "odometry": Kind("calibrate odometry", odometry.calibrate, _odometry_arguments, _odometry_save),
    "diagnose": Kind("diagnose the gap", diagnose.diagnose, _diagnose_arguments, _diagnose_save),
}
