"""Calibrations: make them from runs, upload, name, apply to runs, take them to other programs."""

from __future__ import annotations

import io
import json
import re
import zipfile
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Body, Path, Query, Response

from app.api import calibration_schemas as wire
from app.api import schemas
from app.api.deps import JobsDep, ReadSession, RunId, WriteSession
from app.api.imu import overview
from app.db.tables import Calibration, Run
from app.errors import NotFoundError
from app.figures import calibration as figures
from app.figures.signals import stream_of
from app.jobs.calibration import mean_rate
from app.store import calibrations as store
from app.store import imu as imu_store
from app.store import runs as run_store
from core.calibration.imu import ImuCalibration

router = APIRouter(tags=["calibrations"])

CalibrationId = Annotated[str, Path(description="the calibration's id", examples=["41d0c8a3e7b25f96"], max_length=64)]
FileName = Literal["calibration.json", "kalibr-imu.yaml", "imu-noise.sdf", "firmware.zip"]
MEDIA = {"json": "application/json", "yaml": "application/yaml", "sdf": "application/xml", "zip": "application/zip"}
FILES: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The file",
        "content": {
            **{media: {"schema": {}} for media in (MEDIA["json"], MEDIA["yaml"], MEDIA["sdf"])},
            MEDIA["zip"]: {"schema": {"type": "string", "format": "binary"}},
        },
    }
}
Text200 = Annotated[str | None, Query(max_length=200)]


@router.get("/calibrations", summary="List calibrations")
def list_calibrations(session: ReadSession, robot: Text200 = None) -> wire.CalibrationList:
    """All stored calibrations, or those of one robot, newest first."""
    return wire.CalibrationList(items=[summary(row) for row in store.list_calibrations(session, robot)])


@router.get("/calibrations/runs", summary="List runs to calibrate from")
def list_calibration_runs(session: ReadSession, robot: Text200 = None) -> list[wire.CalibrationRun]:
    """Runs whose `procedure` says that they were made for it: at rest, in six positions, on a rate table."""
    return [calibration_run(run) for run in store.calibration_runs(session, robot)]


@router.post("/calibrations", summary="Calibrate an IMU from runs", status_code=202)
def create_calibration(session: ReadSession, jobs: JobsDep, wanted: wire.CalibrateRequest) -> schemas.Job:
    """Queue a job that fits the error model to these runs together; its `result.calibration_id` is the calibration."""
    chosen = list(dict.fromkeys(wanted.runs))
    for run_id in chosen:
        stream_of(run_store.manifest(session, run_id), "imu")
    params = {"runs": chosen, "name": wanted.name, "robot": wanted.robot}
    return schemas.Job(**jobs.get(jobs.submit("calibrate", None, params)))


@router.post("/calibrations/upload", summary="Upload a calibration", status_code=201)
def upload_calibration(
    session: WriteSession,
    model: Annotated[dict[str, Any], Body(examples=[wire.MODEL])],
    name: Annotated[str, Query(min_length=1, max_length=200, examples=["mill, by its maker"])],
    robot: Text200 = None,
) -> wire.CalibrationDetail:
    """The body is a calibration/1 object, as `driftscope calibrate --json` writes it. Refused with the key named."""
    return detail(store.add_uploaded(session, model, name=name, robot=robot))


@router.get("/calibrations/{calibration_id}", summary="Get a calibration")
def get_calibration(session: ReadSession, calibration_id: CalibrationId) -> wire.CalibrationDetail:
    """The model with deviations, what it stands on, and its curves."""
    return detail(store.get_calibration(session, calibration_id))


@router.patch("/calibrations/{calibration_id}", summary="Change a calibration's name or robot")
def update_calibration(
    session: WriteSession, calibration_id: CalibrationId, change: wire.CalibrationChange
) -> wire.CalibrationDetail:
    """Change what people write about a calibration. Its numbers never change."""
    return detail(store.update_calibration(session, calibration_id, **change.model_dump()))


@router.delete("/calibrations/{calibration_id}", summary="Delete a calibration", status_code=204)
def delete_calibration(session: WriteSession, calibration_id: CalibrationId) -> None:
    """Forget a calibration. Runs that were corrected by it stay as they are."""
    store.delete_calibration(session, calibration_id)


@router.get(
    "/calibrations/{calibration_id}/files/{file}",
    summary="Take a calibration to another program",
    responses=FILES,
    response_class=Response,
)
def download_calibration(
    session: ReadSession,
    calibration_id: CalibrationId,
    file: FileName,
    rate: Annotated[
        float | None,
        Query(ge=1, le=100_000, allow_inf_nan=False, description="of the IMU [Hz]; default: of its runs, else 100"),
    ] = None,
    bias: Annotated[Literal["best", "C"], Query(description="bias tracker of the firmware")] = "best",
    run: Annotated[
        str | None, Query(max_length=64, description="a run whose Allan fit gives densities and walks; default: none")
    ] = None,
) -> Response:
    """JSON (calibration/1); Kalibr's `imu.yaml`; a Gazebo sensor with SDF `<noise>`; firmware as C99, zipped."""
    row = store.get_calibration(session, calibration_id)
    model = ImuCalibration.from_json(row.result)
    hertz = rate or _rate(row) or figures.RATE
    allan = overview(session, run).noise if run else None
    body = _file(file, row, model, hertz, bias, allan)
    name = re.sub(r"[^\w.+-]+", "-", f"{row.name} {file}").strip("-").encode("ascii", "ignore").decode()
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(body, media_type=MEDIA[file.rsplit(".", 1)[1]], headers=headers)


