"""One axis fitted over all runs at once: matrix row, static and drifting bias, and the noise that surrounds them.

A reading of axis i, averaged over a block of readings, is

    y = sum_j M_ij u_j + b + A (1 - exp(-t / tau)) + n

with u the declared rate or specific force. All but tau are linear. The noise n of block means is white, flicker (a sum
of Gauss-Markov processes two octaves apart), a random walk, a constant per run (turn-on scatter) and one per segment
(fixture and table, in proportion to u). A Kalman filter whitens y and the columns together, so least squares on what
it leaves is maximum likelihood under coloured noise; levels of noise and tau are found by restricted maximum
likelihood (Nelder-Mead on their logarithms). Deviations come from the whitened columns, averaged over the likelihood
of tau and of the flicker's level.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from core.calibration.imu.columns import AxisData, Levels, Problem, axis_data
from core.calibration.imu.stretches import Stretch

Floats = npt.NDArray[np.float64]

SHOWN = 12.0  # chi-square that a drift must save to count as shown
WIDEST = 0.7  # deviation of tau's logarithm, beyond which it is not shown
NARROW = 0.3  # the same, where the longest run does not reach REACHED times tau: a bend of flicker looks alike
REACHED = 3.0
GRID = 19
UNLIKELY = 14.0  # chi-square beyond the best, where a time is no longer looked at
SURE = 10.0  # deviations, beyond which a drift needs no comparison with none
FLOOR = -9.0  # logarithm of a level that does not show
MATRIX_SD = 0.2  # beyond which an element is not shown
ALIKE = 1.0  # deviation, between a sensor's axes, of the logarithm of the flicker's level
LONG_ENOUGH = 1200.0  # s: a run in which a warm-up would have shown


@dataclass(frozen=True)
class AxisFit:
    """One axis: row (3,), static, amplitude, tau, each with its deviation, NaN where not shown; levels of the noise;
    scatter, whether runs are enough to tell their turn-on, and offsets (runs with readings,), each run's against the
    mean; drift_gain, chi-square that the drift saves; tau_best and tau_log_sd, the likeliest tau whether shown or not
    and the deviation of its logarithm; model (n,) fitted readings of the blocks."""

    row: Floats
    row_sd: Floats
    static: float
    static_sd: float
    amplitude: float
    amplitude_sd: float
    tau: float
    tau_sd: float
    levels: Levels
    scatter: bool
    offsets: Floats
    drift_gain: float
    tau_log_sd: float
    tau_best: float
    model: Floats
    flicker: Usual | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Usual:
    """What is known of the logarithm of the flicker's level [u^2]: mean and variance."""

    mean: float
    variance: float


def fit_axis(
    data: AxisData, pooled: Levels | None = None, before: AxisFit | None = None, usual: Usual | None = None
) -> AxisFit:
    """Fit one axis. `pooled` gives turn_on and fixture found over all axes of the sensor; without it they are found
    here, where runs and segments are enough for it. `before` is a fit to start from; `usual`, the flicker of the
    sensor's other axes."""
    problem = Problem(data)
    enough = len(data.value) >= 12 and problem.span > 6 * problem.shortest
    free = problem.scatters if pooled is None else (False, False)
    held = pooled or Levels(1.0, 0.0, 0.0)
    if not enough:
        levels, _ = _likeliest(problem, free, held, None, before)
        return _described(problem, levels, None, 0.0)
    first = before.tau_best if before else _first_tau(problem, held)
    levels, tau = _likeliest(problem, free, held, first, before)
    assert tau is not None
    tau = _refined(problem, levels, tau)
    gain = np.inf
    beta, covariance, _, _ = problem.solve(levels, tau)
    if abs(beta[-1]) < SURE * np.sqrt(covariance[-1, -1]):
        # Each model with its own noise: a drift may also pass for a walk.
        plain, _ = _likeliest(problem, free, held, None, before)
        gain = problem.cost(plain, None, restricted=False) - problem.cost(levels, tau, restricted=False)
    return _described(problem, levels, tau, gain, usual)


def _told_flicker(data: AxisData, made: AxisFit, usual: Usual) -> AxisFit:
    """The same fit, its deviations told what flicker the other axes show."""
    if made.flicker is None:
        return made
    return _described(Problem(data), made.levels, made.tau_best, made.drift_gain, usual)


def _first_tau(problem: Problem, held: Levels) -> float:
    """The tau of a grid that leaves the least, with some flicker in the noise."""
    levels = replace(held, white=1.0, swing=problem.base, walk=0.0, turn_on=max(held.turn_on, 100 * problem.base))
    grid = np.geomspace(problem.shortest, problem.span * 3, 18)
    return float(grid[int(np.argmin([problem.cost(levels, float(t), restricted=False) for t in grid]))])


