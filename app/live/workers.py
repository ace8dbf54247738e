"""The worker processes: started when the first run comes, replaced when one dies, each run on one of them."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack

from app.live.worker import LENGTH, Message, packed

log = logging.getLogger("driftscope.live")
ROOT = Path(__file__).resolve().parents[2]
MOST_WAITING = 32 << 20  # bytes to a worker that does not read: then it is replaced


class Workers:
    """Estimation beside the event loop. `hear(message)` is called with every answer, `died(run_id)` for every run whose
    worker was lost: it is to be opened and fed anew."""

    def __init__(self, count: int, hear: Callable[[Message], None], died: Callable[[str], None]) -> None:
        self._hear, self._died = hear, died
        self._slots: list[_Worker | None] = [None] * count
        self._of: dict[str, int] = {}
        self._stopping = False
        self._starting: set[asyncio.Task[None]] = set()

    def open(self, run_id: str, run: dict[str, Any]) -> None:
        """Begin a run on the worker that has the fewest."""
        held = list(self._of.values())
        slot = self._of.setdefault(run_id, min(range(len(self._slots)), key=held.count))
        self._worker(slot).send({"op": "open", "id": run_id, "run": run})

    def feed(self, run_id: str, n: int, streams: dict[str, dict[str, Any]], names: list[str]) -> None:
        """Rows of batch n; columns as arrays."""
        slot = self._of.get(run_id)
        if slot is not None:
            raw = {s: {c: v.tobytes() for c, v in columns.items()} for s, columns in streams.items()}
            self._worker(slot).send({"op": "feed", "id": run_id, "n": n, "streams": raw, "names": names})

    def close(self, run_id: str) -> None:
        """The run is over."""
        slot = self._of.pop(run_id, None)
        if slot is not None and (worker := self._slots[slot]) is not None:
            worker.send({"op": "close", "id": run_id})

    async def stop(self) -> None:
        """End the processes."""
        self._stopping = True
        await asyncio.gather(*(w.stop() for w in self._slots if w is not None))
        for task in self._starting:
            task.cancel()

    def _worker(self, slot: int) -> _Worker:
        worker = self._slots[slot]
        if worker is None:
            worker = self._slots[slot] = _Worker()
            task = asyncio.create_task(self._serve(slot, worker))
            self._starting.add(task)
            task.add_done_callback(self._starting.discard)
        return worker

    async def _serve(self, slot: int, worker: _Worker) -> None:
        try:
            await worker.run(self._hear)
        except (OSError, asyncio.IncompleteReadError) as error:
            log.error("a worker of live runs cannot be reached: %s", error)
        finally:
            await worker.stop()
        if self._stopping:
            return
        log.error("a worker of live runs ended; its runs go on in a new one")
        self._slots[slot] = None
        for run_id in [r for r, s in self._of.items() if s == slot]:
            del self._of[run_id]
            self._died(run_id)


class _Worker:
    """One process and its pipe; what is sent before it runs is kept."""

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None
        self._waiting: list[bytes] = []

    def send(self, message: Message) -> None:
        """What is sent in one turn of the loop goes in one write."""
        self._waiting.append(packed(message))
        if len(self._waiting) == 1 and self._process is not None:
            asyncio.get_running_loop().call_soon(self._flush)

    def _flush(self) -> None:
        process, waiting, self._waiting = self._process, self._waiting, []
        if process is None or process.stdin is None or process.returncode is not None:
            return
        process.stdin.write(b"".join(waiting))
        if process.stdin.transport.get_write_buffer_size() > MOST_WAITING:
            process.kill()

    async def run(self, hear: Callable[[Message], None]) -> None:
        """Start the process and hear it until it ends."""
        path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "app.live.worker",
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, limit=1 << 24,
            env={**os.environ, "PYTHONPATH": path, "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1",
                 "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        assert self._process.stdin is not None and self._process.stdout is not None
        self._flush()
        with contextlib.suppress(asyncio.IncompleteReadError):
            while True:
                head = await self._process.stdout.readexactly(LENGTH.size)
                hear(msgpack.unpackb(await self._process.stdout.readexactly(LENGTH.unpack(head)[0])))

    async def stop(self) -> None:
        """End the process."""
        process = self._process
        if process is None or process.returncode is not None:
            return
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
