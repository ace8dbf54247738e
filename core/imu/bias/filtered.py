"""Our bias estimators: `best` looks back only, `smoothed` with hindsight. Heading and bias in one Kalman filter.

State: heading, bias as a random walk b, bias as a Gauss-Markov process f, bias per kelvin c, and the rate r that is
left of a movement. Blocks in movement integrate heading' = gyro - (b + f + c T); those at rest hold it but for r, which
dies out, and measure gyro = b + f + c T + r. A rest so repairs the heading before it, through the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from core.errors import ParameterError
from core.imu.bias import _learn_numba as kernel
from core.imu.bias._best_numba import run as run_blocks
from core.imu.bias.blocks import Blocks, cut
from core.imu.bias.drift import SLOPE_SD, BiasNoise, learn, usual
from core.imu.bias.result import ACCEPTED, REJECTED_BY_BAND, REJECTED_BY_RANGE, BiasEstimate, SegmentVerdicts
from core.run import Run
from core.sensors import ImuLog

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

HIDDEN = 0.8  # of the Gauss-Markov sd, in hindsight: flicker too fast for means at rest to show
FASTEST = 4.0  # s: of flicker faster than this hardly anything is left in a bias
HINDSIGHT = 1500  # blocks after which noise levels count as known


@dataclass(frozen=True)
class FilterConfig:
    """block [s]; gate: deviations between a rest's mean and the bias; enter: the same where a rest begins; patience
    [s]: a rest that is steady for so long at another mean is believed; tail: sd of the rate left when a rest is first
    taken for one, in units of the noise of a second's mean, before it is learnt, and tail_tau [s] its correlation
    time; stop: what each stop's beginning and end hide, in noise of a second's angle; first_sd [rad/s] of the bias
    before anything is known; noise: of the gyro, learnt from the run's own rests where None.
    """

    block: float = 0.2
    gate: float = 5.0
    enter: float = 2.0
    patience: float = 30.0
    tail: float = 3.0
    tail_tau: float = 5.0
    stop: float = 1.0
    first_sd: float = 0.2
    noise: BiasNoise | None = None

    def __post_init__(self) -> None:
        for name in ("block", "gate", "enter", "patience", "tail", "tail_tau", "stop", "first_sd"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ParameterError(f"{name} is {value}, expected over 0", parameter=name, found=value)


@dataclass(frozen=True)
class _Pass:
    """What the causal filter gives by block: live (K, 7) as known at the time, marks (K, 4) and mean (K,) as they
    stand in the end, and its last state."""

    live: Floats
    marks: Ints
    mean: Floats
    state: kernel.State

    @property
    def still(self) -> Flags:
        return np.asarray(self.marks[:, 0] == 1)


def settings(config: FilterConfig, length: float, warm: bool) -> Floats:
    """The kernel's constants for blocks of `length` [s]; `warm` where there is a temperature."""
    noise = config.noise
    out = np.zeros(kernel.SETTINGS)
    out[kernel.GATE], out[kernel.ENTER] = config.gate, config.enter
    out[kernel.PATIENCE] = config.patience / length
    out[kernel.FIRST], out[kernel.SLOPE] = config.first_sd**2, SLOPE_SD**2 if warm else 0.0
    out[kernel.TAIL], out[kernel.TAIL_TAU], out[kernel.STOP] = config.tail, config.tail_tau, config.stop
    out[kernel.LENGTH] = length
    out[kernel.TAU] = noise.tau if noise else kernel.USUAL_TAU
    if noise:
        out[kernel.GIVEN] = 1.0
        out[kernel.N2], out[kernel.K2], out[kernel.SD2] = noise.N**2, noise.K**2, noise.sd**2
    return out


def best(run: Run, imu: ImuLog, config: FilterConfig) -> BiasEstimate:
    """Heading and bias as known at the time."""
    blocks = cut(run, imu, config.block)
    done = _live(imu, blocks, config)
    noise = _last_noise(done, blocks, config)
    return _result("best", blocks, noise, done, done.live[:, :2], done.live[:, 2:4], hold=True)


