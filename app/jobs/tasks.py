"""What runs in a worker: load from the data folder, one call, plain data and array keys back. No database here.

Every task is `task(data, progress, **arguments)`; `progress(fraction, message)` tells the dashboard how far it is, and
raises CancelledError once somebody asked to stop.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from core.errors import CancelledError, DriftscopeError

log = logging.getLogger("driftscope.jobs")

Progress = Callable[[float, str], None]
REPORT_S = 0.1  # progress is told at most this often


def attempt(task: Callable[..., Any], data: str, key: str, topic: str, arguments: Mapping[str, Any]) -> Any:
    """Run one task as one attempt of a job: what the engine submits."""
    return task(Path(data), Reporter(key, topic, cancel_flag(Path(data), key)), **arguments)


def cancel_flag(data: Path, key: str) -> Path:
    """The file whose presence asks an attempt to stop; workers elsewhere see it in the shared data folder."""
    return data / "jobs" / f"{key}.cancel"


class Reporter:
    """The progress hook of one attempt."""

    def __init__(self, key: str, topic: str, flag: Path) -> None:
        self._key, self._topic, self._flag = key, topic, flag
        self._told, self._message = 0.0, ""

    def __call__(self, fraction: float, message: str = "") -> None:
        if self._flag.exists():
            raise CancelledError("cancelled on request")
        if message == self._message and time.monotonic() - self._told < REPORT_S:
            return
        from distributed import get_worker

        self._told, self._message = time.monotonic(), message
        get_worker().log_event(self._topic, {"key": self._key, "progress": float(fraction), "message": message})


def ingest(data: Path, progress: Progress, *, path: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Store an uploaded file's readings; the manifest of the run. `path` is relative to the data folder."""
    from app.ingest import IngestOptions, ingest_file

    return ingest_file(data, data / path, IngestOptions.from_plain(options), progress)


def estimate(
    data: Path,
    progress: Progress,
    *,
    manifest: Mapping[str, Any],
    methods: Sequence[str] | None,
    config: Mapping[str, Any],
) -> dict[str, Any]:
    """Estimate a stored run by each method (None: all that can run); {"estimates": [...], "failed": [...]}.

    One method's failure is told beside the others' results; it is raised where no method gave any.
    """
    from app.store import arrays
    from core.estimation.pipeline import METHODS, Estimates, available

    run = arrays.run_from_manifest(data, manifest)
    chosen = list(methods) if methods is not None else [m for m, reason in available(run).items() if reason is None]
    estimates = Estimates(run, chosen, dict(config))
    made: list[dict[str, Any]] = []
    failures: list[tuple[str, Exception]] = []
    for i, method in enumerate(chosen):
        progress(i / len(chosen), METHODS[method].label if method in METHODS else method)
        try:
            made.append(stored_estimate(data, run, estimates, method, config))
        except CancelledError:
            raise
        except Exception as error:  # a fault in one method must not take the others' results with it
            log.exception("estimating by %s failed", method)
            failures.append((method, error))
    if failures and not made:
        raise failures[0][1]
    progress(1.0, "saving")
    return {"estimates": made, "failed": [{"method": method, **_failure(error)} for method, error in failures]}


def _failure(error: Exception) -> dict[str, str]:
    if isinstance(error, DriftscopeError):
        return {"code": error.code, "detail": error.message}
    return {"code": "internal", "detail": f"{type(error).__name__}: {error}"}


def stored_estimate(data: Path, run: Any, estimates: Any, method: str, config: Mapping[str, Any]) -> dict[str, Any]:
    """One estimate of a core Run, its arrays in the data folder, the rest as plain data for `app.store.results`."""
    from app.jobs.outcome import outcome_of
    from app.store import arrays
    from app.store.provenance import code_version

    outcome = outcome_of(run, estimates.by(method), estimates.seconds[method])
    keys = {name: arrays.put(data, column) for name, column in outcome.pop("columns").items()}
    return {**outcome, "config": dict(config), "seed": 0, "arrays": keys, "code_version": code_version()}


def warm() -> float:
    """Compile, or load from the cache, what estimates need, so that the first run doesn't wait; seconds it took."""
    from app.jobs.warm import warm_up

    return warm_up()
