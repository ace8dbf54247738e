"""How a gyro's bias moves: white noise, random walk and a Gauss-Markov process, learnt from a run's own rests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import ParameterError

Floats = npt.NDArray[np.float64]

GROUP = 2.0  # s, of the means that the likelihood is taken of
LEAST_GROUPS = 20
SLOPE_SD = 7e-4  # rad/s/K: a MEMS gyro's 0.04 deg/s/K


@dataclass(frozen=True)
class BiasNoise:
    """N [rad/s/sqrt(Hz)] two-sided, K [rad/s/sqrt(s)], sd [rad/s] and tau [s] of the Gauss-Markov process."""

    N: float
    K: float
    sd: float
    tau: float = 100.0

    def __post_init__(self) -> None:
        for name, value in (("N", self.N), ("tau", self.tau)):
            if not (np.isfinite(value) and value > 0):
                raise ParameterError(f"{name} is {value}, expected over 0", parameter=name, found=value)
        for name, value in (("K", self.K), ("sd", self.sd)):
            if not (np.isfinite(value) and value >= 0):
                raise ParameterError(f"{name} is {value}, expected at least 0", parameter=name, found=value)


def usual(white: float) -> BiasNoise:
    """What a MEMS gyro of this white noise mostly has: a floor near a hundred seconds."""
    return BiasNoise(white, white / 1000, white / 15, 100.0)


def learn(
    still: npt.NDArray[np.bool_],
    t: Floats,
    mean: Floats,
    noise: Floats,
    kelvin: Floats,
    white: float,
    tail: Floats,
) -> BiasNoise:
    """The most likely drift, given blocks (K,) at rest with their mean, its variance and the temperature.

    tail (K,): variance [rad^2/s^2] of the rate left of the movement before.

    A weak prior (a factor of e^2 for one deviation) stands behind it where rests are few: `usual`.
    """
    from scipy.optimize import minimize

    from core.imu.bias._likelihood_numba import cost

    first = usual(white)
    grouped = _groups(still, t, mean, noise, kelvin, tail)
    if len(grouped[0]) < LEAST_GROUPS:
        return first
    centre = np.log([first.K, first.sd, first.tau])
    width = np.array([2.0, 1.0, 0.7])

    def objective(q: Floats) -> float:
        if np.abs(q - centre).max() > 9:
            return 1e30
        k, sd, tau = np.exp(q)
        return float(cost(*grouped, k * k, sd * sd, tau, SLOPE_SD**2) + np.sum(((q - centre) / width) ** 2))

    simplex = centre + np.vstack((np.zeros(3), np.diag([1.5, 1.0, 0.7])))
    found = minimize(
        objective,
        centre,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 0.1, "fatol": 0.2, "maxfev": 90},
    )
    k, sd, tau = np.exp(found.x)
    return BiasNoise(white, float(k), float(sd), float(tau))


def _groups(
    still: npt.NDArray[np.bool_], t: Floats, mean: Floats, noise: Floats, kelvin: Floats, tail: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Means over GROUP of blocks at rest that follow each other: mean, its variance, time since the one before."""
    place = np.flatnonzero(still)
    if not len(place):
        empty = np.empty(0)
        return empty, empty, empty, empty
    step = float(np.median(np.diff(t))) if len(t) > 1 else GROUP
    size = max(1, round(GROUP / step))
    run = np.cumsum(np.concatenate(([0], (np.diff(place) > 1).astype(np.int64))))
    begins = np.flatnonzero(np.concatenate(([True], np.diff(run) > 0)))
    inside = np.arange(len(place)) - begins[run]
    starts = np.flatnonzero(inside % size == 0)
    count = np.diff(np.append(starts, len(place)))
    total = np.add.reduceat(mean[place], starts) / count
    variance = np.add.reduceat(noise[place], starts) / count**2
    when = np.add.reduceat(t[place], starts) / count
    # A group's blocks share what is left of the movement.
    variance += np.add.reduceat(tail[place], starts) / count
    warm = np.add.reduceat(kelvin[place], starts) / count
    return total, variance, np.concatenate(([0.0], np.diff(when))), warm
