"""Diagnoses over HTTP: asked for, found, listed, told, changed, deleted and taken to other programs."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.db.session import writing
from app.jobs.kinds import KINDS, diagnosis_params
from app.store import diagnoses, jobs
from core.formats import write_run
from core.gap import Config, as_json, diagnose
from core.run import Run
from core.sensors import CommandLog
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS
from tests.app.gap_documents import answer, bare_evidence, made

WIDER = {"track_width": {"scale": 1.05}}


def sent(server: TestClient, run: Run, name: str, robot: str = "eight") -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.zip"
        write_run(run, path, "zip-parquet")
        asked = {"filename": "run.zip", "name": name, "robot": robot}
        run_id: str = server.post("/api/v1/runs", params=asked, content=path.read_bytes()).json()["id"]
    for job in server.get("/api/v1/jobs", params={"run": run_id, "state": "queued"}).json()["items"]:
        server.post(f"/api/v1/jobs/{job['id']}/cancel")  # what is queued for every new run is not what is tested here
    return run_id


def drive(seconds: float, first: float) -> Run:
    """Bends of 4 s, the first to the left for 1.0, with wheels, IMU and reference."""
    bare = dataclasses.replace(SCENARIOS["figure-eight"].run().crop(0.0, seconds), ranges=None, beacon=None)
    t = np.arange(0.0, seconds, 0.05)
    bends, speed = np.where(t // 4 % 2 == 0, 0.6, -0.6), np.where(t % 8 < 7, 0.3, 0.0)
    return simulate(dataclasses.replace(bare, commands=CommandLog(t=t, v=speed, w=first * bends)), WIDER, 0)


@pytest.fixture(scope="module")
def runs(server: TestClient) -> list[str]:
    """Two drives of a robot with a wider track than simulated: turns both ways, and stops."""
    return [sent(server, drive(14.0, 1.0), "first drive"), sent(server, drive(8.0, -1.0), "second drive")]


@pytest.fixture(scope="module")
def found(server: TestClient, runs: list[str]) -> dict[str, Any]:
    """A diagnosis of the drives, by the steps that the engine and a worker take."""
    app: Any = server.app
    params = diagnosis_params(runs[:1], runs[1:], seed=5, tolerances={"gyro_bias.bias": 0.01})
    told: list[tuple[float, str]] = []
    with writing(app.state.engine) as session:
        job = jobs.create(session, "diagnose", runs[0], params)
        job.state = "running"
        arguments = KINDS["diagnose"].arguments(session, app.state.settings, job)
        key = job.id
    made = KINDS["diagnose"].task(app.state.settings.data, lambda f, m="": told.append((f, m)), **arguments)
    with writing(app.state.engine) as session:
        job = jobs.get_job(session, key, lock=True)
        saved = KINDS["diagnose"].save(session, app.state.settings, job, json.loads(json.dumps(made)))
        jobs.finish(job, "done", saved.message, result=saved.result)
    assert told[0][0] == 0.0 and told[-1] == (1.0, "saving") and len(told) > 4
    answer: dict[str, Any] = server.get(f"/api/v1/diagnoses/{saved.result['diagnosis_id']}").json()
    return answer


@pytest.fixture
def stored(server: TestClient, runs: list[str]) -> str:
    """A diagnosis written by hand, with every kind of evidence."""
    return store(server, runs)


def store(server: TestClient, runs: list[str], **changed: Any) -> str:
    app: Any = server.app
    with writing(app.state.engine) as session:
        return diagnoses.add_diagnosis(session, runs[:1], runs[1:], made(**changed), job_id="0" * 16).id


def test_a_worker_finds_the_wider_track_and_what_makes_it_again_is_kept(found: dict[str, Any], runs: list[str]) -> None:
    assert found["verdict"] == "explained" and found["result"]["schema"] == "gap/1"
    assert found["effects"]["track_width"]["scale"] == pytest.approx(1.05, abs=2e-3)
    assert found["sentence"].startswith("Your simulator turns 5.0 % more than the robot. Track width explains")
    assert found["gap"]["held_out"] and found["gap"]["after"] < 0.5 * found["gap"]["before"]
    assert [(r["id"], r["held_out"]) for r in found["runs"]] == [(runs[0], False), (runs[1], True)]
    assert found["seed"] == 5 and found["config"] == {"tolerances": {"gyro_bias.bias": 0.01}}
    assert found["code_version"] and found["robot"] == "eight" and found["name"] == "eight: first drive"
    assert all(r["sha256"].startswith(r["id"]) for r in found["runs"])


def test_the_command_line_gives_the_same_answer(found: dict[str, Any]) -> None:
    config = Config(tolerances={"gyro_bias.bias": 0.01}, seed=5)
    told = as_json(diagnose([drive(14.0, 1.0)], held_out=[drive(8.0, -1.0)], config=config))
    assert {k: v for k, v in found["result"].items() if k != "runtime_s"} == json.loads(
        json.dumps({k: v for k, v in told.items() if k != "runtime_s"})
    )


def test_a_diagnosis_is_queued_as_a_job_and_can_be_cancelled(server: TestClient, runs: list[str]) -> None:
    before = server.get("/api/v1/diagnoses").json()
    asked = server.post("/api/v1/diagnoses", json={"runs": runs[:1], "options": {"name": "never"}})
    assert asked.status_code == 202 and asked.json()["kind"] == "diagnose" and asked.json()["run_id"] == runs[0]
    assert server.post(f"/api/v1/jobs/{asked.json()['id']}/cancel").status_code == 200
    end = time.monotonic() + 60
    while (state := server.get(f"/api/v1/jobs/{asked.json()['id']}").json())["state"] in ("queued", "running"):
        assert time.monotonic() < end
        time.sleep(0.05)
    assert state["state"] == "cancelled" and server.get("/api/v1/diagnoses").json() == before


def test_evidence_and_files_of_a_found_one(server: TestClient, found: dict[str, Any]) -> None:
    at = f"/api/v1/diagnoses/{found['id']}"
    assert server.get(f"{at}/evidence").json()["schema"] == "gap-evidence/1"
    assert server.get(f"{at}/files/report.json").json() == found["result"]
    assert server.get(f"{at}/files/effects.json").json() == {"effects": found["effects"]}
    for target, text in (("sdf", "<sdf"), ("ros2_control", "wheel_separation"), ("mjcf", "<mujoco"), ("json", "track")):
        answered = server.get(f"{at}/patches/{target}")
        assert answered.status_code == 200 and text in answered.text, target
    told = server.get(f"{at}/patches/sdf", params={"form": "json"}).json()
    assert told["expressed"] == ["track_width"]
    assert server.get(f"{at}/patches/cobol").json()["where"]["parameter"] == "target"


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [
        ({"runs": ["0123456789abcdef"]}, 404, "there is no run"),
        ({"held_out": "same"}, 422, "was also given to fit"),
        ({"runs": "twice"}, 422, "is given twice"),
        ({"runs": "mixed"}, 422, "is of another robot than run 1"),
        ({"runs": "blind"}, 422, "neither commands nor wheels"),
        ({"runs": "short"}, 422, "s of data are too few"),
        ({"options": {"tolerances": {"track_width.size": 0.1}}}, 422, "there is no 'track_width.size'"),
        ({"options": {"tolerances": {"track_width.scale": -1}}}, 422, "greater than 0"),
        ({"options": {"simulator": "somebody's"}}, 422, "options.simulator"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else None,
)
def test_what_cannot_be_diagnosed_is_refused_and_named(
    server: TestClient, runs: list[str], others: dict[str, str], change: dict[str, Any], status: int, words: str
) -> None:
    lists = {
        "same": [runs[0]],
        "twice": [runs[0], runs[0]],
        "mixed": [runs[0], others["mixed"]],
        "blind": [others["blind"]],
        "short": [others["short"]],
    }
    asked = {"runs": [runs[0]], **{k: lists.get(v, v) if isinstance(v, str) else v for k, v in change.items()}}
    answered = server.post("/api/v1/diagnoses", json=asked)
    assert answered.status_code == status and words in answered.json()["detail"], answered.text


@pytest.fixture(scope="module")
def others(server: TestClient) -> dict[str, str]:
    """Runs that cannot be diagnosed, alone or with `runs`."""
    whole = drive(9.0, 1.0)
    robot = dataclasses.replace(whole.meta.robot, track_width=0.9)
    meta = dataclasses.replace(whole.meta, robot=robot)
    return {
        "mixed": sent(server, dataclasses.replace(whole.crop(0.0, 9.0), meta=meta), "other robot", "nine"),
        "blind": sent(server, dataclasses.replace(whole.crop(0.0, 8.0), commands=None, wheels=None), "blind"),
        "short": sent(server, whole.crop(0.0, 3.0), "short"),
    }


def test_the_list_filters_and_a_run_carries_its_newest_verdict(
    server: TestClient, runs: list[str], found: dict[str, Any]
) -> None:
    unknown = store(server, runs, result=answer("unknown"))

    def ids(**params: Any) -> list[str]:
        return [d["id"] for d in server.get("/api/v1/diagnoses", params=params).json()["items"]]

    def verdict(run_id: str) -> str | None:
        told: str | None = server.get(f"/api/v1/runs/{run_id}").json()["verdict"]
        return told

    assert ids(run=runs[1])[0] == unknown and found["id"] in ids(robot="eight")
    assert unknown in ids(verdict="unknown") and found["id"] not in ids(verdict="unknown")
    assert ids(robot="nobody") == [] and server.get("/api/v1/diagnoses?verdict=perhaps").status_code == 422
    assert verdict(runs[0]) == verdict(runs[1]) == "unknown"
    page = server.get("/api/v1/runs", params={"q": "gap:unknown"}).json()
    assert {r["id"] for r in page["items"]} == set(runs) and page["facets"]["verdicts"] == {"unknown": 2}
    assert server.delete(f"/api/v1/diagnoses/{unknown}").json()["deleted_at"]
    assert unknown not in ids() and verdict(runs[1]) != "unknown"
    assert server.get(f"/api/v1/diagnoses/{unknown}").status_code == 404
    assert server.get("/api/v1/diagnoses/deleted").json()["items"][0]["id"] == unknown
    assert server.post(f"/api/v1/diagnoses/{unknown}/restore").status_code == 200
    assert verdict(runs[1]) == "unknown"
    server.delete(f"/api/v1/diagnoses/{unknown}")


def test_words_can_be_changed_and_findings_cannot(server: TestClient, stored: str) -> None:
    at = f"/api/v1/diagnoses/{stored}"
    before = server.get(at).json()
    after = server.patch(at, json={"name": "after repair", "notes": "new tyres"}).json()
    assert (after["name"], after["notes"]) == ("after repair", "new tyres")
    assert {k: v for k, v in after.items() if k not in ("name", "notes")} == {
        k: v for k, v in before.items() if k not in ("name", "notes")
    }
    assert server.patch(at, json={"name": " "}).status_code == 422
    assert server.patch(at, json={"result": {}}).status_code == 422


def test_the_next_experiment_is_a_command_file(server: TestClient, runs: list[str], stored: str) -> None:
    text = server.get(f"/api/v1/diagnoses/{stored}/files/commands.csv").text
    rows = list(csv.DictReader(io.StringIO(text)))
    assert list(rows[0]) == ["t", "v", "w"] and [float(r["v"]) for r in rows] == [0.0, 0.3, 0.3]
    bare = store(server, runs, evidence=bare_evidence())
    refused = server.get(f"/api/v1/diagnoses/{bare}/files/commands.csv")
    assert refused.status_code == 404 and "no further experiment" in refused.json()["detail"]


def test_nothing_is_stored_where_a_run_went_meanwhile(server: TestClient, runs: list[str]) -> None:
    from app.errors import NotFoundError

    before = server.get("/api/v1/diagnoses").json()
    with pytest.raises(NotFoundError, match="deleted meanwhile"):
        store(server, [*runs, "f" * 16])
    assert server.get("/api/v1/diagnoses").json() == before


def test_report_json_is_what_the_command_line_takes(server: TestClient, stored: str) -> None:
    from core.effects.chosen import effects_of

    told = json.loads(server.get(f"/api/v1/diagnoses/{stored}/files/report.json").text)
    assert dict(effects_of(told)) == server.get(f"/api/v1/diagnoses/{stored}").json()["effects"]
