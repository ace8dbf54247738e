"""Jobs through the engine's door, on real worker processes: progress, cancel, retry, deaths, restarts."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from job_kinds import KINDS, database, read_pid, until

from app.db.session import writing
from app.errors import ConflictError, NotFoundError
from app.jobs import engine as engine_module
from app.jobs.engine import JobEngine
from app.settings import Settings
from app.store import jobs as store


def history(engine: JobEngine, job_id: str) -> list[dict[str, Any]]:
    """All that a reader hears of a job, to its end."""

    async def listen() -> list[dict[str, Any]]:
        return [job async for job in engine.follow(job_id)]

    return asyncio.run(asyncio.wait_for(listen(), 60))


def test_progress_is_told_in_order_to_the_end(jobs: JobEngine) -> None:
    told = history(jobs, jobs.submit("nap", None, {"seconds": 0.6}))
    states = [job["state"] for job in told]
    assert states == sorted(states, key=["queued", "running", "done"].index)
    assert states[-1] == "done"
    progress = [job["progress"] for job in told]
    assert progress == sorted(progress)
    assert any(0 < p < 1 for p in progress)
    assert told[-1]["result"] == {"slept": 0.6}
    assert told[-1]["attempt"] == 1
    assert told[-1]["started_at"] <= told[-1]["finished_at"]


def test_what_is_told_is_what_is_stored(jobs: JobEngine) -> None:
    job_id = jobs.submit("nap", None, {"seconds": 0.02})
    assert history(jobs, job_id)[-1] == jobs.get(job_id)


def test_a_queued_job_is_cancelled_at_once(jobs: JobEngine, pid_file: Path) -> None:
    first = jobs.submit("nap", None, {"seconds": 20})
    read_pid(pid_file)
    waiting = jobs.submit("nap", None, {"seconds": 20})
    assert jobs.get(waiting)["state"] == "queued"
    assert jobs.cancel(waiting)["state"] == "cancelled"
    jobs.cancel(first)
    ended = until(jobs, first, "cancelled")
    assert ended["progress"] < 1
    assert jobs.get(waiting)["attempt"] == 0


def test_a_running_job_hears_of_its_cancellation(jobs: JobEngine, pid_file: Path) -> None:
    job_id = jobs.submit("nap", None, {"seconds": 60})
    pid = read_pid(pid_file)
    assert jobs.cancel(job_id)["message"] == "cancelling"
    ended = until(jobs, job_id, "cancelled")
    assert ended["message"] == "cancelled"
    os.kill(pid, 0)  # its worker lives on
    assert not list(pid_file.parent.glob("jobs/*"))
    with pytest.raises(ConflictError, match="cancelled already"):
        jobs.cancel(job_id)


def test_a_deaf_job_is_cancelled_with_its_worker(
    jobs: JobEngine, pid_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine_module, "CANCEL_GRACE_S", 0.2)
    job_id = jobs.submit("deaf", None, {"seconds": 120})
    pid = read_pid(pid_file)
    jobs.cancel(job_id)
    assert until(jobs, job_id, "cancelled")["message"] == "cancelled; its worker was restarted"
    with pytest.raises(ProcessLookupError):
        for _ in range(500):
            os.kill(pid, 0)
            os.sched_yield()
            asyncio.run(asyncio.sleep(0.02))
    assert until(jobs, jobs.submit("nap", None, {"seconds": 0.02}), "done")["attempt"] == 1


def test_a_cancelled_job_can_be_started_again(jobs: JobEngine, pid_file: Path) -> None:
    job_id = jobs.submit("nap", None, {"seconds": 0.5})
    read_pid(pid_file)
    jobs.cancel(job_id)
    until(jobs, job_id, "cancelled")
    again = jobs.retry(job_id)
    assert (again["state"], again["error"], again["result"]) == ("queued", None, None)
    assert until(jobs, job_id, "done")["attempt"] == 2
    with pytest.raises(ConflictError, match="nothing to retry"):
        jobs.retry(job_id)


def test_a_job_whose_worker_is_killed_is_taken_up_again(jobs: JobEngine, pid_file: Path) -> None:
    job_id = jobs.submit("nap", None, {"seconds": 0.6})
    pid = read_pid(pid_file)
    pid_file.unlink()
    os.kill(pid, signal.SIGKILL)
    ended = until(jobs, job_id, "done", "failed")
    assert (ended["state"], ended["attempt"]) == ("done", 2)
    assert read_pid(pid_file) != pid


def test_a_job_that_always_kills_its_worker_fails(jobs: JobEngine, job_settings: Settings) -> None:
    job_id = jobs.submit("die", None, {"times": 99})
    ended = until(jobs, job_id, "failed")
    assert ended["attempt"] == engine_module.DEATHS
    assert ended["error"]["code"] == "worker_died"
    assert "died 3 times" in ended["error"]["detail"]
    jobs.retry(job_id)
    (job_settings.data / "deaths").write_text("99")
    assert until(jobs, job_id, "done")["result"] == {"deaths": 99}


def test_a_hostile_file_takes_its_worker_down_not_the_server(jobs: JobEngine) -> None:
    ended = until(jobs, jobs.submit("swallow", None, {"gigabytes": 3}), "failed", "done")
    assert (ended["state"], ended["error"]["code"]) == ("failed", "worker_died")
    assert until(jobs, jobs.submit("nap", None, {"seconds": 0.02}), "done")


def test_bad_input_is_told_as_the_problem_that_it_is(jobs: JobEngine) -> None:
    ended = until(jobs, jobs.submit("refuse", None, {}), "failed")
    assert ended["message"] == ended["error"]["detail"] == "imu.csv: row 3, column gz: expected a number, found 'abc'"
    assert ended["error"]["status"] == 422
    assert ended["error"]["where"] == {"stream": "imu", "row": 3, "column": "gz"}


def test_a_fault_of_ours_is_told_without_the_inside(jobs: JobEngine, caplog: pytest.LogCaptureFixture) -> None:
    ended = until(jobs, jobs.submit("crash", None, {}), "failed")
    assert (ended["error"]["status"], ended["error"]["code"]) == (500, "internal")
    assert "ZeroDivisionError" in ended["error"]["detail"]
    assert "ZeroDivisionError" in caplog.text


def test_a_job_that_another_process_queued_is_found(jobs: JobEngine, job_settings: Settings) -> None:
    with writing(database(job_settings)) as session:
        job_id = store.create(session, "nap", None, {"seconds": 0.02}).id
    assert until(jobs, job_id, "done", timeout=10)


def test_unknown_jobs_and_kinds_are_refused(jobs: JobEngine) -> None:
    with pytest.raises(NotFoundError):
        jobs.get("nope")
    with pytest.raises(NotFoundError):
        jobs.cancel("nope")
    with pytest.raises(ValueError, match="unknown kind"):
        jobs.submit("dance", None, {})


def test_jobs_survive_a_restart_of_the_server(tmp_path: Path) -> None:
    settings = Settings(data=tmp_path / "data", workers=1)
    database(settings)
    first = JobEngine(settings, database(settings), KINDS)
    first.start()
    running = first.submit("nap", None, {"seconds": 1.0})
    read_pid(settings.data / "pid")
    queued = first.submit("nap", None, {"seconds": 0.02})
    assert first.stop()
    assert (first.get(running)["state"], first.get(queued)["state"]) == ("running", "queued")
    second = JobEngine(settings, database(settings), KINDS)
    second.start()
    try:
        assert until(second, running, "done")["attempt"] == 2
        assert until(second, queued, "done")["attempt"] == 1
    finally:
        assert second.stop()


def test_waiting_ends_when_the_server_stops(tmp_path: Path) -> None:
    settings = Settings(data=tmp_path / "data", workers=1, scheduler="tcp://127.0.0.1:9")  # nobody is there
    engine = JobEngine(settings, database(settings), KINDS)
    job_id = engine.submit("nap", None, {"seconds": 1})

    async def wait() -> None:
        waiting = asyncio.create_task(engine.wait(job_id))
        await asyncio.sleep(0.1)
        engine.stop()
        await asyncio.wait_for(waiting, 5)

    with pytest.raises(ConflictError, match="stopping"):
        asyncio.run(wait())
    assert engine.get(job_id)["state"] == "queued"