def _file(
    file: str, row: Calibration, model: ImuCalibration, rate: float, bias: str, allan: dict[str, Any] | None
) -> str | bytes:
    from app.exports.imu_kalibr import kalibr_yaml
    from app.exports.imu_sdf import sdf_noise

    if file == "calibration.json":
        return json.dumps(row.result, indent=2)
    if file == "kalibr-imu.yaml":
        return kalibr_yaml(model, name=row.name, rate=rate, allan=allan)
    if file == "imu-noise.sdf":
        return sdf_noise(model, name=row.name, rate=rate, allan=allan)
    return _firmware(model, rate, bias, allan)


def _firmware(model: ImuCalibration, rate: float, bias: str, allan: dict[str, Any] | None) -> bytes:
    from core.firmware import generate, noise_of_allan

    terms = (allan or {}).get("gz") or {}
    known = {"schema": "allan/1", "axis": "imu.gz", **{name: terms.get(name) for name in ("N", "B", "K")}}
    noise = noise_of_allan(known) if terms.get("N") else None
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in generate(model, rate_hz=rate, bias=bias, noise=noise).items():
            archive.writestr(zipfile.ZipInfo(name), text)  # of no date: the same calibration is the same file
    return buffer.getvalue()


@router.post("/runs/{run_id}/corrections", summary="Correct a run by a calibration", status_code=202)
def create_correction(session: ReadSession, jobs: JobsDep, run_id: RunId, wanted: wire.CorrectRequest) -> schemas.Job:
    """Queue a job that stores the same run with its IMU corrected by Algorithm 1, as a run of its own."""
    return _job_on_run(session, jobs, "correct", run_id, wanted.calibration)


@router.post(
    "/runs/{run_id}/imu/calibrations/{calibration_id}", summary="Judge a calibration on a run", status_code=202
)
def create_judgement(session: ReadSession, jobs: JobsDep, run_id: RunId, calibration_id: CalibrationId) -> schemas.Job:
    """Queue a job that compares raw, online and offline readings at the run's longest rest (Fig. 13 and 14)."""
    return _job_on_run(session, jobs, "judge", run_id, calibration_id)


def _job_on_run(session: ReadSession, jobs: JobsDep, kind: str, run_id: str, calibration_id: str) -> schemas.Job:
    stream_of(run_store.manifest(session, run_id), "imu")
    store.get_calibration(session, calibration_id)
    return schemas.Job(**jobs.get(jobs.submit(kind, run_id, {"calibration": calibration_id})))


@router.get("/runs/{run_id}/imu/calibrations/{calibration_id}", summary="How good a calibration is on a run")
def get_judgement(session: ReadSession, run_id: RunId, calibration_id: CalibrationId) -> wire.Correction:
    """Error at start and at the asymptote, noise, and how well online agrees with offline; 404 until it is judged."""
    run_store.get_run(session, run_id)
    store.get_calibration(session, calibration_id)
    row = imu_store.find_part(session, run_id, f"calibration.{calibration_id}")
    if row is None:
        raise NotFoundError(
            f"calibration {calibration_id} was not judged on this run yet; POST to this address does it",
            what="judgement",
            id=calibration_id,
        )
    return wire.Correction(calibration=calibration_id, figures=row.figures, notes=row.notes, error=row.error)


def summary(row: Calibration) -> wire.CalibrationSummary:
    """A row of the list on the wire."""
    return wire.CalibrationSummary(**_summary(row))


def _summary(row: Calibration) -> dict[str, Any]:
    return {
        **{name: getattr(row, name) for name in ("id", "name", "robot", "created_at")},
        "source": "runs" if row.run_ids else "upload",
        "runs": row.report.get("runs", []),
        "sentence": figures.sentence(row.result),
        "knows": figures.knows(row.result),
    }


def detail(row: Calibration) -> wire.CalibrationDetail:
    """A calibration whole on the wire."""
    copied = ("report", "notes", "code_version", "run_sha256", "runtime_s", "job_id")
    return wire.CalibrationDetail(
        **_summary(row),
        **{name: getattr(row, name) for name in copied},
        calibration=row.result,
        spectrum=figures.spectra(row.result),
        bode=figures.bode(_rate(row)),
    )


def _rate(row: Calibration) -> float | None:
    rates = [run["rate_hz"] for run in row.report.get("runs", []) if run.get("rate_hz")]
    return max(rates) if rates else None


def calibration_run(run: Run) -> wire.CalibrationRun:
    """A run to calibrate from on the wire."""
    imu = next((s for s in run.streams if s.name == "imu"), None)
    rate = mean_rate({"rows": imu.rows, "t0": imu.t0, "t1": imu.t1}) if imu else None
    kind = (run.meta.get("procedure") or {}).get("kind")
    return wire.CalibrationRun(id=run.id, name=run.name, kind=kind, rate_hz=rate)
