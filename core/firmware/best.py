"""The header's part for `best`: the constants of its kernel, so that both are always the same filter."""

from __future__ import annotations

import math

import numpy as np

from core.firmware.constants import MICRO, Constant, integer, number, vector
from core.imu.bias import BiasNoise, FilterConfig
from core.imu.bias import _learn_numba as kernel
from core.imu.bias.blocks import FEWEST, PAUSE, WARMTH
from core.imu.bias.drift import SLOPE_SD
from core.imu.bias.result import RATE

RECENT = 10  # readings that the rate beside a gap is told from


def constants(rate_hz: float, given: BiasNoise | None, config: FilterConfig) -> list[Constant]:
    """All of them; `given` where the drift is told, else it is learnt on the controller."""
    step = 1 / rate_hz
    length = max(1, round(max(config.block, FEWEST * step) * RATE)) / RATE
    return [
        *_blocks(step, length),
        *_rests(length, config),
        *_filter(length, given, config),
        *_learning(length, config),
    ]


def _blocks(step: float, length: float) -> list[Constant]:
    most = math.ceil(1.25 * length / step) + 2
    return [
        Constant("DS_BLOCK_US", integer(length * MICRO), "us", "a block"),
        Constant("DS_BLOCK_S", number(length), "s", "the same"),
        Constant("DS_BLOCK_MOST", f"{most}U", "samples", "kept of a block: a quarter more than the rate gives"),
        Constant("DS_CELL_US", integer(MICRO / RATE), "us", "a step of the curve that Python writes"),
        Constant("DS_GAP_US", integer(PAUSE * step * MICRO), "us", "a longer step is a gap"),
        Constant("DS_GO_ON_US", integer(2 * step * MICRO), "us", "that a reading holds for after it, at most"),
        Constant("DS_RECENT", f"{RECENT}U", "samples", "on each side of a gap that its rate is told from"),
        Constant("DS_WARMTH", number(WARMTH), "", "share of a block in the running mean of the temperature"),
        Constant("DS_RING", f"{kernel.RING}U", "blocks", "that may still be labelled anew"),
    ]


def _rests(length: float, config: FilterConfig) -> list[Constant]:
    scales = "{" + ", ".join(f"{n}U" for n in kernel.SCALES) + "}"
    patience = math.ceil(config.patience / length - 1e-9)
    return [
        Constant("DS_WINDOW", f"{kernel.WINDOW}U", "blocks", "in which a rest is recognised"),
        Constant("DS_EVEN", number(kernel.EVEN), "", "chi-square of a window's means, at 1e-5"),
        Constant("DS_STEADY", number(kernel.STEADY), "", "chi-square of three windows' means, at 1e-2"),
        Constant("DS_QUIETER", number(kernel.QUIETER), "sd", "that a window must be quieter by, to be a new level"),
        Constant("DS_FAR", number(kernel.FAR), "sd", "of a block's variance that speak against rest"),
        Constant("DS_CLIP", number(kernel.CLIP), "sd", "beyond which a reading counts as this"),
        Constant("DS_SCALES", f"{len(kernel.SCALES)}U", "", "how many scales there are"),
        Constant("DS_SCALE_BLOCKS", scales, "blocks", "over which a rest's mean is compared with the bias before"),
        Constant("DS_GATE", number(config.gate), "sd", "between a rest's mean and the bias that end it"),
        Constant("DS_ENTER", number(config.enter), "sd", "the same where a rest begins"),
        Constant("DS_PATIENCE", f"{patience}U", "blocks", "a rest that is steady elsewhere for so long is believed"),
    ]


