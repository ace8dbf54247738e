"""One axis fitted over all runs at once: matrix row, static and drifting bias, and the noise that surrounds them.

A reading of axis i, averaged over a block of readings, is

    y = sum_j M_ij u_j + b + A (1 - exp(-t / tau)) + n

with u the declared rate or specific force. All but tau are linear. The noise n of block means is white, flicker (a sum
of Gauss-Markov processes two octaves apart), a random walk, a constant per run (turn-on scatter) and one per segment
(fixture and table, in proportion to u). A Kalman filter whitens y and the columns together, so least squares on what
it leaves is maximum likelihood under coloured noise; levels of noise and tau are found by restricted maximum
likelihood (Nelder-Mead on their logarithms). Deviations come from the whitened columns, and where tau is wide, from
its likelihood over a grid (tau's logarithm evenly likely beforehand).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from core.calibration.imu.stretches import Stretch

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

SHOWN = 12.0  # chi-square that a drift must save to count as shown
WIDEST = 1.0  # deviation of tau's logarithm, beyond which it is not shown
LARGEST = 20.0  # longest tau, in lengths of the longest run
FASTEST = 10.0  # s, of the flicker's processes
GRID = 41
MATRIX_SD = 0.2  # beyond which an element is not shown


@dataclass(frozen=True)
class AxisData:
    """Blocks of one axis over all runs (n,): lo, hi [s], value, white (variance of a block's mean), u (n, 3) declared,
    run and segment numbers, size (n,) of u, quantum floor (n,) as a variance; unknown (n,) is the number of a
    constant of its own (force not declared), -1 where there is none.
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


@dataclass(frozen=True)
class AxisFit:
    """One axis: row (3,), static, amplitude, tau, each with its deviation, NaN where not shown; levels of the noise;
    offsets (runs,) turn-on of each run against the mean, NaN for runs without; drift_gain, chi-square that the drift
    saves; dof of what fixes turn_on and fixture. model (n,) fitted readings of the blocks."""

    row: Floats
    row_sd: Floats
    static: float
    static_sd: float
    amplitude: float
    amplitude_sd: float
    tau: float
    tau_sd: float
    levels: Levels
    offsets: Floats
    drift_gain: float
    tau_log_sd: float
    model: Floats
    notes: tuple[str, ...] = ()


def axis_data(found: Sequence[Stretch], axis: int) -> AxisData | None:
    """Blocks of axis number `axis` (of AXES) from the stretches that show it; None where there are none."""
    accel = axis < 3
    parts = [s for s in found if np.isfinite(s.mean[:, axis]).all() and (s.still or not accel)]
    if not parts:
        return None
    unknown = [k for k, s in enumerate(parts) if accel and s.force is None]
    rows = []
    for k, s in enumerate(parts):
        n = len(s.lo)
        declared = s.force if accel else s.rate
        u = np.zeros(3) if declared is None else declared
        noise = max(float(s.noise[axis]), float(s.quantum[axis]) ** 2 / 12, 1e-24)
        rows.append(
            (
                s.lo,
                s.hi,
                s.mean[:, axis],
                noise / s.count,
                np.tile(u, (n, 1)),
                np.full(n, s.run),
                np.full(n, k),
                np.full(n, np.linalg.norm(u)),
                np.full(n, _hidden_by_quantum(noise, float(s.quantum[axis]))),
                np.full(n, unknown.index(k) if k in unknown else -1),
            )
        )
    return AxisData(*(np.concatenate(column) for column in zip(*rows, strict=True)))


def _hidden_by_quantum(noise: float, quantum: float) -> float:
    """Variance of the error that rounding leaves in a mean, where noise is too small to smooth the steps away."""
    if quantum == 0:
        return 0.0
    own = max(noise - quantum**2 / 12, 0.0)
    return 0.5 * (quantum / np.pi * np.exp(-2 * np.pi**2 * own / quantum**2)) ** 2


class _Problem:
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
        count = max(1, int(np.ceil(np.log(max(2 * max(lengths) / fastest, 1.0)) / np.log(4))))
        self.taus: Floats = np.array([fastest * 4.0**k for k in range(min(count, 7))])
        self.base = float(np.median(data.white))
        self.runs = int(self.new_run.sum())

    def curve(self, tau: float) -> Floats:
        """(n,) mean of 1 - exp(-t/tau) over each block."""
        lo, hi = self.data.lo, self.data.hi
        return np.asarray(1 - tau * np.exp(-lo / tau) * -np.expm1(-(hi - lo) / tau) / (hi - lo))

    def whitened(self, levels: Levels, *columns: Floats) -> tuple[Floats, Floats, float]:
        """Whitened y, fixed columns and `columns` as one (n, c) array, the runs' offsets of each, log determinant."""
        from core.calibration.imu._whiten_numba import whiten

        d = self.data
        stacked = np.column_stack([d.value, self.fixed, *columns])
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

    def solve(self, levels: Levels, tau: float | None) -> tuple[Floats, Floats, float, float, Floats, Floats]:
        """Coefficients, their covariance, squares left, log determinant, whitened columns, runs' offsets."""
        out, offsets, logdet = self.whitened(levels, *([] if tau is None else [self.curve(tau)]))
        y, x = out[:, 0], out[:, 1:]
        scale = np.maximum(np.sqrt((x**2).sum(axis=0)), 1e-300)
        left, size, right = np.linalg.svd(x / scale, full_matrices=False)
        keep = size > 1e-7 * size[0]
        inverse = (right[keep].T / size[keep]) / scale[:, None]
        beta = inverse @ (left[:, keep].T @ y)
        squares = float(((y - x @ beta) ** 2).sum())
        information = float(2 * np.log(size[keep]).sum() + 2 * np.log(scale).sum())
        return beta, inverse @ inverse.T, squares, logdet + information, x, offsets

    def cost(self, levels: Levels, tau: float | None) -> float:
        """-2 log restricted likelihood but for a constant."""
        _, _, squares, logdet, _, _ = self.solve(levels, tau)
        return squares + logdet

    def shown(self) -> Flags:
        """(columns,) which coefficients the columns tell apart from the others, drift not among them."""
        scale = np.maximum(np.sqrt((self.fixed**2).sum(axis=0)), 1e-300)
        _, size, right = np.linalg.svd(self.fixed / scale)
        rank = int((size > 1e-6 * size[0]).sum())
        return np.asarray((np.abs(right[rank:]) < 1e-5).all(axis=0))


def fit_axis(data: AxisData, pooled: Levels | None = None) -> AxisFit:
    """Fit one axis. `pooled` gives turn_on and fixture found over all axes of the sensor; without it they are found
    here, where runs and segments are enough for it."""
    problem = _Problem(data)
    enough = len(data.value) >= 12 and problem.span > 6 * problem.shortest
    with_turn_on = problem.runs > 1
    rows = len(np.unique(data.segment[data.size > 0]))
    with_fixture = rows > len(problem.used) + (with_turn_on * (problem.runs - 1))
    free = (with_turn_on, with_fixture) if pooled is None else (False, False)
    held = pooled or Levels(1.0, 0.0, 0.0)
    tau0 = _first_tau(problem, held) if enough else None
    levels, tau = _likeliest(problem, free, held, tau0)
    if tau is None:
        gain = 0.0
    else:
        plain, _ = _likeliest(problem, free, held, None)
        gain = _gain(problem, plain, levels, tau)
    return _described(problem, levels, tau, gain)


def _first_tau(problem: _Problem, held: Levels) -> float:
    """The tau of a grid that leaves the least, with some flicker in the noise."""
    levels = replace(held, white=1.0, swing=problem.base, walk=0.0, turn_on=max(held.turn_on, 100 * problem.base))
    grid = np.geomspace(problem.shortest, problem.span * 3, 18)
    return float(grid[int(np.argmin([problem.solve(levels, t)[2] for t in grid]))])


def _likeliest(
    problem: _Problem, free: tuple[bool, bool], held: Levels, tau: float | None
) -> tuple[Levels, float | None]:
    """Levels of noise (turn_on and fixture where `free`) and tau by restricted maximum likelihood."""
    from scipy.optimize import minimize

    base = problem.base
    force = max(float(problem.data.size.max()), 1e-12) ** 2
    turn_on, fixture = free

    def unpack(q: Floats) -> tuple[Levels, float | None]:
        e = np.exp(np.clip(q, -30, 30))
        levels = Levels(
            white=float(np.clip(e[0], 0.2, 1e6)),
            swing=float(e[1]) * base,
            walk=float(e[2]) * base / max(problem.taus[0], 1e-9) * 0.01,
            turn_on=float(e[3]) * base if turn_on else held.turn_on,
            fixture=float(e[3 + turn_on]) * base / force if fixture else held.fixture,
        )
        return levels, None if tau is None else float(np.clip(e[-1], problem.shortest, problem.longest))

    start = [0.0, -2.0, -2.0] + [0.0] * (turn_on + fixture) + ([] if tau is None else [np.log(tau)])
    steps = np.array([0.5, 2.0, 2.0] + [2.0] * (turn_on + fixture) + ([] if tau is None else [0.4]))
    simplex = np.vstack([start, start + np.diag(steps)])

    def cost(q: Floats) -> float:
        # Levels far below what shows are all alike: a slight pull keeps the search from wandering there.
        return problem.cost(*unpack(q)) + 1e-3 * float((np.minimum(q[1:], -12) + 12) @ (np.minimum(q[1:], -12) + 12))

    options = {"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.02, "maxfev": 120 * len(start)}
    return unpack(minimize(cost, start, method="Nelder-Mead", options=options).x)


def _gain(problem: _Problem, plain: Levels, levels: Levels, tau: float) -> float:
    """How much the drift adds to the likelihood, each with its own noise: the larger, the surer."""

    def plain_cost(levels: Levels, tau: float | None) -> float:
        logdet = problem.whitened(levels)[2]
        squares = problem.solve(levels, tau)[2]
        return float(logdet + squares)

    return plain_cost(plain, None) - plain_cost(levels, tau)


def _described(problem: _Problem, levels: Levels, tau: float | None, gain: float) -> AxisFit:
    """Coefficients by name with deviations; NaN for those that are not shown."""
    shown = problem.shown()
    beta, covariance, _, _, _, offsets = problem.solve(levels, tau)
    variance = np.diag(covariance).copy()
    amplitude = amplitude_sd = best = tau_sd = log_sd = np.nan
    notes: tuple[str, ...] = ()
    if tau is not None:
        made = _over_tau(problem, levels, tau, beta)
        variance, log_sd = made.variance, made.log_sd
        if gain < SHOWN:
            beta = np.append(made.mean[:-1], made.mean[-1])
            amplitude, amplitude_sd = float(beta[-1]), float(np.sqrt(variance[-1]))
            notes += (
                f"no drift is shown (it would be {amplitude:.2g} ± {amplitude_sd:.1g}); its time is not identifiable",
            )
        elif log_sd > WIDEST:
            notes += ("the bias drifts, but the runs are too short for its time and asymptote: not identifiable",)
        else:
            amplitude, amplitude_sd = float(beta[-1]), float(np.sqrt(variance[-1]))
            best, tau_sd = tau, float(tau * log_sd)
    else:
        notes += ("the runs are too short to show a drift",)
    row, row_sd = np.full(3, np.nan), np.full(3, np.nan)
    for place, j in enumerate(problem.used):
        sd = float(np.sqrt(variance[place]))
        if shown[place] and sd < MATRIX_SD:
            row[j], row_sd[j] = beta[place], sd
    static = static_sd = np.nan
    if shown[problem.static]:
        static, static_sd = float(beta[problem.static]), float(np.sqrt(variance[problem.static]))
    columns = [problem.fixed] + ([] if tau is None else [problem.curve(tau)[:, None]])
    return AxisFit(
        row=row,
        row_sd=row_sd,
        static=static,
        static_sd=static_sd,
        amplitude=amplitude,
        amplitude_sd=amplitude_sd,
        tau=best,
        tau_sd=tau_sd,
        levels=levels,
        offsets=offsets[:, 0] - offsets[:, 1:] @ beta,
        drift_gain=gain,
        tau_log_sd=log_sd,
        model=np.hstack(columns) @ beta,
        notes=notes,
    )


@dataclass(frozen=True)
class _OverTau:
    mean: Floats
    variance: Floats
    log_sd: float


def _over_tau(problem: _Problem, levels: Levels, tau: float, beta: Floats) -> _OverTau:
    """Second moments about `beta` and log tau over the likelihood of tau, levels held."""
    step = 1e-3
    sides = [problem.solve(levels, tau * np.exp(s))[2] for s in (-50 * step, 0.0, 50 * step)]
    bend = (sides[0] - 2 * sides[1] + sides[2]) / (50 * step) ** 2 / 2
    width = 1 / np.sqrt(bend) if bend > 0 else np.inf
    low, high = np.log(problem.shortest), np.log(problem.longest)
    middle = float(np.log(tau))
    logs = np.linspace(max(low, middle - 5 * width), min(high, middle + 5 * width), GRID)
    solved = [problem.solve(levels, float(t)) for t in np.exp(logs)]
    squares = np.array([s[2] for s in solved])
    weight = np.exp(-(squares - squares.min()) / 2)
    weight /= weight.sum()
    values = np.array([s[0] for s in solved])
    own = np.array([np.diag(s[1]) for s in solved])
    mean = weight @ values
    about = mean if width > WIDEST else beta
    centre = float(weight @ logs) if width > WIDEST else middle
    return _OverTau(mean, weight @ (own + (values - about) ** 2), float(np.sqrt(weight @ (logs - centre) ** 2)))


def fit_triad(found: Sequence[Stretch], axes: Sequence[int], tell: Callable[[float], None]) -> dict[int, AxisFit]:
    """The axes of one sensor. Turn-on scatter and fixture errors are alike on its axes: found on each, then pooled."""
    data = {axis: made for axis in axes if (made := axis_data(found, axis)) is not None}
    first = {}
    for axis, columns in data.items():
        first[axis] = fit_axis(columns)
        tell(1 / (2 * len(data)))
    if not first:
        return {}
    turn_on = float(np.mean([f.levels.turn_on for f in first.values()]))
    fixture = float(np.mean([f.levels.fixture for f in first.values()]))
    if turn_on == 0 and fixture == 0:
        return first
    pooled = Levels(1.0, 0.0, 0.0, turn_on, fixture)
    second = {}
    for axis, columns in data.items():
        second[axis] = fit_axis(columns, pooled)
        tell(1 / (2 * len(data)))
    return second
