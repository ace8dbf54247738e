"""The API keeps to its own description, whatever it is asked; and the description is complete."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import schemathesis
import uvicorn
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis import checks

from app.main import create_app
from app.settings import Settings
from core.formats import write_run
from core.run import Run

ENDLESS = ["/api/v1/jobs/events", "/api/v1/jobs/{job_id}/events"]


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a server with one run in it."""
    data: Path = tmp_path_factory.mktemp("openapi") / "data"
    app = create_app(Settings(data=data, workers=1))
    server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="error"))
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        time.sleep(0.02)
    yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    server.should_exit = True
    thread.join()


@pytest.fixture(scope="module")
def description(served: str) -> dict[str, Any]:
    found: dict[str, Any] = httpx.get(f"{served}/api/v1/openapi.json").json()
    return found


@pytest.fixture
def stored(served: str, make_run: Callable[..., Run], tmp_path: Path) -> str:
    """The id of a run, estimated."""
    write_run(make_run(), tmp_path / "lap.zip", "zip-csv")
    with httpx.Client(base_url=f"{served}/api/v1", timeout=120) as client:
        sent = (tmp_path / "lap.zip").read_bytes()
        run_id: str = client.post("/runs", params={"filename": "lap.zip"}, content=sent).json()["id"]
        while client.get("/jobs", params={"state": "active"}).json()["items"]:
            time.sleep(0.05)
    return run_id


def test_every_operation_is_described(description: dict[str, Any]) -> None:
    schema = description
    ids = []
    for path, operations in schema["paths"].items():
        for method, operation in operations.items():
            where = f"{method} {path}"
            assert operation.get("summary") and operation.get("description"), where
            assert operation.get("tags"), where
            assert "default" in operation["responses"], where
            ids.append(operation["operationId"])
            for parameter in operation.get("parameters", []):
                assert parameter["schema"], (where, parameter["name"])
    assert len(ids) == len(set(ids)) and all(i.isidentifier() for i in ids)


def test_every_type_on_the_wire_has_an_example_that_fits() -> None:
    from app.api import schemas

    named = {n: c for n, c in vars(schemas).items() if isinstance(c, type) and issubclass(c, schemas.BaseModel)}
    del named["BaseModel"]
    for name, kind in named.items():
        for example in kind.model_json_schema().get("examples", []):
            kind.model_validate(example)
        if name not in ("Wire", "Best", "MetricValue", "EstimateSummary", "TableColumn", "Series"):
            assert kind.model_json_schema().get("examples"), name


def test_operation_ids_stay(description: dict[str, Any]) -> None:
    """Clients are generated from these: a change here is a change of the interface."""
    ids = {o["operationId"] for ops in description["paths"].values() for o in ops.values()}
    assert ids >= {
        "list_runs", "list_deleted_runs", "get_run", "update_run", "delete_run", "restore_run", "upload_run",
        "create_upload", "get_upload", "append_upload", "finish_upload", "get_upload_columns", "delete_upload",
        "get_stream", "download_run", "list_mappings", "get_mapping", "put_mapping", "delete_mapping",
    }  # fmt: skip


# Threads of the server draw from `random` at any moment; hypothesis takes that for the strategies' doing.
@pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")
def test_whatever_is_asked(served: str, stored: str) -> None:
    """Generated requests to every operation: never a 5xx, always an answer that the description allows."""
    known = {"run_id": stored, "stream": "imu"}
    schema = schemathesis.openapi.from_url(f"{served}/api/v1/openapi.json").exclude(path=ENDLESS)
    wanted = [
        checks.CHECKS.get_one(name)
        for name in ("not_a_server_error", "status_code_conformance", "content_type_conformance",
                     "response_headers_conformance", "response_schema_conformance")
    ]  # fmt: skip
    seen: set[str] = set()
    for found in schema.get_all_operations():
        operation = found.ok()
        seen.add(operation.definition.raw["operationId"])

        @settings(
            max_examples=6,
            derandomize=True,
            deadline=None,
            database=None,
            phases=[Phase.explicit, Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @asked(operation)
        def ask(case: Any) -> None:
            for name in case.path_parameters or {}:
                if name in known and len(str(case.path_parameters[name])) % 2:
                    case.path_parameters[name] = known[name]  # half the time something that exists
            case.call_and_validate(checks=wanted)

        ask()
    assert len(seen) > 20


def asked(operation: Any) -> Callable[..., Any]:
    """Hypothesis' `given` for the requests of one operation."""
    return given(case=operation.as_strategy())
