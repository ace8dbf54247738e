"""What every sensor log shares: stamps, columns by name, cropping, and the spec that readers and plots go by."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from core import timing
from core.errors import FormatError

Floats = npt.NDArray[np.floating]
Stamps = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Column:
    """One column of a stream: its name in files, SI unit, and what it is in words."""

    name: str
    unit: str
    label: str
    required: bool = True


@dataclass(frozen=True)
class Log:
    """Readings of one sensor: `t` (N,) float64 [s], strictly increasing; every other column (N,) or None.

    Subclasses add the columns. Lengths are checked here; stamps and values once, where data enter (`core.formats`).
    """

    t: Stamps

    def __post_init__(self) -> None:
        for name, column in self.columns().items():
            if column.shape != self.t.shape:
                raise FormatError(
                    f"column {name} has {column.shape} values where t has {self.t.shape}",
                    column=name,
                    expected=self.t.shape,
                    found=column.shape,
                )

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def columns(self) -> dict[str, npt.NDArray[np.generic]]:
        """Present columns by name, `t` first; text columns as their integer codes."""
        names = self.__dataclass_fields__  # `dataclasses.fields` is slow, and live runs ask often
        return {name: value for name in names if isinstance(value := getattr(self, name), np.ndarray)}

    def crop(self, t0: float, t1: float) -> Self:
        """The readings with t0 <= t <= t1 (views, nothing is copied)."""
        a, b = np.searchsorted(self.t, t0, "left"), np.searchsorted(self.t, t1, "right")
        cropped: dict[str, Any] = {k: v[a:b] for k, v in self.columns().items()}
        return dataclasses.replace(self, **cropped)

    @property
    def rate(self) -> float:
        """Typical sampling rate [Hz], robust against jitter, rounding and pauses; 0 with fewer than two readings."""
        return timing.rate(self.t)


@dataclass(frozen=True)
class StreamSpec:
    """One stream of the run format: its columns, and the class that holds them."""

    name: str
    label: str
    columns: tuple[Column, ...]
    log: type[Log]
    at_least_one_of: tuple[str, ...] = ()
    text_columns: tuple[str, ...] = ()

    def column(self, name: str) -> Column:
        """The column of that name; KeyError if the stream has none."""
        return next(c for c in self.columns if c.name == name)