def smoothed(run: Run, imu: ImuLog, config: FilterConfig) -> BiasEstimate:
    """Heading and bias with hindsight: the same filter, its labels as they stand in the end, and back again."""
    blocks = cut(run, imu, config.block)
    done = _live(imu, blocks, config)
    noise = config.noise or _learnt(done, blocks)
    _, heading, bias = _again(blocks, done, noise, config, done.state.tail)
    return _result("smoothed", blocks, noise, done, heading, bias, hold=False)


def known_rests(run: Run, imu: ImuLog, resting: Flags, config: FilterConfig, hindsight: bool) -> BiasEstimate:
    """The same estimators told which readings are at rest (n,): what knowing stillness perfectly would give."""
    blocks = cut(run, imu, config.block)
    moving = np.concatenate(([0], np.cumsum(~resting)))
    still = moving[blocks.start[1:]] == moving[blocks.start[:-1]]
    done = _live(imu, blocks, config)
    marks = done.marks.copy()
    marks[:, 0] = still
    marks[:, 1] = _since(still)
    nothing = done.state._replace(tail=np.zeros_like(done.state.tail))  # where rests are known, nothing creeps in them
    done = replace(done, marks=marks, state=nothing)
    noise = config.noise or _learnt(done, blocks)
    forward, heading, bias = _again(blocks, done, noise, config, np.zeros((0, 2)))
    if not hindsight:
        x, p = forward
        kelvin = blocks.given[:, kernel.KELVIN]
        h = np.stack([np.zeros(len(x)), np.ones(len(x)), np.ones(len(x)), kelvin, np.zeros(len(x))], axis=1)
        heading = np.stack([x[:, 0], p[:, 0, 0]], axis=1)
        bias = np.stack([np.einsum("ki,ki->k", h, x), np.einsum("ki,kij,kj->k", h, p, h)], axis=1)
    return _result("known rests", blocks, noise, done, heading, bias, hold=False)


def _since(still: Flags) -> Ints:
    place = np.arange(len(still))
    return np.where(still, place - np.maximum.accumulate(np.where(still, -1, place)) - 1, 0)


def _live(imu: ImuLog, blocks: Blocks, config: FilterConfig) -> _Pass:
    c = settings(config, blocks.length, bool(blocks.given[:, kernel.KELVIN].any()))
    state = kernel.new_state(c)
    live, marks, mean = run_blocks(state, c, imu.gz, blocks.start, blocks.given)
    return _Pass(live, marks, mean, state)


def _last_noise(done: _Pass, blocks: Blocks, config: FilterConfig) -> BiasNoise:
    """The noise that the causal filter had learnt in the end."""
    if config.noise:
        return config.noise
    level = done.state.level
    white = float(np.sqrt(level[kernel.WHITE] * blocks.length)) or 1e-6
    return BiasNoise(white, float(np.sqrt(level[kernel.WALK])), float(np.sqrt(level[kernel.SWING])), kernel.USUAL_TAU)


def _noise_of_mean(done: _Pass, blocks: Blocks) -> Floats:
    """(K,) variance of each block's mean in rest, by the levels as known some minutes later."""
    later = np.minimum(np.arange(len(done.mean)) + HINDSIGHT, len(done.mean) - 1)
    level = done.live[later, 5]
    count = np.diff(blocks.start)
    known = np.where(level > 0, level, max(float(level.max()), 1e-18)) / np.maximum(count, 1)
    return np.where(count >= 2, known, kernel.NOTHING)


def _learnt(done: _Pass, blocks: Blocks) -> BiasNoise:
    """The most likely drift, from the whole run's rests."""
    table = np.concatenate((done.state.tail, np.zeros((1, 2))))
    left = table[np.where(done.still, np.minimum(done.marks[:, 1], len(table) - 1), -1)]
    white = float(np.sqrt(done.state.level[kernel.WHITE] * blocks.length)) or 1e-6
    kelvin = blocks.given[:, kernel.KELVIN]
    mean = done.mean - done.marks[:, 3] * left[:, 0]
    noise = _noise_of_mean(done, blocks)
    return learn(done.still & (noise < kernel.NOTHING), blocks.t, mean, noise, kelvin, white, left[:, 1])


