"""Run zip: the contents of a run folder, `sim/` included, in an archive, in its root or in one wrapping folder.

An archive is hostile until unpacked: names, kinds and the sizes that really come out are checked, never the sizes
that its directory claims.
"""

from __future__ import annotations

import errno
import io
import stat
import tempfile
import zipfile
import zlib
from contextlib import ExitStack
from pathlib import Path, PurePosixPath

from core.errors import FormatError, TooLargeError
from core.formats.base import Format, Opening, RunSource
from core.formats.checks import refuse, shown
from core.formats.limits import KIB, Limits
from core.formats.run_folder import DESCRIPTION, SIMULATED, TABLES, open_files, write_folder
from core.run import Run

CHUNK = 1 << 20
INSIDE = f"{SIMULATED}/"
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, ValueError, NotImplementedError, UnicodeDecodeError, OverflowError)


def open_zip(path: Path, opening: Opening) -> RunSource:
    """A run archive, unpacked into a temporary folder that goes when the source is closed."""
    label = opening.name or path.name
    with ExitStack() as cleanup:
        folder = Path(cleanup.enter_context(tempfile.TemporaryDirectory(prefix="run-", dir=opening.tmp)))
        files, ignored = _unpack(path, folder, label, opening.limits)
        source = open_files({n: f for n, f in files.items() if "/" not in n}, opening, label, "zip")
        beside = {n.removeprefix(INSIDE): f for n, f in files.items() if n.startswith(INSIDE)}
        if beside:
            source.simulated = open_files(beside, opening, f"{label}/{SIMULATED}", "zip", INSIDE)
        source.found += [f"file {name!r} was ignored: not part of a run" for name in ignored]
        source.cleanup = cleanup.pop_all()
    return source


class _Guarded(io.BufferedReader):
    """The archive's file; refuses to hand out a huge directory at once, which zipfile would parse in memory."""

    def __init__(self, path: Path, label: str, limits: Limits) -> None:
        super().__init__(io.FileIO(path))
        self.label, self.longest = label, max(limits.max_members * KIB, CHUNK)

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > self.longest:
            what = f"its directory takes {size:,} bytes; expected at most {self.longest:,}"
            refuse(self.label, what, kind=TooLargeError, expected=self.longest, found=size)
        return super().read(size)


def _unpack(path: Path, folder: Path, label: str, limits: Limits) -> tuple[dict[str, Path], list[str]]:
    try:
        with _Guarded(path, label, limits) as file, zipfile.ZipFile(file) as archive:
            members = _members(archive, label, limits)
            wanted, ignored = _choose(members, label)
            budget = _Budget(label, limits, path.stat().st_size)
            files = {}
            for i, (name, member) in enumerate(wanted.items()):
                files[name] = folder / f"{i}{PurePosixPath(name).suffix}"
                _extract(archive, member, files[name], budget)
            return files, ignored
    except FormatError:
        raise
    except (*BROKEN, OSError) as error:
        if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
            raise  # the machine's trouble (a full disk), not the file's; EINVAL is a seek to a place that cannot be
        reason = shown((str(error) or type(error).__name__).splitlines()[0], 200)
        refuse(label, f"the archive is damaged: {reason}", expected="a sound zip archive", found=reason)


def _members(archive: zipfile.ZipFile, label: str, limits: Limits) -> dict[str, zipfile.ZipInfo]:
    """The archive's files by name, each of them safe to unpack."""
    infos = archive.infolist()
    if len(infos) > limits.max_members:
        limit = limits.max_members
        refuse(
            label,
            f"expected at most {limit} files; found {len(infos)}",
            kind=TooLargeError,
            expected=f"at most {limit} files",
            found=len(infos),
        )
    members: dict[str, zipfile.ZipInfo] = {}
    for info in infos:
        # ZipInfo.filename is cut at a NUL and has this system's separators; the entry's own name counts.
        name = info.orig_filename
        parts = PurePosixPath(name).parts
        if not name or "\\" in name or "\0" in name or ":" in name or name.startswith("/") or ".." in parts:
            refuse(
                label,
                f"the entry {shown(name)} climbs out of the archive",
                member=name,
                expected="a plain relative path",
                found=name,
            )
        kind = stat.S_IFMT(info.external_attr >> 16)
        if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
            refuse(
                label,
                f"the entry {shown(name)} is a link or a device",
                member=name,
                expected="a file",
                found="a link or a device",
            )
        if info.is_dir():
            continue
        if info.flag_bits & 0x1:
            refuse(
                label, f"the entry {shown(name)} is encrypted", member=name, expected="no password", found="encryption"
            )
        if info.compress_type not in METHODS:
            refuse(
                label,
                f"the entry {shown(name)} is packed by method {info.compress_type}",
                member=name,
                expected="deflate or store",
                found=f"method {info.compress_type}",
            )
        if name in members:
            refuse(
                label, f"the entry {shown(name)} is there twice", member=name, expected="each entry once", found="twice"
            )
        members[name] = info
    return members


