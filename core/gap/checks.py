"""What a diagnosis refuses, in words that say what would do instead."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.errors import MissingStreamError, NotEnoughDataError, ParameterError
from core.robot import EffectSet
from core.run import Run

Array = npt.NDArray[np.float64]

SHORTEST = 4.0
"""Seconds of data below which nothing can be said."""
LEAST_WAY = 0.1
"""Least driving [m, or rad of turning] of all runs together."""


def check_runs(runs: Sequence[Run], held_out: Sequence[Run]) -> None:
    """Raises ParameterError, MissingStreamError or NotEnoughDataError."""
    if not runs:
        raise NotEnoughDataError("a diagnosis needs at least one run")
    for run in (*runs, *held_out):
        _drivable(run)
    first = runs[0].meta
    for k, run in enumerate((*runs[1:], *held_out), start=2):
        if run.meta.robot != first.robot:
            raise ParameterError(
                f"run {k} ({run.meta.name}) is of another robot than run 1: its robot in run.json differs",
                parameter="runs",
                expected=str(first.robot),
                found=str(run.meta.robot),
            )
        for name in ("commands", "wheels"):
            one, other = (getattr(given, name) is None for given in (runs[0], run))
            if one != other:
                raise MissingStreamError(
                    f"run {1 if one else k} ({runs[0].meta.name if one else run.meta.name}) has no {name}, run "
                    f"{k if one else 1} has: the chain must begin alike in all; diagnose them apart",
                    method="diagnose",
                    missing=[name],
                )
        if run.meta.effects != first.effects:
            raise ParameterError(
                f"run {k} ({run.meta.name}) names another simulator than run 1: simulator.effects differ",
                parameter="runs",
            )
    for k, run in enumerate(held_out):
        if any(_same(run, other) for other in runs):
            raise ParameterError(
                f"held-out run {k + 1} ({run.meta.name}) was also given to fit; give a run that was not",
                parameter="held_out",
            )
    _moving(runs)


def check_tolerances(given: Mapping[str, float], name: str = "tolerances") -> None:
    """Sizes by "effect.parameter"; `name` is what the user calls them. Raises ParameterError."""
    for key, size in given.items():
        effect, _, parameter = key.partition(".")
        known = {p.name: p for p in EFFECTS[effect].parameters} if effect in EFFECTS else {}
        if parameter not in known:
            raise ParameterError(
                f"{name}: there is no {key!r}; expected effect.parameter, as track_width.scale",
                parameter=f"{name}.{key}",
                found=key,
            )
        if known[parameter].small is None:
            sized = [f"{effect}.{p.name}" for p in known.values() if p.small is not None]
            raise ParameterError(
                f"{name}: {key} has no size that matters by itself; set {' or '.join(sized) or 'another effect'}",
                parameter=f"{name}.{key}",
                expected=sized,
                found=key,
            )
        if not (math.isfinite(size) and size > 0.0):
            raise ParameterError(
                f"{name}: {key} must be a size above 0, found {size:g}", parameter=f"{name}.{key}", found=size
            )


def _drivable(run: Run) -> None:
    if run.commands is None and run.wheels is None:
        raise MissingStreamError(
            f"{run.meta.name or 'the run'} has neither commands nor wheels: nothing to drive the simulator by",
            method="diagnose",
            missing=["commands", "wheels"],
        )
    missing = [name for name in ("wheel_radius", "track_width") if getattr(run.meta.robot, name) is None]
    if missing:
        raise MissingStreamError(
            f"the simulator needs the robot's {' and '.join(missing)}; add it to run.json",
            method="diagnose",
            missing=[f"robot.{name}" for name in missing],
        )
    others = [run.wheels if run.commands is not None else None, run.imu, run.beacon, run.ranges, run.truth]
    if not any(log is not None and len(log) > 3 for log in others):
        raise MissingStreamError(
            f"{run.meta.name or 'the run'} has no stream to compare with the simulator",
            method="diagnose",
            missing=["wheels", "imu", "beacon", "ranges", "truth"],
        )
    logs = {name: log for name, log in run.logs().items() if len(log)}
    spans = {name: (float(log.t[0]), float(log.t[-1])) for name, log in logs.items()}
    lead = spans.get("commands") or spans.get("wheels")
    for name, (a, b) in spans.items():
        if lead is not None and (a > lead[1] or b < lead[0]):
            raise ParameterError(
                f"{name} of {run.meta.name or 'the run'} lies at {a:.1f} to {b:.1f} s, the drive at {lead[0]:.1f} to "
                f"{lead[1]:.1f} s: their clocks do not match",
                parameter=f"{name}.t",
            )
    for name, log in logs.items():
        for column, values in log.columns().items():
            if column in READ and values.dtype.kind == "f" and not np.isfinite(values).any():
                raise MissingStreamError(
                    f"{name}.{column} of {run.meta.name or 'the run'} holds no value: leave the column out",
                    method="diagnose",
                    missing=[f"{name}.{column}"],
                )
    _clocks(run)


READ = frozenset(("gz", "ax", "ay", "x", "y", "theta", "range", "left", "right"))
"""Columns that are compared with the simulator's."""
RATE, LOOKED, APART = 20.0, 20.0, 1.0
"""Turn rates are compared at this rate [Hz], shifted by up to so many seconds; a better fit beyond that many is no
effect but another clock."""
LEAST_SEEN = 8.0
"""Less of both together tells nothing [s]."""
ALIKE, BETTER = 0.7, 0.3
"""Correlation that the better fit must have, and by how much more than without a shift."""


