"""Our bias estimators: `best` looks back only, `smoothed` with hindsight. Heading and bias in one Kalman filter.

State: heading, bias as a random walk b, bias as a Gauss-Markov process f, bias per kelvin c, and the rate r that is
left of a movement. Blocks in movement integrate heading' = gyro - (b + f + c T); those at rest hold it but for r, which
dies out, and measure gyro = b + f + c T + r. A rest so repairs the heading before it, through the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import ParameterError
from core.imu.bias.blocks import Blocks, cut
from core.imu.bias.drift import SLOPE_SD, BiasNoise, learn, usual
from core.imu.bias.result import ACCEPTED, REJECTED_BY_BAND, REJECTED_BY_RANGE, BiasEstimate, SegmentVerdicts
from core.run import Run
from core.sensors import ImuLog

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

FAST = 0.8  # of the Gauss-Markov sd, found and usual: flicker too fast for means at rest to show, yet part of the bias


@dataclass(frozen=True)
class FilterConfig:
    """block [s]; tail: sd of the rate left when a rest is first taken for one, in units of the noise of a second's
    mean; tail_tau [s] its correlation time; tail_fade [s] in which its sd dies out; gate: deviations between a rest's
    mean and the bias; enter: the same where a rest begins; patience [s]: a rest that is steady for so long at another
    mean is believed; first_sd [rad/s] of the bias before anything is known; noise: of the gyro, learnt from the run's
    own rests where None.
    """

    block: float = 0.2
    tail: float = 1.5
    tail_tau: float = 2.5
    tail_fade: float = 1.0
    gate: float = 4.0
    enter: float = 2.0
    patience: float = 30.0
    first_sd: float = 0.2
    noise: BiasNoise | None = None

    def __post_init__(self) -> None:
        for name in ("block", "tail", "tail_tau", "tail_fade", "gate", "enter", "patience", "first_sd"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ParameterError(f"{name} is {value}, expected over 0", parameter=name, found=value)


@dataclass(frozen=True)
class _Pass:
    """What one forward pass gives, by block."""

    still: Flags
    x: Floats
    p: Floats
    residual: Floats
    total: Floats
    live: Floats
    live_bias: Floats


def best(run: Run, imu: ImuLog, config: FilterConfig) -> BiasEstimate:
    """Heading and bias as known at the time."""
    blocks, noise, _, done = _forward(run, imu, config)
    return _result("best", blocks, noise, done.still, done.live, done.live_bias, hold=True)


def smoothed(run: Run, imu: ImuLog, config: FilterConfig) -> BiasEstimate:
    """Heading and bias with hindsight: the same filter, and back again."""
    blocks, noise, setting, done = _forward(run, imu, config)
    heading, bias = _backward(blocks, done, setting)
    return _result("smoothed", blocks, noise, done.still, heading, bias, hold=False)


def known_rests(run: Run, imu: ImuLog, resting: Flags, config: FilterConfig, hindsight: bool) -> BiasEstimate:
    """The same estimators told which readings are at rest (n,): what knowing stillness perfectly would give."""
    blocks = cut(run, imu, config.block)
    edges = np.searchsorted(imu.t, np.concatenate(([imu.t[0]], blocks.t)) + 1e-9, "right")
    moving = np.concatenate(([0], np.cumsum(~resting)))
    still = (moving[edges[1:]] - moving[edges[:-1]] == 0) & np.isfinite(blocks.noise)
    noise = config.noise or learn(still, blocks.t, blocks.mean, blocks.noise, blocks.kelvin, blocks.white)
    setting = _setting(noise, blocks, config)
    setting[4] = 0.0
    done = _track(blocks, setting, still)
    heading, bias = _backward(blocks, done, setting) if hindsight else (done.live, done.live_bias)
    return _result("known rests", blocks, noise, done.still, heading, bias, hold=not hindsight)


def _forward(run: Run, imu: ImuLog, config: FilterConfig) -> tuple[Blocks, BiasNoise, Floats, _Pass]:
    blocks = cut(run, imu, config.block)
    noise = config.noise
    if noise is None:
        found = _track(blocks, _setting(usual(blocks.white), blocks, config))
        tail = (config.tail * blocks.white, config.tail_fade)
        noise = learn(found.still, blocks.t, blocks.mean, blocks.noise, blocks.kelvin, blocks.white, tail)
    setting = _setting(noise, blocks, config)
    return blocks, noise, setting, _track(blocks, setting)


def _setting(noise: BiasNoise, blocks: Blocks, config: FilterConfig) -> Floats:
    slope = SLOPE_SD**2 if blocks.kelvin.any() else 0.0
    return np.array(
        [
            noise.N**2,
            noise.K**2,
            noise.tau,
            noise.sd**2,
            config.tail * noise.N,
            config.tail_tau,
            config.gate,
            config.first_sd**2,
            slope,
            config.patience / blocks.time[0],
            config.tail_fade,
            config.enter,
        ]
    )


def _track(blocks: Blocks, setting: Floats, still: Flags | None = None) -> _Pass:
    from core.imu.bias._filter_numba import track

    quiet = blocks.quiet if still is None else still
    return _Pass(
        *track(
            quiet,
            blocks.calm,
            still is None,
            blocks.angle,
            blocks.lost,
            blocks.time,
            blocks.mean,
            blocks.noise,
            blocks.kelvin,
            setting,
        )
    )


def _backward(blocks: Blocks, done: _Pass, setting: Floats) -> tuple[Floats, Floats]:
    from core.imu.bias._filter_numba import smooth

    return smooth(
        done.still, done.x, done.p, done.residual, done.total, blocks.time, blocks.noise, blocks.kelvin, setting
    )


def _result(
    method: str, blocks: Blocks, noise: BiasNoise, still: Flags, heading: Floats, bias: Floats, *, hold: bool
) -> BiasEstimate:
    """On the curve's stamps: at rest the heading's own curve, in movement the raw integral with the filter's
    correction; `hold` keeps the last block's where interpolation would look ahead."""
    ends = np.concatenate((blocks.out[:1], blocks.t))
    angle = np.concatenate(([0.0], heading[:, 0]))
    raw = blocks.turned[:: blocks.cells][: len(ends)]
    place = np.clip(np.searchsorted(ends, blocks.out - 1e-9), 1, len(ends) - 1) - 1
    known = np.clip(np.searchsorted(ends, blocks.out + 1e-9, "right") - 1, 0, len(ends) - 1)
    calm = still[place] & (blocks.out <= ends[-1] + 1e-9)
    if hold:
        theta = np.where(calm, angle[known], (angle - raw)[known] + blocks.turned)
    else:
        held = np.interp(blocks.out, ends, angle)
        theta = np.where(calm, held, np.interp(blocks.out, ends, angle - raw) + blocks.turned)
    at = np.maximum(known - 1, 0) if hold else place
    verdict = np.where(still, ACCEPTED, np.where(blocks.quiet, REJECTED_BY_BAND, REJECTED_BY_RANGE)).astype(np.int8)
    figures = {"N": noise.N, "K": noise.K, "markov_sd": noise.sd, "markov_tau": noise.tau, "length": blocks.time[0]}
    notes = blocks.notes
    if not still.any():
        notes += ("No rest was found: the bias is not known, the heading is the raw integral.",)
    return BiasEstimate(
        method,
        blocks.out,
        theta - theta[0],
        bias[at, 0],
        np.sqrt(np.maximum(bias[at, 1], 0.0) + FAST**2 * (noise.sd**2 + usual(noise.N).sd ** 2)),
        np.sqrt(np.maximum(np.where(blocks.out > blocks.out[0], heading[at, 1], 0.0), 0.0)),
        calm,
        SegmentVerdicts(blocks.t - blocks.time / 2, blocks.mean, verdict),
        figures,
        notes,
    )
