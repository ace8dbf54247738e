"""UMBmark: two systematic errors of odometry from squares driven both ways.

Borenstein and Feng, "Measurement and Correction of Systematic Odometry Errors in Mobile Robots", IEEE Transactions on
Robotics and Automation 12(6), 1996 (and UM-MEAM-94-22). A wrong track width turns each corner by alpha too far or too
little (type A), unequal wheels bend each side by beta (type B); one way round the two add up, the other way they
cancel. The path starts at a corner along a side, and returns there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from core.errors import MissingStreamError, NotEnoughDataError
from core.estimation.odometry import arcs, wheel_path
from core.geometry import between
from core.run import Run

Array = npt.NDArray[np.float64]

FULL_TURN = (1.5 * math.pi, 2.6 * math.pi)  # rad: a square with or without its last corner


@dataclass(frozen=True)
class Umbmark:
    """E_d ratio of right to left wheel diameter, E_b actual over nominal track width, each with its sd (None with fewer
    than two runs a way); alpha, beta [rad] by the x and the y errors; c_left, c_right factors of the wheels' radii.

    returns_cw, returns_ccw (n, 2) [m]: true less computed place of return, in the start's axes; worst_systematic [m]:
    the farther of both centres, the paper's E_max,syst; side [m].
    """

    side: float
    returns_cw: Array
    returns_ccw: Array
    alpha: tuple[float, float]
    beta: tuple[float, float]
    E_d: float
    E_d_sd: float | None
    E_b: float
    E_b_sd: float | None
    worst_systematic: float

    @property
    def c_left(self) -> float:
        """Factor of the left wheel's nominal radius; the mean of both stays."""
        return 2.0 / (self.E_d + 1.0)

    @property
    def c_right(self) -> float:
        """Factor of the right wheel's nominal radius."""
        return 2.0 / (1.0 / self.E_d + 1.0)

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "schema": "umbmark/1", "side": self.side, "alpha": list(self.alpha), "beta": list(self.beta),
            "E_d": self.E_d, "E_d_sd": self.E_d_sd, "E_b": self.E_b, "E_b_sd": self.E_b_sd,
            "c_left": self.c_left, "c_right": self.c_right, "worst_systematic": self.worst_systematic,
            "returns_cw": self.returns_cw.tolist(), "returns_ccw": self.returns_ccw.tolist(),
        }  # fmt: skip


def umbmark(runs: Sequence[Run], side: float | None = None) -> Umbmark:
    """From runs of one square each, at least one each way, with a truth that has a heading at the start.

    side [m]: of the square; without it, from the odometry's own extent. Raises MissingStreamError, NotEnoughDataError.
    """
    ways: dict[int, list[Array]] = {1: [], -1: []}
    sides = []
    for run in runs:
        way, off, extent = _return_error(run)
        ways[way].append(off)
        sides.append(extent)
    if not ways[1] or not ways[-1]:
        raise NotEnoughDataError(
            f"squares both ways are needed, found {len(ways[-1])} clockwise and {len(ways[1])} counter-clockwise",
            expected="at least one each way",
            found=(len(ways[-1]), len(ways[1])),
        )
    length = side if side is not None else float(np.mean(sides))
    cw, ccw = np.array(ways[-1]), np.array(ways[1])
    track = runs[0].meta.robot.track_width
    assert track
    (ax, ay), (bx, by) = angles(cw.mean(axis=0), ccw.mean(axis=0), length)
    E_d, E_b = ratios((ax + ay) / 2, (bx + by) / 2, length, track)
    spread = _angle_sd(cw, ccw, length)
    far = max(float(np.hypot(*cw.mean(axis=0))), float(np.hypot(*ccw.mean(axis=0))))
    return Umbmark(
        length, cw, ccw, (ax, ay), (bx, by), E_d, None if spread is None else spread * track / length,
        E_b, None if spread is None else spread * 2 / math.pi, far,
    )  # fmt: skip


def angles(cw: Array, ccw: Array, side: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """alpha and beta [rad], each by the x and by the y errors (centres of gravity (2,) [m]) of both ways round."""
    four = -4.0 * side
    alpha = ((cw[0] + ccw[0]) / four, (cw[1] - ccw[1]) / four)
    beta = ((cw[0] - ccw[0]) / four, (cw[1] + ccw[1]) / four)
    return (float(alpha[0]), float(alpha[1])), (float(beta[0]), float(beta[1]))


def ratios(alpha: float, beta: float, side: float, track: float) -> tuple[float, float]:
    """E_d and E_b from the corner's error alpha and the side's bend beta [rad]."""
    bend = 2.0 * math.sin(beta / 2.0) / side  # 1/R, R = (L/2) / sin(beta/2)
    E_d = (1.0 + bend * track / 2.0) / (1.0 - bend * track / 2.0)
    return E_d, (math.pi / 2) / (math.pi / 2 - alpha)


def _angle_sd(cw: Array, ccw: Array, side: float) -> float | None:
    """sd of alpha and of beta (alike): x and y give two values each, of which the mean is taken."""
    if len(cw) < 2 or len(ccw) < 2:
        return None
    var = cw.var(axis=0, ddof=1).sum() / len(cw) + ccw.var(axis=0, ddof=1).sum() / len(ccw)
    return float(math.sqrt(var) / (8 * side))


def _return_error(run: Run) -> tuple[int, Array, float]:
    """+1 counter-clockwise or -1, true less computed place of return (2,), the square's extent [m]."""
    wheels, truth, robot = run.wheels, run.truth, run.meta.robot
    posed = truth is not None and truth.x is not None and truth.y is not None and truth.theta is not None
    lacking = [
        name
        for name, there in (
            ("wheels", wheels is not None and len(wheels) > 1), ("robot.wheel_radius", bool(robot.wheel_radius)),
            ("robot.track_width", bool(robot.track_width)),
            ("truth.x, truth.y, truth.theta", posed),
        )
        if not there
    ]  # fmt: skip
    if lacking:
        raise MissingStreamError(f"umbmark needs {', '.join(lacking)}", method="umbmark", missing=lacking)
    assert wheels is not None and truth is not None and robot.wheel_radius
    assert truth.x is not None and truth.y is not None and truth.theta is not None
    path = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    turned = float(path.turn[-1])
    if not FULL_TURN[0] <= abs(turned) <= FULL_TURN[1]:
        raise NotEnoughDataError(
            f"run {run.meta.name!r} turns by {turned:.2f} rad, a square turns by 3/4 or 4/4 of 2 pi", found=turned
        )
    pose = np.column_stack([np.asarray(c, np.float64) for c in (truth.x, truth.y, truth.theta)])
    whole = np.flatnonzero(np.isfinite(pose).all(axis=1))
    if whole.size < 2:
        raise NotEnoughDataError(f"run {run.meta.name!r} has no truth at its start and end", stream="truth")
    real = between(pose[whole[0]], pose[whole[-1]])
    reckoned = arcs(path.d, path.turn)
    end = [np.interp(truth.t[whole[-1]], path.t, c) for c in reckoned.T]
    begin = np.array([np.interp(truth.t[whole[0]], path.t, c) for c in reckoned.T])
    computed = between(begin, np.array(end))
    extent = float(np.mean(np.ptp(reckoned[:, :2], axis=0)))
    return (1 if turned > 0 else -1), (real - computed)[:2], extent
