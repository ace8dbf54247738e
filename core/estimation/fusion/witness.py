"""What wheels and gyro say of each other, without a beacon: how much the wheels slip, how fast the gyro's bias walks.

Slip: over stretches of equal rolled length the wheels' turn is held against the gyro's, freed of its bias, the track's
scale and the wheels' inequality by least squares. What is left is slip, which adds up with the distance, and errors of
each border (encoder steps, stamps that do not quite agree), which the next stretch takes back: their covariance with it
tells the one from the other (the long-run variance of a series, Newey, West 1987, at one lag).
Bias: gyro readings of each rest are averaged over blocks; the differences of their means are a random walk's steps plus
noise, whose likelihood is a banded Gaussian's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.cleaning import gyro_readings
from core.estimation.events import Disturbances
from core.estimation.fusion.events import Events
from core.estimation.fusion.layout import OUT, WHEEL
from core.estimation.rest import Rest
from core.run import Run

Array = npt.NDArray[np.float64]
Evidence = Callable[[float], float]

STRETCH = 0.5  # m rolled by the rims
FEWEST, MOST = 12, 2000  # stretches to learn from; longer runs get longer ones
OUTLIER = 4.0  # sd beyond which a stretch was disturbed
ROUNDS = 3  # of least squares
BLOCK = 2.0  # s of rest
SHORTEST = 10  # readings of a block


def nothing(_: float) -> float:
    """No evidence."""
    return 0.0


@dataclass(frozen=True)
class TurnSlip:
    """Long-run variance of the wheels' turn against the gyro's per stretch [rad^2], its border errors' variance, that
    of the gyro's own noise, the slip's per slip squared, and how many stretches there were."""

    variance: float
    border: float
    gyro: float
    per_slip: float
    count: int

    def log_likelihood(self, slip: float) -> float:
        """Of `slip` [m/sqrt(m)]: the variance found against the one expected, by its sampling error (Gaussian)."""
        expected = slip**2 * self.per_slip + self.gyro
        sd = np.sqrt((2.0 * expected**2 + 4.0 * expected * self.border + 6.0 * self.border**2) / self.count)
        return float(-0.5 * ((self.variance - expected) / sd) ** 2 - np.log(sd))


def turn_slip(run: Run, events: Events, numbers: Assumptions, disturbances: Disturbances) -> TurnSlip | None:
    """How the wheels' turn wanders from the gyro's; None where one of them is missing, or has too little to say."""
    track, rows = run.meta.robot.track_width, events.kind == WHEEL
    turn = events.data[rows, 1]
    gyro = events.kind == OUT
    if not track or run.imu is None or not gyro.any() or np.isnan(turn).any() or len(turn) < FEWEST:
        return None
    t, distance = events.t[rows], events.data[rows, 0]
    rolled = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(distance)) + track / 2 * np.abs(np.diff(turn)))))
    length = max(STRETCH, float(rolled[-1]) / MOST)
    edge = np.searchsorted(rolled, np.arange(0.0, rolled[-1], length))
    if len(edge) <= FEWEST:
        return None
    at, raw = events.t[gyro], events.data[gyro, 0]
    turned = np.concatenate(([0.0], np.cumsum(np.diff(at) * (raw[1:] + raw[:-1]) / 2)))
    span = np.column_stack((np.interp(t[edge], at, turned), t[edge], distance[edge]))
    basis, wheels = np.diff(span, axis=0), np.diff(turn[edge])
    good = ~_disturbed(t[edge], disturbances)
    for _ in range(ROUNDS):
        if good.sum() < FEWEST:
            return None
        fit = np.linalg.lstsq(basis[good], wheels[good], rcond=None)[0]
        left = wheels - basis @ fit
        sd = 1.4826 * float(np.median(np.abs(left[good]))) + 1e-12
        good &= np.abs(left) < OUTLIER * sd
    both = good[1:] & good[:-1]
    border = max(-float(np.mean((left[1:] * left[:-1])[both])), 0.0) if both.any() else 0.0
    variance = float(np.mean(left[good] ** 2))
    return TurnSlip(
        max(variance - 2.0 * border, 0.0), border, numbers.gyro_density**2 / 2 * float(np.mean(basis[good, 1])),
        2.0 * length / track**2, int(good.sum()) - basis.shape[1],
    )  # fmt: skip


def _disturbed(edge: Array, disturbances: Disturbances) -> npt.NDArray[np.bool_]:
    """(K - 1,) stretches between edges (K,) [s] that a disturbance touches."""
    t0 = np.array([d.t0 for d in disturbances.found])
    t1 = np.array([d.t1 for d in disturbances.found])
    begun, ended = np.searchsorted(np.sort(t0), edge[1:], "right"), np.searchsorted(np.sort(t1), edge[:-1], "left")
    return np.asarray(begun > ended, np.bool_)


def rest_walk(run: Run, rest: Rest | None) -> Evidence:
    """Log-likelihood of the bias walk's density [rad/s/sqrt(s)], by the gyro at rest."""
    if rest is None or run.imu is None or not rest.flags.any():
        return nothing
    t, gz = gyro_readings(run.imu)
    t, gz = np.asarray(t[rest.flags], np.float64), gz[rest.flags]
    row = np.flatnonzero(rest.flags)
    first = np.concatenate(([True], np.diff(row) > 1))
    begin = np.maximum.accumulate(np.where(first, t, -np.inf))
    number = np.floor((t - begin) / BLOCK)
    edges = np.flatnonzero(np.concatenate(([True], first[1:] | (np.diff(number) > 0))))
    sizes = np.diff(np.append(edges, len(t)))
    kept = sizes >= SHORTEST
    if kept.sum() < 2:
        return nothing
    mean, middle = (np.add.reduceat(c, edges)[kept] / sizes[kept] for c in (gz, t))
    noise = rest.gyro_sd**2 / sizes[kept]
    step, apart = np.diff(mean), np.maximum(np.diff(middle) - BLOCK / 3, BLOCK / 3)
    both = noise[1:] + noise[:-1]

    def log_likelihood(walk: float) -> float:
        from scipy.linalg import cholesky_banded, solve_banded

        band = np.zeros((2, len(step)))
        band[0], band[1, :-1] = walk**2 * apart + both, -noise[1:-1]
        lower = cholesky_banded(band, lower=True)
        scaled = solve_banded((1, 0), lower, step)
        return float(-0.5 * scaled @ scaled - np.sum(np.log(lower[0])))

    return log_likelihood
