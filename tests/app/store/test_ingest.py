"""A file becomes a manifest and arrays, all or nothing."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from app.errors import DiskFullError, NotFoundError
from app.ingest import IngestOptions, ingest_file, look_inside
from app.store import arrays
from core.errors import CancelledError, FormatError, NeedsMappingError
from core.formats import read_run, write_run
from core.run import Run

MakeRun = Callable[..., Run]


def stored_arrays(data: Path) -> list[Path]:
    return [p for p in (data / "arrays").rglob("*") if p.is_file() and p.name != ".lock"]


def ingest(data: Path, path: Path, **options: object) -> dict:
    return ingest_file(data, path, IngestOptions(file_name=path.name, **options))


def test_what_is_stored_is_what_the_file_says(make_run: MakeRun, tmp_path: Path) -> None:
    write_run(make_run(), tmp_path / "lap.zip", "zip-parquet")
    manifest = ingest(tmp_path / "data", tmp_path / "lap.zip", robot="mill", tags=("wet",))
    back, truth = arrays.run_from_manifest(tmp_path / "data", manifest), read_run(tmp_path / "lap.zip")
    assert back.meta == truth.meta
    assert list(back.logs()) == list(truth.logs())
    for name, log in truth.logs().items():
        stored = back.logs()[name].columns()
        for column, values in log.columns().items():
            assert stored[column].dtype == values.dtype
            assert np.array_equal(stored[column], values, equal_nan=values.dtype.kind == "f")
    assert back.ranges is not None and back.ranges.names == ("B1", "B2")
    assert manifest["name"] == "lap" and manifest["robot"] == "mill" and manifest["tags"] == ["wet"]


def test_manifest_figures(make_run: MakeRun, tmp_path: Path) -> None:
    write_run(make_run(), tmp_path / "lap.zip", "zip-csv")
    manifest = ingest(tmp_path / "data", tmp_path / "lap.zip")
    imu = next(s for s in manifest["streams"] if s["name"] == "imu")
    assert imu["rate_hz"] == pytest.approx(50.0, rel=1e-3)
    assert imu["gaps"] == [[pytest.approx(7.98), pytest.approx(10.02)]]
    assert manifest["t0"] == 0.0 and manifest["duration_s"] == pytest.approx(19.98)
    assert 2 <= len(manifest["sparkline"]) <= 64
    assert manifest["sparkline"][0] == [0.0, 0.0]
    assert manifest["source"]["format"] == "zip" and manifest["source"]["file_name"] == "lap.zip"
    whole = sum(a.nbytes for log in read_run(tmp_path / "lap.zip").logs().values() for a in log.columns().values())
    assert manifest["size_bytes"] == whole


def test_same_readings_same_run_whatever_the_name_or_the_packing(make_run: MakeRun, tmp_path: Path) -> None:
    write_run(make_run("a"), tmp_path / "a.zip", "zip-csv")
    write_run(make_run("b"), tmp_path / "folder", "folder-csv")
    write_run(make_run("a", turn=0.2), tmp_path / "c.zip", "zip-csv")
    first, second, other = (ingest(tmp_path / "data", tmp_path / n) for n in ("a.zip", "folder", "c.zip"))
    assert first["sha256"] == second["sha256"] != other["sha256"]
    assert first["id"] == first["sha256"][:16]


def test_dead_reckoning_draws_the_sparkline_where_nothing_else_can(make_run: MakeRun, tmp_path: Path) -> None:
    run = make_run(turn=0.2, seconds=30.0)
    bare = Run(meta=run.meta, wheels=run.wheels)
    write_run(bare, tmp_path / "w.zip", "zip-csv")
    points = np.array(ingest(tmp_path / "data", tmp_path / "w.zip")["sparkline"])
    radius = np.hypot(points[:, 0], points[:, 1] - 2.0)  # a circle of 0.4 / 0.2 m round (0, 2)
    assert len(points) == 64
    assert np.abs(radius - 2.0).max() < 2e-3
    unknown = Run(wheels=run.wheels)
    write_run(unknown, tmp_path / "u.zip", "zip-csv")
    assert ingest(tmp_path / "data", tmp_path / "u.zip")["sparkline"] == []


def test_a_fault_in_the_last_stream_leaves_nothing(make_run: MakeRun, tmp_path: Path) -> None:
    write_run(make_run(), tmp_path / "bad", "folder-csv")
    with (tmp_path / "bad" / "truth.csv").open("a") as file:
        file.write("99,oops,0,0\n")
    with pytest.raises(FormatError) as caught:
        ingest(tmp_path / "data", tmp_path / "bad")
    assert caught.value.where["stream"] == "truth" and caught.value.where["column"] == "x"
    assert stored_arrays(tmp_path / "data") == []


def test_cancelling_leaves_nothing(make_run: MakeRun, tmp_path: Path) -> None:
    write_run(make_run(), tmp_path / "lap.zip", "zip-csv")

    def stop(fraction: float, message: str) -> None:
        if fraction > 0.3:
            raise CancelledError("enough")

    with pytest.raises(CancelledError):
        ingest_file(tmp_path / "data", tmp_path / "lap.zip", IngestOptions(file_name="lap.zip"), stop)
    assert stored_arrays(tmp_path / "data") == []


def test_progress_never_goes_back(make_run: MakeRun, tmp_path: Path) -> None:
    write_run(make_run(), tmp_path / "lap.zip", "zip-csv")
    told: list[float] = []
    options = IngestOptions(file_name="lap.zip")
    ingest_file(tmp_path / "data", tmp_path / "lap.zip", options, lambda fraction, _: told.append(fraction))
    assert told == sorted(told) and told[-1] == 1.0 and 0 <= told[0] < 1


def test_no_room_is_said_before_anything_is_written(
    make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(make_run(), tmp_path / "lap.zip", "zip-csv")
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1 << 20))
    with pytest.raises(DiskFullError) as caught:
        ingest(tmp_path / "data", tmp_path / "lap.zip")
    assert caught.value.where["free_bytes"] == 1 << 20


def test_a_disk_that_fills_up_on_the_way_leaves_nothing(
    make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(make_run(), tmp_path / "lap.zip", "zip-csv")
    original, seen = arrays.Writer.append, []

    def full(self: arrays.Writer, array: np.ndarray) -> None:
        seen.append(array)
        if len(seen) > 5:
            raise OSError(errno.ENOSPC, "No space left on device")
        original(self, array)

    monkeypatch.setattr(arrays.Writer, "append", full)
    with pytest.raises(OSError, match="No space left"):
        ingest(tmp_path / "data", tmp_path / "lap.zip")
    assert stored_arrays(tmp_path / "data") == []


def test_a_file_that_is_gone(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="upload it again"):
        ingest(tmp_path / "data", tmp_path / "absent.zip")


def test_foreign_table(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_ms,gyro_z,note\n0,1.0,a\n10,2.0,b\n20,3.0,c\n")
    with pytest.raises(NeedsMappingError):
        ingest(tmp_path / "data", path)
    inside = look_inside(path, "log.csv")
    assert inside["needs_mapping"] is True
    assert inside["columns"] == [
        {"name": "time_ms", "type": "number"},
        {"name": "gyro_z", "type": "number"},
        {"name": "note", "type": "text"},
    ]
    assert inside["rows"][1] == {"time_ms": "10", "gyro_z": "2.0", "note": "b"}
    assert inside["suggested"]["streams"]["imu"]["t"]["unit"] == "ms"
    mapping = {"streams": {"imu": {"t": {"column": "time_ms", "unit": "ms"}, "gz": {"column": "gyro_z", "sign": -1}}}}
    manifest = ingest(tmp_path / "data", path, mapping=mapping)
    run = arrays.run_from_manifest(tmp_path / "data", manifest)
    assert run.imu is not None
    assert run.imu.t.tolist() == [0.0, 0.01, 0.02] and run.imu.gz.tolist() == [-1.0, -2.0, -3.0]
    assert manifest["source"]["mapping"] == mapping


def test_a_table_that_says_what_it_is_needs_no_mapping(make_run: MakeRun, tmp_path: Path) -> None:
    path = tmp_path / "imu.csv"
    path.write_text("t,gz\n0,1\n1,2\n")
    assert look_inside(path, "imu.csv")["needs_mapping"] is False
    write_run(make_run(), tmp_path / "lap.zip", "zip-csv")
    assert look_inside(tmp_path / "lap.zip", "lap.zip")["columns"] == []


def test_options_as_a_job_has_them() -> None:
    plain = {"file_name": "a.zip", "name": None, "robot": "mill", "tags": ["x"], "mapping": None}
    assert IngestOptions.from_plain(plain).tags == ("x",)
