"""How long a 12-hour run at 384 Hz takes to read, to check and to write as column files, against polars alone.

Run by hand: `python tests/bench/bench_ingest.py`. Makes a CSV of 16.6 million rows (t, gz; about 400 MB) and its
parquet twin in a temporary folder, from a fixed seed. Each figure is the best of three subprocesses, with its peak
memory.
"""

from __future__ import annotations

import hashlib
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

HOURS, RATE = 12, 384
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from app.ingest import IngestOptions, ingest_file  # noqa: E402
from core.formats import open_run  # noqa: E402


def make(folder: Path) -> None:
    """The run as CSV and as parquet."""
    n = HOURS * 3600 * RATE
    noise = np.random.default_rng(384)
    gz = np.cumsum(noise.normal(0.0, 1e-6, n)) + noise.normal(0.0, 1e-3, n)
    frame = pl.DataFrame({"t": np.arange(n) / RATE, "gz": gz}).with_columns(pl.col("t").round(6), pl.col("gz").round(9))
    for suffix in ("csv", "parquet"):
        run = folder / suffix
        run.mkdir()
        (run / "run.json").write_text('{"format": "run/1", "name": "12 h at 384 Hz"}')
    frame.write_csv(folder / "csv" / "imu.csv")
    frame.write_parquet(folder / "parquet" / "imu.parquet")


def polars_csv(folder: Path) -> int:
    return pl.read_csv(folder / "csv" / "imu.csv").height


def polars_parquet(folder: Path) -> int:
    return pl.read_parquet(folder / "parquet" / "imu.parquet").height


def read(run: Path, out: Path | None = None) -> int:
    """Our reader with all its checks; with `out`, hashing and raw column files too."""
    rows = 0
    with open_run(run) as source:
        for stream in source.streams():
            files = {name: (out / name).open("wb") for name in stream.columns} if out else {}
            hashes = {name: hashlib.sha256() for name in files}
            for batch in stream.batches():
                rows += batch["t"].size
                for name, file in files.items():
                    file.write(batch[name])
                    hashes[name].update(batch[name])
            for file in files.values():
                file.close()
    return rows


def write_columns(folder: Path, suffix: str) -> int:
    with tempfile.TemporaryDirectory(dir=folder) as out:
        return read(folder / suffix, Path(out))


def store(folder: Path) -> int:
    """The whole import, as the dashboard does it."""
    with tempfile.TemporaryDirectory(dir=folder) as data:
        ingest_file(Path(data), folder / "csv" / "imu.csv", IngestOptions("imu.csv"))
    return HOURS * 3600 * RATE


PARTS = {
    "polars read_csv": polars_csv,
    "open_run, CSV": lambda folder: read(folder / "csv"),
    "open_run, CSV, to column files": lambda folder: write_columns(folder, "csv"),
    "import of the CSV": store,
    "polars read_parquet": polars_parquet,
    "open_run, parquet": lambda folder: read(folder / "parquet"),
    "open_run, parquet, to column files": lambda folder: write_columns(folder, "parquet"),
}


def measure(folder: Path, part: str) -> dict[str, float]:
    best: dict[str, float] = {}
    for _ in range(3):
        command = [sys.executable, __file__, str(folder), part]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        figures = json.loads(done.stdout)
        best = figures if not best or figures["s"] < best["s"] else best
    return best


def run_part(folder: Path, part: str) -> None:
    start = time.perf_counter()
    rows = PARTS[part](folder)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"rows": rows, "s": seconds, "mb": peak}))


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([sys.executable, __file__, name, "make"], check=True)  # a child's peak starts at its parent's
        size = (folder / "csv" / "imu.csv").stat().st_size / 1e6
        print(f"{HOURS} h at {RATE} Hz, {HOURS * 3600 * RATE:,} rows, CSV {size:.0f} MB")
        reference: dict[str, float] = {}
        for part in PARTS:
            figures = measure(folder, part)
            reference = figures if part.startswith("polars") else reference
            ratio = figures["s"] / reference["s"]
            print(f"{part:36} {figures['s']:6.2f} s  {ratio:5.2f} x polars  peak {figures['mb']:5.0f} MB")


if __name__ == "__main__":
    if sys.argv[2:] == ["make"]:
        make(Path(sys.argv[1]))
    elif len(sys.argv) == 3:
        run_part(Path(sys.argv[1]), sys.argv[2])
    else:
        main()
