"""A gyro on a platform that turns and rests, after Cechowicz 2017: the plant that bias methods are judged on.

White noise, quantisation, warm-up, flicker and rate random walk as of an L3GD20H; movements end in a creep that the
paper's range test takes for rest. Made here from scratch, so that an estimator is not judged by its own model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.run import Run, RunMeta
from core.sensors import ImuLog, TruthLog

Floats = npt.NDArray[np.float64]

DEG = np.pi / 180
DEG_H = DEG / 3600
LSB = 0.00875 * DEG  # of the L3GD20H at +/-245 deg/s


@dataclass(frozen=True)
class Scenario:
    """What a record is like. Densities two-sided; `lively` moves 69 % of the time; vibrations are sd per reading
    [rad/s]; `tails` are the degrees of freedom of a Student's t (0: Gaussian)."""

    hours: float = 12.0
    rate: float = 384.0
    lively: bool = False
    creep: str = "slow"  # "slow" speed, "fading" speed, "long" fading, "stepping" down, "mixed" of all, or "none"
    stops: str = "exponential"  # their lengths on the lively platform; or "even", "wide"
    straight: float = 0.0  # share of a lively platform's legs that hardly turn
    both_ways: bool = False  # turns of the paper's platform to either side
    N: float = 0.011 * DEG
    B: float = 3.58 * DEG_H / 0.664
    K: float = 1.0 * DEG_H / 60.0  # 1 deg/h in an hour's root
    warm_fast: float = -110.0 * DEG_H  # over 15 minutes
    warm_slow: float = 150.0 * DEG_H  # over 75 minutes
    temperature_slope: float = 0.0  # rad/s/K, of a daily swing of 8 K, given as a column
    vibration_drive: float = 0.0
    vibration_rest: float = 0.0
    vibration: str = "tone"  # of 37 Hz; or "band", noise from 15 to 60 Hz; or "motor", a tone of changing pitch
    tails: float = 0.0


SCENARIOS: dict[str, Scenario] = {
    "paper": Scenario(),
    "paper, fading ends": Scenario(creep="fading"),
    "lively": Scenario(lively=True),
    "lively, fading ends": Scenario(lively=True, creep="fading"),
    "hot start": Scenario(warm_fast=-400 * DEG_H, warm_slow=300 * DEG_H),
    "temperature": Scenario(temperature_slope=18 * DEG_H),
    "lively, temperature": Scenario(lively=True, temperature_slope=18 * DEG_H),
    "vibration in driving": Scenario(vibration_drive=0.6 * DEG),
    "vibration always": Scenario(vibration_drive=0.6 * DEG, vibration_rest=0.2 * DEG),
    "lively, vibration": Scenario(lively=True, vibration_drive=0.6 * DEG, vibration_rest=0.2 * DEG),
    "heavy tails": Scenario(tails=3.0),
    "lively, heavy tails": Scenario(lively=True, tails=3.0),
}

# Other creeps, stops, shakes and sensors: what a method must not be tuned to.
VARIATIONS: dict[str, Scenario] = {
    "paper, long fading": Scenario(creep="long"),
    "paper, stepping": Scenario(creep="stepping", both_ways=True),
    "lively, long fading": Scenario(lively=True, creep="long"),
    "lively, stepping": Scenario(lively=True, creep="stepping"),
    "lively, mixed, wide": Scenario(lively=True, creep="mixed", stops="wide"),
    "lively, sharp, even": Scenario(lively=True, creep="none", stops="even"),
    "lively, straights": Scenario(lively=True, creep="mixed", straight=0.4, vibration_drive=0.3 * DEG),
    "lively, band shake": Scenario(
        lively=True, creep="mixed", vibration="band", vibration_drive=1.0 * DEG, vibration_rest=0.3 * DEG
    ),
    "lively, motor": Scenario(lively=True, creep="mixed", vibration="motor", vibration_drive=1.0 * DEG),
    "lively, MPU6050": Scenario(lively=True, creep="mixed", N=0.0036 * DEG, B=6.0 * DEG_H, K=3.0 * DEG_H / 60),
    "lively, ADIS16405": Scenario(lively=True, creep="mixed", N=0.041 * DEG, B=25.0 * DEG_H, K=6.0 * DEG_H / 60),
    "paper, MPU6050": Scenario(creep="mixed", N=0.0036 * DEG, B=6.0 * DEG_H, K=3.0 * DEG_H / 60),
}


