"""The examples go in once; what the user deleted does not come back."""

from __future__ import annotations

from typing import Any

import pytest

from app import examples, paths
from app.ingest import IngestOptions, ingest_file
from app.settings import Settings


class Recorder:
    """A job engine that only remembers."""

    def __init__(self) -> None:
        self.jobs: list[dict[str, Any]] = []

    def submit(self, kind: str, run_id: str | None, params: dict[str, Any]) -> str:
        assert kind == "ingest" and run_id is None and params["is_example"]
        self.jobs.append(params)
        return str(len(self.jobs))


def test_each_is_loaded_once(settings: Settings, tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings.data.mkdir(parents=True)
    folder = tmp_path / "examples"
    for name in ("a", "b", "notes"):
        (folder / name).mkdir(parents=True)
        if name != "notes":
            (folder / name / "run.json").write_text("{}")
    monkeypatch.setattr(paths, "EXAMPLES", folder)
    jobs: Any = Recorder()
    assert len(examples.load_examples(settings, jobs)) == 2
    assert examples.load_examples(settings, jobs) == []
    (folder / "c").mkdir()
    (folder / "c" / "run.json").write_text("{}")
    examples.load_examples(settings, jobs)
    assert [job["options"]["file_name"] for job in jobs.jobs] == ["a", "b", "c"]


def test_the_examples_of_the_package_can_be_read(settings: Settings) -> None:
    folders = [f.parent for f in paths.EXAMPLES.glob("*/run.json")]
    assert len(folders) >= 3
    for folder in folders:
        manifest = ingest_file(settings.data, folder, IngestOptions(file_name=folder.name))
        assert manifest["streams"] and len(manifest["sparkline"]) > 10
