"""What each segment of a calibration run really holds: steady stretches cut into blocks, or the reason why not.

A segment's declared times are a promise that a rig keeps only roughly: tables spin up, hands let go late. So each
segment is cut into pieces of half a second, and pieces are left out that shake or that leave the level of the
segment's middle; a margin follows what was cut off at an end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from core.calibration.imu.algorithm1 import AXES
from core.imu.oddities import RESTLESS
from core.imu.stamps import in_order
from core.robot import Segment
from core.run import Run
from core.sensors import ImuLog

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

PIECE = 0.5  # s
FEWEST = 8  # readings of a piece
LEAST = 6  # pieces of a segment
CLIP = 5.0  # deviations, beyond which a reading counts as this
SHAKE = 8.0  # deviations of a piece's variance
LEVEL = 6.0  # deviations of a piece's mean
LONG = 300.0  # s, beyond which the middle's level is a running one
LEAST_SHARE = 0.4  # of a segment that must be steady
BLOCKS = 400  # of a run


@dataclass(frozen=True)
class Stretch:
    """The steady part of one segment.

    run, index: which; kind of the run's procedure; rate (3,) [rad/s] as declared; force (3,) [m/s^2] as declared, None
    where unknown; still: not turning, so the accelerometer feels gravity alone. Blocks (K,): lo, hi [s] their
    edges, count readings; mean (K, 6) by AXES, NaN for absent axes. noise (6,) variance of a reading about its
    piece's mean and noise_sd (6,) the deviation of that; quantum (6,), 0 where none shows; limit (6,) share of
    readings at the extreme, where that looks like saturation.
    """

    run: int
    index: int
    kind: str
    rate: Floats
    force: Floats | None
    still: bool
    lo: Floats
    hi: Floats
    count: Floats
    mean: Floats
    noise: Floats
    noise_sd: Floats
    quantum: Floats
    limit: Floats

    @property
    def level(self) -> Floats:
        """(6,) mean of all blocks."""
        return np.asarray(self.count @ self.mean / self.count.sum())

    @property
    def name(self) -> str:
        """How messages call it."""
        return f"run {self.run + 1}, segment {self.index + 1} ({self.lo[0]:.5g} to {self.hi[-1]:.5g} s)"


@dataclass(frozen=True)
class LeftOut:
    """A segment that is not used, and why. run and index from 0; t0, t1 [s] as declared; `sensor` None for both."""

    run: int
    index: int
    t0: float
    t1: float
    reason: str
    sensor: str | None = None

    def __str__(self) -> str:
        what = f", {self.sensor}" if self.sensor else ""
        return f"run {self.run + 1}, segment {self.index + 1} ({self.t0:.5g} to {self.t1:.5g} s){what}: {self.reason}"


def readings(imu: ImuLog) -> Floats:
    """(n, 6) by AXES; NaN columns for absent axes."""
    columns = [getattr(imu, name) for name in AXES]
    absent = np.full(len(imu), np.nan)
    return np.column_stack([absent if c is None else np.asarray(c, np.float64) for c in columns])


def stretches(runs: Sequence[Run]) -> tuple[list[Stretch], list[LeftOut], list[str]]:
    """Steady stretches of every run, segments left out, and notes on what is odd about the readings."""
    found: list[Stretch] = []
    left: list[LeftOut] = []
    notes: list[str] = []
    for r, run in enumerate(runs):
        if run.imu is None or len(run.imu) < LEAST * FEWEST:
            notes.append(f"run {r + 1} has no IMU readings, or too few; it is left out")
            continue
        imu, told = in_order(run.imu)
        segments, kind, note = _segments(run, imu)
        notes += [f"run {r + 1}: {text}" for text in (*told, *note)]
        values, text = _finite(readings(imu))
        if not np.isfinite(values).any():
            notes.insert(0, f"run {r + 1}: none of its readings is a finite number; it is left out")
            continue
        notes += [f"run {r + 1}: {text}"] if text else []
        rows = np.isfinite(values[:, np.isfinite(values).any(axis=0)]).all(axis=1)
        t, values = imu.t[rows], values[rows]
        total = sum(max(0.0, s.t1 - s.t0) for s in segments)
        for k, segment in enumerate(segments):
            made = _stretch(r, k, kind, segment, t, values, total)
            if isinstance(made, Stretch):
                found.append(made)
            else:
                left.append(LeftOut(r, k, segment.t0, segment.t1, made))
    return found, left, notes


def without(s: Stretch, axes: Sequence[int]) -> Stretch:
    """The stretch with some axes (of AXES) made absent."""
    mean = s.mean.copy()
    mean[:, list(axes)] = np.nan
    return replace(s, mean=mean)


def _segments(run: Run, imu: ImuLog) -> tuple[tuple[Segment, ...], str, list[str]]:
    """Declared segments and the kind of run; a run that declares nothing is tried as one at rest."""
    whole = Segment(float(imu.t[0]), float(imu.t[-1]), None, (0.0, 0.0, 0.0))
    procedure = run.meta.procedure
    if procedure is None:
        return (whole,), "rest", ["says nothing of its procedure; it is tried as a run at rest"]
    if procedure.kind not in ("rest", "six_position", "rate_table"):
        return (), procedure.kind, [f"was made for '{procedure.kind}', which shows nothing of the IMU; it is left out"]
    if not procedure.segments and procedure.kind == "rest":
        return (whole,), "rest", []
    if not procedure.segments:
        return (), procedure.kind, ["names no segments; it is left out"]
    return procedure.segments, procedure.kind, []


def _finite(values: Floats) -> tuple[Floats, str]:
    """Readings with axes that are mostly not finite made absent, and what was found."""
    bad = ~np.isfinite(values)
    share = bad.mean(axis=0)
    some = (share > 0) & (share < 1)
    if not some.any():
        return values, ""
    gone = some & (share > 0.5)
    values = np.where(gone, np.nan, values)
    parts = [f"{name} {int(bad[:, j].sum())}" for j, name in enumerate(AXES) if some[j]]
    text = f"readings that are not finite are left out: {', '.join(parts)}"
    return values, text + (f"; {', '.join(np.array(AXES)[gone])} counts as absent" if gone.any() else "")


def _stretch(r: int, k: int, kind: str, segment: Segment, t: Floats, values: Floats, total: float) -> Stretch | str:
    """One segment's stretch, or why there is none. `total` [s] of all the run's segments sets the length of blocks."""
    if kind == "rate_table" and segment.rate is None:
        return "the rate of the table is not given"
    a, b = np.searchsorted(t, (segment.t0, segment.t1 + 1e-9))
    t, values = t[a:b], values[a:b]
    if len(t) < LEAST * FEWEST:
        return f"{len(t)} readings are too few: at least {LEAST * FEWEST}"
    step = (t[-1] - t[0]) / (len(t) - 1)
    size = max(FEWEST, round(PIECE / step), len(t) // 20_000)
    pieces = len(t) // size
    if pieces < LEAST:
        return f"{t[-1] - t[0]:.3g} s are too short: at least {LEAST * size * step:.3g} s"
    rate = np.array(segment.rate if segment.rate is not None else (0.0, 0.0, 0.0))
    still = not rate.any()
    cut = values[: pieces * size].reshape(pieces, size, 6)
    mean, variance, level, own = _moments(cut)
    watched = np.isfinite(mean).all(axis=0) & (np.ones(6, np.bool_) if still else np.arange(6) >= 3)
    lo = t[: pieces * size : size] - step / 2
    hi = t[size - 1 : pieces * size : size] + step / 2
    good = _steady((lo + hi) / 2, mean[:, watched], variance[:, watched], level[watched], size)
    share = float(good.mean())
    if share < LEAST_SHARE or good.sum() < LEAST:
        what = "it is not at rest" if still else "the rate is not steady"
        return f"{what}: only {share:.0%} of the time holds one level"
    if still and (name := _restless(cut[good], level)):
        return f"it is not at rest: within half a second {name}'s readings wander far beyond their own noise"
    group = _groups(good, max(2, int(np.ceil(total / (size * step) / BLOCKS))))
    first = np.flatnonzero(np.diff(group, prepend=-1))
    last = np.append(first[1:], len(group)) - 1
    index = np.flatnonzero(good)
    share_of = np.diff(np.append(first, len(group))).astype(np.float64)
    kept = own[good]
    return Stretch(
        run=r,
        index=k,
        kind=kind,
        rate=rate,
        force=None if segment.gravity is None else np.array(segment.gravity, np.float64),
        still=still,
        lo=lo[index[first]],
        hi=hi[index[last]],
        count=share_of * size,
        mean=np.add.reduceat(mean[good], first, axis=0) / share_of[:, None],
        noise=kept.mean(axis=0),
        noise_sd=kept.std(axis=0) / np.sqrt(len(kept)),
        quantum=_quantum(cut[good]),
        limit=_at_limit(cut[good]),
    )


def _restless(cut: Floats, level: Floats) -> str:
    """The axis whose pieces' variance (`level`) is far beyond that from reading to reading; "" where there is none."""
    steps = (np.diff(cut, axis=1) ** 2).mean(axis=(0, 1))
    times = np.sqrt(np.divide(2 * level, steps, out=np.zeros(len(level)), where=steps > 0))  # 0: dead, told elsewhere
    return AXES[int(np.nanargmax(times))] if (times > RESTLESS).any() else ""


