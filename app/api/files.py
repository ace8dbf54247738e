"""Files out: a run as a zip of its folder, its truth as a trajectory."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from fastapi import APIRouter
from fastapi.responses import FileResponse
from starlette.background import BackgroundTask

from app.api.deps import ReadSession, RunId, SettingsDep
from app.ingest import check_room
from app.store import beside
from app.store import runs as store
from core.errors import MissingStreamError
from core.formats import write_run, write_trajectory
from core.run import Run
from core.trajectory import Trajectory

router = APIRouter(tags=["files"])
FileName = Literal["run-csv.zip", "run-parquet.zip", "truth.tum", "truth.kitti"]
MAKERS: dict[str, Callable[[Run, Run | None, Path], None]] = {
    "run-csv.zip": lambda run, simulated, path: write_run(run, path, "zip-csv", simulated),
    "run-parquet.zip": lambda run, simulated, path: write_run(run, path, "zip-parquet", simulated),
    "truth.tum": lambda run, _, path: write_trajectory(truth_of(run), path, "tum"),
    "truth.kitti": lambda run, _, path: write_trajectory(truth_of(run), path, "kitti"),
}
BINARY: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The file",
        "content": {
            "application/zip": {"schema": {"type": "string", "format": "binary"}},
            "text/plain": {"schema": {"type": "string"}},
        },
    }
}


@router.get("/runs/{run_id}/files/{file}", summary="Download a run", response_class=FileResponse, responses=BINARY)
def download_run(session: ReadSession, settings: SettingsDep, run_id: RunId, file: FileName) -> FileResponse:
    """The run in the run format, zipped, as CSV or Parquet, with the simulated run that lay beside it in `sim/`; or its
    truth as TUM (`t x y z qx qy qz qw`) or KITTI.
    """
    run = store.get_run(session, run_id)
    check_room(settings.data, run.size_bytes * (4 if file == "run-csv.zip" else 1))
    loaded, simulated = store.load_run(session, settings, run_id), beside.load(settings.data, run.source)
    return made_file(settings.data, f"{run.name} {file}", file, lambda path: MAKERS[file](loaded, simulated, path))


def made_file(data: Path, name: str, kind: str, make: Callable[[Path], None]) -> FileResponse:
    """A file made on the data folder's disk, sent in pieces, and deleted once it is sent."""
    (data / "tmp").mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(dir=data / "tmp"))
    try:
        make(folder / kind)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    media = "application/zip" if kind.endswith(".zip") else "text/plain; charset=utf-8"
    return FileResponse(
        folder / kind,
        filename=re.sub(r"[^\w.+-]+", "-", name).strip("-"),
        media_type=media,
        background=BackgroundTask(shutil.rmtree, folder, ignore_errors=True),
    )


def truth_of(run: Run) -> Trajectory:
    """The truth as a trajectory, stamps without a whole pose left out; MissingStreamError if there is none."""
    truth = run.truth
    if truth is None or truth.x is None or truth.y is None or truth.theta is None:
        raise MissingStreamError("the run has no truth with x, y and theta", missing="truth")
    pose = np.column_stack((truth.x, truth.y, truth.theta)).astype(np.float64)
    whole = np.isfinite(pose).all(axis=1)
    if not whole.any():
        raise MissingStreamError("no stamp of the truth has x, y and theta at once", missing="truth")
    return Trajectory(np.asarray(truth.t)[whole], *pose[whole].T)
