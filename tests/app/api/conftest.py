"""One server for the tests of the API, with its worker, since that takes seconds to start."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from app.main import create_app
from app.settings import Settings
from core.formats import write_run
from core.run import Run


@pytest.fixture(scope="package")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """A started server that keeps what the tests of this folder give it."""
    settings = Settings(data=tmp_path_factory.mktemp("api") / "data", workers=1, allowed_hosts=("testserver",))
    with TestClient(create_app(settings), base_url="http://testserver", raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def zipped(make_run: Callable[..., Run]) -> Callable[..., bytes]:
    """The bytes of a zipped run folder; arguments as for `make_run`."""

    def make(*args: object, **kwargs: object) -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "run.zip"
            write_run(make_run(*args, **kwargs), path, "zip-csv")
            return io.BytesIO(path.read_bytes()).getvalue()

    return make


@pytest.fixture
def run_id(server: TestClient, zipped: Callable[..., bytes]) -> str:
    """A run that the server has: `small_run`."""
    answer = server.post("/api/v1/runs", params={"filename": "lap.zip", "robot": "mill"}, content=zipped())
    assert answer.status_code in (200, 201), answer.text
    found: str = answer.json()["id"]
    return found