@dataclass(frozen=True)
class GyroPlant:
    """t, gz, bias, resting (n,) per reading; truth_t, truth_theta at 10 Hz; temperature (n,) or None."""

    t: Floats
    gz: Floats
    bias: Floats
    resting: npt.NDArray[np.bool_]
    truth_t: Floats
    truth_theta: Floats
    temperature: Floats | None

    def run(self) -> Run:
        """The record as a run with a reference heading."""
        imu = ImuLog(self.t, self.gz, temperature=self.temperature)
        return Run(RunMeta(name="gyro"), imu=imu, truth=TruthLog(self.truth_t, theta=self.truth_theta))


def gyro_plant(seed: int, scenario: Scenario) -> GyroPlant:
    """One seeded record of a scenario."""
    rng = np.random.default_rng(seed)
    n = int(scenario.hours * 3600 * scenario.rate)
    t = np.arange(n) / scenario.rate
    knots, rates = _movements(rng, scenario)
    # At rest is where both the knot before and the knot behind are at zero.
    place = np.searchsorted(knots, t, "right") - 1
    zero = np.append((rates[:-1] == 0) & (rates[1:] == 0), True)
    resting = zero[place]
    true = np.interp(t, knots, rates)
    theta = np.concatenate(([0.0], np.cumsum((true[1:] + true[:-1]) / 2 / scenario.rate)))
    bias, temperature = _bias(rng, t, scenario)
    gz = true + bias
    gz += _white(rng, n, scenario)
    if scenario.vibration_drive or scenario.vibration_rest:
        gz += np.where(resting, scenario.vibration_rest, scenario.vibration_drive) * _shake(rng, t, scenario)
    gz = np.round(gz / LSB) * LSB
    truth_t = np.arange(0.0, t[-1], 0.1)
    return GyroPlant(t, gz, bias, resting, truth_t, np.interp(truth_t, t, theta), temperature)


def _shake(rng: np.random.Generator, t: Floats, scenario: Scenario) -> Floats:
    """A vibration of unit deviation."""
    from scipy.signal import butter, sosfilt

    n = len(t)
    if scenario.vibration == "band":
        top = min(60.0, 0.45 * scenario.rate)
        shake = sosfilt(butter(2, [15.0, top], "band", fs=scenario.rate, output="sos"), rng.standard_normal(n))
        return shake / shake.std()
    if scenario.vibration == "motor":
        pitch = np.interp(
            t, np.arange(0.0, t[-1] + 20, 10.0), rng.uniform(8.0, min(90.0, 0.45 * scenario.rate), int(t[-1] / 10) + 3)
        )
        return np.sqrt(2) * np.sin(2 * np.pi * np.cumsum(pitch) / scenario.rate)
    return np.sqrt(2) * np.sin(2 * np.pi * 37.3 * t + np.cumsum(rng.standard_normal(n)) * 0.05)


def _white(rng: np.random.Generator, n: int, scenario: Scenario) -> Floats:
    sd = scenario.N * np.sqrt(scenario.rate)
    if scenario.tails:
        # Scaled to the same standard deviation.
        return sd * rng.standard_t(scenario.tails, n) / np.sqrt(scenario.tails / (scenario.tails - 2))
    return sd * rng.standard_normal(n)


def _bias(rng: np.random.Generator, t: Floats, scenario: Scenario) -> tuple[Floats, Floats | None]:
    """Offset, warm-up, flicker (Gauss-Markov processes two octaves apart) and random walk, made at 1 Hz."""
    from scipy.signal import lfilter

    slow = np.arange(0.0, t[-1] + 2.0)
    bias = rng.uniform(-1, 1) * DEG + np.zeros_like(slow)
    bias += scenario.warm_fast * (1 - np.exp(-slow / 900)) + scenario.warm_slow * (1 - np.exp(-slow / 4500))
    bias += scenario.K * np.cumsum(rng.standard_normal(len(slow)))
    for tau in 4.0 ** np.arange(1, 8):
        # The sum of these has an Allan floor near 0.664 B between their times.
        phi = np.exp(-1 / tau)
        drive = rng.standard_normal(len(slow)) * np.sqrt(1 - phi**2)
        drive[0] = rng.standard_normal()
        bias += scenario.B * 0.664 * lfilter([1.0], [1.0, -phi], drive)
    temperature = None
    if scenario.temperature_slope:
        swing = 4 * np.sin(2 * np.pi * slow / 7200 + rng.uniform(0, 6)) + 4 * np.sin(2 * np.pi * slow / 1700)
        swing += 20 * (1 - np.exp(-slow / 3600))
        bias += scenario.temperature_slope * swing
        temperature = np.round(25 + np.interp(t, slow, swing) + 0.1 * rng.standard_normal(len(t)), 1)
    return np.interp(t, slow, bias), temperature