def _again(
    blocks: Blocks, done: _Pass, noise: BiasNoise, config: FilterConfig, tail: Floats
) -> tuple[tuple[Floats, Floats], Floats, Floats]:
    """Forward with the labels as they stand, and back: states, heading and bias by block."""
    from core.imu.bias._filter_numba import follow, smooth

    given, marks = blocks.given, done.marks
    columns = np.ascontiguousarray(
        np.stack([given[:, kernel.TIME], given[:, kernel.ANGLE], given[:, kernel.LOST], done.mean,
                  given[:, kernel.KELVIN]], axis=1)
    )  # fmt: skip
    warm = SLOPE_SD**2 if given[:, kernel.KELVIN].any() else 0.0
    start = np.array([config.first_sd**2, noise.sd**2, warm])
    setting = np.array([noise.N**2, noise.K**2, noise.tau, config.tail_tau, (config.stop * noise.N) ** 2])
    variance = _noise_of_mean(done, blocks)
    still = done.still
    x, p, residual, total, kept = follow(
        still, marks[:, 1].copy(), marks[:, 3].copy(), marks[:, 2] == 1, columns, variance, tail, start, setting
    )
    heading, bias = smooth(still, x, p, residual, total, kept, columns, variance, setting)
    return (x, p), heading, bias


def _result(
    method: str, blocks: Blocks, noise: BiasNoise, done: _Pass, heading: Floats, bias: Floats, *, hold: bool
) -> BiasEstimate:
    """On the curve's stamps: at rest the heading's own curve, in movement the raw integral with the filter's
    correction; `hold` goes on from the last block that had ended."""
    out, cells = blocks.out, blocks.cells
    count = len(blocks.t)
    block = np.arange(len(out)) // cells  # how many blocks have ended
    ended = np.minimum(block, count)
    angle = np.concatenate(([0.0], heading[:, 0]))
    raw = blocks.turned[: cells * count + 1 : cells]
    value, variance = np.concatenate((bias[:1, 0], bias[:, 0])), np.concatenate((bias[:1, 1], bias[:, 1]))
    if hold:
        value[0], variance[0] = 0.0, np.inf
        calm = np.concatenate(([False], done.live[:, 4] == 1))[ended]
        since = out - blocks.out[ended * cells]
        going = angle[ended] + blocks.turned - raw[ended] - value[ended] * since
        theta = np.where(calm, angle[ended], going)
        at, still = ended, done.live[:, 4] == 1
        fast: Floats | float = np.concatenate(([0.0], done.live[:, 6]))[at]
    else:
        at = np.minimum(-(-np.arange(len(out)) // cells), count)
        # Every octave of flicker holds as much: the fewer there are below the process' time, the less is missing.
        octaves = np.log(max(noise.tau / FASTEST, 1.0)) / np.log(kernel.USUAL_TAU / FASTEST)
        fast = HIDDEN**2 * (noise.sd**2 * min(float(octaves), 1.0) + usual(noise.N).sd ** 2)
        ends = np.concatenate((out[:1], blocks.t))
        still = done.still
        calm = np.concatenate((still[:1], still))[at]
        theta = np.where(calm, np.interp(out, ends, angle), np.interp(out, ends, angle - raw) + blocks.turned)
    verdict = np.where(still, ACCEPTED, np.where(done.live[:, 4] == 1, REJECTED_BY_BAND, REJECTED_BY_RANGE))
    figures = {"N": noise.N, "K": noise.K, "markov_sd": noise.sd, "markov_tau": noise.tau, "length": blocks.length}
    notes = blocks.notes
    if not still.any():
        notes += ("No rest was found: the bias is not known, the heading is the raw integral.",)
    spread = np.concatenate((heading[:1, 1] * 0, heading[:, 1]))[at]
    return BiasEstimate(
        method,
        out,
        theta - theta[0],
        value[at],
        np.sqrt(np.maximum(variance[at], 0.0) + fast),
        np.sqrt(np.maximum(spread, 0.0)),
        calm,
        SegmentVerdicts(blocks.t - blocks.length / 2, done.mean, verdict.astype(np.int8)),
        figures,
        notes,
    )
