"""Files in: in one piece (`POST /runs`), or resumable, in as many pieces as it takes."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from typing import Annotated, Any

from fastapi import APIRouter, Header, Path, Query, Request, Response
from fastapi.responses import JSONResponse
from starlette.requests import ClientDisconnect

from app import errors
from app.api import schemas
from app.api.deps import EngineDep, JobsDep, SettingsDep
from app.api.runs import detail
from app.db.session import reading
from app.db.tables import Upload
from app.ingest import look_inside
from app.jobs.engine import JobEngine
from app.settings import Settings
from app.store import runs as run_store
from app.store import uploads as store
from core.formats import ColumnMap

log = logging.getLogger("driftscope")
router = APIRouter(tags=["uploads"])

HOP = 1 << 20  # bytes gathered before they go to the disk in a thread
CHECKPOINT = 32 << 20  # bytes after which they are acknowledged, so that a crash loses at most these
MENDABLE = ("needs_mapping", "stamp_order")  # refusals after which `finish` can be told how to read the file
RAW_BODY = {
    "requestBody": {
        "required": True,
        "description": "The bytes of the file, not encoded in any way.",
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}
UploadId = Annotated[str, Path(description="the upload's id", examples=["0d4c7be1a5f29386"], max_length=64)]
Text200 = Annotated[str | None, Query(max_length=200)]


@router.post(
    "/runs",
    summary="Upload a run in one piece",
    status_code=201,
    response_model=schemas.RunDetail,
    openapi_extra=RAW_BODY,
    responses={
        200: {"model": schemas.RunDetail, "description": "These readings were stored before"},
        202: {"model": schemas.Job, "description": "With `Prefer: respond-async`: the job that reads the file"},
    },
)
async def upload_run(
    request: Request,
    settings: SettingsDep,
    engine: EngineDep,
    jobs: JobsDep,
    filename: Annotated[str, Query(max_length=300, description="with its suffix", examples=["lap3.zip"])],
    name: Text200 = None,
    robot: Text200 = None,
    tags: Annotated[str, Query(description="with commas", max_length=4000, examples=["wet,night"])] = "",
    x_checksum_sha256: Annotated[str | None, Header(description="of the body, hexadecimal", max_length=100)] = None,
    prefer: Annotated[str | None, Header(max_length=200, examples=["respond-async"])] = None,
) -> Response:
    """The body is the file: a `.zip` of a run folder, a `.csv` or `.parquet`. Waits until it is stored.

    Refused files (422) leave nothing behind, but for those whose columns need a mapping (`needs_mapping`) or whose
    stamps go back (`stamp_order`): `where` then holds the upload's id, to go on with at `/uploads/{id}/finish`.
    """
    options = {"name": name, "robot": robot, "tags": [t for t in tags.split(",") if t.strip()]}
    declared = request.headers.get("content-length", "")
    size = int(declared) if declared.isdecimal() else None
    row = await asyncio.to_thread(
        store.create, engine, settings, file_name=filename, size=size, sha256=x_checksum_sha256, options=options
    )
    try:
        await _receive(request, store.Appender(engine, settings, row.id, 0), checkpoint=None)
        job = await _submit(engine, settings, jobs, row.id)
    except BaseException:
        await asyncio.shield(asyncio.to_thread(store.discard, engine, settings, row.id))
        raise
    if "respond-async" in (prefer or ""):
        _settle_later(request, row.id, job["id"])
        return JSONResponse(_job(job), 202, headers={"Location": f"/api/v1/jobs/{job['id']}"})
    ended = await jobs.wait(job["id"])
    await asyncio.to_thread(_settle, engine, settings, row.id, ended)
    if ended["state"] != "done":
        return _refusal(request, row.id, ended)
    return await asyncio.to_thread(_stored, engine, settings, row, ended["result"]["run_id"])


@router.post("/uploads", summary="Begin a resumable upload", status_code=201)
def create_upload(engine: EngineDep, settings: SettingsDep, start: schemas.UploadStart) -> schemas.UploadState:
    """Announce a file. Send its bytes with `PATCH`, then `finish`. Forgotten uploads are dropped after two days."""
    if start.mapping is not None:
        ColumnMap.from_json(start.mapping)
    row = store.create(
        engine,
        settings,
        file_name=start.file_name,
        size=start.size,
        sha256=start.sha256,
        options=start.model_dump(include={"name", "robot", "tags", "mapping"}),
    )
    return schemas.UploadState.model_validate(row)


@router.get("/uploads/{upload_id}", summary="Where an upload stands")
def get_upload(engine: EngineDep, upload_id: UploadId) -> schemas.UploadState:
    """How many bytes are safe on the server's disk: go on from there after a lost connection or a crash."""
    return schemas.UploadState.model_validate(store.get(engine, upload_id))


@router.patch("/uploads/{upload_id}", summary="Send bytes", openapi_extra=RAW_BODY)
async def append_upload(
    request: Request,
    engine: EngineDep,
    settings: SettingsDep,
    upload_id: UploadId,
    upload_offset: Annotated[int, Header(ge=0, description="`received` so far", examples=[8388608])],
) -> schemas.UploadState:
    """The body is the next piece, of any length. Answered once it is on disk.

    409 with the right offset in `where.expected` if the upload stands elsewhere.
    """
    busy: set[str] = request.app.state.busy_uploads
    if upload_id in busy:
        raise errors.ConflictError("another request is sending bytes of this upload", what="upload", id=upload_id)
    busy.add(upload_id)
    try:
        appender = await asyncio.to_thread(store.Appender, engine, settings, upload_id, upload_offset)
        await _receive(request, appender, checkpoint=CHECKPOINT)
    finally:
        busy.discard(upload_id)
    return schemas.UploadState.model_validate(await asyncio.to_thread(store.get, engine, upload_id))


