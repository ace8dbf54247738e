"""Jobs: a row in the database, started in a worker process when there is room, followed to its end.

One thread owns the cluster and moves jobs on; requests only add rows, ask and wait. A job that another process put
into the table (`driftscope import`) is found within LOOK_S. Dask gets no more tasks than it has workers, so the queue
is the table, and a worker's death takes down one job only, which is then started again, at most DEATHS times.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import queue
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Engine

from app.db.session import reading, writing
from app.errors import ConflictError, problem, problem_of
from app.jobs import tasks
from app.jobs.broadcast import Broadcast
from app.jobs.cluster import Cluster
from app.jobs.kinds import KINDS, Kind
from app.settings import Settings
from app.store import jobs
from core.errors import CancelledError, DriftscopeError

log = logging.getLogger("driftscope.jobs")

LOOK_S = 2.0  # the table is looked at this often, beside every time that something changed
SOON_S = 0.1  # while a worker comes back, or a job is being cancelled
RECONNECT_S = 5.0
WRITE_PROGRESS_S = 1.0  # progress is told at once and written this often
CANCEL_GRACE_S = 5.0  # then the worker of a job that doesn't listen is restarted
DEATHS = 3
STOP_S = 1.5


@dataclass
class Attempt:
    """A job that a worker has now."""

    job: dict[str, Any]
    kind: str
    key: str
    future: Any
    written_at: float
    kill_at: float | None = None


class JobEngine:
    """`start` once, `submit` from any thread, `stop` at the end. `events` tells what happens."""

    def __init__(self, settings: Settings, engine: Engine, kinds: Mapping[str, Kind] = KINDS) -> None:
        self._settings, self._engine, self._kinds = settings, engine, kinds
        self.events = Broadcast()
        self._cluster = Cluster(settings, self._on_event)
        self._inbox: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._attempts: dict[str, Attempt] = {}  # by job
        self._deaths: Counter[str] = Counter()
        self._stopping = threading.Event()
        self._look, self._hurry = True, False
        self._reconnect_at = 0.0
        self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)

    # -- from any thread ---------------------------------------------------------------------------------------

    def start(self) -> None:
        """Take up what a stopped server left and begin to work. The cluster starts with the first job."""
        (self._settings.data / "jobs").mkdir(parents=True, exist_ok=True)
        for flag in (self._settings.data / "jobs").glob("*.cancel"):
            flag.unlink(missing_ok=True)
        with writing(self._engine) as session:
            jobs.interrupted(session)
        self._thread.start()

    def prepare(self) -> None:
        """Start the cluster and compile ahead of the first job."""
        self._inbox.put(self._prepare)

    def stop(self) -> bool:
        """End streams, leave running jobs for the next start, close the cluster; False if that takes over STOP_S."""
        self.events.close()
        self._stopping.set()
        self._inbox.put(lambda: None)
        if self._thread.is_alive():
            self._thread.join(STOP_S)
        return not self._thread.is_alive()

    def submit(self, kind: str, run_id: str | None, params: Mapping[str, Any]) -> str:
        """Queue a job; its id."""
        if kind not in self._kinds:
            raise ValueError(f"unknown kind of job {kind!r}; there are {', '.join(self._kinds)}")
        with writing(self._engine) as session:
            job = jobs.as_dict(jobs.create(session, kind, run_id, params))
        self._changed(job)
        return str(job["id"])

    def get(self, job_id: str) -> dict[str, Any]:
        """The job as it is now (`jobs.as_dict`)."""
        with reading(self._engine) as session:
            return jobs.as_dict(jobs.get_job(session, job_id))

    def active(self) -> list[dict[str, Any]]:
        """Queued and running jobs, oldest first."""
        with reading(self._engine) as session:
            found = jobs.list_jobs(session, states=jobs.ACTIVE, limit=jobs.MAX_LISTED)
            return [jobs.as_dict(job) for job in reversed(found)]

    def cancel(self, job_id: str) -> dict[str, Any]:
        """Cancel: at once if queued, soon if running; ConflictError if it has ended."""
        with writing(self._engine) as session:
            job = jobs.get_job(session, job_id, lock=True)
            if job.state in jobs.FINISHED:
                raise ConflictError(f"job {job_id} is {job.state} already", state=job.state)
            job.cancel_requested = True
            if job.state == "queued":
                jobs.finish(job, "cancelled", "cancelled before it started")
            else:
                job.message = "cancelling"
            told = jobs.as_dict(job)
        self._inbox.put(lambda: self._ask_to_stop(job_id))
        self._changed(told)
        return told

    def retry(self, job_id: str) -> dict[str, Any]:
        """Start a failed or cancelled job again; ConflictError in any other state."""
        with writing(self._engine) as session:
            job = jobs.get_job(session, job_id, lock=True)
            jobs.reset(job)
            told = jobs.as_dict(job)
        self._inbox.put(lambda: self._deaths.__setitem__(job_id, 0))
        self._changed(told)
        return told

    async def wait(self, job_id: str) -> dict[str, Any]:
        """The job once it has ended. Raises ConflictError if the server stops before."""
        async for job in self.follow(job_id):
            if job["state"] in jobs.FINISHED:
                return job
        raise ConflictError(f"the server is stopping; job {job_id} goes on when it is back", job=job_id)

    async def follow(self, job_id: str) -> AsyncIterator[dict[str, Any]]:
        """The job now, and whenever it changes, to its end."""
        with self.events.reader() as reader:
            job = await asyncio.to_thread(self.get, job_id)
            yield job
            if job["state"] in jobs.FINISHED:
                return
            async for news in reader.news():
                if news.job["id"] == job_id:
                    yield news.job
                    if news.job["state"] in jobs.FINISHED:
                        return

    def _changed(self, job: dict[str, Any]) -> None:
        self.events.publish(job)
        self._inbox.put(self._have_a_look)

    def _on_event(self, event: dict[str, Any]) -> None:
        self._inbox.put(lambda: self._on_progress(event))

    # -- the engine's own thread -------------------------------------------------------------------------------

    def _work(self) -> None:
        while not self._stopping.is_set():
            self._safely(self._turn)
        self._safely(self._cluster.close)

    def _turn(self) -> None:
        try:
            self._inbox.get(timeout=SOON_S if self._hurry else LOOK_S)()
            with contextlib.suppress(queue.Empty):
                while not self._stopping.is_set():
                    self._inbox.get_nowait()()
        except queue.Empty:
            self._look = True
        self._kill_deaf()
        if self._look and not self._stopping.is_set():
            self._look = self._hurry = False
            self._dispatch()
        self._hurry = self._hurry or any(a.kill_at is not None for a in self._attempts.values())

    def _safely(self, step: Callable[[], None]) -> None:
        try:
            step()
        except Exception:  # a full disk or a lost scheduler must not end the thread that moves every job on
            if not self._stopping.is_set():
                log.exception("a step of the job engine failed")
            self._stopping.wait(0.5)

    def _have_a_look(self) -> None:
        self._look = True

    def _prepare(self) -> None:
        """Warm one worker after the other, so that a first upload finds the rest free."""
        if self._connect():
            self._cluster.warm(tasks.warm, lambda key: self._inbox.put(lambda: self._warmed(key)))

    def _warmed(self, key: str) -> None:
        self._cluster.ended(key)
        self._look = True
        self._prepare()

    def _connect(self) -> bool:
        if self._cluster.connected:
            return True
        if time.monotonic() < self._reconnect_at:
            return False
        try:
            self._cluster.connect()
        except OSError as error:
            log.warning("no connection to the scheduler %s: %s", self._settings.scheduler, error)
            self._reconnect_at = time.monotonic() + RECONNECT_S
            return False
        return True

    def _dispatch(self) -> None:
        """Start queued jobs while there is room."""
        with reading(self._engine) as session:
            if not jobs.next_queued(session, 1):
                return
        if not self._connect():
            return
        room = self._cluster.room()
        self._hurry = room == 0 and not self._attempts  # a worker is on its way back, or warms up
        with reading(self._engine) as session:
            waiting = [job.id for job in jobs.next_queued(session, room)] if room else []
        for job_id in waiting:
            self._start_job(job_id)

    def _start_job(self, job_id: str) -> None:
        with writing(self._engine) as session:
            job = jobs.get_job(session, job_id, lock=True)
            if job.state != "queued":
                return
            jobs.start(job)
            kind, refusal = self._kinds[job.kind], None
            try:
                arguments = kind.arguments(session, self._settings, job)
            except DriftscopeError as error:
                arguments, refusal = {}, error
            told = jobs.as_dict(job)
        if refusal is not None:
            self._end(job_id, "failed", refusal.message, problem_of(refusal))
            return
        key = f"{job.kind}-{job_id}-{job.attempt}"
        future = self._cluster.submit(
            key,
            tasks.attempt,
            kind.task,
            str(self._settings.data.resolve()),
            key,
            self._cluster.topic,
            arguments,
            done=lambda _: self._inbox.put(lambda: self._on_done(job_id, key)),
        )
        self._attempts[job_id] = Attempt(told, job.kind, key, future, time.monotonic())
        self.events.publish(told)

    def _on_progress(self, event: dict[str, Any]) -> None:
        job_id = str(event["key"]).rsplit("-", 2)[1]
        attempt = self._attempts.get(job_id)
        if attempt is None or attempt.key != event["key"] or attempt.kill_at is not None:
            return
        now = time.monotonic()
        message = str(event["message"])[: jobs.MESSAGE_LENGTH]
        attempt.job = {**attempt.job, "progress": min(max(event["progress"], 0.0), 1.0), "message": message}
        self.events.publish(attempt.job)
        if now - attempt.written_at >= WRITE_PROGRESS_S:
            attempt.written_at = now
            with writing(self._engine) as session:
                job = jobs.get_job(session, job_id, lock=True)
                job.progress, job.message = attempt.job["progress"], message

    def _ask_to_stop(self, job_id: str) -> None:
        attempt = self._attempts.get(job_id)
        if attempt is not None and attempt.kill_at is None:
            tasks.cancel_flag(self._settings.data, attempt.key).touch()
            attempt.kill_at = time.monotonic() + CANCEL_GRACE_S

    def _kill_deaf(self) -> None:
        now = time.monotonic()
        for job_id, attempt in list(self._attempts.items()):
            if attempt.kill_at is not None and now >= attempt.kill_at:
                self._forget(job_id)
                self._cluster.kill(attempt.key)
                self._end(job_id, "cancelled", "cancelled; its worker was restarted")

    def _forget(self, job_id: str) -> Attempt:
        attempt = self._attempts.pop(job_id)
        self._cluster.ended(attempt.key)
        tasks.cancel_flag(self._settings.data, attempt.key).unlink(missing_ok=True)
        self._look = True
        return attempt

    def _on_done(self, job_id: str, key: str) -> None:
        current = self._attempts.get(job_id)
        if current is None or current.key != key:
            return
        attempt = self._forget(job_id)
        status, error = attempt.future.status, None
        if status == "finished":
            try:
                self._save(job_id, self._kinds[attempt.kind], attempt.future.result())
                return
            except Exception as fault:  # whatever went wrong with saving is the job's failure, and told as such
                error = fault
        elif status == "error":
            error = attempt.future.exception()
        if error is None or type(error).__name__ == "KilledWorker":
            self._worker_died(job_id, cancelled=attempt.kill_at is not None)
        elif isinstance(error, CancelledError):
            self._end(job_id, "cancelled", "cancelled")
        else:
            self._fail(job_id, error)

    def _save(self, job_id: str, kind: Kind, made: Any) -> None:
        with writing(self._engine) as session:
            job = jobs.get_job(session, job_id, lock=True)
            saved = kind.save(session, self._settings, job, made)
            job.run_id = saved.run_id
            jobs.finish(job, "done", saved.message, result=saved.result)
            told = [jobs.as_dict(j) for j in (*saved.follow, job)]
        for each in told:
            self.events.publish(each)

    def _worker_died(self, job_id: str, *, cancelled: bool) -> None:
        self._deaths[job_id] += 1
        if cancelled:
            self._end(job_id, "cancelled", "cancelled; its worker was gone")
        elif self._deaths[job_id] < DEATHS:
            with writing(self._engine) as session:
                job = jobs.get_job(session, job_id, lock=True)
                jobs.requeue(job, f"its worker died in attempt {job.attempt}; queued again")
                told = jobs.as_dict(job)
            self.events.publish(told)
        else:
            detail = f"the worker died {DEATHS} times while it ran this job (out of memory?); it is not tried again"
            self._end(job_id, "failed", detail, problem(500, detail, code="worker_died", where={"deaths": DEATHS}))

    def _fail(self, job_id: str, error: BaseException) -> None:
        shape = problem_of(error)
        if shape["code"] == "internal":
            log.error("job %s failed", job_id, exc_info=error)
            name = "out of memory" if isinstance(error, MemoryError) else f"internal error ({type(error).__name__})"
            shape["detail"] = f"the job failed: {name}; the server's log says more"
        self._end(job_id, "failed", shape["detail"], shape)

    def _end(self, job_id: str, state: str, message: str, error: dict[str, Any] | None = None) -> None:
        with writing(self._engine) as session:
            job = jobs.get_job(session, job_id, lock=True)
            jobs.finish(job, state, message, error=error)
            told = jobs.as_dict(job)
        self.events.publish(told)