def _refined(problem: Problem, levels: Levels, tau: float) -> float:
    """The likeliest tau near `tau`, levels held."""
    from scipy.optimize import minimize_scalar

    low, high = np.log(problem.shortest), np.log(problem.longest)
    middle = float(np.log(tau))
    bounds = (max(low, middle - 0.3), min(high, middle + 0.3))
    found = minimize_scalar(
        lambda q: problem.cost(levels, float(np.exp(q)), restricted=False),
        bounds=bounds,
        method="bounded",
        options={"xatol": 1e-4},
    )
    return float(np.exp(found.x))


def _likeliest(
    problem: Problem, free: tuple[bool, bool], held: Levels, tau: float | None, before: AxisFit | None = None
) -> tuple[Levels, float | None]:
    """Levels of noise (turn_on and fixture where `free`) and tau by restricted maximum likelihood."""
    from scipy.optimize import minimize

    base = problem.base
    force = max(float(problem.data.size.max()), 1e-12) ** 2
    turn_on, fixture = free
    per_second = 0.01 * base / problem.taus[0]

    def unpack(q: Floats) -> tuple[Levels, float | None]:
        e = np.exp(np.clip(q, -30, 30))
        levels = Levels(
            white=float(np.clip(e[0], 0.2, 1e6)),
            swing=float(e[1]) * base,
            walk=float(e[2]) * per_second,
            turn_on=float(e[3]) * base if turn_on else held.turn_on,
            fixture=float(e[3 + turn_on]) * base / force if fixture else held.fixture,
        )
        return levels, None if tau is None else float(np.clip(e[-1], problem.shortest, problem.longest))

    start = [0.0, -2.0, -2.0] + [0.0] * (turn_on + fixture)
    if before is not None:
        known = np.array([before.levels.white, before.levels.swing / base, before.levels.walk / per_second])
        start[:3] = np.log(np.maximum(known, np.exp(FLOOR)))
    start += [] if tau is None else [float(np.log(tau))]
    steps = np.array([0.5, 2.0, 2.0] + [2.0] * (turn_on + fixture) + ([] if tau is None else [0.4]))
    simplex = np.vstack([start, start + np.diag(steps if before is None else steps / 3)])

    def cost(q: Floats) -> float:
        # Levels far below what shows are all alike: a slight pull keeps the search from wandering there.
        low = np.minimum(q[1:] - FLOOR, 0.0)
        return problem.cost(*unpack(q)) + 1e-2 * float(low @ low)

    options = {"initial_simplex": simplex, "xatol": 10.0, "fatol": 0.01, "maxfev": 100 * len(start)}
    return unpack(minimize(cost, start, method="Nelder-Mead", options=options).x)


def _described(problem: Problem, levels: Levels, tau: float | None, gain: float, usual: Usual | None = None) -> AxisFit:
    """Coefficients by name with deviations; NaN for those that are not shown."""
    shown = problem.shown
    beta, covariance, _, offsets = problem.solve(levels, tau)
    variance = np.diag(covariance).copy()
    amplitude = amplitude_sd = best = tau_sd = log_sd = np.nan
    notes: tuple[str, ...] = ()
    flicker = None
    if tau is not None:
        made = _spread(problem, levels, tau, beta, usual, shown=gain >= SHOWN)
        flicker = made.flicker
        variance, log_sd = made.variance, made.log_sd
        if gain < SHOWN:
            beta, _, _, offsets = problem.solve(levels, None)
            beta = np.append(beta, made.mean[-1])
            offsets = np.column_stack([offsets, np.zeros(len(offsets))])
            if problem.span >= LONG_ENOUGH:
                amplitude, amplitude_sd = float(beta[-1]), float(np.sqrt(variance[-1]))
            notes += ("no drift is shown; its time is not identifiable",)
        elif log_sd > (WIDEST if problem.span > REACHED * tau else NARROW):
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
    model = problem.fixed @ beta[: problem.drift]
    if tau is not None and gain >= SHOWN:
        model = model + beta[-1] * problem.curve(tau)
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
        scatter=problem.scatters[0],
        offsets=offsets[:, 0] - offsets[:, 1:] @ beta,
        drift_gain=gain,
        tau_log_sd=log_sd,
        tau_best=np.nan if tau is None else tau,
        model=model,
        flicker=flicker,
        notes=notes,
    )


@dataclass(frozen=True)
class _Spread:
    """Mean and variance of the coefficients, the deviation of tau's logarithm, and the flicker's level."""

    mean: Floats
    variance: Floats
    log_sd: float
    flicker: Usual


