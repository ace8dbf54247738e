"""The log keeps what was acknowledged, wherever it was cut off."""

from __future__ import annotations

import errno
import threading
from pathlib import Path

import pytest

from app.live import log as logs
from app.live.columns import Columns
from app.live.history import Extremes, Thinned


def test_a_log_that_was_cut_anywhere_has_its_whole_records_and_goes_on(tmp_path: Path) -> None:
    records = [(logs.TEXT, b"one"), (logs.BINARY, b""), (logs.TEXT, b"three" * 9)]
    whole = b"".join(logs.record(kind, payload) for kind, payload in records)
    ends = [len(b"".join(logs.record(k, p) for k, p in records[:n])) for n in range(4)]
    path = tmp_path / "log"
    for cut in range(len(whole) + 1):
        path.write_bytes(whole[:cut])
        kept = max(n for n in range(4) if ends[n] <= cut)
        assert list(logs.read(path)) == records[:kept]
        assert path.stat().st_size == ends[kept]


def test_a_flipped_bit_ends_the_log_there(tmp_path: Path) -> None:
    path = tmp_path / "log"
    good, bad = logs.record(logs.TEXT, b"good"), bytearray(logs.record(logs.TEXT, b"bad"))
    bad[-1] ^= 1
    path.write_bytes(good + bad + logs.record(logs.TEXT, b"never acknowledged"))
    assert list(logs.read(path)) == [(logs.TEXT, b"good")]


def test_records_are_acknowledged_in_order_once_they_are_in_the_file(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    writer, seen, done = logs.Writer(), [], threading.Event()
    log = logs.Log(tmp_path / "run" / "log", writer)
    for n in range(200):

        def acknowledged(error: OSError | None, n: int = n) -> None:
            held = sum(1 for _ in logs.read(tmp_path / "run" / "log")) if n % 50 == 49 else n + 1
            seen.append((n, error, held >= n + 1))
            if n == 199:
                done.set()

        log.append(logs.TEXT, f"{n}".encode(), acknowledged)
    assert done.wait(20)
    writer.stop()
    log.close()
    assert seen == [(n, None, True) for n in range(200)]


def test_the_last_record_comes_behind_all_that_is_queued(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    writer, seen = logs.Writer(), []
    log = logs.Log(tmp_path / "run" / "log", writer)
    for n in range(50):
        log.append(logs.TEXT, f"{n}".encode(), seen.append)
    log.finish(logs.END)
    writer.stop()
    assert seen == [None] * 50
    assert list(logs.read(tmp_path / "run" / "log")) == [
        *((logs.TEXT, f"{n}".encode()) for n in range(50)),
        (logs.END, b""),
    ]


def test_a_full_disk_is_told_and_leaves_no_half_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run").mkdir()
    writer, told, done = logs.Writer(), [], threading.Event()
    log = logs.Log(tmp_path / "run" / "log", writer)
    log.write(logs.record(logs.TEXT, b"before"))

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(logs.os, "fdatasync", full)
    log.append(logs.TEXT, b"lost", lambda error: (told.append(error), done.set()))
    assert done.wait(20)
    writer.stop()
    log.close()
    assert told[0].errno == errno.ENOSPC
    assert list(logs.read(tmp_path / "run" / "log")) == [(logs.TEXT, b"before")]


def test_a_column_that_begins_late_is_empty_before(tmp_path: Path) -> None:
    import numpy as np

    columns = Columns(tmp_path, "0" * 16)
    columns.add({"imu": {"t": np.array([0.0, 0.1]), "gz": np.array([1.0, 2.0])}})
    columns.flush()
    columns.add({"imu": {"t": np.array([0.2]), "gz": np.array([3.0]), "ax": np.array([9.0])}})
    (stream,) = columns.flush()
    assert stream["rows"] == 3 and stream["t1"] == 0.2
    np.testing.assert_array_equal(columns.open("imu", "ax"), [np.nan, np.nan, 9.0])
    np.testing.assert_array_equal(columns.open("imu", "gz"), [1.0, 2.0, 3.0])


def test_history_stays_small_and_keeps_extremes() -> None:
    import numpy as np

    signal, path = Extremes(most=100), Thinned(2, most=100)
    t = np.arange(0.0, 500.0, 0.01)
    y = np.sin(t)
    y[31_234] = 50.0
    for part in np.array_split(np.arange(len(t)), 5000):
        signal.add(t[part], y[part])
        path.add([t[part].tolist(), y[part].tolist()])
    shown = signal.shown()
    assert len(shown) < 250 and max(v for _, v in shown) == 50.0
    assert [stamp for stamp, _ in shown] == sorted(stamp for stamp, _ in shown)
    assert 50 <= len(path.columns[0]) <= 101
    assert path.columns[0][0] == 0.0
