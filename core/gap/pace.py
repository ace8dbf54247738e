"""Progress inside a phase: every prediction that the search asks a world for is a moment to tell, and to be stopped at.

Nobody knows how many there will be: the share nears the phase's end by a part of what is left at each of them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from core.gap.explain import Progress
from core.gap.world import World
from core.robot import EffectSet
from core.simulation._batch_numba import Outputs

MARKS = (0.0, 0.1, 0.3, 0.55, 0.6, 0.7, 0.9, 0.92, 0.94, 0.97, 1.0)
"""Where phases begin."""
MANY = 15.0
"""After so many predictions two thirds of a phase are told."""


class Pace:
    """A progress hook whose `tick` tells of a step inside the phase; raises whatever the hook raises."""

    def __init__(self, told: Progress) -> None:
        self._told, self._at, self._end, self._message, self._count = told, 0.0, MARKS[1], "", 0

    def __call__(self, fraction: float, message: str) -> None:
        """A phase begins."""
        self._at, self._message, self._count = fraction, message, 0
        self._end = min((mark for mark in MARKS if mark > fraction + 1e-9), default=1.0)
        self._told(fraction, message)

    def tick(self) -> None:
        """One step more."""
        self._count += 1
        share = 1.0 - math.exp(-self._count / MANY)
        self._told(self._at + share * (self._end - self._at), self._message)


@dataclasses.dataclass(frozen=True)
class Watched(World):
    """A world that tells whenever it is asked for a prediction."""

    tick: Callable[[], None] = lambda: None

    def wheels(self, sets: Sequence[EffectSet]) -> dict[str, npt.NDArray[np.float64]]:
        self.tick()
        return super().wheels(sets)

    def body(self, sets: Sequence[EffectSet]) -> Outputs:
        self.tick()
        return super().body(sets)


def watched(world: World, progress: Progress) -> World:
    """The world, telling the pace of its predictions, where there is one."""
    if not isinstance(progress, Pace):
        return world
    parts = {field.name: getattr(world, field.name) for field in dataclasses.fields(World)}
    return Watched(**parts, tick=progress.tick)
