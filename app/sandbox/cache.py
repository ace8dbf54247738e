"""The prepared stretches that are kept in memory, least recently used first to go; and the registered simulators."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import Any

from fastapi import FastAPI
from sqlalchemy import Engine, func, select

from app.db.session import reading
from app.db.tables import Estimate, Run
from app.figures.path import of_estimate
from app.sandbox.prepared import Prepared, make_prepared
from app.settings import Settings
from app.simulators import OURS, RECORDED, registered
from app.store import beside, results, runs
from core.errors import ParameterError
from core.run import Run as CoreRun
from core.run import RunMeta
from core.simulation.foreign import Foreign, recorded
from core.simulation.scenarios import SCENARIOS

Loaded = tuple[CoreRun, tuple[str, str, Any] | None, CoreRun | None]
"""A run; method, label and columns of its best path; the simulated run that was stored beside it."""


@dataclass(frozen=True)
class Source:
    """What can be simulated: what tells it from all others, its first and last second, and how to load it."""

    key: tuple[str, ...]
    span: tuple[float, float]
    load: Callable[[], Loaded]


KEPT = 8
LONGEST_S = 1200.0
"""A longer run is simulated in stretches of this unless another one is asked for [s]."""
MOST_ROWS = 4_000_000
"""Readings of one stretch, and of all that are kept together four times as many: bounds memory and time."""


class Sandbox:
    """Prepared stretches by source and window; thread-safe. One is made once, however many ask for it."""

    def __init__(self, settings: Settings, engine: Engine) -> None:
        self._settings, self._engine = settings, engine
        self._kept: OrderedDict[tuple[str | float, ...], Prepared] = OrderedDict()
        self._lock, self._making = threading.Lock(), threading.Lock()
        self._foreign: dict[str, Foreign] | None = None

    def prepared(self, run: str | None, scenario: str | None, start: float | None, end: float | None) -> Prepared:
        """The stretch from `start` to `end` [s]. Raises NotFoundError, ParameterError, MissingStreamError."""
        source = self._source(run, scenario)
        t0, t1 = source.span
        start = t0 if start is None else min(max(start, t0), t1)
        end = min(start + LONGEST_S, t1) if end is None else min(max(end, t0), t1)
        if not end > start:
            raise ParameterError(
                f"the stretch ends at {end:g} s, before it starts", parameter="end", expected=f"> {start:g}", found=end
            )
        key: tuple[str | float, ...] = (*source.key, start, end)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        with self._making:
            with self._lock:
                if key in self._kept:
                    return self._kept[key]
            made = self._make(*source.load(), start, end, recorded=run is not None)
            with self._lock:
                self._kept[key] = made
                self._shrink()
        return made

    def meta(self, run: str | None, scenario: str | None) -> RunMeta:
        """The description of a source. Raises NotFoundError, ParameterError."""
        return self._source(run, scenario).load()[0].meta

    def foreign(self, name: str | None, one: Prepared) -> Foreign | None:
        """A registered simulator, its process kept for the next call; for `sim` what was recorded beside the run.

        None for our own. Raises ParameterError.
        """
        if name is None or name == OURS:
            return None
        if name == RECORDED:
            if one.beside is None:
                raise ParameterError(
                    "this run was stored without a simulated run beside it (a folder sim/)",
                    parameter="simulator",
                    expected=[OURS, *self.simulators()],
                    found=name,
                )
            return recorded(RECORDED, one.beside)
        simulators = self.simulators()
        if name not in simulators:
            raise ParameterError(
                f"there is no simulator {name!r}", parameter="simulator", expected=[OURS, *simulators], found=name
            )
        return simulators[name]

    def simulators(self) -> dict[str, Foreign]:
        """Those of DRIFTSCOPE_SIMULATORS, read once."""
        with self._lock:
            if self._foreign is None:
                self._foreign = registered(self._settings.simulators)
            return self._foreign

    def _make(
        self, whole: CoreRun, best: Any, aside: CoreRun | None, start: float, end: float, *, recorded: bool
    ) -> Prepared:
        t0, t1 = whole.span
        part = (start, end) != (t0, t1)
        cut = whole.crop(start, end) if part else whole
        made = aside.crop(start, end) if part and aside is not None else aside
        rows = sum(len(log) for log in cut.logs().values())
        if rows > MOST_ROWS:
            raise ParameterError(
                f"the stretch has {rows} readings; the sandbox takes up to {MOST_ROWS}: choose a shorter one",
                parameter="end",
                expected=MOST_ROWS,
                found=rows,
            )
        return make_prepared(cut, (t0, t1), recorded=recorded, best=best, beside=made)

    def _shrink(self) -> None:
        while len(self._kept) > 1 and (
            len(self._kept) > KEPT or sum(p.rows for p in self._kept.values()) > 4 * MOST_ROWS
        ):
            self._kept.popitem(last=False)

    def _source(self, run: str | None, scenario: str | None) -> Source:
        if (run is None) == (scenario is None):
            raise ParameterError("expected either a run or a scenario", parameter="run", expected="run or scenario")
        if run is not None:
            return self._stored(run)
        made = self._scenario(scenario or "")
        return Source(("scenario", scenario or ""), made.span, lambda: (made, None, None))

    def _stored(self, run_id: str) -> Source:
        """Two rows of a few columns are read with every move, the run itself only where it is not at hand."""
        columns = (Run.id, Run.name, Run.t0, Run.t1, Run.source)
        with reading(self._engine) as session:
            row = session.execute(select(*columns).where(Run.id == run_id, Run.deleted_at.is_(None))).one_or_none()
            if row is None:  # gone, or known by the id that it had while it was live
                return self._stored(runs.get_run(session, run_id).id)
            newest = session.scalar(select(func.max(Estimate.created_at)).where(Estimate.run_id == row.id))
            found: str = row.id
            key = ("run", found, row.name, str(newest), *sorted(beside.keys(row.source)))
            return Source(key, (row.t0, row.t1), lambda: self._load(found))

    def _load(self, run_id: str) -> Loaded:
        with reading(self._engine) as session:
            run = runs.load_run(session, self._settings, run_id)
            estimates = results.latest_by_method(session, run_id)
            method = next((m for m in results.PREFERENCE if m in estimates), None)
            found = of_estimate(self._settings.data, estimates[method]) if method else None
            best = (found.method, found.label, found.columns) if found else None
            return run, best, runs.load_simulated(session, self._settings, run_id)

    @staticmethod
    @functools.cache
    def _scenario(name: str) -> CoreRun:
        if name not in SCENARIOS:
            raise ParameterError(
                f"there is no scenario {name!r}", parameter="scenario", expected=list(SCENARIOS), found=name
            )
        return SCENARIOS[name].run()


@contextlib.asynccontextmanager
async def service(app: FastAPI) -> AsyncIterator[None]:
    """The application's sandbox, as `app.state.sandbox`."""
    app.state.sandbox = Sandbox(app.state.settings, app.state.engine)
    yield
