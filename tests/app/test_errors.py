"""One shape for every error; nothing of the inside gets out."""

from __future__ import annotations

import errno
import json

import numpy as np
import pytest
from fastapi import FastAPI, Request
from fastapi.testclient import TestClient

from app import errors
from app.errors import plain, problem_of
from core import errors as core_errors

SHAPE = {"type", "title", "status", "detail", "code", "where", "instance"}
FAMILY = [
    (core_errors.FormatError("bad", row=3), 422, "format"),
    (core_errors.StampOrderError("back", row=3), 422, "stamp_order"),
    (core_errors.TooLargeError("big"), 413, "too_large"),
    (core_errors.UnknownFormatError("what"), 422, "unknown_format"),
    (core_errors.NeedsMappingError("map", columns=["a"]), 422, "needs_mapping"),
    (core_errors.ParameterError("p"), 422, "parameter"),
    (core_errors.MissingStreamError("m"), 422, "missing_stream"),
    (core_errors.NotEnoughDataError("n"), 422, "not_enough_data"),
    (core_errors.CancelledError("c"), 409, "cancelled"),
    (errors.NotFoundError("n"), 404, "not_found"),
    (errors.ConflictError("c"), 409, "conflict"),
    (errors.UnauthorizedError("u"), 401, "unauthorized"),
    (errors.ForbiddenError("f"), 403, "forbidden"),
    (errors.DiskFullError("d"), 507, "disk_full"),
    (OSError(errno.ENOSPC, "No space left on device", "/secret/path"), 507, "disk_full"),
    (PermissionError(13, "denied", "/secret/path"), 500, "internal"),
    (ZeroDivisionError("secret sum"), 500, "internal"),
]


@pytest.mark.parametrize(("error", "status", "code"), FAMILY, ids=[type(f[0]).__name__ for f in FAMILY])
def test_every_error_has_its_status(error: Exception, status: int, code: str) -> None:
    app = FastAPI()
    errors.install(app)

    @app.get("/api/v1/fail")
    def fail() -> None:
        raise error

    answer = TestClient(app, raise_server_exceptions=False).get("/api/v1/fail")
    body = answer.json()
    assert answer.status_code == body["status"] == status and body["code"] == code
    assert answer.headers["content-type"] == errors.PROBLEM
    assert set(body) == SHAPE and body["instance"] == "/api/v1/fail"
    assert "secret" not in answer.text


def test_every_error_of_the_library_is_known() -> None:
    family = {c for c in vars(core_errors).values() if isinstance(c, type) and c.__module__ == core_errors.__name__}
    tried = {type(error) for error, _, _ in FAMILY}
    assert family - {core_errors.DriftscopeError} <= tried


def test_where_is_plain_json() -> None:
    where = {
        "row": np.int64(3), "value": np.float32(0.5), "nan": float("nan"), "range": (1, 2), "names": {"a"},
        "none": None, 5: object, "nested": {"x": [np.bool_(True)]},
    }  # fmt: skip
    assert json.loads(json.dumps(plain(where), allow_nan=False)) == {
        "row": 3, "value": 0.5, "nan": "nan", "range": [1, 2], "names": ["a"], "none": None,
        "5": "<class 'object'>", "nested": {"x": [True]},
    }  # fmt: skip


def test_a_failed_job_keeps_the_same_shape() -> None:
    assert set(problem_of(core_errors.FormatError("bad"))) == SHAPE


def test_browsers_get_a_page(client: TestClient) -> None:
    answer = client.get("/runs/none", headers={"Accept": "text/html,*/*"})
    assert answer.status_code == 404 and answer.headers["content-type"].startswith("text/html")
    assert "<h1" in answer.text or "verdict" in answer.text


def test_a_page_that_fails_tells_nothing(app: FastAPI) -> None:
    @app.get("/boom")
    def boom(request: Request) -> None:
        raise ZeroDivisionError("secret sum")

    with TestClient(app, raise_server_exceptions=False) as client:
        answer = client.get("/boom", headers={"Accept": "text/html"})
    assert answer.status_code == 500 and "secret" not in answer.text
    assert answer.headers["content-type"].startswith("text/html")
