"""A live run that has ended becomes an ordinary one: its columns, by the hash of what they hold."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from app.jobs.tasks import Progress


def store(data: Path, progress: Progress, *, manifest: Mapping[str, Any]) -> dict[str, Any] | None:
    """The manifest of the stored run, given that of the growing one; None where not a row came."""
    from app.ingest import described, run_hash
    from app.store import arrays

    streams = []
    for i, stream in enumerate(manifest["streams"]):
        progress(i / len(manifest["streams"]), stream["name"])
        columns = {name: arrays.put(data, arrays.open(data, key)) for name, key in stream["columns"].items()}
        streams.append(described(data, stream["name"], columns, stream["names"]))
    if not streams:
        return None
    sha256 = run_hash(manifest["meta"], streams)
    progress(1.0, "stored")
    return {**manifest, "id": sha256[:16], "sha256": sha256, "streams": streams}
