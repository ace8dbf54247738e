"""Jobs over HTTP: lists, events, and what cannot be done to a job that has ended."""

from __future__ import annotations

import json
from typing import Any

from fastapi.testclient import TestClient

API = "/api/v1"


def events(text: str) -> list[dict[str, Any]]:
    """The jobs of an event stream."""
    blocks = [block for block in text.split("\n\n") if "data:" in block]
    assert all("event: job" in block for block in blocks)
    return [json.loads(line[5:]) for block in blocks for line in block.splitlines() if line.startswith("data:")]


def test_a_jobs_events_end_with_the_job(server: TestClient, run_id: str) -> None:
    asked = server.post(f"{API}/runs/{run_id}/estimates", json={"methods": ["encoders"]}).json()
    with server.stream("GET", f"{API}/jobs/{asked['id']}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        told = events("".join(stream.iter_text()))
    states = [job["state"] for job in told]
    assert states == sorted(states, key=["queued", "running", "done"].index)
    assert {job["id"] for job in told} == {asked["id"]}
    assert told[-1] == server.get(f"{API}/jobs/{asked['id']}").json()


def test_the_list_can_be_narrowed(server: TestClient, run_id: str) -> None:
    everything = server.get(f"{API}/jobs").json()["items"]
    assert {"ingest", "estimate"} <= {job["kind"] for job in everything}
    created = [job["created_at"] for job in everything]
    assert created == sorted(created, reverse=True)
    done = server.get(f"{API}/jobs", params={"state": "done", "run": run_id}).json()["items"]
    assert done
    assert all((job["state"], job["run_id"]) == ("done", run_id) for job in done)
    assert len(server.get(f"{API}/jobs", params={"limit": 1}).json()["items"]) == 1
    assert server.get(f"{API}/jobs", params={"state": "asleep"}).status_code == 422


def test_a_finished_job_is_neither_cancelled_nor_started_again(server: TestClient, run_id: str) -> None:
    job = server.get(f"{API}/jobs", params={"state": "done", "run": run_id}).json()["items"][0]
    for verb in ("cancel", "retry"):
        refused = server.post(f"{API}/jobs/{job['id']}/{verb}")
        assert (refused.status_code, refused.json()["code"]) == (409, "conflict")


def test_unknown_jobs_are_not_found(server: TestClient) -> None:
    for verb, path in (("GET", ""), ("GET", "/events"), ("POST", "/cancel"), ("POST", "/retry")):
        answer = server.request(verb, f"{API}/jobs/nope{path}")
        assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
