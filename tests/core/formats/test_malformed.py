"""Every malformed table is refused with its place: file, stream, row, column, what was expected and what was found."""

from __future__ import annotations

import io
import pickle
import time
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from core.errors import FormatError, TooLargeError
from core.formats import Limits, open_run, read_run

OK = '{"format": "run/1"}'


def folder(path: Path, files: dict[str, str | bytes]) -> Path:
    run = path / "run"
    run.mkdir()
    for name, content in files.items():
        (run / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return run


def refusal(path: Path, **options: Any) -> FormatError:
    start = time.perf_counter()
    with pytest.raises(FormatError) as caught:
        read_run(path, **options)
    assert time.perf_counter() - start < 20
    return caught.value


def table(tmp_path: Path, content: str | bytes, name: str = "imu.csv", **options: Any) -> FormatError:
    return refusal(folder(tmp_path, {"run.json": OK, name: content}), **options)


IMU = {
    # what is wrong: (content, row, column, expected, found)
    "text": ("t,gz\n0,1\n1,abc\n", 2, "gz", "a number", "'abc'"),
    "a number with a tail": ("t,gz\n0,1\n1,2 \n", 2, "gz", "a number", "'2 '"),
    "hexadecimal": ("t,gz\n0,0x1F\n", 1, "gz", "a number", "'0x1F'"),
    "NA": ("t,gz\n0,NA\n", 1, "gz", "a number", "'NA'"),
    "infinity": ("t,gz\n0,1\n1,inf\n", 2, "gz", "a finite number", "'inf'"),
    "overflow": ("t,gz\n0,1e999\n", 1, "gz", "a finite number", "'1e999'"),
    "NaN stamp": ("t,gz\n0,1\nnan,1\n", 2, "t", "a finite stamp", "'nan'"),
    "infinite stamp": ("t,gz\n0,1\ninf,1\n", 2, "t", "a finite stamp", "'inf'"),
    "no stamp": ("t,gz\n0,1\n,1\n", 2, "t", "a finite stamp", "an empty cell"),
    "repeated stamp": ("t,gz\n0,1\n1,1\n1,2\n", 3, "t", "a stamp after 1.0", "1.0"),
    "stamp goes back": ("t,gz\n0,1\n1,1\n0.5,2\n", 3, "t", "a stamp after 1.0", "0.5"),
    "short row": ("t,gz,ax\n0,1,2\n1,2\n2,3,4\n", 2, None, "3 fields", "2 fields: '1,2'"),
    "short first row": ("t,gz,ax\n0,1\n1,2,3\n", 1, None, "3 fields", "2 fields: '0,1'"),
    "long row": ("t,gz\n0,1\n1,2,3\n", 2, None, "2 fields", "3 fields: '1,2,3'"),
    "short beside long": ("t,gz\n0\n1,2,3\n", 1, None, "2 fields", "1 field: '0'"),
    "decimal comma": ("t,gz\n0,1,5\n", 1, None, "2 fields", "3 fields"),
    "blank line": ("t,gz\n0,1\n\n2,3\n", 2, None, "2 fields", "a blank line"),
    "open quote": ('t,gz\n0,1\n1,"2\n2,3\n', 2, None, "2 fields", "a quote that does not end"),
    "header only": ("t,gz\n", None, None, "at least one row", "no row"),
    "header without newline": ("t,gz", None, None, "at least one row", "no row"),
    "empty file": ("", None, None, "a header row", "0 bytes"),
    "blank header": ("\n0,1\n", None, None, "a header row", "a blank line"),
    "missing column": ("t,ax\n0,1\n", None, "gz", "gz", None),
    "missing t": ("gz,ax\n0,1\n", None, "t", "t", None),
    "unknown column": ("t,gz,foo\n0,1,2\n", None, "foo", None, "foo"),
    "duplicate column": ("t,gz,gz\n0,1,2\n", None, "gz", "each column once", "2 times"),
    "nameless column": ("t,gz,\n0,1,2\n", None, None, "column names", None),
    "semicolons": ("t;gz\n0;1\n", None, None, "commas", None),
    "tabs": ("t\tgz\n0\t1\n", None, None, "commas", None),
    "CR alone": ("t,gz\r0,1\r", None, None, "LF", "CR"),
    "UTF-16": ("t,gz\n0,1\n".encode("utf-16"), None, None, "UTF-8 text", "UTF-16"),
    "UTF-16 without mark": ("t,gz\n0,1\n".encode("utf-16-le"), None, None, "UTF-8 text", "binary data"),
    "Latin-1 cell": ("t,gz\n0,1\n1,2µ\n".encode("latin-1"), 2, None, "UTF-8 text", "byte 0xb5"),
    "Latin-1 header": ("t,gz,µ\n0,1,2\n".encode("latin-1"), None, None, "UTF-8 text", "byte 0xb5"),
    "NUL byte": ("t,gz\n0,1\n1,2\0\n", 2, None, "UTF-8 text", "a NUL byte"),
    "binary": (bytes(range(256)) * 50, None, None, "UTF-8 text", "binary data"),
    "zeros": (b"\0" * 100_000, None, None, "UTF-8 text", "binary data"),
}


@pytest.mark.parametrize("what", IMU)
def test_a_broken_csv_names_its_place(what: str, tmp_path: Path) -> None:
    content, row, column, expected, found = IMU[what]
    error = table(tmp_path, content)
    where = error.where
    assert where["file"] == "imu.csv" and where["stream"] == "imu"
    assert where.get("row") == row and where.get("column") == column
    assert expected is None or str(where["expected"]).startswith(expected)
    assert found is None or str(where["found"]).startswith(found)
    assert error.message.startswith("imu.csv, stream imu")
    assert pickle.loads(pickle.dumps(error)).where == where  # noqa: S301 (errors travel between processes)


RANGES = {
    "no name": ("t,beacon,range\n0,A,1\n1,,2\n", 2, "nothing"),
    "blank name": ("t,beacon,range\n0,  ,1\n", 1, "'  '"),
    "control character": ('t,beacon,range\n0,A,1\n1,"B\x01",2\n', 2, "'B\\x01'"),
    "long name": (f"t,beacon,range\n0,A,1\n1,{'B' * 300},2\n", 2, "'BBB"),
}


@pytest.mark.parametrize("what", RANGES)
def test_a_beacon_needs_a_name(what: str, tmp_path: Path) -> None:
    content, row, found = RANGES[what]
    error = table(tmp_path, content, "ranges.csv")
    assert (error.where["row"], error.where["column"]) == (row, "beacon")
    assert str(error.where["found"]).startswith(found)


FAR = 400_000  # rows: far beyond the engine's first batch


@pytest.mark.parametrize(
    ("row", "line", "column", "found"),
    [
        (FAR - 10, "text,0.5", "t", "'text'"),
        (FAR - 10, "5,0.5", "t", "5.0"),
        (FAR - 10, f"{FAR - 10},inf", "gz", "'inf'"),
        (FAR - 10, f"{FAR - 10}", None, f"1 field: '{FAR - 10}'"),
        (FAR, ",1", "t", "an empty cell"),
    ],
)
def test_the_row_is_right_deep_in_a_file(row: int, line: str, column: str | None, found: str, tmp_path: Path) -> None:
    lines = [f"{i},0.25" for i in range(1, FAR + 1)]
    lines[row - 1] = line
    error = table(tmp_path, "t,gz\n" + "\n".join(lines) + "\n")
    assert error.where["row"] == row
    assert error.where.get("column") == column
    assert error.where["found"] == found


GOOD = {
    "plain": "t,gz\n0,1\n1,2\n",
    "CR LF": "t,gz\r\n0,1\r\n1,2\r\n",
    "byte order mark": "\ufefft,gz\n0,1\n1,2\n",
    "no newline at the end": "t,gz\n0,1\n1,2",
    "quoted": '"t","gz"\n"0","1"\n"1","2"\n',
    "blanks": "t, gz\n0, 1\n1, 2\n",
    "another order": "gz,t\n1,0\n2,1\n",
    "signs and exponents": "t,gz\n-0,+1\n1e0,0.2E+1\n",
}


@pytest.mark.parametrize("what", GOOD)
def test_harmless_differences_read_the_same(what: str, tmp_path: Path) -> None:
    imu = read_run(folder(tmp_path, {"run.json": OK, "imu.csv": GOOD[what]})).imu
    assert imu is not None
    assert imu.t.tolist() == [0.0, 1.0] and imu.gz.tolist() == [1.0, 2.0]


def test_absent_readings_are_nan_and_only_stamps_must_be_there(tmp_path: Path) -> None:
    run = read_run(folder(tmp_path, {"run.json": OK, "imu.csv": "t,gz,ax\n0,nan,\n1,,2\n2,3,NaN\n"}))
    assert run.imu is not None and run.imu.ax is not None
    assert str(run.imu.gz.tolist()) == "[nan, nan, 3.0]" and str(run.imu.ax.tolist()) == "[nan, 2.0, nan]"


def test_unlisted_beacons_are_a_warning(tmp_path: Path) -> None:
    files: dict[str, str | bytes] = {
        "run.json": '{"format": "run/1", "beacons": {"A": [0, 0, 1]}}',
        "ranges.csv": "t,beacon,range\n0,A,1\n1,B,2\n",
    }
    with open_run(folder(tmp_path, files)) as source:
        rows = [b["beacon"].tolist() for s in source.streams() for b in s.batches()]
        assert rows == [[0, 1]]
        assert len(source.warnings) == 1 and "'B'" in source.warnings[0] and "ranges.csv" in source.warnings[0]


def parquet(**columns: Any) -> bytes:
    out = io.BytesIO()
    pl.DataFrame(columns).write_parquet(out)
    return out.getvalue()


SOUND = parquet(t=[0.0, 1.0], gz=[1.0, 2.0])
PARQUET = {
    "empty": (b"", "0 bytes"),
    "cut": (SOUND[:-10], None),
    "cut to a stub": (SOUND[:20], None),
    "garbage": (b"PAR1" + bytes(1000) + b"PAR1", None),
    "garbage inside": (SOUND[:10] + b"\xff" * 20 + SOUND[30:], None),
    "a CSV": (b"t,gz\n0,1\n", "b't,gz'"),
    "text for numbers": (parquet(t=[0.0], gz=["a"]), "String"),
    "lists": (parquet(t=[0.0], gz=[[1.0]]), "List(Float64)"),
    "truth values": (parquet(t=[0.0], gz=[True]), "Boolean"),
    "null stamp": (parquet(t=[0.0, None], gz=[1.0, 2.0]), "an empty cell"),
    "infinity": (parquet(t=[0.0], gz=[float("inf")]), "inf"),
    "repeated stamp": (parquet(t=[0.0, 0.0], gz=[1.0, 2.0]), "0.0"),
    "no rows": (parquet(t=pl.Series([], dtype=pl.Float64), gz=pl.Series([], dtype=pl.Float64)), "no row"),
    "too many columns": (parquet(**{f"c{i}": [1] for i in range(1200)}), "1200"),
}


@pytest.mark.parametrize("what", PARQUET)
def test_a_broken_parquet_file_is_refused(what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    content, found = PARQUET[what]
    error = table(tmp_path, content, "imu.parquet")
    assert error.where["file"] == "imu.parquet" and error.where["stream"] == "imu"
    assert found is None or str(error.where["found"]) == found


def test_integers_halves_and_all_null_columns_are_numbers(tmp_path: Path) -> None:
    content = parquet(t=[0, 1], gz=pl.Series([1.0, 2.0], dtype=pl.Float16), ax=[None, None])
    imu = read_run(folder(tmp_path, {"run.json": OK, "imu.parquet": content})).imu
    assert imu is not None and imu.ax is not None
    assert imu.t.dtype == "f8" and imu.gz.dtype == "f4" and imu.gz.tolist() == [1.0, 2.0]
    assert str(imu.ax.tolist()) == "[nan, nan]"


def test_sizes_are_limited_before_the_engine_sees_them(tmp_path: Path) -> None:
    cases: dict[str, str] = {
        "header": "t," + "gz," * 10_000_000,
        "columns": ",".join(f"c{i}" for i in range(5000)) + "\n",
        "line": "t,gz\n0,1\n1," + "1" * 10_000_000 + "\n",
        "no line ends": "t,gz\n" + "1" * 10_000_000,
    }
    for name, content in cases.items():
        (tmp_path / name).mkdir()
        assert isinstance(table(tmp_path / name, content), TooLargeError), name


def test_a_quote_that_never_ends_is_found_before_the_engine_holds_the_rest(tmp_path: Path) -> None:
    error = table(tmp_path, 't,gz\n0,1\n1,"2\n' + "3,4\n" * 3_000_000)
    assert error.where["row"] == 2 and "a quote that does not end" in str(error.where["found"])


def test_rows_and_names_are_limited(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    many = "t,beacon,range\n" + "".join(f"{i},B{i},1\n" for i in range(50))
    assert isinstance(table(tmp_path / "a", many, "ranges.csv", limits=Limits(max_names=10)), TooLargeError)
    assert isinstance(table(tmp_path, "t,gz\n0,1\n1,1\n2,1\n", limits=Limits(max_rows=2)), TooLargeError)


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({"imu.csv": "t,gz\n0,1\n"}, "no run.json"),
        ({"run.json": OK}, "no stream"),
        ({"run.json": OK, "odom.csv": "t\n"}, "'odom.csv' is no stream"),
        ({"run.json": OK, "IMU.CSV": "t,gz\n0,1\n"}, "'IMU.CSV' is no stream"),
        ({"run.json": OK, "imu.csv": "t,gz\n0,1\n", "imu.parquet": SOUND}, "both imu.csv and imu.parquet"),
    ],
)
def test_a_folder_must_hold_a_description_and_one_table_per_stream(
    files: dict[str, str | bytes], told: str, tmp_path: Path
) -> None:
    assert told in refusal(folder(tmp_path, files)).message


def test_other_files_are_left_alone_and_told(tmp_path: Path) -> None:
    run = folder(tmp_path, {"run.json": OK, "imu.csv": "t,gz\n0,1\n", "notes.txt": "hi", ".DS_Store": "x"})
    (run / "pictures").mkdir()
    with open_run(run) as source:
        assert source.warnings == ("file 'notes.txt' was ignored: not part of a run", "folder 'pictures' was ignored")


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89PNG\r\n\x1a\n", bytes(5000)])
def test_what_is_no_format_is_refused(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "thing.bin"
    file.write_bytes(content)
    assert refusal(file).code == "unknown_format"
    assert refusal(tmp_path / "nowhere.zip").code == "unknown_format"
