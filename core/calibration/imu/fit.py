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

from core.calibration.imu.columns import AxisData, Levels, Problem, axis_data
from core.calibration.imu.stretches import Stretch

Floats = npt.NDArray[np.float64]

SHOWN = 12.0  # chi-square that a drift must save to count as shown
WIDEST = 1.0  # deviation of tau's logarithm, beyond which it is not shown
GRID = 25
SURE = 10.0  # deviations, beyond which a drift needs no comparison with none
FLOOR = -9.0  # logarithm of a level that does not show
MATRIX_SD = 0.2  # beyond which an element is not shown


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
    tau_best: float
    model: Floats
    notes: tuple[str, ...] = ()


def fit_axis(data: AxisData, pooled: Levels | None = None, before: AxisFit | None = None) -> AxisFit:
    """Fit one axis. `pooled` gives turn_on and fixture found over all axes of the sensor; without it they are found
    here, where runs and segments are enough for it. `before` is a fit to start from."""
    problem = Problem(data)
    enough = len(data.value) >= 12 and problem.span > 6 * problem.shortest
    with_turn_on = problem.runs > 1
    rows = len(np.unique(data.segment[data.size > 0]))
    with_fixture = rows > len(problem.used) + (with_turn_on * (problem.runs - 1))
    free = (with_turn_on, with_fixture) if pooled is None else (False, False)
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
    return _described(problem, levels, tau, gain)


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


def _described(problem: Problem, levels: Levels, tau: float | None, gain: float) -> AxisFit:
    """Coefficients by name with deviations; NaN for those that are not shown."""
    shown = problem.shown
    beta, covariance, _, offsets = problem.solve(levels, tau)
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
        tau_best=np.nan if tau is None else tau,
        model=np.hstack(columns) @ beta,
        notes=notes,
    )


@dataclass(frozen=True)
class _OverTau:
    mean: Floats
    variance: Floats
    log_sd: float


def _over_tau(problem: Problem, levels: Levels, tau: float, beta: Floats) -> _OverTau:
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
    """The axes of one sensor. Turn-on scatter and fixture errors are alike on its axes: found on each, pooled, held."""
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
        second[axis] = fit_axis(columns, pooled, first[axis])
        tell(1 / (2 * len(data)))
    return second
