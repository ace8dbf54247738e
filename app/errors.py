"""Every error of every route in one shape: problem+json (RFC 9457), or an error page for a browser."""

from __future__ import annotations

import errno
import logging
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from core import errors as core_errors

log = logging.getLogger("driftscope")
PROBLEM = "application/problem+json"


class NotFoundError(core_errors.DriftscopeError):
    """What the address names doesn't exist. `where`: what, id."""

    code = "not_found"


class ConflictError(core_errors.DriftscopeError):
    """The state of what is asked for doesn't allow it. `where` says what state it is in."""

    code = "conflict"


class UnauthorizedError(core_errors.DriftscopeError):
    """No token, or a wrong one."""

    code = "unauthorized"


class ForbiddenError(core_errors.DriftscopeError):
    """The request comes from a foreign origin or host."""

    code = "forbidden"


class DiskFullError(core_errors.DriftscopeError):
    """The data folder has no room for what was sent. `where`: needed_bytes, free_bytes."""

    code = "disk_full"


STATUS: tuple[tuple[type[core_errors.DriftscopeError], int], ...] = (
    (NotFoundError, 404),
    (ConflictError, 409),
    (UnauthorizedError, 401),
    (ForbiddenError, 403),
    (DiskFullError, 507),
    (core_errors.TooLargeError, 413),
    (core_errors.CancelledError, 409),
    (core_errors.DriftscopeError, 422),
)
_CODES = {404: "not_found", 405: "method_not_allowed", 409: "conflict", 413: "too_large", 415: "unsupported_media_type"}


def status_of(error: core_errors.DriftscopeError) -> int:
    """The HTTP status that an error of the family is answered with."""
    return next(status for kind, status in STATUS if isinstance(error, kind))


def problem(
    status: int, detail: str, *, code: str, where: Mapping[str, object] | None = None, instance: str = ""
) -> dict[str, Any]:
    """The error's shape on the wire (`app.api.schemas.Problem`); also what a failed job keeps as its error."""
    return {
        "type": f"urn:driftscope:problem:{code}",
        "title": _phrase(status),
        "status": status,
        "detail": detail,
        "code": code,
        "where": plain(dict(where or {})),
        "instance": instance,
    }


def problem_of(error: BaseException, instance: str = "") -> dict[str, Any]:
    """The problem for any exception; what isn't ours or the disk's becomes a 500 that tells nothing of the inside."""
    if isinstance(error, core_errors.DriftscopeError):
        return problem(status_of(error), error.message, code=error.code, where=error.where, instance=instance)
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        detail = "the disk that holds the data folder is full; nothing was stored"
        return problem(507, detail, code="disk_full", instance=instance)
    return problem(500, "the server failed on this request; its log says why", code="internal", instance=instance)


def plain(value: object) -> Any:
    """`where` data as plain JSON: numpy scalars, tuples, paths and the like become numbers, lists and text."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else str(value)
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in value]
    if hasattr(value, "item") and getattr(value, "shape", None) == ():
        return plain(value.item())
    return str(value)


def install(app: FastAPI) -> None:
    """Register the handlers."""
    for kind in (core_errors.DriftscopeError, OSError, HTTPException, RequestValidationError, ClientDisconnect):
        app.add_exception_handler(kind, _handle)
    app.add_exception_handler(Exception, _handle)


async def _handle(request: Request, error: Exception) -> Response:
    if isinstance(error, ClientDisconnect):
        return Response(status_code=499)  # nobody listens
    headers: dict[str, str] = {}
    if isinstance(error, RequestValidationError):
        body = _of_validation(error, request.url.path)
    elif isinstance(error, HTTPException):
        code = _CODES.get(error.status_code, _phrase(error.status_code).lower().replace(" ", "_"))
        detail = error.detail if error.detail != _phrase(error.status_code) else _http_detail(error, request)
        body = problem(error.status_code, detail, code=code, instance=request.url.path)
        headers.update(error.headers or {})
    else:
        body = problem_of(error, request.url.path)
        if body["status"] == 500:
            log.error("request failed: %s %s", request.method, request.url.path, exc_info=error)
    return response(request, body, headers)


def response(request: Request, body: dict[str, Any], headers: Mapping[str, str] | None = None) -> Response:
    """A problem as the asker can read it."""
    status, given = body["status"], dict(headers or {})
    if status == 401:
        given.setdefault("WWW-Authenticate", 'Bearer realm="driftscope"')
    if wants_page(request):
        from app.pages.base import error_page  # pages stand on the store, and the store on these errors

        page = error_page(request, status, body["title"], body["detail"], body["code"], body["where"])
        page.headers.update(given)
        return page
    return JSONResponse(body, status, headers=given, media_type=PROBLEM)


def wants_page(request: Request) -> bool:
    """Whether a browser asks for a page (and not for data)."""
    path = request.url.path
    return (
        not path.startswith(("/api/", "/static/"))
        and not path.endswith(".json")
        and "text/html" in request.headers.get("accept", "")
    )


def _http_detail(error: HTTPException, request: Request) -> str:
    if error.status_code == 404:
        return f"there is nothing at {request.url.path}"
    if error.status_code == 405:
        return f"{request.method} is not possible at {request.url.path}"
    return error.detail


def _of_validation(error: RequestValidationError, instance: str) -> dict[str, Any]:
    first = error.errors()[0]
    place = [str(p) for p in first["loc"]]
    name = ".".join(place[1:]) or place[0]
    where = {"in": place[0], "parameter": name, "expected": first["msg"], "found": str(first.get("input"))[:200]}
    detail = f"{place[0]} {name}: {first['msg']}" if name != place[0] else f"{name}: {first['msg']}"
    others = len(error.errors()) - 1
    return problem(
        422,
        detail + (f" (and {others} more)" if others else ""),
        code="parameter",
        where=where,
        instance=instance,
    )


def _phrase(status: int) -> str:
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return "Error"
