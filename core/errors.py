"""The exception family: every error a caller can mend is one of these, and carries where it is as data."""

from __future__ import annotations

from collections.abc import Mapping


class DriftscopeError(Exception):
    """Root of the family. `code` is a stable slug; `where` holds what machines want to know (stream, row, ...)."""

    code = "error"

    def __init__(self, message: str, **where: object) -> None:
        super().__init__(message)
        self.message = message
        self.where: Mapping[str, object] = {k: v for k, v in where.items() if v is not None}

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.message, dict(self.where))


def _rebuild(kind: type[DriftscopeError], message: str, where: dict[str, object]) -> DriftscopeError:
    return kind(message, **where)


class FormatError(DriftscopeError):
    """A file breaks its format. `where`: file, stream, row (1 is the first data row), column, expected, found."""

    code = "format"


class StampOrderError(FormatError):
    """Stamps of a stream repeat or go back; the rest could be read in order. `where`: file, stream, row, ..."""

    code = "stamp_order"


class TooLargeError(FormatError):
    """A file, or what it unpacks to, is over a stated limit."""

    code = "too_large"


class UnknownFormatError(FormatError):
    """No reader recognises the file."""

    code = "unknown_format"


class NeedsMappingError(FormatError):
    """A table was read, but its columns must first be mapped to streams. `where['columns']` lists them."""

    code = "needs_mapping"


class ParameterError(DriftscopeError):
    """A parameter or option is unknown or out of range. `where`: parameter, expected, found."""

    code = "parameter"


class MissingStreamError(DriftscopeError):
    """The run lacks a stream, a column or a robot dimension that the method needs. `where`: method, missing."""

    code = "missing_stream"


class NotEnoughDataError(DriftscopeError):
    """The data are sound but too few to answer. `where` says what would be enough."""

    code = "not_enough_data"


class CancelledError(DriftscopeError):
    """The caller's progress hook asked to stop."""

    code = "cancelled"
