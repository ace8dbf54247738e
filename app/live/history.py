"""The whole run so far, thinned as it grows: what a viewer who joins late is shown. Memory stays level."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Number = float | None

SHORT = 0.1  # s of readings that become two points


class Thinned:
    """Rows of numbers, the first the stamp. Above `most` every second one goes, and from then on every second is not
    taken at all, and so on."""

    def __init__(self, width: int, most: int = 4000) -> None:
        self.columns: list[list[Number]] = [[] for _ in range(width)]
        self._most, self._every, self._skipped = most, 1, 0

    def add(self, columns: Sequence[Sequence[Number]]) -> None:
        """New rows, as columns."""
        for row in zip(*columns, strict=True):
            self._skipped += 1
            if self._skipped < self._every:
                continue
            self._skipped = 0
            for column, value in zip(self.columns, row, strict=True):
                column.append(value)
        if len(self.columns[0]) > self._most:
            self.columns = [column[::2] for column in self.columns]
            self._every *= 2


class Extremes:
    """A signal thinned so that minima and maxima stay: of each group of points its least and its greatest; groups
    double when there are too many. `fresh` gives what came since it was last asked, before it is grouped."""

    def __init__(self, most: int = 1200) -> None:
        self.points: list[tuple[float, float]] = []
        self._most, self._size = most, 2
        self._group: list[tuple[float, float]] = []
        self._fresh: list[tuple[float, float]] = []

    def add(self, t: Array, y: Array, width: float = SHORT) -> None:
        """New readings, of which each `width` s become two points; NaN is a gap."""
        for part in _short(t, width):
            points = extremes(t[part], y[part])
            self._fresh += points
            self._group += points
            while len(self._group) >= self._size:
                self.points += _ends(self._group[: self._size])
                del self._group[: self._size]
        del self._fresh[: -self._most]
        while len(self.points) > self._most:
            self._size *= 2
            points = self.points
            self.points = [p for k in range(0, len(points), 4) for p in _ends(points[k : k + 4])]

    def shown(self) -> list[tuple[float, float]]:
        """All of it, thinned."""
        return [*self.points, *self._group]

    def fresh(self) -> list[tuple[float, float]]:
        """Points since the last call."""
        fresh, self._fresh = self._fresh, []
        return fresh


def extremes(t: Array, y: Array) -> list[tuple[float, float]]:
    """The least and the greatest reading, in order of time; all of them where there are but two."""
    if len(t) <= 2:
        return list(zip(t.tolist(), y.tolist(), strict=True))
    low, high = sorted((int(y.argmin()), int(y.argmax())))
    return (
        [(float(t[low]), float(y[low])), (float(t[high]), float(y[high]))]
        if low != high
        else [(float(t[0]), float(y[0]))]
    )


def _short(t: Array, width: float) -> list[slice]:
    """Stretches of `width` s."""
    if len(t) < 3 or t[-1] - t[0] <= 2 * width:
        return [slice(0, len(t))]
    cuts = [0, *(np.flatnonzero(np.diff(np.floor(t / width))) + 1).tolist(), len(t)]
    return [slice(a, b) for a, b in itertools.pairwise(cuts)]


def _ends(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    low, high = min(points, key=_value), max(points, key=_value)
    return [low] if low == high else sorted((low, high))


def _value(point: tuple[float, float]) -> float:
    return point[1] if point[1] == point[1] else -1e300