def _moments(cut: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Of each piece (K, 6): mean without outliers, variance of the clipped readings, [the level of these variances
    (6,)], and the variance without outliers.

    Clipped, a shake shows; without outliers, the noise is that of the many.
    """
    middle = np.median(cut, axis=1, keepdims=True)
    level = np.median(cut.var(axis=1, ddof=1), axis=0)
    reach = np.where(level > 0, CLIP * np.sqrt(level), np.inf)
    rest = cut - middle
    clipped = np.clip(rest, -reach, reach)
    inside = np.abs(rest) <= reach
    held = np.maximum(inside.sum(axis=1), 2)
    rest = np.where(inside | np.isnan(rest), rest, 0.0)
    mean = rest.sum(axis=1) / held
    own = np.maximum((rest**2).sum(axis=1) - held * mean**2, 0.0) / (held - 1)
    return middle[:, 0] + mean, clipped.var(axis=1, ddof=1), level, own


def _steady(t: Floats, mean: Floats, variance: Floats, level: Floats, size: int) -> Flags:
    """(K,) pieces that do not shake and stay at the middle's level, with margins behind what was cut off."""
    bad = np.zeros(len(t), np.bool_)
    for j in range(mean.shape[1]):
        if level[j] > 0:
            bad |= variance[:, j] > level[j] * (1 + SHAKE * np.sqrt(2 / (size - 1)))
        bad |= _off_level(t, mean[:, j], float(np.sqrt(level[j] / size)))
    if not bad.any():
        return ~bad
    near = bad.copy()
    near[1:] |= bad[:-1]
    near[:-1] |= bad[1:]
    good = ~near
    runs = np.flatnonzero(np.convolve(good, np.ones(4), "valid") == 4)
    if not len(runs):
        return np.zeros(len(t), np.bool_)
    head, tail = int(runs[0]), len(t) - 1 - int(runs[-1] + 3)
    limit = max(1, len(t) // 10)
    if head:
        good[: head + min(limit, head // 2 + 1)] = False
    if tail:
        good[len(t) - tail - min(limit, tail // 2 + 1) :] = False
    return good


def _off_level(t: Floats, mean: Floats, least: float) -> Flags:
    """Pieces whose mean leaves the level of the segment's middle, which may drift."""
    if t[-1] - t[0] <= LONG or len(t) < 64:
        return _off_line(t, mean, least, len(t) // 4, len(t) - len(t) // 4)
    from scipy.ndimage import median_filter

    edge = int(np.searchsorted(t - t[0], LONG / 2))
    rest = mean - median_filter(mean, size=61, mode="nearest")
    bad = np.abs(rest) > LEVEL * max(_spread(rest), least)
    bad[:edge] = _off_line(t[:edge], mean[:edge], least, edge // 2, edge)
    bad[-edge:] = _off_line(t[-edge:], mean[-edge:], least, 0, edge - edge // 2)
    return bad


def _off_line(t: Floats, mean: Floats, least: float, a: int, b: int) -> Flags:
    """Pieces off the line through those from a to b."""
    half = (a + b) // 2
    slope = (np.median(mean[half:b]) - np.median(mean[a:half])) / (np.median(t[half:b]) - np.median(t[a:half]))
    rest = mean - slope * (t - t[half])
    rest = rest - np.median(rest[a:b])
    # The slope's own error grows towards the ends.
    lever = np.abs(t - t[half]) / (t[b - 1] - t[a]) / np.sqrt(b - a)
    return np.asarray(np.abs(rest) > LEVEL * max(_spread(rest[a:b]), least) * np.sqrt(1 + 12 * lever**2))


def _spread(rest: Floats) -> float:
    return 1.4826 * float(np.median(np.abs(rest - np.median(rest))))


def _groups(good: Flags, size: int) -> npt.NDArray[np.int64]:
    """(sum of good,) block of each good piece: neighbours, at most `size` of them."""
    index = np.flatnonzero(good)
    fresh = np.diff(index, prepend=-2) > 1
    start = np.maximum.accumulate(np.where(fresh, np.arange(len(index)), 0))
    inside = (np.arange(len(index)) - start) // size
    changed = fresh | (np.diff(inside, prepend=0) != 0)
    return np.cumsum(changed)


def _quantum(cut: Floats) -> Floats:
    """(6,) step between readings, 0 where they do not repeat."""
    few = cut[:400].reshape(-1, 6)[:20_000]
    out = np.zeros(6)
    for j in range(6):
        values = np.unique(few[:, j])
        if np.isfinite(values).all() and 1 < len(values) < 0.2 * len(few):
            step = np.diff(values)
            out[j] = step[step > 1e-3 * np.median(step)].min()
    return out


def _at_limit(cut: Floats) -> Floats:
    """(6,) share of readings at an extreme on which they pile up, 0 where they do not."""
    flat = cut.reshape(-1, 6)
    out = np.zeros(6)
    for j in range(6):
        values, counts = np.unique(flat[:, j], return_counts=True)
        if not np.isfinite(values).all() or len(values) < 6:
            continue
        for end, inner in ((0, 1), (-1, -2)):
            if counts[end] > max(10, 0.01 * len(flat), 3 * counts[inner]):
                out[j] = max(out[j], counts[end] / len(flat))
    return out
