"""Wheel counters that wrap round or jump: found by steps that no wheel can make, named, and put right.

A counter that wraps leaps by its modulus (a turn, or two to the power of its bits in ticks) against the motion, so that
its readings stay within it. Any other leap is a fault of the counter: the wheel is taken to have gone on as before it.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.run import Run
from core.sensors import WheelLog

Array = npt.NDArray[np.float64]

BITS = (8, 10, 12, 14, 15, 16, 20, 24, 31, 32)
NEAR = 0.1  # share of the modulus that a wrap's leap may differ from it: the motion meanwhile
FEWEST = 20  # readings


def counters(run: Run, numbers: Assumptions) -> tuple[Run, tuple[str, ...]]:
    """The run with both wheels' readings cumulative, and a sentence on each wheel that was mended."""
    wheels, radius = run.wheels, run.meta.robot.wheel_radius
    if wheels is None or not radius or len(wheels) < FEWEST:
        return run, ()
    mended, notes = {}, []
    for name in ("left", "right"):
        column = np.asarray(getattr(wheels, name), np.float64)
        fastest = numbers.top_speed / radius * np.maximum(np.diff(wheels.t), 0.01)
        mended[name], said = _mended(wheels.t, column, fastest, run.meta.robot.ticks_per_rev)
        if said:
            notes.append(f"The {name} encoder {said}")
    return (dataclasses.replace(run, wheels=WheelLog(wheels.t, **mended)), tuple(notes)) if notes else (run, ())


def _mended(t: Array, column: Array, fastest: Array, ticks: float | None) -> tuple[Array, str]:
    step = np.diff(column)
    if not np.isfinite(step).all():
        return column, ""
    usual = float(np.quantile(np.abs(step[step != 0]), 0.9)) if step.any() else 0.0  # at rest a counter stands
    span = float(np.ptp(column))
    leap = np.abs(step) > np.minimum(fastest, max(0.5 * span, 10.0 * usual))
    if not leap.any() or leap.sum() > 0.2 * len(step):
        return column, ""
    modulus = _modulus(step[leap], span, ticks)
    before = np.where(leap, 0.0, step)
    if modulus:
        step = np.where(leap, step - modulus * np.round(step / modulus), step)
        said = f"wraps round at {modulus:.6g} rad ({int(leap.sum())} times): unrolled."
    else:
        calm = np.flatnonzero(~leap)
        at = np.flatnonzero(leap)
        step = before.copy()
        step[at] = before[calm[np.clip(np.searchsorted(calm, at) - 1, 0, len(calm) - 1)]]
        said = f"jumps {at.size} times, first by {np.diff(column)[at[0]]:.3g} rad at {t[at[0] + 1]:.2f} s: taken out."
    return column[0] + np.concatenate(([0.0], np.cumsum(step))), said


def _modulus(leaps: Array, span: float, ticks: float | None) -> float | None:
    """What all leaps are near to, if a counter may have it and the readings stay within it."""
    known = [2 * math.pi] + ([2.0**bits / ticks * 2 * math.pi for bits in BITS] if ticks else [])
    for modulus in known:
        if span <= modulus * (1 + 1e-6) and (np.abs(np.abs(leaps) - modulus) < NEAR * modulus).all():
            return modulus
    return None
