"""How kernels are compiled where every nanosecond counts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def uncounted(**options: Any) -> Callable[[F], F]:
    """numba's `njit(**options)` without its runtime, for the function and all that it calls.

    numba counts who holds an array, atomically, whenever a row or a field is taken; in a filter's step that is half of
    the time. Such a function can make no array (numpy's constructors do not compile): scratch is the caller's.
    """
    compiled: Any = njit  # its stubs do not know the option
    made: Callable[[F], F] = compiled(_nrt=False, **options)
    return made
