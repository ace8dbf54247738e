"""What is written is read back the same, bit by bit, in every format of a run."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.errors import FormatError, ParameterError
from core.formats import WRITERS, read_run, write_run
from core.robot import PROCEDURES, ImuMount, Noise, Pose, Procedure, RobotParams, Segment, TagMount
from core.run import Run, RunMeta
from core.sensors import STREAMS, RangeLog

finite = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(min_value=5e-324, allow_infinity=False)
not_negative = st.floats(min_value=0.0, allow_infinity=False)
maybe = lambda s: st.one_of(st.none(), s)  # noqa: E731
vectors = st.tuples(finite, finite, finite)
names = st.text(st.characters(codec="utf-8", categories=("L", "N", "P")), min_size=1, max_size=12)
json_values = st.recursive(
    st.none() | st.booleans() | finite | st.integers(-(2**60), 2**60) | st.text(max_size=8).filter(str.isprintable),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=3),
    max_leaves=6,
)
segments = st.builds(
    lambda t0, dt, g, w: Segment(t0, t0 + dt, g, w),
    st.floats(0, 1e6),
    st.floats(0, 1e6),
    maybe(vectors),
    maybe(vectors),
)
metas = st.builds(
    RunMeta,
    name=names,
    robot=st.builds(
        RobotParams,
        wheel_radius=maybe(positive),
        track_width=maybe(positive),
        ticks_per_rev=maybe(positive),
        imu=st.builds(ImuMount, finite, finite, finite),
        tag=st.builds(TagMount, finite, finite, finite),
    ),
    beacons=st.dictionaries(names, vectors, max_size=3),
    start=maybe(st.builds(Pose, finite, finite, finite)),
    noise=st.builds(Noise, **{k: maybe(not_negative) for k in Noise.__dataclass_fields__}),
    effects=st.dictionaries(names, st.dictionaries(names, finite | names, max_size=2), max_size=2),
    procedure=maybe(st.builds(Procedure, st.sampled_from(PROCEDURES), st.lists(segments, max_size=2).map(tuple))),
    extra=st.dictionaries(names.map(lambda n: f"x-{n}"), json_values, max_size=3),
)


@st.composite
def logs(draw: st.DrawFn, stream: str):
    spec = STREAMS[stream]
    stamps = draw(st.lists(finite, min_size=1, max_size=30, unique=True))
    t = np.unique(np.array(stamps) + 0.0)
    columns: dict[str, object] = {"t": t}
    chosen = [c.name for c in spec.columns[1:] if c.required or draw(st.booleans())]
    if spec.at_least_one_of and not set(chosen) & set(spec.at_least_one_of):
        chosen.append(spec.at_least_one_of[0])
    for name in chosen:
        if name in spec.text_columns:
            kinds = draw(st.lists(names, min_size=1, max_size=4, unique=True))
            codes = draw(st.lists(st.integers(0, len(kinds) - 1), min_size=t.size, max_size=t.size))
            seen = list(dict.fromkeys(codes))  # names come back in order of appearance, and only those that appear
            columns[name] = np.array([seen.index(c) for c in codes], np.int16)
            columns["names"] = tuple(kinds[c] for c in seen)
            continue
        width = draw(st.sampled_from((32, 64)))
        value = st.floats(width=width, allow_infinity=False)
        columns[name] = np.array(draw(st.lists(value, min_size=t.size, max_size=t.size)), f"f{width // 8}")
    return spec.log(**columns)


@st.composite
def runs(draw: st.DrawFn) -> Run:
    chosen = draw(st.lists(st.sampled_from(list(STREAMS)), min_size=1, max_size=3, unique=True))
    return Run(meta=draw(metas), **{name: draw(logs(name)) for name in chosen})


@pytest.mark.parametrize("kind", WRITERS)
@settings(max_examples=40, deadline=None)
@given(run=runs())
def test_readings_come_back_bit_by_bit(kind: str, run: Run) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run"
        write_run(run, path, kind)
        back = read_run(path)
    assert back.meta == run.meta
    assert list(back.logs()) == list(run.logs())
    for name, log in run.logs().items():
        found = back.logs()[name]
        assert getattr(found, "names", ()) == getattr(log, "names", ())
        assert found.columns().keys() == log.columns().keys()
        for column, values in log.columns().items():
            again = found.columns()[column]
            # CSV says no precision: its numbers are read as float64, of the same value
            expected = values if kind.endswith("parquet") or column == "beacon" else values.astype(np.float64)
            assert again.dtype == expected.dtype
            present = ~np.isnan(expected) if expected.dtype.kind == "f" else np.ones(expected.shape, bool)
            assert np.array_equal(present, ~np.isnan(again) if again.dtype.kind == "f" else present)
            assert again[present].tobytes() == expected[present].tobytes()


@pytest.mark.parametrize("kind", WRITERS)
def test_many_rows_cross_batches(kind: str, tmp_path: Path) -> None:
    n = 300_000
    rng = np.random.default_rng(7)
    gz, codes = rng.normal(size=n).astype(np.float32), np.arange(n, dtype=np.int16) % 3
    t = np.cumsum(rng.uniform(1e-4, 1e-2, n))
    run = Run(
        imu=STREAMS["imu"].log(t=t, gz=gz),  # type: ignore[call-arg]
        ranges=RangeLog(t=t, beacon=codes, range=rng.normal(size=n), names=("B1", "B2", "B3")),
    )
    write_run(run, tmp_path / "run", kind)
    back = read_run(tmp_path / "run")
    assert back.imu is not None and back.ranges is not None and run.ranges is not None
    assert np.array_equal(back.imu.t, t) and np.array_equal(back.imu.gz, gz)
    assert np.array_equal(back.ranges.beacon, codes) and back.ranges.names == run.ranges.names
    assert np.array_equal(back.ranges.range, run.ranges.range)


def test_a_stream_without_readings_is_not_written(tmp_path: Path) -> None:
    empty = np.zeros(0)
    run = Run(
        wheels=STREAMS["wheels"].log(t=np.arange(2.0), left=np.zeros(2), right=np.ones(2)),  # type: ignore[call-arg]
        imu=STREAMS["imu"].log(t=empty, gz=empty),  # type: ignore[call-arg]
    )
    write_run(run, tmp_path / "run", "folder-csv")
    assert list(read_run(tmp_path / "run").logs()) == ["wheels"]


def test_writing_refuses_a_full_folder_and_an_unknown_format(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("kept")
    with pytest.raises(FormatError, match="empty folder"):
        write_run(Run(), tmp_path, "folder-csv")
    assert (tmp_path / "mine").read_text() == "kept"
    with pytest.raises(ParameterError, match="folder-csv"):
        write_run(Run(), tmp_path / "run", "rosbag")
