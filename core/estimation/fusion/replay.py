"""Readings that come late or out of order: the filter goes back to before the late one and walks to the present again.

The result is that of the same readings in order, to rounding: nothing is approximated. What is later than the horizon
is dropped and counted, as the filter no longer keeps a state that old.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

from core.errors import ParameterError
from core.estimation.events import Disturbances
from core.estimation.fusion.events import Events
from core.estimation.fusion.layout import OUT
from core.estimation.fusion.walk import Problem, State, flagged, tracks

Array = npt.NDArray[np.float64]

EVERY = 64  # events between two kept states


class Replay:
    """A filter for readings as they arrive. `take` them in any order, then look at `state`, `path`, `dropped`.

    horizon [s]: how late a reading may be, by the stamps of the newest one.
    """

    def __init__(self, problem: Problem, horizon: float) -> None:
        if not horizon >= 0:
            raise ParameterError("horizon must be >= 0 s", parameter="horizon", expected=">= 0", found=horizon)
        self._problem, self._horizon = problem, horizon
        nothing = np.zeros(0)
        self._events = Events(nothing, np.zeros(0, np.int64), np.zeros((0, 5)), np.zeros(0, np.int64), nothing)
        self._kept: list[tuple[int, State]] = [(0, problem.begin.copy())]
        self._state = problem.begin.copy()
        self._begin = -np.inf
        self._rows, self._covariance = np.zeros((0, 5)), np.zeros((0, 3, 3))
        self._old: list[tuple[Array, Array, Array]] = []
        self._judged: deque[tuple[Any, Array, Array]] = deque(maxlen=64)
        self.dropped = 0

    @property
    def state(self) -> State:
        """The filter at the newest reading."""
        return self._state.copy()

    def path(self) -> tuple[Array, Array, Array]:
        """Stamps (M,), rows (M, 5) of x, y, theta, bias and its variance, covariance (M, 3, 3), by all readings."""
        parts = [*self._old, (self._events.out, self._rows, self._covariance)]
        t, rows, covariance = (np.concatenate([part[i] for part in parts]) for i in range(3))
        return t, rows, covariance

    def drain(self) -> tuple[Array, Array, Array]:
        """As `path`, of the rows that no reading can change any more; they are forgotten here."""
        nothing = (np.zeros(0), np.zeros((0, 5)), np.zeros((0, 3, 3)))
        parts, self._old = [nothing, *self._old], []
        t, rows, covariance = (np.concatenate([part[i] for part in parts]) for i in range(3))
        return t, rows, covariance

    def judged(self) -> tuple[Any, Array, Array]:
        """Kind, third number and normalised innovation squared of readings that came in order since the last call."""
        parts = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0)), *self._judged]
        self._judged.clear()
        kind, third, nis = (np.concatenate([part[i] for part in parts]) for i in range(3))
        return kind, third, nis

    @property
    def constants(self) -> Array:
        """The filter's numbers, an array of `Constants`: what is changed there holds from then on."""
        return self._problem.constants

    def since(self, t: float) -> tuple[Array, Array, Array]:
        """As `path`, of the rows after `t` that can still change."""
        first = int(np.searchsorted(self._events.out, t, "right"))
        return self._events.out[first:], self._rows[first:], self._covariance[first:]

    def tell(self, known: Disturbances) -> None:
        """What befell the robot, as far as the horizon reaches back: marked, and walked to the present again."""
        events = flagged(self._events, known.dated(self._events.t))
        changed = np.flatnonzero(events.flags != self._events.flags)
        if changed.size:
            self._events = events
            self._walk_from(int(changed[0]))

    def take(self, t: Array, kind: npt.NDArray[np.int64], data: Array, flags: npt.NDArray[np.int64]) -> None:
        """Readings (K,) as `layout` describes them, in any order."""
        fresh = t > self._begin
        self.dropped += int(np.sum(~fresh))
        if not fresh.any():
            return
        if not fresh.all():
            t, kind, data, flags = t[fresh], kind[fresh], data[fresh], flags[fresh]
        old, first = self._events, float(t.min())
        late = bool(len(old.t)) and first <= old.t[-1]
        if late:
            t, kind, data, flags = (
                np.concatenate(pair)
                for pair in zip((old.t, old.kind, old.data, old.flags), (t, kind, data, flags), strict=True)
            )
        if not (t[1:] > t[:-1]).all():
            order = np.lexsort((*np.nan_to_num(data.T, nan=np.inf), kind, t))  # nothing is left to the order of arrival
            t, kind, data, flags = t[order], kind[order], data[order], flags[order]
        taken = _with(old, t, kind, data, flags, t[kind == OUT])
        if late:
            self._events = taken
            self._walk_from(int(np.searchsorted(t, first, "left")))
        else:
            self._go_on(taken)
        self._forget()

    def _go_on(self, new: Events) -> None:
        """Readings later than all that are here: on from the newest state."""
        old, state, out = self._events, self._state.copy(), tracks(new)
        before, rows, state.row = len(old.t), state.row, 0
        for at in range(0, len(new.t), EVERY):
            if before + at - self._kept[-1][0] >= EVERY:
                self._kept.append((before + at, _earlier(state.copy(), -rows)))
            self._problem.step(new, at, min(at + EVERY, len(new.t)), state, out)
        judged = out.status[:, 0] > 0
        self._judged.append((new.kind[judged], new.data[judged, 2], out.nis[judged, 0]))
        self._state = _earlier(state, -rows)
        self._rows = np.concatenate((self._rows, out.rows))
        self._covariance = np.concatenate((self._covariance, out.covariance))
        self._events = _with(
            old, np.concatenate((old.t, new.t)), np.concatenate((old.kind, new.kind)),
            np.concatenate((old.data, new.data)), np.concatenate((old.flags, new.flags)),
            np.concatenate((old.out, new.out)),
        )  # fmt: skip

    def _walk_from(self, changed: int) -> None:
        """From the last state before what has changed to the end."""
        while self._kept[-1][0] > changed:
            self._kept.pop()
        at, state = self._kept[-1][0], self._kept[-1][1].copy()
        out, end = tracks(self._events), len(self._events.t)
        out.rows[: state.row], out.covariance[: state.row] = self._rows[: state.row], self._covariance[: state.row]
        while at < end:
            stop = min(at + EVERY, end)
            self._problem.step(self._events, at, stop, state, out)
            at = stop
            if at < end:
                self._kept.append((at, state.copy()))
        self._state, self._rows, self._covariance = state, out.rows, out.covariance

    def _forget(self) -> None:
        """Drop events that no reading can come before any more."""
        cut = self._events.t[-1] - self._horizon
        index = 0
        for k, (at, _) in enumerate(self._kept):
            if at > 0 and self._events.t[at - 1] < cut:
                index = k
        if not index:
            return
        at, state = self._kept[index]
        e, row = self._events, state.row
        self._begin = float(e.t[at - 1])
        self._old.append((e.out[:row], self._rows[:row], self._covariance[:row]))
        self._rows, self._covariance = self._rows[row:], self._covariance[row:]
        self._events = _with(e, e.t[at:], e.kind[at:], e.data[at:], e.flags[at:], e.out[row:])
        self._kept = [(k - at, _earlier(s, row)) for k, s in self._kept[index:]]
        self._state = _earlier(self._state, row)


def _with(events: Events, t: Array, kind: Any, data: Array, flags: Any, out: Array) -> Events:
    """The same with other readings."""
    e = events
    return Events(t, kind, data, flags, out, e.first_offset, e.lasting, e.silence, e.notes)


def _earlier(state: State, rows: int) -> State:
    """The state, with rows counted from later on."""
    return State(state.x, state.P, state.mem, state.past, state.row - rows)