def _spread(problem: Problem, levels: Levels, tau: float, beta: Floats, usual: Usual | None, *, shown: bool) -> _Spread:
    """Second moments about `beta` and log tau over the likelihood of tau and of the flicker's level.

    A short record hardly shows its flicker, and what it does not show may still bend a drift: so levels are averaged
    over, evenly likely by their deviation (Gelman 2006) and near `usual`; times evenly by their logarithm. Where no
    drift is shown: about the fit without one, over times that the runs are long enough to show.
    """
    weights, parts = [], []
    allowed = _flicker_levels(problem, levels, tau, usual)
    for level, weight in allowed:
        logs = _likely_times(problem, level, tau, shown=shown)
        solved = [problem.solve(level, float(t)) for t in np.exp(logs)]
        squares = np.array([s[2] for s in solved])
        within = np.exp(-(squares - squares.min()) / 2)
        # The more flicker, the more times are likely: that speaks for it as well.
        room = float(logs[1] - logs[0]) if shown else 1 / float(within.sum())
        weights.append(weight * within * room)
        parts.append((logs, np.array([s[0] for s in solved]), np.array([np.diag(s[1]) for s in solved])))
    likely = np.concatenate(weights)
    likely /= likely.sum()
    logs, values, own = (np.concatenate([p[k] for p in parts]) for k in range(3))
    middle = float(np.log(tau))
    mean = likely @ values
    wide = float(np.sqrt(likely @ (logs - likely @ logs) ** 2)) > WIDEST or not shown
    about, centre = (mean, float(likely @ logs)) if wide else (beta, middle)
    if not shown:
        # What is used is the constant bias; the drift that may hide in it widens its deviation.
        about = np.append(problem.solve(levels, None)[0], mean[-1])
        mean = about
    share = np.array([w.sum() for w in weights]) / sum(w.sum() for w in weights)
    swings = np.log([level.swing for level, _ in allowed])
    flicker = Usual(float(share @ swings), float(share @ (swings - share @ swings) ** 2))
    variance = likely @ (own + (values - about) ** 2)
    return _Spread(mean, variance, float(np.sqrt(likely @ (logs - centre) ** 2)), flicker)


def _flicker_levels(problem: Problem, levels: Levels, tau: float, usual: Usual | None) -> list[tuple[Levels, float]]:
    """Levels of flicker that the data allow, each with its weight."""
    start = np.log(max(levels.swing / problem.base, np.exp(FLOOR)))
    logs = np.unique(np.append(np.arange(FLOOR, 6.1, 1.5), start))
    trials = [replace(levels, swing=float(np.exp(q)) * problem.base) for q in logs]
    costs = np.array([problem.cost(level, tau) for level in trials])
    # By logarithm, levels near none would outweigh all others.
    score = logs / 2 - costs / 2
    if usual is not None:
        score -= (logs + np.log(problem.base) - usual.mean) ** 2 / (2 * usual.variance)
    weight = np.exp(score - score.max()) * np.gradient(logs)
    weight /= weight.sum()
    return [(level, float(w)) for level, w in zip(trials, weight, strict=True) if w > 0.01]


def _likely_times(problem: Problem, levels: Levels, tau: float, *, shown: bool) -> Floats:
    """(GRID,) logarithms of tau as far as its likelihood reaches."""
    low, high = np.log(problem.shortest), np.log(problem.longest)
    if not shown:
        return np.linspace(low, max(np.log(problem.span / 2), low + 1), GRID)
    middle = float(np.log(tau))
    least = problem.cost(levels, tau, restricted=False)
    ends = []
    for way, bound in ((-1, low), (1, high)):
        # Outwards until nothing is likely: the tail of long times may be far longer than the other.
        reach = 0.004
        while reach < way * (bound - middle):
            if problem.cost(levels, float(np.exp(middle + way * reach)), restricted=False) - least > UNLIKELY:
                break
            reach *= 1.6
        ends.append(middle + way * min(reach, max(way * (bound - middle), 0.0)))
    return np.linspace(ends[0], ends[1], GRID)


def fit_triad(found: Sequence[Stretch], axes: Sequence[int], tell: Callable[[float], None]) -> dict[int, AxisFit]:
    """The axes of one sensor. Turn-on scatter and fixture errors are alike on its axes: found on each, pooled, held."""
    data = {axis: made for axis in axes if (made := axis_data(found, axis)) is not None}
    first = {}
    for axis, columns in data.items():
        first[axis] = fit_axis(columns)
        tell(1 / (2 * len(data)))
    if not first:
        return {}
    turn_on = float(np.mean([f.levels.turn_on for f in first.values() if f.scatter] or [0.0]))
    fixture = float(np.mean([f.levels.fixture for f in first.values()]))
    usual = {axis: _of_others(first, axis) for axis in first}
    if turn_on == 0 and fixture == 0:
        return {a: made if (u := usual[a]) is None else _told_flicker(data[a], made, u) for a, made in first.items()}
    pooled = Levels(1.0, 0.0, 0.0, turn_on, fixture)
    second = {}
    for axis, columns in data.items():
        second[axis] = fit_axis(columns, pooled, first[axis], usual[axis])
        tell(1 / (2 * len(data)))
    return second


def _of_others(fits: dict[int, AxisFit], axis: int) -> Usual | None:
    """What the sensor's other axes tell of this one's flicker: alike within ALIKE."""
    others = [f.flicker for a, f in fits.items() if a != axis and f.flicker is not None]
    if not others:
        return None
    weight = np.array([1 / (u.variance + ALIKE**2) for u in others])
    mean = float(weight @ [u.mean for u in others] / weight.sum())
    return Usual(mean, 1 / float(weight.sum()) + ALIKE**2)
