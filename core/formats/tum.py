"""TUM trajectory: lines of `t x y z qx qy qz qw`, blanks between, `#` starts a comment. Read as `truth`.

https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats. The quaternion's scalar comes last here.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import polars as pl

from core.formats.base import ENGINE_ERRORS, MAX_EPOCHLESS_S, Format, Opening, RunSource
from core.formats.checks import refuse, shown
from core.formats.streams import native_stream
from core.run import RunMeta
from core.sensors import STREAMS
from core.trajectory import Trajectory

FIELDS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")


class TumTable:
    """An opened TUM file as a table of t, x, y, theta; see `core.formats.base.Table`."""

    typed = False
    names: tuple[str, ...] = ("t", "x", "y", "theta")

    def __init__(self, path: Path, file: str) -> None:
        self.path, self.file = path, file
        self.origin = 0.0

    def dtypes(self) -> Mapping[str, pl.DataType]:
        """All numbers."""
        return dict.fromkeys(self.names, pl.Float64())

    def scan(self, numbers: tuple[str, ...], texts: tuple[str, ...], *, count_rows: str | None = None) -> pl.LazyFrame:
        """Stamps, positions, and the heading of each orientation (its turn about z)."""
        cells = self._cells().select(pl.col(name).cast(pl.Float64) for name in FIELDS)
        qx, qy, qz, qw = (pl.col(name) for name in FIELDS[4:])
        theta = pl.arctan2(2 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
        columns = {"t": pl.col("t") - self.origin, "x": pl.col("x"), "y": pl.col("y"), "theta": theta}
        return cells.select(columns[name].alias(name) for name in numbers)

    def explain(self, error: BaseException | None, stream: str | None) -> None:
        """Find the first line that has not eight numbers."""
        self.check_shape(stream)
        if error is not None:
            reason = shown(str(error).splitlines()[0], 200)
            refuse(self.file, f"the trajectory cannot be read: {reason}", stream=stream, found=reason)

    def check_shape(self, stream: str | None) -> None:
        """Raise at the first line that has not eight numbers."""
        numbers = [pl.col(name).cast(pl.Float64, strict=False) for name in FIELDS]
        wrong = pl.any_horizontal(n.is_null() for n in numbers) | pl.col("rest")
        try:
            found = self._cells().with_row_index("row").filter(wrong).head(1).collect(engine="streaming")
        except ENGINE_ERRORS as error:
            reason = shown(str(error).splitlines()[0], 200)
            refuse(
                self.file,
                f"expected lines of UTF-8 text; found {reason}",
                stream=stream,
                expected="UTF-8 text",
                found=reason,
            )
        if found.height:
            line = shown(found["line"][0])
            expected = f"8 numbers: {' '.join(FIELDS)}"
            refuse(
                self.file,
                f"expected {expected}; found {line}",
                stream=stream,
                row=int(found["row"][0]) + 1,
                expected=expected,
                found=line,
            )

    def cell(self, row: int, column: str) -> str | None:
        """Lines are shown whole, by `check_shape`."""
        return None

    def head(self, rows: int) -> list[tuple[str | None, ...]]:
        """The first rows as text."""
        return self.scan(self.names, ()).head(rows).select(pl.all().cast(pl.String)).collect().rows()

    def _cells(self) -> pl.LazyFrame:
        line = pl.col("line").str.strip_chars()
        lines = pl.scan_lines(self.path, name="line", glob=False).select(line)
        lines = lines.filter(line != "", ~line.str.starts_with("#"))
        fields = (
            line.str.replace_all(r"[\s,]+", " ")
            .str.splitn(" ", len(FIELDS) + 1)
            .struct.rename_fields([*FIELDS, "rest"])
        )
        return lines.select("line", fields.alias("fields")).unnest("fields").with_columns(pl.col("rest").is_not_null())


def open_tum(path: Path, opening: Opening) -> RunSource:
    """A trajectory as the truth of a run that has nothing else. Epoch stamps are counted from the first one."""
    file = opening.name or path.name
    table = TumTable(path, file)
    table.check_shape("truth")
    first = table.scan(("t",), ()).head(1).collect()
    warnings = []
    if first.height and abs(first.item()) > MAX_EPOCHLESS_S:
        table.origin = first.item()
        warnings.append(f"{file}: stamps are counted from the first one, {table.origin!r}")
    stream = native_stream(STREAMS["truth"], table, opening.limits)
    return RunSource(file, "tum", RunMeta(name=Path(file).stem), (stream,), warnings)


def write_tum(trajectory: Trajectory, path: Path) -> None:
    """Write a trajectory; where the heading is unknown the orientation is the identity, and a comment says so."""
    known = ~(np.isnan(trajectory.x) | np.isnan(trajectory.y))
    headless = np.isnan(trajectory.theta) & known
    theta = np.nan_to_num(trajectory.theta)
    zero = np.zeros(len(trajectory))
    columns = (trajectory.t, trajectory.x, trajectory.y, zero, zero, zero, np.sin(theta / 2), np.cos(theta / 2))
    frame = pl.DataFrame(dict(zip(FIELDS, columns, strict=True))).filter(known)
    with path.open("wb") as out:
        out.write(f"# {' '.join(FIELDS)}\n".encode())
        if headless.any():
            out.write(b"# the heading is unknown in some lines: their orientation is the identity\n")
        frame.write_csv(out, include_header=False, separator=" ")


FORMAT = Format(
    name="tum",
    label="TUM trajectory",
    suffixes=(".tum",),
    sniff=lambda name, head: head is not None and head.startswith(b"#") and b"qx qy qz qw" in head[:400],
    open=open_tum,
)
