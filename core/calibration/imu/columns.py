"""Block means of one axis over all runs as a least-squares problem: columns, noise, and what whitens both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from core.calibration.imu.stretches import Stretch

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

LARGEST = 20.0  # longest tau, in lengths of the longest run
FASTEST = 10.0  # s, of the flicker's processes
MISALIGNED = 0.03  # of an axis of an accelerometer against the case
SLOWEST = 8.0  # of them, in lengths of the longest run


@dataclass(frozen=True)
class AxisData:
    """Blocks of one axis over all runs (n,): lo, hi [s], value, white (variance of a block's mean), u (n, 3) declared,
    run and segment numbers, size (n,) of what a fixture's error is in proportion to, quantum floor (n,) as a variance;
    unknown (n,) is the number of a constant of its own (force not declared), -1 where there is none.
    """

    lo: Floats
    hi: Floats
    value: Floats
    white: Floats
    u: Floats
    run: npt.NDArray[np.int64]
    segment: npt.NDArray[np.int64]
    size: Floats
    floor: Floats
    unknown: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Levels:
    """Noise: white as a factor on the readings' own; swing [u^2] variance of each flicker process; walk [u^2/s];
    turn_on [u^2] variance from run to run; fixture, relative variance of u from segment to segment."""

    white: float
    swing: float
    walk: float
    turn_on: float = 0.0
    fixture: float = 0.0


def axis_data(found: Sequence[Stretch], axis: int) -> AxisData | None:
    """Blocks of axis number `axis` (of AXES) from the stretches that show it; None where there are none."""
    accel = axis < 3
    parts = [s for s in found if np.isfinite(s.mean[:, axis]).all() and (s.still or not accel)]
    if not parts:
        return None
    unknown = [k for k, s in enumerate(parts) if accel and s.force is None]
    # Coarse steps may hide all noise of one stretch: the other stretches tell.
    usual = float(np.median([s.noise[axis] for s in parts]))
    quantum = float(np.max([s.quantum[axis] for s in parts]))
    least = max(0.01 * usual, quantum**2 / 12, (1e-9 * max(float(np.abs(s.level[axis])) for s in parts)) ** 2, 1e-24)
    rows = []
    for k, s in enumerate(parts):
        n = len(s.lo)
        declared = s.force if accel else s.rate
        u = np.zeros(3) if declared is None else declared
        noise = max(float(s.noise[axis]), least)
        rows.append(
            (
                s.lo,
                s.hi,
                s.mean[:, axis],
                noise / s.count,
                np.tile(u, (n, 1)),
                np.full(n, s.run),
                np.full(n, k),
                np.full(n, _tilted(u, axis) if accel else np.linalg.norm(u)),
                np.full(n, _hidden_by_quantum(noise, quantum)),
                np.full(n, unknown.index(k) if k in unknown else -1),
            )
        )
    return AxisData(*(np.concatenate(column) for column in zip(*rows, strict=True)))


def _tilted(u: Floats, axis: int) -> float:
    """How much of `u` a tilt turns into the axis: gravity's size is known, so a position is wrong across it only.

    The sensor's own misalignment brings a little of that back.
    """
    square = float(u @ u)
    return float(np.sqrt(square - u[axis] ** 2 + MISALIGNED**2 * square))


def _hidden_by_quantum(noise: float, quantum: float) -> float:
    """Variance of the error that rounding leaves in a mean, where noise is too small to smooth the steps away."""
    if quantum == 0:
        return 0.0
    own = max(noise - quantum**2 / 12, 0.0)
    return 0.5 * (quantum / np.pi * np.exp(-2 * np.pi**2 * own / quantum**2)) ** 2


class Problem:
    """The columns of one axis and how they are whitened; tau and levels come from outside."""

    def __init__(self, data: AxisData) -> None:
        n = len(data.value)
        self.data = data
        self.time = (data.lo + data.hi) / 2
        self.new_run = np.diff(data.run, prepend=-1) != 0
        self.new_segment = np.diff(data.segment, prepend=-1) != 0
        self.used = np.flatnonzero(np.abs(data.u).max(axis=0) > 0)
        dummies = data.unknown.max(initial=-1) + 1
        extra = (data.unknown[:, None] == np.arange(dummies)).astype(np.float64)
        self.fixed = np.column_stack([data.u[:, self.used], np.ones(n), extra])
        self.static = len(self.used)  # column of the static bias
        self.drift = self.fixed.shape[1]  # column of the drift
        self.span = float(data.hi.max())
        block = float(np.median(data.hi - data.lo))
        self.shortest, self.longest = max(3 * block, 1.0), LARGEST * self.span
        lengths = [np.ptp(self.time[data.run == r]) for r in np.unique(data.run)]
        # Faster flicker lies under the white noise; its factor takes it.
        fastest = max(2 * block, FASTEST)
        count = max(1, int(np.ceil(np.log(max(SLOWEST * max(lengths) / fastest, 1.0)) / np.log(4))))
        self.taus: Floats = np.array([fastest * 4.0**k for k in range(min(count, 8))])
        self.base = float(np.median(data.white))
        scale = np.maximum(np.sqrt((self.fixed**2).sum(axis=0)), 1e-300)
        _, size, right = np.linalg.svd(self.fixed / scale, full_matrices=False)
        rank = int((size > 1e-6 * size[0]).sum())
        self.lost = right[rank:]  # combinations of scaled columns that the data do not hold
        self.basis = self.fixed / scale @ right[:rank].T
        # y without what a plain fit explains: what is left keeps its digits.
        self.rest = data.value - self.fixed @ np.linalg.lstsq(self.fixed, data.value, rcond=1e-9)[0]
        self.runs = int(self.new_run.sum())

    def curve(self, tau: float) -> Floats:
        """(n,) mean of 1 - exp(-t/tau) over each block."""
        lo, hi = self.data.lo, self.data.hi
        return np.asarray(1 - tau * np.exp(-lo / tau) * -np.expm1(-(hi - lo) / tau) / (hi - lo))

    def whitened(self, levels: Levels, stacked: Floats) -> tuple[Floats, Floats, float]:
        """Whitened columns (n, c), the runs' offsets of each, log determinant."""
        from core.calibration.imu._whiten_numba import whiten

        d = self.data
        out, offsets = np.empty_like(stacked), np.zeros((self.runs, stacked.shape[1]))
        logdet = whiten(
            self.time,
            self.new_run,
            self.new_segment,
            levels.white * d.white,
            levels.fixture * d.size**2 + d.floor,
            stacked,
            levels.turn_on,
            levels.walk,
            levels.swing,
            self.taus,
            out,
            offsets,
        )
        return out, offsets, float(logdet)

    def solve(self, levels: Levels, tau: float | None) -> tuple[Floats, Floats, float, Floats]:
        """Coefficients, their covariance, squares left, runs' offsets of each column."""
        columns = [self.data.value, self.fixed] + ([] if tau is None else [self.curve(tau)])
        out, offsets, _ = self.whitened(levels, np.column_stack(columns))
        y, x = out[:, 0], out[:, 1:]
        scale = np.maximum(np.sqrt((x**2).sum(axis=0)), 1e-300)
        left, size, right = np.linalg.svd(x / scale, full_matrices=False)
        keep = size > 1e-7 * size[0]
        inverse = (right[keep].T / size[keep]) / scale[:, None]
        beta = inverse @ (left[:, keep].T @ y)
        squares = float(((y - x @ beta) ** 2).sum())
        return beta, inverse @ inverse.T, squares, offsets

    def cost(self, levels: Levels, tau: float | None, *, restricted: bool = True) -> float:
        """-2 log (restricted) likelihood but for a constant."""
        columns = [self.basis] + ([] if tau is None else [self.curve(tau)]) + [self.rest]
        out, _, logdet = self.whitened(levels, np.column_stack(columns))
        size = np.abs(np.diag(np.linalg.qr(out, mode="r")))
        information = 2 * np.log(np.maximum(size[:-1], 1e-12 * size[0])).sum() if restricted else 0.0
        return float(size[-1] ** 2 + logdet + information)

    @cached_property
    def scatters(self) -> tuple[bool, bool]:
        """Whether constants of runs, and beyond them of segments with a declared size, can be told from the columns."""
        run = (self.data.run[:, None] == np.unique(self.data.run)).astype(np.float64)
        sized = np.unique(self.data.segment[self.data.size > 0])
        segment = (self.data.segment[:, None] == sized).astype(np.float64)
        stages = (self.basis, np.hstack([self.basis, run]), np.hstack([self.basis, run, segment]))
        ranks = [int(np.linalg.matrix_rank(c / np.sqrt((c**2).sum(axis=0)), 1e-6)) for c in stages]
        return ranks[1] > ranks[0], ranks[2] > ranks[1]

    @property
    def shown(self) -> Flags:
        """(columns,) which coefficients the columns tell apart from the others, drift not among them."""
        return np.asarray((np.abs(self.lost) < 1e-5).all(axis=0))
