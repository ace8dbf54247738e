"""Diagnoses of the gap: ask for one, list, read, keep or drop, and take them to other programs."""

from __future__ import annotations

import dataclasses
import re
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Response
from pydantic_core import to_json
from sqlalchemy.orm import Session

from app.api import diagnosis_schemas as wire
from app.api import sandbox_schemas, schemas
from app.api.deps import JobsDep, ReadSession, SettingsDep, WriteSession
from app.api.diagnosis_rows import detail, summaries
from app.db.tables import Diagnosis
from app.errors import NotFoundError
from app.jobs.kinds import diagnosis_params
from app.settings import Settings
from app.simulators import OURS, RECORDED, registered
from app.store import beside
from app.store import diagnoses as store
from app.store import runs as run_store
from core.effects.chosen import effects_of
from core.errors import ParameterError

router = APIRouter(tags=["diagnoses"])

DiagnosisId = Annotated[str, Path(description="the diagnosis's id", examples=["41d0c8a3e7b25f96"], max_length=64)]
FileName = Literal["report.html", "report.json", "evidence.json", "effects.json", "effects-all.json", "commands.csv"]
MEDIA = {"html": "text/html", "json": "application/json", "csv": "text/csv"}
FILES: dict[int | str, dict[str, Any]] = {
    200: {"description": "The file", "content": {media: {"schema": {}} for media in MEDIA.values()}}
}
PATCH: dict[int | str, dict[str, Any]] = {
    200: {
        "model": sandbox_schemas.EffectFile,
        "description": "the file; or, with form=json, its text and what the target cannot say",
        "content": {kind: {"schema": {"type": "string"}} for kind in ("application/xml", "application/yaml")},
    }
}
Text64 = Annotated[str | None, Query(max_length=64)]
Text200 = Annotated[str | None, Query(max_length=200)]


@router.post("/diagnoses", summary="Diagnose the gap between runs and their simulator", status_code=202)
def create_diagnosis(
    session: ReadSession, settings: SettingsDep, jobs: JobsDep, wanted: wire.DiagnoseRequest
) -> schemas.Job:
    """Queue a job; its `result.diagnosis_id` is the diagnosis. Runs that cannot be diagnosed are refused at once."""
    check_request(session, settings, wanted)
    options = wanted.options.model_dump()
    options["simulator"] = None if options["simulator"] == OURS else options["simulator"]
    params = diagnosis_params(wanted.runs, wanted.held_out, **options)
    return schemas.Job(**jobs.get(jobs.submit("diagnose", wanted.runs[0], params)))


@router.get("/diagnoses", summary="List diagnoses")
def list_diagnoses(
    session: ReadSession,
    run: Text64 = None,
    robot: Text200 = None,
    verdict: Annotated[
        str | None, Query(max_length=40, description=f"one of {', '.join(store.VERDICTS)}", examples=["unknown"])
    ] = None,
    limit: Annotated[int, Query(ge=1, le=store.MAX_LISTED)] = 100,
) -> wire.DiagnosisList:
    """Stored diagnoses, newest first: all, or those of a run (fitted or held out), a robot, a verdict."""
    rows = store.list_diagnoses(session, run=run, robot=robot, verdict=verdict, limit=limit)
    return wire.DiagnosisList(items=summaries(session, rows))


@router.get("/diagnoses/deleted", summary="List deleted diagnoses")
def list_deleted_diagnoses(session: ReadSession) -> wire.DiagnosisList:
    """Diagnoses that can still be restored."""
    return wire.DiagnosisList(items=summaries(session, store.list_diagnoses(session, deleted=True)))


@router.get("/diagnoses/{diagnosis_id}", summary="Get a diagnosis")
def get_diagnosis(session: ReadSession, diagnosis_id: DiagnosisId) -> wire.DiagnosisDetail:
    """The answer (gap/1), the sentence, and all that makes it again."""
    return detail(session, store.get_diagnosis(session, diagnosis_id))


@router.get(
    "/diagnoses/{diagnosis_id}/evidence",
    summary="What stands behind a diagnosis",
    responses={200: {"model": wire.Evidence}},
)
def get_diagnosis_evidence(session: ReadSession, diagnosis_id: DiagnosisId) -> Response:
    """Curves and figures of the report (gap-evidence/1): heat map, paths, timelines, signatures, what to drive next."""
    return Response(to_json(evidence_of(session, diagnosis_id)), media_type="application/json")


@router.patch("/diagnoses/{diagnosis_id}", summary="Change a diagnosis's name or notes")
def update_diagnosis(
    session: WriteSession, diagnosis_id: DiagnosisId, change: wire.DiagnosisChange
) -> wire.DiagnosisDetail:
    """Change what people write about a diagnosis. What it found never changes."""
    return detail(session, store.update_diagnosis(session, diagnosis_id, **change.model_dump()))


@router.delete("/diagnoses/{diagnosis_id}", summary="Delete a diagnosis")
def delete_diagnosis(session: WriteSession, diagnosis_id: DiagnosisId) -> wire.DiagnosisSummary:
    """Delete a diagnosis; for a day it can be restored."""
    return summaries(session, [store.delete_diagnosis(session, diagnosis_id)])[0]


@router.post("/diagnoses/{diagnosis_id}/restore", summary="Restore a deleted diagnosis")
def restore_diagnosis(session: WriteSession, diagnosis_id: DiagnosisId) -> wire.DiagnosisSummary:
    """Undo a deletion."""
    return summaries(session, [store.restore_diagnosis(session, diagnosis_id)])[0]


