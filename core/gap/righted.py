"""Readings in wrong units, counters that wrap, maps that are mirrored: put right before a gap is looked for in them."""

from __future__ import annotations

from collections.abc import Sequence

from core.estimation.assumptions import assume
from core.estimation.sanity import MENDING, sound
from core.run import Run


def righted(runs: Sequence[Run]) -> tuple[list[Run], tuple[str, ...]]:
    """The runs as the estimators read them, and a note on each mistake: such a one is the file's, not the robot's."""
    out, notes = [], []
    for k, run in enumerate(runs, start=1):
        mended, said = sound(run, assume(run)[0], MENDING)
        out.append(mended if said else run)
        notes += [f"{run.meta.name or f'run {k}'}: {sentence}" for sentence in said]
    return out, tuple(notes)
