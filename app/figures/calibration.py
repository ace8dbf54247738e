"""What a calibration says, for people: a sentence, what it knows, and its curves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from app.figures.units import bias, duration, significant

ORDER = ("gx", "gy", "gz", "ax", "ay", "az")
KNOWN = {
    "static_bias": "static bias",
    "drift_amplitude": "drift",
    "matrix": "scale and misalignment",
    "noise_sd": "noise",
}
RATE = 100.0  # Hz, where no run tells one
POINTS = 200


def sentence(result: Mapping[str, Any]) -> str:
    """What a colleague could repeat of it: gyro z first, then how large scale errors and misalignment are."""
    gyro, accel = result["gyro"], result["accel"]
    static, drift, tau = (gyro[name][2] for name in ("static_bias", "drift_amplitude", "drift_tau"))
    parts = [f"Gyro z reads {bias(static)} at switching on" if static is not None else "Gyro z: bias not known"]
    tau_sd = result["sd"]["gyro"]["drift_tau"][2]
    if drift is not None and tau is not None:
        shown = tau_sd is not None and tau_sd < tau / 2
        told = f"by {bias(drift)} with a time of {duration(tau)}" if shown else "on beyond the length of its runs"
        parts[0] += f" and drifts {told}"
    for name, matrix in (("gyro", gyro["matrix"]), ("accelerometer", accel["matrix"])):
        off = [abs(v - (i == j)) for i, row in enumerate(matrix) for j, v in enumerate(row) if v is not None]
        if off:
            parts.append(f"{name} scale and misalignment up to {significant(100 * max(off), 2)} %")
    return "; ".join(parts) + "."


def knows(result: Mapping[str, Any]) -> list[str]:
    """Which errors it holds numbers of, by sensor."""
    found = []
    for sensor in ("gyro", "accel"):
        for key, words in KNOWN.items():
            if any(v is not None for v in np.ravel(np.array(result[sensor][key], object))):
                found.append(f"{sensor} {words}")
    return found


def spectra(result: Mapping[str, Any]) -> dict[str, dict[str, list[float]]]:
    """Density of each axis' fitted drift (eq. 5), over four decades about its corner."""
    from core.calibration.imu import spectrum

    made = {}
    for axis in ORDER:
        model, k = result["gyro" if axis[0] == "g" else "accel"], "xyz".index(axis[1])
        amplitude, tau = model["drift_amplitude"][k], model["drift_tau"][k]
        if amplitude and tau:
            f = np.geomspace(0.01, 100, 80) / (2 * np.pi * tau)
            made[axis] = {"f": f.tolist(), "density": spectrum(amplitude, tau, f).tolist()}
    return made


def bode(rate: float | None) -> dict[str, Any]:
    """Gain and phase of the moving average (eq. 8) up to half of the rate."""
    from core.calibration.imu import WINDOW, moving_average_bode

    hertz = rate or RATE
    made = moving_average_bode(hertz, np.linspace(hertz / 2 / POINTS, hertz / 2, 2 * POINTS, endpoint=False))
    return {
        "rate_hz": hertz,
        "window": WINDOW,
        "f": made.f.tolist(),
        "gain": made.gain.tolist(),
        "phase": made.phase.tolist(),
        "delay": made.delay,
    }