@router.get(
    "/diagnoses/{diagnosis_id}/files/{file}",
    summary="A diagnosis as a file",
    responses=FILES,
    response_class=Response,
)
def download_diagnosis(session: ReadSession, diagnosis_id: DiagnosisId, file: FileName) -> Response:
    """The report as one HTML page that needs nothing else; gap/1; its evidence; the effects as `driftscope simulate`
    takes them, those of the causes or all, with what is below its tolerance; the commands of the next experiment,
    where there is one to drive.
    """
    row = store.get_diagnosis(session, diagnosis_id, evidence=True)
    name = re.sub(r"[^\w.+-]+", "-", f"{row.name}-{file}").strip("-").encode("ascii", "ignore").decode()
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    if file == "report.html":
        headers["Content-Security-Policy"] = "sandbox; default-src 'none'; style-src 'unsafe-inline'"
    return Response(_file(session, row, file), media_type=MEDIA[file.rsplit(".", 1)[1]], headers=headers)


@router.get("/diagnoses/{diagnosis_id}/patches/{target}", summary="A patch for a simulator", responses=PATCH)
def get_diagnosis_patch(
    session: ReadSession,
    settings: SettingsDep,
    diagnosis_id: DiagnosisId,
    target: Annotated[str, Path(description="json, sdf, ros2_control or mjcf", examples=["sdf"], max_length=40)],
    form: Literal["file", "json"] = "file",
) -> Response:
    """The joint explanation in the language of a simulator, with the robot of the first run."""
    from app.exports.effects import export_effects

    row = store.get_diagnosis(session, diagnosis_id)
    meta = run_store.load_run(session, settings, row.run_ids[0]).meta
    made = export_effects(target, meta, effects_of(row.result))
    if form == "json":
        return Response(to_json(dataclasses.asdict(made)), media_type="application/json")
    headers = {"Content-Disposition": f'attachment; filename="{made.file_name}"'}
    return Response(made.text, media_type=made.media_type, headers=headers)


def check_request(session: Session, settings: Settings, wanted: wire.DiagnoseRequest) -> None:
    """Raises NotFoundError, ParameterError, MissingStreamError, NotEnoughDataError: what a job would fail of."""
    from core.gap.checks import check_runs, check_tolerances

    for field, given in (("runs", wanted.runs), ("held_out", wanted.held_out)):
        twice = next((run_id for run_id in given if given.count(run_id) > 1), None)
        if twice is not None:
            raise ParameterError(f"run {twice} is given twice", parameter=field, found=twice)
    both = next((run_id for run_id in wanted.held_out if run_id in wanted.runs), None)
    if both is not None:
        name = run_store.get_run(session, both).name
        raise ParameterError(
            f"held-out run “{name}” was also given to fit; give a run that was not", parameter="held_out", found=both
        )
    check_tolerances(wanted.options.tolerances, "options.tolerances")
    simulator, known = wanted.options.simulator, [OURS, *registered(settings.simulators)]
    bare = [i for i in (*wanted.runs, *wanted.held_out) if beside.KEY not in run_store.get_run(session, i).source]
    if simulator == RECORDED and bare:
        name = run_store.get_run(session, bare[0]).name
        raise ParameterError(
            f"options.simulator: run “{name}” was stored without a simulated run beside it (a folder sim/)",
            parameter="options.simulator",
            expected=known,
            found=simulator,
        )
    known += [] if bare else [RECORDED]
    if simulator is not None and simulator not in known:
        raise ParameterError(
            f"options.simulator: there is no simulator {simulator!r}; expected one of {', '.join(known)}",
            parameter="options.simulator",
            expected=known,
            found=simulator,
        )
    fitted, kept = (
        [run_store.load_run(session, settings, i) for i in given] for given in (wanted.runs, wanted.held_out)
    )
    check_runs(fitted, kept)


def evidence_of(session: Session, diagnosis_id: str) -> dict[str, Any]:
    """A diagnosis's evidence; NotFoundError where it was stored without."""
    row = store.get_diagnosis(session, diagnosis_id, evidence=True)
    if row.evidence is None:
        raise NotFoundError(f"diagnosis {diagnosis_id} was stored without evidence", what="evidence", id=diagnosis_id)
    return row.evidence


def _file(session: Session, row: Diagnosis, file: str) -> str | bytes:
    if file == "report.html":
        from app.pages.diagnosis import report

        return report(detail(session, row).model_dump(mode="json"), row.evidence)
    if file == "report.json":
        return to_json(row.result, indent=2)
    if file == "evidence.json":
        return to_json(evidence_of(session, row.id), indent=2)
    if file in ("effects.json", "effects-all.json"):
        return to_json({"effects": effects_of(row.result, immaterial=file == "effects-all.json")}, indent=2)
    return _commands(row)


def _commands(row: Diagnosis) -> str:
    drive = (row.evidence or {}).get("next")
    if not drive or not drive.get("commands"):
        raise NotFoundError("this diagnosis asks for no further experiment", what="commands", id=row.id)
    columns = drive["commands"]
    rows = zip(columns["t"], columns["v"], columns["w"], strict=True)
    return "t,v,w\n" + "".join(f"{t},{v},{w}\n" for t, v, w in rows)
