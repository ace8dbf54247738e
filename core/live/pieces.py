"""A recorded run in pieces, as a robot would send it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from core.run import Run


def pieces(run: Run, seconds: float) -> Iterator[Run]:
    """The run's rows in spans of so many seconds, in order; streams without a row in a span are absent from it."""
    t0, t1 = run.span
    empty: dict[str, Any] = dict.fromkeys(run.logs())
    for k in range(int((t1 - t0) / seconds) + 1):
        begin, end = t0 + k * seconds, float(np.nextafter(t0 + (k + 1) * seconds, -np.inf))
        logs = {name: log.crop(begin, end) for name, log in run.logs().items()}
        yield dataclasses.replace(run, **(empty | {name: log for name, log in logs.items() if len(log)}))
