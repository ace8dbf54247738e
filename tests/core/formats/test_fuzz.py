"""A fuzzer over the readers: whatever is done to a valid file, only our own errors come out, and quickly.

Valid files are cut, spliced and overwritten by hypothesis. The readers either read what is left or refuse it; anything
else (an engine's error, a crash, a hang) is a failure. Run longer by hand with
`HYPOTHESIS_EXAMPLES=20000 pytest tests/core/formats/test_fuzz.py`.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from core.errors import DriftscopeError, FormatError
from core.formats import ColumnMap, open_table, read_run, suggest_mapping
from core.formats.run_json import parse_json

DATA = Path(__file__).resolve().parents[2] / "data"
EXAMPLES = int(os.environ.get("HYPOTHESIS_EXAMPLES", "150"))
SECONDS = 30.0  # for one small file; a hang takes for ever, a busy machine a second
SEEDS = {
    "imu.parquet": "husky-step/imu.parquet",
    "truth.parquet": "husky-step/truth.parquet",
    "wheels.csv": "optiodom-circle/wheels.csv",
    "csv.zip": "husky-step-csv.zip",
    "parquet.zip": "husky-step-parquet.zip",
    "path.tum": "optiodom-circle.tum",
    "run.json": "husky-step/run.json",
}

byte = st.one_of(st.integers(0, 255), st.sampled_from(b"\0\n\r,\"'-.0eE#{}[]\xff\xfe\x80"))
change = st.one_of(
    st.tuples(st.just("set"), st.floats(0, 1), byte),
    st.tuples(st.just("cut"), st.floats(0, 1), st.integers(1, 400)),
    st.tuples(st.just("end"), st.floats(0, 1), st.just(0)),
    st.tuples(st.just("copy"), st.floats(0, 1), st.integers(1, 400)),
    st.tuples(st.just("put"), st.floats(0, 1), st.binary(min_size=1, max_size=12)),
)


def mutated(data: bytes, changes: list[tuple[str, float, object]]) -> bytes:
    """The file after each change in turn; places are fractions of its length."""
    for kind, place, what in changes:
        at = int(place * max(len(data) - 1, 0))
        if kind == "set":
            data = data[:at] + bytes([what]) + data[at + 1 :]  # type: ignore[list-item]
        elif kind == "cut":
            data = data[:at] + data[at + what :]  # type: ignore[operator]
        elif kind == "end":
            data = data[:at]
        elif kind == "copy":
            data = data[:at] + data[-what:] + data[at:]  # type: ignore[operator]
        else:
            data = data[:at] + what + data[at + len(what) :]  # type: ignore[operator, arg-type]
    return data


def read_safely(path: Path) -> None:
    """Read a file in all ways; a refusal must say what it is about."""
    start = time.perf_counter()
    try:
        run = read_run(path)
        assert all(np.isfinite(log.t).all() and (np.diff(log.t) > 0).all() for log in run.logs().values())
        assert run.logs()
    except DriftscopeError as error:
        assert error.message and (not isinstance(error, FormatError) or error.where["file"])
    try:
        open_table(path).head(5)
    except DriftscopeError as error:
        assert error.message
    assert time.perf_counter() - start < SECONDS


@pytest.mark.parametrize("name", SEEDS)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(changes=st.lists(change, min_size=1, max_size=6))
def test_only_our_errors_come_out(name: str, changes: list[tuple[str, float, object]]) -> None:
    data = mutated((DATA / SEEDS[name]).read_bytes(), changes)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        if name == "run.json":
            (Path(folder) / "imu.csv").write_text("t,gz\n0,1\n")
            path = Path(folder)
        read_safely(path)


@pytest.mark.parametrize("name", ["file.csv", "file.zip", "file.parquet", "file.tum", "file"])
@settings(max_examples=EXAMPLES // 3, deadline=None)
@given(data=st.one_of(st.binary(max_size=400), st.text(max_size=200).map(lambda s: s.encode("utf-8", "replace"))))
def test_any_bytes_under_any_name(name: str, data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        read_safely(path)


@settings(max_examples=EXAMPLES, deadline=None)
@given(data=st.one_of(st.binary(max_size=60), st.text('{}[]":,0eE-.\\u ', max_size=40).map(str.encode)))
def test_json_is_read_or_refused(data: bytes) -> None:
    try:
        assert isinstance(parse_json(data, "run.json"), dict)
    except DriftscopeError as error:
        assert error.where["file"] == "run.json"


plain = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=8,
)
words = st.sampled_from(
    ["streams", "imu", "t", "gz", "column", "unit", "sign", "time", "rate", "deg/s", "ms", "robot", "t0"]
)
nested = st.recursive(
    words | st.integers(-2, 2), lambda inner: st.dictionaries(words, inner, max_size=4), max_leaves=10
)


@settings(max_examples=EXAMPLES, deadline=None)
@given(data=plain | nested)
def test_a_mapping_is_taken_or_refused(data: object) -> None:
    try:
        again = ColumnMap.from_json(data)
        assert ColumnMap.from_json(again.to_json()).to_json() == again.to_json()
    except DriftscopeError as error:
        assert error.message


@settings(max_examples=EXAMPLES, deadline=None)
@given(columns=st.lists(st.text(max_size=15), max_size=8))
def test_a_suggestion_never_fails_and_takes_only_what_is_there(columns: list[str]) -> None:
    suggested = suggest_mapping(columns)
    assert {s.column for group in suggested.streams.values() for s in group.values()} <= set(columns)


@pytest.mark.parametrize("at", [14, 829, 1553])
def test_a_page_that_asks_for_exabytes_harms_nobody(at: int, tmp_path: Path) -> None:
    # One byte in a definition level: the engine asks for 2 EB and Rust aborts the process that did.
    data = bytearray((DATA / SEEDS["imu.parquet"]).read_bytes())
    data[at] = 0xFF
    (tmp_path / "imu.parquet").write_bytes(data)
    with pytest.raises(FormatError, match="cannot be decoded within"):
        read_run(tmp_path / "imu.parquet")
    assert read_run(DATA / SEEDS["imu.parquet"]).imu is not None  # and the next file reads
