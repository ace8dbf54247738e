"""Archives are hostile until unpacked."""

from __future__ import annotations

import io
import stat
import struct
import zipfile
from pathlib import Path

import pytest

from core.errors import FormatError, TooLargeError
from core.formats import Limits, open_run, read_run

OK = {"run.json": b'{"format": "run/1"}', "imu.csv": b"t,gz\n0,1\n1,2\n"}


def pack(path: Path, entries: dict[str, bytes] | list[tuple[str, bytes]], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in entries.items() if isinstance(entries, dict) else entries:
            archive.writestr(name, content)
    return path


def refusal(path: Path, limits: Limits | None = None) -> FormatError:
    before = set(path.parent.iterdir())
    with pytest.raises(FormatError) as caught, open_run(path, limits=limits, tmp=path.parent) as source:
        for stream in source.streams():
            list(stream.batches())
    assert set(path.parent.iterdir()) == before  # nothing stays, nothing was put beside
    return caught.value


@pytest.mark.parametrize("prefix", ["", "corridor lap 3/", "./"])
def test_root_or_one_wrapping_folder(prefix: str, tmp_path: Path) -> None:
    junk = {"__MACOSX/._run.json": b"x", f"{prefix}.DS_Store": b"x"}
    run = read_run(pack(tmp_path / "run.zip", {f"{prefix}{n}": c for n, c in OK.items()} | junk))
    assert run.imu is not None and run.imu.gz.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    "name", ["../evil.csv", "/etc/evil.csv", "a/../../evil.csv", "..\\evil.csv", "C:\\evil.csv", "C:evil.csv", "a\\b"]
)
def test_entries_that_climb_out_are_refused(name: str, tmp_path: Path) -> None:
    info = zipfile.ZipInfo("x")
    info.filename = info.orig_filename = name
    path = pack(tmp_path / "run.zip", OK)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(info, b"t,gz\n0,1\n")
    error = refusal(path)
    assert "climbs out" in error.message and error.where["member"] == name


def test_links_and_devices_are_refused(tmp_path: Path) -> None:
    for i, kind in enumerate((stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR)):
        path = pack(tmp_path / f"{i}.zip", {"run.json": OK["run.json"]})
        info = zipfile.ZipInfo("imu.csv")
        info.external_attr = (kind | 0o777) << 16
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(info, b"/etc/passwd")
        assert "link or a device" in refusal(path).message


@pytest.mark.filterwarnings("ignore:Duplicate name:UserWarning")
def test_duplicate_entries_are_refused(tmp_path: Path) -> None:
    path = pack(tmp_path / "run.zip", [*OK.items(), ("imu.csv", b"t,gz\n0,9\n")])
    assert "there twice" in refusal(path).message


def test_encrypted_entries_are_refused(tmp_path: Path) -> None:
    data = bytearray(pack(tmp_path / "plain.zip", OK).read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = data.find(signature)
        data[at + offset] |= 1
    (tmp_path / "run.zip").write_bytes(data)
    assert "encrypted" in refusal(tmp_path / "run.zip").message


def test_unusual_packing_is_refused(tmp_path: Path) -> None:
    assert "packed by method 14" in refusal(pack(tmp_path / "run.zip", OK, zipfile.ZIP_LZMA)).message


@pytest.mark.parametrize("keep", [0.3, 0.7, 0.98])
def test_a_truncated_archive_is_refused(keep: float, tmp_path: Path) -> None:
    data = pack(tmp_path / "whole.zip", OK | {"wheels.csv": b"t,left,right\n0,1,2\n"}).read_bytes()
    (tmp_path / "run.zip").write_bytes(data[: int(keep * len(data))])
    assert "damaged" in refusal(tmp_path / "run.zip").message


def test_a_wrong_checksum_is_refused(tmp_path: Path) -> None:
    data = bytearray(pack(tmp_path / "whole.zip", OK, zipfile.ZIP_STORED).read_bytes())
    data[data.find(b"0,1\n")] = ord("7")
    (tmp_path / "run.zip").write_bytes(data)
    error = refusal(tmp_path / "run.zip")
    assert "damaged" in error.message and error.where["member"] == "imu.csv"


def test_a_bomb_is_stopped_by_what_comes_out_not_by_what_it_claims(tmp_path: Path) -> None:
    content = b"t,gz\n" + b"0" * 8_000_000
    path = pack(tmp_path / "run.zip", OK | {"wheels.csv": content})
    small = Limits(ratio_free_bytes=1_000_000)
    assert isinstance(refusal(path, small), TooLargeError)
    assert isinstance(refusal(path, Limits(max_unpacked_bytes=1_000_000)), TooLargeError)
    # the same with a directory that claims 10 bytes
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        at = data.rfind(signature, 0, len(data)) if signature == b"PK\x01\x02" else data.find(b"wheels.csv") - 30
        data[at + offset : at + offset + 4] = struct.pack("<I", 10)
    (tmp_path / "liar.zip").write_bytes(data)
    assert refusal(tmp_path / "liar.zip", small).code in ("too_large", "format")


def test_many_entries_are_refused(tmp_path: Path) -> None:
    path = pack(tmp_path / "run.zip", OK | {f"{i}.txt": b"" for i in range(50)})
    assert isinstance(refusal(path, Limits(max_members=20)), TooLargeError)


def test_a_huge_directory_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    path = pack(tmp_path / "run.zip", OK | {f"{i:0200d}": b"" for i in range(8000)})
    error = refusal(path)
    assert isinstance(error, TooLargeError) and "directory" in error.message


@pytest.mark.parametrize(
    ("entries", "told"),
    [
        ({}, "no run.json"),
        ({"imu.csv": OK["imu.csv"]}, "no run.json"),
        ({"a/b/run.json": OK["run.json"], "a/b/imu.csv": OK["imu.csv"]}, "buried"),
        ({f"{d}/{n}": c for d in "ab" for n, c in OK.items()}, "holds 2 runs"),
        (OK | {"more/wheels.csv": b"t,left,right\n0,1,2\n"}, "not beside run.json"),
        (OK | {"imu.parquet": b"PAR1"}, "both imu.csv and imu.parquet"),
        ({"run.json": OK["run.json"]}, "no stream"),
    ],
)
def test_its_contents_must_be_one_run(entries: dict[str, bytes], told: str, tmp_path: Path) -> None:
    assert told in refusal(pack(tmp_path / "run.zip", entries)).message


def test_an_error_inside_names_the_member_and_the_row(tmp_path: Path) -> None:
    error = refusal(pack(tmp_path / "run.zip", OK | {"imu.csv": b"t,gz\n0,1\n1,x\n"}))
    assert (error.where["file"], error.where["row"], error.where["column"]) == ("imu.csv", 2, "gz")


def test_other_files_are_left_packed_and_told(tmp_path: Path) -> None:
    path = pack(tmp_path / "run.zip", OK | {"README.md": b"hi"})
    with open_run(path, tmp=tmp_path) as source:
        assert source.warnings == ("file 'README.md' was ignored: not part of a run",)
        unpacked = [f for f in tmp_path.rglob("*") if f.is_file() and f != path]
        assert sorted(f.suffix for f in unpacked) == [".csv", ".json"]


def test_an_archive_in_an_archive_is_not_opened(tmp_path: Path) -> None:
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w") as archive:
        archive.writestr("run.json", OK["run.json"])
    assert "no run.json" in refusal(pack(tmp_path / "run.zip", {"run.zip": inner.getvalue()})).message
