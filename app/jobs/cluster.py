"""The Dask side of the jobs: an embedded cluster on loopback, or a scheduler by its address. Knows no database.

Dask's wire carries pickled functions, so whoever reaches the scheduler can run code: the embedded one listens on
127.0.0.1 only; one at an address belongs on a private network, or behind TLS (`DASK_DISTRIBUTED__COMM__TLS__*`).
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import secrets
import signal
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from app.settings import Settings

log = logging.getLogger("driftscope.jobs")

CONFIG: dict[str, Any] = {
    # A task whose worker dies comes back at once: the engine counts attempts, not Dask.
    "distributed.scheduler.allowed-failures": 0,
    # No status pages, and no spilling: a worker over its limit is killed, and the job with it.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.98,
}
CONNECT_S = 10.0
CLOSE_S = 1.0
STUCK_S = 10.0


class Cluster:
    """Where tasks run. `connect` first; then `submit`, at most `room()` at a time."""

    def __init__(self, settings: Settings, on_event: Callable[[dict[str, Any]], None]) -> None:
        self._settings, self._on_event = settings, on_event
        self._client: Any = None
        self._local: Any = None
        self._busy: dict[str, str] = {}  # worker by task
        self._warming: dict[str, Any] = {}  # Dask drops a task whose future nobody holds
        self._warmed: set[str] = set()
        self._short_since: float | None = None  # since when workers are missing
        self.topic = f"driftscope-{secrets.token_hex(8)}"  # two dashboards may share one scheduler

    @property
    def connected(self) -> bool:
        """Whether tasks can be sent."""
        return self._client is not None and self._client.status == "running"

    def connect(self) -> None:
        """Start the embedded cluster, or connect to the scheduler. Raises OSError if that one doesn't answer."""
        dask: Any = importlib.import_module("dask")
        distributed: Any = importlib.import_module("distributed")  # slow to import: with the first job only
        self.close()
        self._busy.clear()
        self._short_since = None
        dask.config.set(CONFIG)
        logging.getLogger("distributed").setLevel(logging.ERROR)
        target: Any = self._settings.scheduler
        if target is None:
            target = self._local = self._start_local(distributed)
        self._client = distributed.Client(target, timeout=CONNECT_S, set_as_default=False, name="driftscope")
        self._client.subscribe_topic(self.topic, lambda event: self._on_event(event[1]))

    def _start_local(self, distributed: Any) -> Any:
        import psutil

        return distributed.LocalCluster(
            n_workers=self._settings.workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            protocol="tcp://",
            memory_limit=min(self._settings.worker_memory_bytes, int(0.75 * psutil.virtual_memory().total)),
            dashboard_address=None,
            worker_dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
            silence_logs=logging.CRITICAL,
        )

    def room(self) -> int:
        """How many tasks can start now: a thread of a worker each; none wait inside Dask."""
        free = self._free()
        if self._is_stuck(len(free)):
            log.warning("worker processes did not come back; the embedded cluster is started anew")
            self.connect()
            free = self._free()
        return len(free)

    def _is_stuck(self, free: int) -> bool:
        """Whether workers of the idle embedded cluster have been missing for STUCK_S.

        A nanny starts a dead worker again, but not reliably where that one dies while it is being started.
        """
        if self._local is None or self._busy or free >= self._settings.workers:
            self._short_since = None
            return False
        self._short_since = self._short_since or time.monotonic()
        return time.monotonic() - self._short_since > STUCK_S

    def _free(self) -> list[str]:
        """Addresses of workers with an idle thread, one entry per thread."""
        threads: dict[str, int] = self._client.nthreads() if self.connected else {}  # the client's own copy is old
        if self._local is not None:
            # A task that kills its worker before the nanny has seen that worker start would leave the nanny waiting.
            seen = {nanny.worker_address for nanny in self._local.workers.values() if _is_up(nanny)}
            threads = {address: n for address, n in threads.items() if address in seen}
        busy = Counter(self._busy.values())
        return [address for address, n in threads.items() for _ in range(n - busy[address])]

    def submit(self, key: str, function: Callable[..., Any], *args: Any, done: Callable[[Any], None]) -> Any:
        """Run `function(*args)` in a free worker; `done` is called, from another thread, once it ended in any way."""
        worker = next(iter(self._free()), None)
        where = {} if worker is None else {"workers": [worker], "allow_other_workers": True}
        future = self._client.submit(function, *args, key=key, pure=False, **where)
        if worker is not None:
            self._busy[key] = worker
        future.add_done_callback(done)
        return future

    def ended(self, key: str) -> None:
        """The task of that key has left its worker."""
        self._busy.pop(key, None)
        self._warming.pop(key, None)

    def warm(self, function: Callable[[], Any], done: Callable[[str], None]) -> None:
        """Run `function` in an idle worker that has not run it yet, if there is one; `done` is told the task's key."""
        worker = next((address for address in self._free() if address not in self._warmed), None)
        if worker is not None:
            self._warmed.add(worker)
            key = f"warm-{secrets.token_hex(4)}"
            self._busy[key] = worker
            future = self._client.submit(function, key=key, pure=False, workers=[worker], allow_other_workers=True)
            self._warming[key] = future
            future.add_done_callback(lambda _: done(key))

    def kill(self, key: str) -> None:
        """Stop a task that doesn't listen, by restarting the worker that runs it."""
        if not self.connected:
            return
        busy = {address for address, keys in self._client.processing().items() if key in keys}
        self._client.cancel([key], force=True)
        if self._local is None:
            self._client.restart_workers(list(busy), timeout=CONNECT_S, raise_for_error=False)
            return
        for nanny in self._local.workers.values():
            if nanny.worker_address in busy:
                _kill_process(nanny)  # the nanny starts another

    def close(self) -> None:
        """Disconnect; of the embedded cluster nothing is left running."""
        local, client, self._local, self._client = self._local, self._client, None, None
        if local is not None:
            # What still runs is taken up again at the next start; waiting for it would hold up the server's stop.
            for nanny in local.workers.values():
                nanny.close_gracefully()
                _kill_process(nanny)
        for each in (client, local):
            if each is not None:
                with contextlib.suppress(TimeoutError, OSError):
                    each.close(timeout=CLOSE_S)


def _is_up(nanny: Any) -> bool:
    return nanny.process is not None and nanny.process.status.name == "running"


def _kill_process(nanny: Any) -> None:
    if nanny.pid is not None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(nanny.pid, signal.SIGKILL)
