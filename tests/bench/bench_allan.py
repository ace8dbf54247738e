"""16.6 million readings (12 h at 384 Hz): Allan deviation at 60 averaging times against allantools in the same process,
and every bias method against the time of reading the run's file."""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import allantools
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from core.formats import read_run, write_run
from core.imu.allan import allan_of, default_factors
from core.imu.bias import METHODS, track_bias
from core.imu.grid import to_grid
from core.run import Run
from tests.plants.gyro import SCENARIOS, Scenario, gyro_plant


def timed(work: Callable[[], object], repeat: int = 2) -> float:
    """Seconds of the fastest of `repeat` runs."""
    best = np.inf
    for _ in range(repeat):
        began = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - began)
    return best


def main() -> None:
    warm = gyro_plant(0, Scenario(hours=0.2, rate=48.0)).run()
    for method in METHODS:
        track_bias(warm, method)  # compiled before anything is timed
    run = gyro_plant(1, SCENARIOS["paper"]).run()
    assert run.imu is not None
    n = len(run.imu)
    record = to_grid(run.imu.t, run.imu.gz)
    taus = default_factors(n, 2) * record.tau0
    ours = timed(lambda: allan_of(record, taus=taus))
    peer = timed(lambda: allantools.oadev(run.imu.gz, rate=1 / record.tau0, data_type="freq", taus=taus), 1)  # type: ignore[union-attr]
    print(f"{n} readings, {len(taus)} averaging times: {ours:.2f} s; allantools {peer:.2f} s, {peer / ours:.1f} times")
    with tempfile.TemporaryDirectory() as folder:
        for kind in ("folder-parquet", "folder-csv"):
            path = Path(folder) / kind
            write_run(Run(run.meta, imu=run.imu), path, kind)
            print(f"reading {kind}: {timed(lambda path=path: read_run(path), 1):.2f} s")  # type: ignore[misc]
    for method in METHODS:
        print(f"{method}: {timed(lambda method=method: track_bias(run, method)):.2f} s")  # type: ignore[misc]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(f"peak memory of all this: {peak / 1e9:.2f} GB, one array of readings is {n * 8 / 1e9:.2f} GB")


if __name__ == "__main__":
    main()