@router.post("/uploads/{upload_id}/finish", summary="Read an upload", status_code=202)
async def finish_upload(
    request: Request,
    engine: EngineDep,
    settings: SettingsDep,
    jobs: JobsDep,
    upload_id: UploadId,
    finish: schemas.UploadFinish,
) -> schemas.Job:
    """Check size and checksum, then read the file in a job; its `result.run_id` is the run.

    After a refusal that a mapping can mend (`needs_mapping`), finish again with the mapping; after one for stamps
    that go back (`stamp_order`), with `in_order` to leave those rows out.
    """
    if finish.mapping is not None:
        ColumnMap.from_json(finish.mapping)
    how = finish.model_dump(exclude_unset=True, exclude_none=True)
    job = await _submit(engine, settings, jobs, upload_id, how)
    _settle_later(request, upload_id, job["id"])
    return schemas.Job(**_job(job))


@router.get("/uploads/{upload_id}/columns", summary="Columns of an uploaded table")
def get_upload_columns(engine: EngineDep, settings: SettingsDep, upload_id: UploadId) -> schemas.UploadColumns:
    """What a table holds, its first rows, and a guess at what its columns are."""
    row = store.complete(engine, settings, upload_id)
    return schemas.UploadColumns(**look_inside(store.path_of(settings, upload_id), row.file_name))


@router.delete("/uploads/{upload_id}", summary="Drop an upload", status_code=204)
def delete_upload(request: Request, engine: EngineDep, settings: SettingsDep, upload_id: UploadId) -> None:
    """Forget an upload and its bytes."""
    store.get(engine, upload_id)
    store.check_free(engine, upload_id)
    if upload_id in request.app.state.busy_uploads:
        raise errors.ConflictError("a request is still sending bytes of this upload", what="upload", id=upload_id)
    store.discard(engine, settings, upload_id)


async def _receive(request: Request, appender: store.Appender, checkpoint: int | None) -> None:
    """Stream the body to disk. What came before a lost connection or a refusal stays, acknowledged."""
    with appender:
        try:
            pending: list[bytes] = []
            size = 0
            async for chunk in request.stream():
                pending.append(chunk)
                size += len(chunk)
                if size >= HOP:
                    await asyncio.to_thread(appender.write, b"".join(pending))
                    pending, size = [], 0
                    if checkpoint is not None and appender.unsaved >= checkpoint:
                        await asyncio.to_thread(appender.checkpoint)
            await asyncio.to_thread(appender.write, b"".join(pending))
        except ClientDisconnect:
            await asyncio.to_thread(appender.write, b"".join(pending))
            await asyncio.to_thread(appender.checkpoint)
            raise
        await asyncio.to_thread(appender.checkpoint)


async def _submit(
    engine: EngineDep, settings: Settings, jobs: JobEngine, upload_id: str, how: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Give a complete upload to a job."""

    def submit() -> dict[str, Any]:
        store.complete(engine, settings, upload_id)
        return jobs.get(store.hand_over(engine, upload_id, how or {}, start))

    def start(row: Upload) -> str:
        options = store.ingest_options(settings, row)
        return jobs.submit("ingest", None, {"path": f"uploads/{row.id}", "upload": row.id, "options": options})

    return await asyncio.to_thread(submit)


def _settle_later(request: Request, upload_id: str, job_id: str) -> None:
    """Settle the upload when its job ends; after a restart of the server, `store.purge` does it."""
    state = request.app.state

    async def follow() -> None:
        with contextlib.suppress(errors.ConflictError):  # the server stops first
            ended = await state.jobs.wait(job_id)
            await asyncio.to_thread(_settle, state.engine, state.settings, upload_id, ended)

    task = asyncio.create_task(follow())
    state.followers.add(task)
    task.add_done_callback(state.followers.discard)


def _settle(engine: EngineDep, settings: Settings, upload_id: str, job: dict[str, Any]) -> None:
    """Keep the bytes only where trying again can help: the mapping was missing or wrong, rows out of order can be left
    out, or the fault was ours."""
    problem = job["error"] or {}
    lost = job["state"] == "failed" and problem.get("status") in (413, 422)
    mendable = problem.get("code") in (*MENDABLE, "parameter") or (job["state"] == "failed" and not lost)
    if not mendable:
        store.discard(engine, settings, upload_id)


def _refusal(request: Request, upload_id: str, job: dict[str, Any]) -> Response:
    problem = job["error"] or errors.problem(409, job["message"] or "the job was cancelled", code="cancelled")
    where = dict(problem["where"])
    if problem["code"] in MENDABLE:
        where["upload"] = upload_id
    return errors.response(request, {**problem, "where": where, "instance": request.url.path})


def _stored(engine: EngineDep, settings: Settings, row: Upload, run_id: str) -> Response:
    with reading(engine) as session:
        run = run_store.get_run(session, run_id)
        status = 201 if run.created_at >= row.created_at else 200
        body = detail(session, settings, run).model_dump(mode="json")
    return JSONResponse(body, status, headers={"Location": f"/api/v1/runs/{run_id}"})


def _job(job: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in job.items() if k in schemas.Job.model_fields}
