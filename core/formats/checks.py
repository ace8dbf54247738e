"""How the readers refuse: the place first, then what is wrong."""

from __future__ import annotations

from typing import NoReturn

from core.errors import FormatError

MAX_NAME_CHARS = 200


def shown(value: object, limit: int = 60) -> str:
    """A value for a message: quoted if text, cut if long, control characters escaped."""
    text = repr(value) if isinstance(value, str) else f"{value}"
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def refuse(file: str, what: str, *, kind: type[FormatError] = FormatError, **where: object) -> NoReturn:
    """Raise a FormatError whose message starts with the place (file, stream, row, column) and ends with `what`."""
    place = [file]
    if where.get("stream"):
        place.append(f"stream {where['stream']}")
    if where.get("row"):
        place.append(f"row {where['row']}")
    if where.get("column"):
        place.append(f"column {shown(where['column'])}")
    raise kind(f"{', '.join(place)}: {what}", file=file, **where)
