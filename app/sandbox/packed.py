"""An answer for the page in one block of bytes, so that neither side writes or reads numbers as text.

Four bytes (little-endian) with the head's length; the head, JSON in UTF-8, padded with blanks so that the numbers begin
at a multiple of eight; float64 numbers, little-endian. An array stands in the head as `{"$": [first, count, holes]}`,
`holes` 1 where it has NaN: no reading.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from pydantic_core import to_json

from app.figures.series import numbers

MEDIA = "application/octet-stream"
PLACES = 7  # of JSON: a tenth of a degree per hour, 0.1 um


def pack(answer: dict[str, Any]) -> bytes:
    """The layout above; arrays (N,) may lie at any depth."""
    blocks: list[bytes] = []
    filled = 0

    def walk(value: Any) -> Any:
        nonlocal filled
        if isinstance(value, np.ndarray):
            column = np.ascontiguousarray(value, "<f8")
            first, filled = filled, filled + len(column)
            blocks.append(column.tobytes())
            return {"$": [first, len(column), int(not np.isfinite(column).all())]}
        if isinstance(value, dict):
            return {key: walk(one) for key, one in value.items()}
        return [walk(one) for one in value] if isinstance(value, list | tuple) else value

    head = to_json(walk(answer))
    head += b" " * (-(4 + len(head)) % 8)
    return b"".join((struct.pack("<I", len(head)), head, *blocks))


def listed(value: Any) -> Any:
    """The same for JSON: lists in place of arrays, null where there is no reading."""
    if isinstance(value, np.ndarray):
        return numbers(np.round(value, PLACES) + 0.0)  # no negative zero
    if isinstance(value, dict):
        return {key: listed(one) for key, one in value.items()}
    return [listed(one) for one in value] if isinstance(value, list | tuple) else value
