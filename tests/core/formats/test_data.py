"""The tiny recordings beside the tests: one per format, all readable, equal where they hold the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from core.errors import NeedsMappingError
from core.formats import FORMATS, WRITERS, open_run, read_run, sniff, suggest_mapping
from core.run import Run

DATA = Path(__file__).resolve().parents[2] / "data"
FILES = {
    "husky-step": "folder",
    "optiodom-circle": "folder",
    "husky-step-csv.zip": "zip",
    "husky-step-parquet.zip": "zip",
    "husky-step/imu.parquet": "parquet",
    "optiodom-circle/wheels.csv": "csv",
    "optiodom-circle-log.csv": "csv",
    "optiodom-circle.tum": "tum",
}


def same(a: Run, b: Run) -> bool:
    """Equal descriptions and equal readings, bit by bit where the types agree."""
    if a.meta != b.meta or a.logs().keys() != b.logs().keys():
        return False
    for name, log in a.logs().items():
        columns, others = log.columns(), b.logs()[name].columns()
        if columns.keys() != others.keys() or getattr(log, "names", ()) != getattr(b.logs()[name], "names", ()):
            return False
        if not all(np.array_equal(c, others[k], equal_nan=c.dtype.kind == "f") for k, c in columns.items()):
            return False
    return True


def test_there_is_a_file_for_every_format() -> None:
    assert set(FILES.values()) == set(FORMATS)


@pytest.mark.parametrize(("file", "name"), FILES.items())
def test_its_format_is_recognised(file: str, name: str) -> None:
    assert sniff(DATA / file).name == name


@pytest.mark.parametrize("file", [f for f in FILES if f != "optiodom-circle-log.csv"])
def test_it_reads(file: str) -> None:
    run = read_run(DATA / file)
    assert run.duration > 2.5
    assert all(np.all(np.diff(log.t) > 0) for log in run.logs().values())


def test_zip_and_folder_hold_the_same_run() -> None:
    folder = read_run(DATA / "husky-step")
    assert same(folder, read_run(DATA / "husky-step-csv.zip"))
    assert same(folder, read_run(DATA / "husky-step-parquet.zip"))


def test_a_single_table_with_our_columns_is_a_run_of_one_stream() -> None:
    folder, table = read_run(DATA / "optiodom-circle"), read_run(DATA / "optiodom-circle" / "wheels.csv")
    assert list(table.logs()) == ["wheels"]
    assert table.wheels is not None and folder.wheels is not None
    assert np.array_equal(table.wheels.left, folder.wheels.left)
    assert list(read_run(DATA / "husky-step" / "truth.parquet").logs()) == ["truth"]


def test_a_foreign_table_asks_for_a_mapping_and_reads_with_it() -> None:
    path = DATA / "optiodom-circle-log.csv"
    with pytest.raises(NeedsMappingError) as caught:
        read_run(path)
    assert caught.value.where["columns"] == ["time_ms", "left_deg", "right_deg", "state"]
    suggestion = suggest_mapping(["time_ms", "left_deg", "right_deg", "state"]).to_json()
    assert caught.value.where["suggestion"] == suggestion
    suggestion["streams"]["wheels"]["right"]["sign"] = -1
    mapped, wheels = read_run(path, mapping=suggestion).wheels, read_run(DATA / "optiodom-circle").wheels
    assert mapped is not None and wheels is not None
    np.testing.assert_allclose(mapped.t, wheels.t, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mapped.left, wheels.left, rtol=1e-12, atol=0)
    np.testing.assert_allclose(mapped.right, wheels.right, rtol=1e-12, atol=0)


def test_a_tum_file_is_a_truth() -> None:
    tum, truth = read_run(DATA / "optiodom-circle.tum").truth, read_run(DATA / "optiodom-circle").truth
    assert tum is not None and truth is not None and tum.theta is not None and truth.theta is not None
    assert np.array_equal(tum.t, truth.t) and np.array_equal(tum.x, truth.x)
    np.testing.assert_allclose(np.cos(tum.theta - truth.theta), 1.0, rtol=1e-12)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_batches_are_what_read_run_holds(suffix: str, tmp_path: Path) -> None:
    run = read_run(DATA / "husky-step")
    WRITERS[f"folder-{suffix[1:]}"](run, tmp_path / "run")
    with open_run(tmp_path / "run") as source:
        for stream in source.streams():
            batches = list(stream.batches())
            for name, dtype in stream.columns.items():
                whole = np.concatenate([b[name] for b in batches])
                assert whole.dtype == dtype
                assert np.array_equal(whole, run.logs()[stream.name].columns()[name])


def test_temporary_files_go_when_the_source_is_closed(tmp_path: Path) -> None:
    with open_run(DATA / "husky-step-csv.zip", tmp=tmp_path) as source:
        assert len(list(tmp_path.iterdir())) == 1
        assert next(iter(next(source.streams()).batches()))["t"].size
    assert list(tmp_path.iterdir()) == []


@pytest.mark.shared
def test_every_recorded_run_reads(shared_data: Path) -> None:
    folders = sorted(f.parent for f in shared_data.rglob("run.json"))
    assert len(folders) > 50
    for folder in folders:
        with open_run(folder) as source:
            assert source.warnings == (), folder
            rows = {s.name: sum(b["t"].size for b in s.batches()) for s in source.streams()}
            assert all(rows.values()), folder
            assert source.warnings == (), folder