def _filter(length: float, given: BiasNoise | None, config: FilterConfig) -> list[Constant]:
    tau = given.tau if given else kernel.USUAL_TAU
    keep, tail = math.exp(-length / tau), math.exp(-length / config.tail_tau)
    origin = "as given" if given else "learnt on the controller"
    noise = given or BiasNoise(1.0, 0.0, 0.0)
    return [
        Constant("DS_FIRST_VARIANCE", number(config.first_sd**2), "rad^2/s^2", "of the bias before a first rest"),
        Constant("DS_SLOPE_VARIANCE", number(SLOPE_SD**2), "rad^2/s^2/K^2", "of the bias per kelvin: 0.04 deg/s/K"),
        Constant("DS_STOP", number(config.stop), "sd", "of a second's angle, that each stop's beginning and end hide"),
        Constant("DS_MARKOV_TAU", number(tau), "s", "correlation time of the Gauss-Markov process"),
        Constant("DS_MARKOV_KEEP", number(keep), "", "exp(-block / that)"),
        Constant("DS_TAIL_TAU", number(config.tail_tau), "s", "correlation time of what is left of a movement"),
        Constant("DS_TAIL_KEEP", number(tail), "", "exp(-block / that)"),
        Constant("DS_FAST", number(kernel.FAST), "", "of the Gauss-Markov deviation, too fast for rests to show"),
        Constant("DS_SHOWN", number(kernel.SHOWN), "s", "of a mean whose white noise flicker exceeds: rests show more"),
        Constant("DS_NOISE_GIVEN", "1" if given else "0", "", "1: the drift is given; 0: it is learnt"),
        Constant("DS_GIVEN_WHITE", number(noise.N**2), "rad^2/s", f"N^2; {origin}"),
        Constant("DS_GIVEN_WALK", number(noise.K**2), "rad^2/s^3", f"K^2; {origin}"),
        Constant("DS_GIVEN_SWING", number(noise.sd**2), "rad^2/s^2", f"of the Gauss-Markov process; {origin}"),
    ]


def _learning(length: float, config: FilterConfig) -> list[Constant]:
    edges = np.array(kernel.EDGES)
    first = config.tail**2 * np.exp(-(edges[1:] + edges[:-1]) * length / 5)
    usual = 0.5 * np.exp(-(edges[1:] + edges[:-1]) / 8 * length)
    walk, swing = np.array(kernel.BANK_K) ** 2, np.array(kernel.BANK_SD) ** 2
    weight = np.outer(kernel.BANK_K_PRIOR, kernel.BANK_SD_PRIOR).ravel()
    size = len(weight)
    joined = "{" + ", ".join(f"{n}U" for n in edges) + "}"
    return [
        Constant("DS_BINS", f"{len(edges) - 1}U", "", "of the time since a rest began, to learn the tail in"),
        Constant("DS_BIN_EDGES", joined, "blocks", "of them"),
        Constant("DS_BIN_FIRST", _list(first), "1/s", "variance of the tail over N^2, before it is learnt"),
        Constant("DS_BIN_USUAL", _list(usual), "1/s", "variance of its mean's prior, 0, over N^2"),
        Constant("DS_TABLE", f"{kernel.TABLE}U", "blocks", "of the tail"),
        Constant("DS_TAIL_PRIOR", number(kernel.TAIL_PRIOR), "rests", "that the prior of the tail counts for"),
        Constant("DS_DOUBT", number(kernel.DOUBT), "", "times its variance that the tail's mean must exceed, squared"),
        Constant("DS_GROUP", f"{kernel.GROUP}U", "blocks", "of a mean that the drift is learnt from"),
        Constant("DS_BANK", f"{size}U", "", "candidates of the drift"),
        Constant("DS_BANK_FIRST", _list(weight), "", "their weights at first"),
        Constant("DS_BANK_WALK", _list(np.repeat(walk, len(swing))), "1/s^2", "their K^2 over N^2"),
        Constant("DS_BANK_SWING", _list(np.tile(swing, len(walk))), "1/s", "their Gauss-Markov variance over N^2"),
        Constant("DS_BANK_KEEP", number(0.9995), "", "of a weight; the rest is shared out, so that none dies"),
        Constant("DS_BANK_FLOOR", number(0.0005 / size), "", "what each gets of it"),
    ]


def _list(values: np.ndarray) -> str:
    return "{" + ", ".join(vector(values)) + "}"
