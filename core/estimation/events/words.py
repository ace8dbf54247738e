"""What a found disturbance says of itself: one plain sentence with its figures, and what stands in for the sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.events.disturbances import BOUNCE, COLLISION, DEAD_ENCODER, KINDS, PUSHED, SLIP, STUCK, Disturbance

LOOK = 0.05  # s after a blow's alarm until its size is known


@dataclass(frozen=True)
class Blow:
    """A row of `_impact_numba`: times [s], statistic [sigma], speed (jx, jy) gained within 60 ms [m/s], peaks in the
    plane and upwards [m/s^2] and of pitch and roll [rad/s]; wheels: their speed [m/s]; up: else in the plane."""

    t0: float
    alarm: float
    t1: float
    release: float
    statistic: float
    jx: float
    jy: float
    plane: float
    heave: float
    rates: float
    wheels: float
    up: bool

    @classmethod
    def of(cls, row: npt.NDArray[np.float64], up: bool) -> Blow:
        """From the row's first columns."""
        t0, alarm, t1, release, statistic, jx, jy, plane, heave, rates, wheels = (float(x) for x in row[:11])
        return cls(t0, alarm, t1, release, statistic, jx, jy, plane, heave, rates, wheels, up)


def blow_disturbance(b: Blow) -> Disturbance:
    """A bounce for a blow upwards, a collision for one in the plane; `size` is its peak [m/s^2] or speed [m/s]."""
    alarm, release = min(b.alarm + LOOK, b.release), b.release
    if b.up:
        text = (
            f"up and down {b.heave:.1f} m/s² at its peak, pitch and roll {b.rates:.2f} rad/s, "
            f"for {b.t1 - b.t0:.2f} s, {b.statistic:.0f} sigma"
        )
        return Disturbance(
            BOUNCE, b.t0, b.t1, alarm, release, accelerometer=True, statistic=b.statistic, size=b.heave, peak=b.heave,
            evidence=text,
            replaced="accelerometer not used, speed held with a wider sd",
        )  # fmt: skip
    gained = math.hypot(b.jx, b.jy)
    text = (
        f"{gained:.2f} m/s within 60 ms ({b.jx:+.2f} along, {b.jy:+.2f} across), peak {b.plane:.1f} m/s², "
        f"{b.statistic:.0f} sigma"
    )
    return Disturbance(
        COLLISION, b.t0, b.t1, alarm, release, accelerometer=True, statistic=b.statistic, size=gained, peak=b.plane,
        along=b.jx, wheels=b.wheels, evidence=text,
        replaced="accelerometer not used, speed doubted",
    )  # fmt: skip


def incident_disturbance(row: npt.NDArray[np.float64], track: float) -> Disturbance:
    """From a row of `_incident_numba`."""
    kind = KINDS[int(row[1])]
    t0, alarm, t1, release = float(row[2]), float(row[3]), float(row[4]), float(row[14])
    left, right, turn, stopped = (bool(x > 0) for x in row[5:9])
    statistic, sums, rim = float(row[9]), [float(x) for x in row[10:13]], float(row[13])
    seconds = max(t1 - t0, 0.02)
    evidence, replaced = _words(kind, seconds, left, right, stopped, statistic, sums, rim)
    size = max((abs(sums[0]) * track / 2, abs(sums[1]), abs(sums[2]))) if statistic else rim
    return Disturbance(
        kind, t0, t1, alarm, release, left=left, right=right, turn=turn or left != right, stopped=stopped,
        statistic=statistic, size=size, along=rim if kind != STUCK else 0.0, evidence=evidence, replaced=replaced,
    )  # fmt: skip


def _words(
    kind: str, seconds: float, left: bool, right: bool, stopped: bool, sigma: float, sums: list[float], rim: float
) -> tuple[str, str]:
    side = "both wheels" if left == right else ("left wheel" if left else "right wheel")
    parts = _parts(sums, seconds)
    figures = f"{' and '.join(parts)}, {seconds:.2f} s, {sigma:.0f} sigma" if parts else f"{seconds:.2f} s"
    if kind == SLIP:
        return figures, _slip_replaced(left, right, sums)
    if kind == PUSHED:
        return (
            f"wheels and command rest, yet the IMU moves: {figures}",
            "nothing: its way is not known",
        )
    if kind == DEAD_ENCODER:
        what = "both encoders stand" if left == right else f"the {side.split()[0]} encoder stands"
        stands_in = "speed held" if left == right else "the other wheel and the gyro"
        return f"{what} while the robot moves: {figures}", f"{side} by {stands_in}"
    if kind == STUCK and left and right:
        return f"wheels turn at {rim:.2f} m/s under an IMU at rest, {seconds:.2f} s", "wheels by a standstill"
    return f"{rim:.2f} m/s asked for, {'no wheel turns' if stopped else 'a wheel does not turn'}, {seconds:.2f} s", ""


def _parts(sums: list[float], seconds: float) -> list[str]:
    turn, along, side = sums
    parts = []
    if turn:
        word = "more" if turn > 0 else "less"
        parts.append(f"wheels turn {abs(turn) / seconds:.2f} rad/s {word} to the left than the gyro")
    if along:
        parts.append(f"wheels {abs(along):.2f} m/s {'ahead of' if along > 0 else 'behind'} the accelerometer")
    if side:
        parts.append(f"{abs(side):.2f} m/s sideways by the accelerometer")
    return parts


def _slip_replaced(left: bool, right: bool, sums: list[float]) -> str:
    if left != right:
        return f"{'left' if left else 'right'} wheel by the other and the gyro"
    if left:
        return "wheels by the accelerometer" + (" and the gyro" if sums[0] else "")
    return "encoder heading by gyro" if sums[0] else "sideways motion doubted"