def _clocks(run: Run) -> None:
    """Refuse a gyro, commands, fixes or a reference whose turning is that of the drive, seconds earlier or later."""
    drive = _turning(run, "wheels") or _turning(run, "commands")
    for name in ("commands", "imu", "beacon", "truth"):
        seen = _turning(run, name)
        if drive is None or seen is None:
            continue
        first, last = max(drive[0][0], seen[0][0]), min(drive[0][-1], seen[0][-1])
        t = np.arange(first, last, 1.0 / RATE)
        if len(t) < LEAST_SEEN * RATE:
            continue
        a, b = (np.interp(t, *one) for one in (drive, seen))
        late, best, now = _shift(a - a.mean(), b - b.mean())
        if abs(late) > APART and best > max(ALIKE, now + BETTER):
            raise ParameterError(
                f"{name} of {run.meta.name or 'the run'} turns as the drive does {abs(late):.1f} s "
                f"{'after' if late > 0 else 'before'} it: their clocks do not match; take {late:.1f} s off its stamps",
                parameter=f"{name}.t",
                found=late,
            )


def _turning(run: Run, name: str) -> tuple[Array, Array] | None:
    """Stamps and turn rate [rad/s, or a multiple of it] as a stream has them; None where it does not turn."""
    log = getattr(run, name)
    columns = {} if log is None else log.columns()
    if log is None or len(log) < MANY:
        return None
    if name == "wheels":
        angle = (columns["right"] - columns["left"]) * (run.meta.robot.wheel_radius or 1.0)
        rate = np.gradient(np.asarray(angle, dtype=np.float64), log.t) / (run.meta.robot.track_width or 1.0)
    elif name in ("truth", "beacon"):
        if "theta" not in columns:
            return None
        known = np.isfinite(columns["theta"])
        if known.sum() < MANY:
            return None
        turned, stamps = np.unwrap(np.asarray(columns["theta"], dtype=np.float64)[known]), log.t[known]
        rate = np.gradient(turned, stamps)
        if name == "beacon":  # a fix's heading is rough: its change over a second
            rate = np.interp(stamps + 0.5, stamps, turned) - np.interp(stamps - 0.5, stamps, turned)
        rate = np.interp(log.t, stamps, rate)
    else:
        rate = np.asarray(columns["w" if name == "commands" else "gz"], dtype=np.float64)
    rate = np.nan_to_num(rate)
    return (log.t, rate) if float(np.std(rate)) > TURNS else None


MANY, TURNS = 20, 0.05
"""A stream with fewer readings, or less turning [rad/s], tells nothing of its clock."""


def _shift(a: Array, b: Array) -> tuple[float, float, float]:
    """By how much b is late [s] where it fits a best, the correlation there, and as they stand."""
    size = 1 << int(2 * len(a) - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(b, size) * np.conj(np.fft.rfft(a, size)), size)
    most = int(min(LOOKED * RATE, len(a) // 3))
    lags = np.arange(-most, most + 1)
    sums = [np.concatenate(([0.0], np.cumsum(part * part))) for part in (a, b)]
    n = len(a)
    shared = (sums[0][n - np.maximum(lags, 0)] - sums[0][np.maximum(-lags, 0)]) * (
        sums[1][n + np.minimum(lags, 0)] - sums[1][np.maximum(lags, 0)]
    )
    both = product[lags] / np.sqrt(np.maximum(shared, 1e-12))
    k = int(np.argmax(both))
    return float(lags[k]) / RATE, float(both[k]), float(both[most])


def _moving(runs: Sequence[Run]) -> None:
    seconds = sum(run.duration for run in runs)
    if seconds < SHORTEST:
        raise NotEnoughDataError(
            f"{seconds:.1f} s of data are too few; {SHORTEST:.0f} s are the least, a minute of turns and stops is good",
            needed_s=SHORTEST,
            found_s=seconds,
        )
    way = 0.0
    for run in runs:
        radius = run.meta.robot.wheel_radius or 0.0
        if run.wheels is not None and len(run.wheels) > 1:
            way += float(np.nansum(np.abs(np.diff(run.wheels.left)) + np.abs(np.diff(run.wheels.right)))) * radius
        if run.commands is not None and len(run.commands) > 1:
            size = np.abs(run.commands.v[:-1]) + 0.1 * np.abs(run.commands.w[:-1])
            way += float(np.nansum(size * np.diff(run.commands.t)))
    if way < LEAST_WAY:
        raise NotEnoughDataError(
            "the robot hardly moves in these runs; a minute with turns both ways, stops and two speeds would do"
        )


def _same(a: Run, b: Run) -> bool:
    ours, theirs = a.logs(), b.logs()
    if ours.keys() != theirs.keys():
        return False
    return all(
        len(log) == len(theirs[name])
        and all(
            np.array_equal(v, theirs[name].columns()[k], equal_nan=v.dtype.kind == "f")
            for k, v in log.columns().items()
        )
        for name, log in ours.items()
    )


def simulator_of(runs: Sequence[Run], simulator: EffectSet | None) -> EffectSet:
    """What the simulator already models: as given, else as the runs say."""
    return runs[0].meta.effects if simulator is None else simulator
