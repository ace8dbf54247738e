"""What the paper leaves open, as numbers with reasons. The guide's page `published` prints what other choices would do.

Misprints corrected: eq. (4)'s last row is 0 0 1 (heading carries over); below (5), Q is the process noise and R that of
the measurement. Equation (2) integrates body-fixed accelerations: in a turn the axes turn under the velocity, so the
term of the turn rate is added. In (5) the difference z_k - z_(k-1) of two measured poses meets H x, which is a pose:
either the pose is measured, or both are increments; see `increments`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Decisions:
    """Our reading of the paper. SI units."""

    gyro_cutoff: float = 20.0  # Hz, second-order Butterworth low-pass, one way: causal
    accel_cutoff: float = 5.0  # Hz
    window: float = 0.4  # s over which the accelerometers' change of speed is held against the encoders'
    mean_factor: float = 4.0  # a difference is "larger than mean" beyond this many times the running mean difference
    mean_time: float = 10.0  # s of driving that the running mean looks back
    floor_speed: float = 0.06  # m/s: no smaller difference counts, whatever the mean
    floor_turn: float = 0.08  # rad/s
    accel_drift: float = 0.06  # m/s^2, what is left of the accelerometers' offset: their speed is worth less by it
    longest_bridge: float = 8.0  # s after which speed by accelerometers is worth nothing: the encoders are back
    shock: float = 3.0  # m/s^2, least peak of a collision or bounce
    shock_factor: float = 6.0  # and this many times the usual vibration
    quiet: float = 0.3  # s without a peak end a shock
    fixes_to_replace: int = 5  # fixes looked at before one position replaces another
    agreeing: int = 4  # of them must agree
    loss: float = 1.0  # s without a normal fix: the beacon is lost
    patience: float = 60.0  # s of refused fixes that agree with each other, after which they are believed
    increments: bool = False  # eq. (5) to the letter: measure z_k - z_(k-1); the position is then never pulled back
