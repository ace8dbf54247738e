"""All live runs of this server: who is connected, what is on disk, who watches, who drives, what has ended.

Runs on the event loop; what waits for a disk or the database goes to threads, what computes to the workers. A run that
was live when the server died is there again after its start: its robot goes on with it, or it ends by the time-out.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import secrets
import shutil
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from sqlalchemy import Engine

from app.db.session import reading, writing
from app.errors import ConflictError, NotFoundError
from app.live import log as logs
from app.live.feed import encoded
from app.live.messages import LIMITS, CheckedHello
from app.live.protocol import PROTOCOL, UPDATE_HZ, Ack, Error, Gone, LiveRobot, Welcome
from app.live.robot import Connection, Robot
from app.live.run import LiveRun, said_in
from app.live.tap import LiveFeed
from app.live.workers import Workers
from app.settings import Settings
from app.store import live as store

log = logging.getLogger("driftscope.live")

QUIET_S = 5.0  # without a word for so long a robot is silent
SILENCE_S = 120.0  # a robot that is silent for so long has ended its run
GROW_S = 2.0  # between two looks of the store at a run that grows
GROW_TOGETHER = 8  # runs in one transaction
SWEEP_S = 1.0
HEARTBEAT_S = 1.0  # viewers hear so often how the connection is, whatever robot and workers do
LOOK_S = 0.5  # between two looks whether a run is stored
MOST_ROBOTS = 200


class NameTakenError(ConflictError):
    """Another robot streams under this name."""

    code = "name_taken"


class Hub:
    """The service behind `app.state.live`."""

    def __init__(self, settings: Settings, engine: Engine, submit: Callable[[str], str]) -> None:
        self.settings, self._engine, self._submit = settings, engine, submit
        self._robots: dict[str, Robot] = {}
        self._runs: dict[str, LiveRun] = {}
        self._writer = logs.Writer()
        self._workers = Workers(max(1, min(2, os.cpu_count() or 2)), self._estimated, self._worker_died)
        self._tasks: set[asyncio.Task[None]] = set()
        self._loop = asyncio.get_running_loop()
        self._written: deque[Callable[[], None]] = deque()  # told by the log's thread, not yet on the loop
        self._telling = False
        self._changed: dict[str, float] = {}  # runs that have grown, and when the store looked at them last

    # ------------------------------------------------------------------------------------------------ robots

    async def join(self, name: str, said: CheckedHello, connection: Connection | None) -> tuple[Robot, Welcome]:
        """A robot says Hello: its run goes on, or a new one begins. NameTakenError, ConflictError (too many)."""
        robot = self.robot(name)
        run = robot.run
        if run is not None and run.said.session != said.session:
            if robot.connection is not None:
                raise NameTakenError(
                    f"another robot streams as {name!r}: end its run, or choose another name", what="robot", id=name
                )
            await self.end(robot)
            run = None
        if run is None:
            if len(self._runs) >= MOST_ROBOTS:
                raise ConflictError(f"{MOST_ROBOTS} robots are live already", what="robots", found=len(self._runs))
            run = await self._begin(robot, said)
        if robot.connection is not None and connection is not None:
            detail = "the same session came again from elsewhere"
            robot.connection.close(Error(type="error", code="replaced", detail=detail, where={}))
        robot.connection = connection
        robot.state = "live"
        run.gauge.last_heard = time.time()
        drive = robot.drive
        drive.obeys, drive.virtual, drive.limits = said.drive, said.virtual, said.limits
        drive.connected = connection is not None
        robot.tell_driver()
        return robot, self._welcome(robot, run)

    def _welcome(self, robot: Robot, run: LiveRun) -> Welcome:
        return Welcome(
            type="welcome", protocol=PROTOCOL, run_id=run.id, next=run.next, limits=LIMITS,
            drive=robot.drive.reason is None, at=time.time(),
        )  # fmt: skip

    def leave(self, robot: Robot, connection: Connection) -> None:
        """The connection is gone; the run waits for it."""
        if robot.connection is connection:
            robot.connection = None
            robot.drive.connected = False
            robot.drive.driver = None
            robot.state = "silent"
            if robot.run is not None:
                robot.run.feed.changed = True
            robot.tell_driver()

    def sink(self, run: LiveRun) -> Callable[[int, dict[str, dict[str, Any]], list[str]], None]:
        """Where the rows of a run go."""

        def feed(n: int, streams: dict[str, dict[str, Any]], names: list[str]) -> None:
            self._changed.setdefault(run.id, 0.0)
            self._workers.feed(run.id, n, streams, names)

        return feed

    def acknowledge(
        self, run: LiveRun, answer: Callable[[OSError | None], None]
    ) -> Callable[[int, OSError | None], None]:
        """What the log's thread calls once a batch is on disk, or could not be written."""

        def done(n: int, error: OSError | None) -> None:
            def on_loop() -> None:
                if error is None:
                    run.durable = max(run.durable, n)
                answer(error)

            self._written.append(on_loop)
            if not self._telling:  # one call for all that come before it
                self._telling = True
                self.on_loop(self._tell_written)

        return done

    def _tell_written(self) -> None:
        self._telling = False  # first: what comes from now on calls again
        while self._written:
            self._written.popleft()()

    @staticmethod
    def ack(run: LiveRun) -> Ack:
        """How far the run is on disk."""
        return Ack(type="ack", n=run.durable, at=time.time())

    def robot(self, name: str) -> Robot:
        """The robot of that name, whether it has ever come or not."""
        found = self._robots.get(name)
        if found is None:
            found = self._robots[name] = Robot(name, self.settings.drive, self.sink)
        return found

    def forget_idle(self, robot: Robot) -> None:
        """Keep no name that nobody streams or watches."""
        if robot.run is None and not robot.viewers and robot.connection is None:
            self._robots.pop(robot.name, None)

    def robots(self) -> list[LiveRobot]:
        """Those with a live run, as `GET /api/v1/live` lists them."""
        return [robot.listed(robot.run) for robot in self._robots.values() if robot.run is not None]

    def on_loop(self, call: Callable[[], None]) -> None:
        """Call from any thread what touches robots and viewers."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(call)

    def feed(self, run_id: str) -> LiveFeed | None:
        """A run that still goes on, for one who watches inside the server; None for any other."""
        run = self._runs.get(run_id)
        robot = self._robots.get(run.robot) if run is not None else None
        return LiveFeed(robot, run, self.on_loop, self.forget_idle) if robot is not None and run is not None else None

    def known(self, name: str) -> Robot:
        """The robot of that name that has a live run; NotFoundError."""
        robot = self._robots.get(name)
        if robot is None or robot.run is None:
            raise NotFoundError(f"no robot {name!r} is live", what="robot", id=name)
        return robot

    # -------------------------------------------------------------------------------------------------- runs

    async def _begin(self, robot: Robot, said: CheckedHello) -> LiveRun:
        run_id = secrets.token_hex(8)
        run = await asyncio.to_thread(self._make, run_id, robot.name, said)
        if robot.run is not None:  # the same Hello came twice at once
            return robot.run
        self._adopt(robot, run)
        for viewer in robot.viewers:
            viewer.tell(robot.snapshot(viewer))
        return run

    def _make(self, run_id: str, robot: str, said: CheckedHello) -> LiveRun:
        """On disk before it is answered: the log with the Hello, and the row."""
        run = LiveRun(self.settings.data, run_id, robot, said)
        run.log = logs.Log(run.path, self._writer)
        run.log.write(logs.record(logs.HELLO, json.dumps({"robot": robot, "hello": said.message()}).encode()))
        with writing(self._engine) as session:
            store.begin(session, run_id, robot, said.session, said.run, virtual=said.virtual)
        return run

    def _adopt(self, robot: Robot, run: LiveRun) -> None:
        robot.run, robot.state = run, "silent"
        self._runs[run.id] = run
        self._workers.open(run.id, run.said.run)

    async def end(self, robot: Robot) -> None:
        """The run is over: everything to disk, then an ordinary job stores it."""
        run = robot.run
        if run is None:
            return
        robot.drive.stop()
        robot.run, robot.state = None, "ended"
        run.ended = True
        self._runs.pop(run.id, None)
        self._changed.pop(run.id, None)
        self._workers.close(run.id)
        robot.drive.obeys = robot.drive.connected = False
        robot.drive.driver = None
        for viewer in robot.viewers:
            viewer.tell(Gone(type="gone", run_id=run.id, stored_as=None))
        await asyncio.to_thread(self._close, run)
        self._keep(self._follow(robot, run.id))

    def _close(self, run: LiveRun) -> None:
        if run.log is not None:
            run.log.finish(logs.END)
            run.log = None
        self._grow(run)
        with writing(self._engine) as session:
            store.end(session, run.id)

    async def _follow(self, robot: Robot, run_id: str) -> None:
        """Submit the job that stores the run, and tell who watches what it became."""
        await asyncio.to_thread(self._submit_once, run_id)
        final = await self._final(run_id)
        for viewer in robot.viewers:
            viewer.tell(Gone(type="gone", run_id=run_id, stored_as=final))
        self.forget_idle(robot)

    def _submit_once(self, run_id: str) -> None:
        with reading(self._engine) as session:
            if store.being_stored(session, run_id):
                return
        job = self._submit(run_id)
        with writing(self._engine) as session:
            store.set_job(session, run_id, job)

    async def _final(self, run_id: str) -> str | None:
        """What the run became, once it is stored."""
        while True:
            stored, final = await asyncio.to_thread(self._look, run_id)
            if stored:
                return final
            await asyncio.sleep(LOOK_S)

    def _look(self, run_id: str) -> tuple[bool, str | None]:
        with reading(self._engine) as session:
            row = store.get(session, run_id)
            if row is not None and row.state != store.STORED:
                return False, None
        self.clear(run_id)
        return True, row.run_id if row is not None else None

    def clear(self, run_id: str) -> None:
        """What the run's growth has left on disk, once it is stored."""
        shutil.rmtree(self.settings.data / "live" / run_id, ignore_errors=True)

    def _grow(self, *runs: LiveRun) -> None:
        """The store sees the runs as they are by now, in one transaction."""
        seen = [(run.id, run.columns.flush(), run.columns.sparkline(run.said.meta.robot)) for run in runs]
        with writing(self._engine) as session:
            for run_id, streams, path in seen:
                store.grow(session, run_id, streams, path)

    def recover(self) -> None:
        """Runs that were live when the server ended: made again from their logs."""
        with reading(self._engine) as session:
            rows = [(row.id, row.robot, row.state, row.started_at) for row in store.unfinished(session)]
        for run_id, name, state, began in rows:
            self._recover(run_id, name, state, began.timestamp())
        root = self.settings.data / "live"
        for folder in root.iterdir() if root.is_dir() else ():
            if folder.name not in {row[0] for row in rows}:
                shutil.rmtree(folder, ignore_errors=True)

    def _recover(self, run_id: str, name: str, state: str, began: float) -> None:
        path = self.settings.data / "live" / run_id / "log"
        found = said_in(path) if path.exists() else None
        if found is None or state != store.LIVE:
            self._keep(self._follow(self.robot(name), run_id))
            return
        robot = self.robot(name)
        shutil.rmtree(self.settings.data / "live" / run_id / "columns", ignore_errors=True)
        run = LiveRun(self.settings.data, run_id, name, found[1])
        run.started = began
        self._workers.open(run_id, run.said.run)
        run.replay(self.sink(run))
        run.gauge.last_heard = time.time()
        if run.ended or robot.run is not None:
            self._keep(self._end_recovered(robot, run))
            return
        run.log = logs.Log(path, self._writer)
        robot.run, robot.state = run, "silent"
        self._runs[run_id] = run

    async def _end_recovered(self, robot: Robot, run: LiveRun) -> None:
        self._workers.close(run.id)
        await asyncio.to_thread(self._close, run)
        await self._follow(robot, run.id)

    # -------------------------------------------------------------------------------------------- estimation

    def _estimated(self, made: dict[str, Any]) -> None:
        run = self._runs.get(made["id"])
        if run is None:
            return
        if "error" in made:
            log.error("estimating the live run %s failed: %s", run.id, made["error"])
            return
        run.gauge.estimated(time.time(), made["n"])
        run.feed.take_estimate(made)

    def _worker_died(self, run_id: str) -> None:
        run = self._runs.get(run_id)
        if run is None:
            return
        run.gauge.forget_backlog()
        self._workers.open(run_id, run.said.run)
        streams = {s: dict(c) for s, c in run.rows_so_far().items()}
        if streams:
            self._workers.feed(run_id, run.next - 1, streams, run.columns.names)

    # ------------------------------------------------------------------------------------------- beside all

    def start(self) -> None:
        """Recover, then look after everything."""
        self.recover()
        self._keep(self._tick())
        self._keep(self._sweep())

    def _keep(self, work: Any) -> None:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _tick(self) -> None:
        """Updates to who watches."""
        while True:
            await asyncio.sleep(1.0 / UPDATE_HZ)
            now = time.time()
            for robot in list(self._robots.values()):
                robot.drive.watch(now)
                if robot.run is None:
                    continue
                robot.run.feed.watched = bool(robot.viewers)
                if robot.run.feed.changed or now - robot.told > HEARTBEAT_S:
                    self._update(robot, robot.run, now)

    @staticmethod
    def _update(robot: Robot, run: LiveRun, now: float) -> None:
        robot.told = now
        message = run.feed.update(robot.state, run.gauge.read(now)) if robot.viewers else None
        if message is None:
            return
        frames: dict[bool, str | bytes] = {}
        for viewer in robot.viewers:
            if viewer.binary not in frames:
                frames[viewer.binary] = encoded(message, viewer.binary)
            viewer.post(frames[viewer.binary])

    async def _sweep(self) -> None:
        """The store's look at growing runs, and the end of silent ones."""
        while True:
            await asyncio.sleep(SWEEP_S)
            now = time.time()
            for robot in list(self._robots.values()):
                run = robot.run
                if run is not None and robot.connection is None and now - run.gauge.last_heard > QUIET_S:
                    robot.state = "silent"  # one that posts its rows has no connection to lose
                if run is not None and robot.connection is None and now - run.gauge.last_heard > SILENCE_S:
                    await self.end(robot)
            period = max(GROW_S, 0.2 * len(self._runs))
            due = [r for r, looked in self._changed.items() if now - looked > period and r in self._runs]
            for some in (due[k : k + GROW_TOGETHER] for k in range(0, len(due), GROW_TOGETHER)):
                self._changed.update(dict.fromkeys(some, now))
                with contextlib.suppress(OSError):
                    await asyncio.to_thread(self._grow, *(self._runs[r] for r in some if r in self._runs))

    async def stop(self) -> None:
        """Leave the runs as they are: they go on after the next start."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._workers.stop()
        for run in self._runs.values():
            with contextlib.suppress(OSError):
                await asyncio.to_thread(self._grow, run)
        await asyncio.to_thread(self._writer.stop)
        for run in self._runs.values():
            if run.log is not None:
                run.log.close()
