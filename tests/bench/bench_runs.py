"""Listing among 10,000 stored runs: every query the page makes, in milliseconds. Run by hand."""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from fastapi.testclient import TestClient
from sqlalchemy import Engine, insert

from app.db.migrate import migrate
from app.db.session import make_engine, reading, writing
from app.db.tables import Robot, Run, RunWords, Stream, Tag
from app.main import create_app
from app.settings import Settings
from app.store.runs import RunQuery, list_runs

RUNS = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
STREAMS = ("commands", "wheels", "imu", "beacon", "ranges", "truth")
QUERIES = {
    "newest": RunQuery(),
    "by error": RunQuery(sort="best_ate_m"),
    "by robot": RunQuery(sort="robot"),
    "by name, descending": RunQuery(sort="-name"),
    "words": RunQuery(q="corridor 12"),
    "robot and tag": RunQuery(q="robot:robot-3 tag:tag-7"),
    "has imu and truth": RunQuery(q="has:imu has:truth", sort="duration_s"),
    "nothing found": RunQuery(q="zzz"),
    "500 at once": RunQuery(limit=500),
}


def fill(engine: Engine, runs: int) -> None:
    """Runs as they would be stored, without their arrays."""
    rng = np.random.default_rng(1)
    start = datetime(2026, 1, 1, tzinfo=UTC)
    robots = [{"id": i + 1, "name": f"robot-{i}", "created_at": start} for i in range(20)]
    rows, streams, tags, words = [], [], [], []
    for i in range(runs):
        run_id = f"{i:016x}"
        has = [s for s in STREAMS if rng.random() < 0.6] or ["imu"]
        tagged = sorted({f"tag-{int(t)}" for t in rng.integers(0, 40, 3)})
        name, robot = f"corridor lap {i}", int(rng.integers(1, 21))
        rows.append(
            {
                "id": run_id,
                "sha256": run_id * 4,
                "name": name,
                "robot_id": robot,
                "t0": 0.0,
                "t1": 60.0,
                "created_at": start + timedelta(minutes=i),
                "duration_s": float(rng.uniform(1, 4000)),
                "size_bytes": 10**6,
                "meta": {"format": "run/1", "note": "x" * 600},
                "warnings": [],
                "notes": "",
                "source": {"file_name": f"{name}.zip", "format": "zip"},
                "is_example": False,
                "sparkline": rng.uniform(0, 10, (64, 2)).round(3).tolist(),
                "stream_names": " ".join(sorted(has)),
                "best_method": "fused",
                "best_ate_m": None if i % 5 == 0 else float(rng.uniform(0, 1)),
            }
        )
        words.append({"run_id": run_id, "text": f"{name}\nrobot-{robot}\n{' '.join(tagged)}"})
        tags += [{"run_id": run_id, "tag": t} for t in tagged]
        streams += [
            {
                "run_id": run_id,
                "name": s,
                "rows": 1000,
                "t0": 0.0,
                "t1": 60.0,
                "rate_hz": 100.0,
                "gaps": [],
                "columns": {"t": "a" * 64, "x": "b" * 64},
                "names": [],
            }
            for s in has
        ]
    with writing(engine) as session:
        session.execute(insert(Robot), robots)
        session.execute(insert(Run), rows)
        session.execute(insert(Stream), streams)
        session.execute(insert(Tag), tags)
        session.execute(insert(RunWords), words)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data=Path(folder), allowed_hosts=("testserver",))
        engine = make_engine(settings.url)
        migrate(engine)
        fill(engine, RUNS)
        for name, query in QUERIES.items():
            took = []
            for _ in range(9):
                with reading(engine) as session:
                    began = time.perf_counter()
                    page = list_runs(session, query)
                    took.append(1000 * (time.perf_counter() - began))
            print(f"{name:22s} {statistics.median(took):6.1f} ms (worst {max(took):6.1f})   {page.total:6d} found")
        engine.dispose()
        with TestClient(create_app(settings)) as client:
            for path in ("/api/v1/runs", "/api/v1/runs?q=corridor+12", "/runs", "/runs.json"):
                began = time.perf_counter()
                answer = client.get(path)
                took_ms = 1000 * (time.perf_counter() - began)
                print(f"{path:30s} {answer.status_code} {took_ms:6.1f} ms")


if __name__ == "__main__":
    main()