def _movements(rng: np.random.Generator, scenario: Scenario) -> tuple[Floats, Floats]:
    """Turn rate as knots of a piecewise linear function: stamps [s] and rates [rad/s]."""
    end = scenario.hours * 3600
    knots: list[Floats] = [np.array([0.0])]
    rates: list[Floats] = [np.array([0.0])]
    now = 30.0 if scenario.lively else 360.0
    while now < end - 120:
        leg_t, leg_w = _lively_leg(rng, scenario) if scenario.lively else _turn(rng, scenario)
        tail_t, tail_w = _creep(rng, scenario, float(np.sign(leg_w[-1])) or 1.0)
        stamps = np.concatenate((leg_t, leg_t[-1] + tail_t)) + now
        knots.append(stamps)
        rates.append(np.concatenate((leg_w, tail_w)))
        stop = _stop(rng, scenario)
        now = stamps[-1] + (stop if scenario.lively else 360.0 - (stamps[-1] - now))
    return np.append(np.concatenate(knots), end + 1), np.append(np.concatenate(rates), 0.0)


def _turn(rng: np.random.Generator, scenario: Scenario) -> tuple[Floats, Floats]:
    """About 0.2 rad at 6 deg/s."""
    w = 6 * DEG * rng.uniform(0.8, 1.2)
    hold = (0.17 if scenario.creep != "none" else 0.2) / w - 0.4
    side = rng.choice([-1.0, 1.0]) if scenario.both_ways else 1.0
    return np.array([0.0, 0.4, 0.4 + hold, 0.8 + hold - 0.01]), side * np.array([0.0, w, w, 0.7 * DEG])


def _stop(rng: np.random.Generator, scenario: Scenario) -> float:
    """How long a lively platform rests [s]."""
    if scenario.stops == "even":
        return float(rng.uniform(2.0, 16.0))
    if scenario.stops == "wide":
        return float(0.6 + rng.lognormal(1.4, 1.1))
    return float(1.5 + rng.exponential(8.0))


def _lively_leg(rng: np.random.Generator, scenario: Scenario) -> tuple[Floats, Floats]:
    """Turns of changing rate for about 17 s; or as long straight on, where the rate wanders by 0.2 deg/s."""
    count = 2 + int(rng.exponential(4.0))
    steps = rng.uniform(0.5, 5.0, count)
    w = rng.uniform(-20, 20, count) * DEG
    if scenario.straight and rng.random() < scenario.straight:
        w = 0.2 * DEG * rng.standard_normal(count)
    t = np.concatenate(([0.0], np.cumsum(steps)))
    last = np.sign(w[-1]) * 0.7 * DEG
    return np.append(t, t[-1] + 0.4), np.concatenate(([0.0], w, [last]))


def _creep(rng: np.random.Generator, scenario: Scenario, sign: float) -> tuple[Floats, Floats]:
    """The end of a movement, down to zero."""
    kind = scenario.creep
    if kind == "mixed":
        kind = str(rng.choice(["slow", "fading", "long", "stepping", "none"]))
    if kind == "none":
        return np.array([0.05]), np.array([0.0])
    if kind == "stepping":  # sticks and slips
        steps = 0.05 + np.cumsum(rng.uniform(0.2, 1.5, int(rng.integers(2, 7))))
        rates = sign * DEG * rng.uniform(0.0, 0.5, len(steps)) * np.linspace(1.0, 0.3, len(steps))
        return np.append(steps, steps[-1] + 0.1), np.append(rates, 0.0)
    low, high = {"slow": (0.1, 0.4), "fading": (1.0, 2.5), "long": (2.0, 5.0)}[kind]
    tau = rng.uniform(low, high)
    hold = rng.uniform(2.0, 4.0) if kind == "slow" else 0.05
    low, high = {"slow": (0.5, 0.9), "fading": (0.4, 1.0), "long": (0.2, 1.0)}[kind]
    w = sign * DEG * rng.uniform(low, high)
    fade = np.arange(1, 25) * 0.3 * tau
    rates = w * np.exp(-fade / tau)
    return (
        np.concatenate(([0.05, 0.05 + hold], 0.05 + hold + fade, [0.1 + hold + fade[-1]])),
        np.concatenate(([w, w], rates, [0.0])),
    )
