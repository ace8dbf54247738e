"""Tasks of invented kinds of jobs, run by real workers."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np

from app.jobs.tasks import Progress
from core.errors import FormatError


def nap(data: Path, progress: Progress, *, seconds: float) -> dict[str, Any]:
    """Sleeps and says how far it is; leaves its process id in `pid`."""
    (data / "pid").write_text(str(os.getpid()))
    steps = max(int(seconds / 0.02), 1)
    for i in range(steps):
        progress(i / steps, f"step {i}")
        time.sleep(0.02)
    return {"slept": seconds}


def deaf(data: Path, progress: Progress, *, seconds: float) -> dict[str, Any]:
    """Never asks whether to stop."""
    (data / "pid").write_text(str(os.getpid()))
    time.sleep(seconds)
    return {}


def die(data: Path, progress: Progress, *, times: int) -> dict[str, Any]:
    """Kills its own worker so many times, counted in a file."""
    count = data / "deaths"
    deaths = int(count.read_text()) if count.exists() else 0
    if deaths < times:
        count.write_text(str(deaths + 1))
        os.kill(os.getpid(), signal.SIGKILL)
    return {"deaths": deaths}


def swallow(data: Path, progress: Progress, *, gigabytes: float) -> dict[str, Any]:
    """Takes memory, as a hostile file would."""
    held = []
    for _ in range(int(gigabytes * 64)):
        held.append(np.ones(1 << 21))  # 16 MiB
    return {"held": len(held)}


def refuse(data: Path, progress: Progress) -> dict[str, Any]:
    """Finds the input at fault."""
    raise FormatError("imu.csv: row 3, column gz: expected a number, found 'abc'", stream="imu", row=3, column="gz")


def crash(data: Path, progress: Progress) -> dict[str, Any]:
    """Has a fault of its own."""
    return {"never": 1 / 0}
