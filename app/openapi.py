"""The description of the API: what every operation shares, said once."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from fastapi import FastAPI

from app.api.schemas import Problem
from app.errors import PROBLEM

VERSION = version("driftscope")
SUMMARY = "Runs of wheeled robots: store, look at, estimate, compare."
DESCRIPTION = (
    "SI units and radians throughout; `t` is seconds from the start of a run; times of day are UTC (RFC 3339). "
    "Every error has one shape, `Problem` (RFC 9457, `application/problem+json`): `detail` says what is wrong, what "
    "was expected and what was found, `where` says the same as data. A server that listens beyond its own machine asks "
    "for its token: `Authorization: Bearer ...`."
)


def install(app: FastAPI) -> None:
    """Serve the description with the shared error responses and the token in it."""
    original = app.openapi

    def described() -> dict[str, Any]:
        if app.openapi_schema is None:
            _complete(original())
        assert app.openapi_schema is not None
        return app.openapi_schema

    app.openapi = described  # type: ignore[method-assign]  # FastAPI's own way to extend it


def _complete(schema: dict[str, Any]) -> None:
    components = schema.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    schemas.pop("HTTPValidationError", None)
    schemas.pop("ValidationError", None)
    schemas["Problem"] = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    components["securitySchemes"] = {
        "token": {"type": "http", "scheme": "bearer", "description": "Only where the server has a token."}
    }
    schema["security"] = [{}, {"token": []}]
    content = {PROBLEM: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    for operations in schema.get("paths", {}).values():
        for operation in operations.values():
            responses = operation["responses"]
            for status, response in responses.items():
                if status[0] in "45":
                    response["content"] = content
            responses.setdefault("422", {"description": "Refused: the detail names what is wrong", "content": content})
            responses["default"] = {"description": "Any other error", "content": content}