def _choose(members: dict[str, zipfile.ZipInfo], label: str) -> tuple[dict[str, zipfile.ZipInfo], list[str]]:
    """The run's files by name, from the folder that holds run.json; and what is left out."""
    visible = {
        n: m for n, m in members.items() if not any(p.startswith((".", "__MACOSX")) for p in PurePosixPath(n).parts)
    }
    roots = [str(PurePosixPath(n).parent) for n in visible if PurePosixPath(n).name == DESCRIPTION]
    if not roots:
        refuse(label, f"there is no {DESCRIPTION} in it", expected=DESCRIPTION, found=sorted(visible)[:50])
    shallow = min(roots, key=lambda root: len(PurePosixPath(root).parts))
    beside = str(PurePosixPath(shallow) / SIMULATED)
    roots = [root for root in roots if root != beside or root == shallow]
    if len(roots) > 1:
        refuse(
            label,
            f"it holds {len(roots)} runs; pack each one by itself",
            expected=f"one {DESCRIPTION}",
            found=sorted(roots)[:50],
        )
    root = roots[0]
    if len(PurePosixPath(root).parts) > 1:
        refuse(
            label,
            f"{DESCRIPTION} is buried in {shown(root)}",
            expected="the files in the root or in one folder",
            found=root,
        )
    folders = {root: "", beside: INSIDE} if f"{beside}/{DESCRIPTION}" in visible else {root: ""}
    wanted = {}
    for n, m in visible.items():
        path = PurePosixPath(n)
        if str(path.parent) in folders and (path.name == DESCRIPTION or path.suffix.lower() in TABLES):
            wanted[folders[str(path.parent)] + path.name] = m
    kept = {m.orig_filename for m in wanted.values()}
    stray = [n for n in visible if n not in kept]
    for name in stray:
        if PurePosixPath(name).suffix.lower() in TABLES:
            refuse(
                label,
                f"the table {shown(name)} is not beside {DESCRIPTION}",
                member=name,
                expected="all tables beside run.json",
                found=name,
            )
    return wanted, sorted(stray)


class _Budget:
    """Counts what really comes out of an archive, against its limits."""

    def __init__(self, label: str, limits: Limits, packed: int) -> None:
        self.label, self.limits, self.packed, self.total = label, limits, max(packed, 1), 0

    def spend(self, name: str, size: int) -> None:
        self.total += size
        limits = self.limits
        if self.total > limits.max_unpacked_bytes:
            self._over(name, f"at most {limits.max_unpacked_bytes:,} bytes unpacked", "more")
        if self.total > limits.ratio_free_bytes and self.total > limits.max_ratio * self.packed:
            self._over(
                name, f"at most {limits.max_ratio:g} times its packed size", f"over {self.total // self.packed} times"
            )

    def _over(self, name: str, expected: str, found: str) -> None:
        refuse(
            self.label,
            f"the entry {shown(name)} unpacks to too much: expected {expected}; found {found}",
            kind=TooLargeError,
            member=name,
            expected=expected,
            found=found,
        )


def _extract(archive: zipfile.ZipFile, member: zipfile.ZipInfo, path: Path, budget: _Budget) -> None:
    try:
        with archive.open(member) as packed, path.open("wb") as out:
            while chunk := packed.read(CHUNK):
                budget.spend(member.filename, len(chunk))
                out.write(chunk)
    except (*BROKEN, RuntimeError) as error:
        name = member.filename
        reason = shown(str(error) or "it ends too early", 200)
        refuse(
            budget.label,
            f"the entry {shown(name)} is damaged: {reason}",
            member=name,
            expected="a sound entry",
            found=reason,
        )


def write_csv(run: Run, path: Path, simulated: Run | None = None) -> None:
    """Write a run archive of CSV files."""
    _write(run, path, ".csv", simulated)


def write_parquet(run: Run, path: Path, simulated: Run | None = None) -> None:
    """Write a run archive of parquet files."""
    _write(run, path, ".parquet", simulated)


def _write(run: Run, path: Path, suffix: str, simulated: Run | None) -> None:
    with tempfile.TemporaryDirectory(prefix="run-", dir=path.parent) as folder:
        write_folder(run, Path(folder), suffix, simulated)
        with zipfile.ZipFile(path, "w") as archive:
            for file in sorted(f for f in Path(folder).rglob("*") if f.is_file()):
                # Parquet is packed already. A fixed date makes the same run the same archive.
                method = zipfile.ZIP_STORED if file.suffix == ".parquet" else zipfile.ZIP_DEFLATED
                info = zipfile.ZipInfo(file.relative_to(folder).as_posix(), (1980, 1, 1, 0, 0, 0))
                info.compress_type, info.external_attr = method, 0o644 << 16
                with file.open("rb") as source, archive.open(info, "w", force_zip64=True) as out:
                    while chunk := source.read(CHUNK):
                        out.write(chunk)


FORMAT = Format(
    name="zip",
    label="zipped run folder",
    suffixes=(".zip",),
    sniff=lambda name, head: head is not None and head.startswith((b"PK\x03\x04", b"PK\x05\x06")),
    open=open_zip,
    write={"zip-csv": write_csv, "zip-parquet": write_parquet},
)
