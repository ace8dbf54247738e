"""What goes over the wire, shared by all routes. SI units; times of day in UTC."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Wire(BaseModel):
    """Base of all wire types."""

    model_config = ConfigDict(from_attributes=True)


class Problem(Wire):
    """Every error of every route (RFC 9457)."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "type": "urn:driftscope:problem:format",
                    "title": "Unprocessable Content",
                    "status": 422,
                    "detail": "imu.csv: row 17, column gz: expected a number, found 'abc'",
                    "code": "format",
                    "where": {"file": "imu.csv", "stream": "imu", "row": 17, "column": "gz", "found": "abc"},
                    "instance": "/api/v1/runs",
                }
            ]
        }
    )
    type: str
    title: str
    status: int
    detail: str
    code: str = Field(description="stable slug of the kind of error")
    where: dict[str, Any] = Field(description="what the detail says, as data: file, stream, row, column, ...")
    instance: str = Field(description="the path that was asked for")
