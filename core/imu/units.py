"""Whether angular rates look like degrees: they are a number like any other, only their size tells."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

LARGEST = 35.0  # rad/s: 2000 deg/s, the widest range of a MEMS gyro
NOISIEST_DENSITY = 0.004  # rad/s/sqrt(Hz), at rest; a MEMS gyro has a tenth of it
ENOUGH = 200_000  # readings to judge by


def degrees(t: npt.NDArray[np.float64], rate: npt.NDArray[np.floating], *, rested: bool) -> tuple[str, ...]:
    """A note where rates (N,) at t [s] are too large, or at rest too noisy, for rad/s; else nothing.

    rested: whether the sensor was at rest for a good part of the record.
    """
    if len(rate) < 2:
        return ()
    largest = float(np.nanmax(np.abs(rate)))
    step = float(t[-1] - t[0]) / (len(t) - 1)
    # White noise shows from reading to reading, whatever the movement.
    white = 1.4826 * float(np.nanmedian(np.abs(np.diff(rate[:ENOUGH])))) / np.sqrt(2)
    if largest <= LARGEST and not (rested and white * np.sqrt(step) > NOISIEST_DENSITY):
        return ()
    wanted = f"Wanted are rad/s, {180 / np.pi:.4g} times less."
    return (f"The readings reach {largest:.4g} rad/s: are they in deg/s? {wanted}",)
