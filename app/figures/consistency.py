"""Does a method know its own errors: the sentence, and running NIS and NEES over time with their bands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app.figures.series import check_points, numbers, thin, window
from app.figures.units import significant
from app.store import arrays
from core.metrics import running_nis

LABELS = {
    "wheels.distance": "wheel distances",
    "wheels.turn": "wheel turns",
    "beacon": "fixes with heading",
    "beacon.position": "fixes",
    "ranges": "ranges",
}
MOTION = ("wheels.distance", "wheels.turn")
WINDOWS = 200  # running means at most, whatever the range: zooming in makes them finer
NOT_WHITE = 0.001  # p-value below which a long record is called correlated


def label(sensor: str) -> str:
    """The sensor's readings in words."""
    return LABELS.get(sensor, sensor.replace(".", " "))


def figure(
    data: Path,
    stored: Mapping[str, str],
    judged: Mapping[str, Any] | None,
    *,
    t0: float | None = None,
    t1: float | None = None,
    points: int = 2000,
) -> dict[str, Any]:
    """All that the page shows of one estimate. `stored`: its arrays' keys; `judged`: its stored `consistency`."""
    check_points(points)
    known = judged or {"sensors": {}, "nees": None}
    return {
        "sentence": sentence(judged),
        "sensors": [
            {"sensor": name, "label": label(name), **told, "running": _running(data, stored, name, told["dof"], t0, t1)}
            for name, told in known["sensors"].items()
        ],
        "nees": known["nees"] and {**known["nees"], **_nees(data, stored, t0, t1, points)},
    }


def _running(
    data: Path, stored: Mapping[str, str], sensor: str, dof: int, t0: float | None, t1: float | None
) -> dict[str, Any]:
    """Means over windows of accepted readings in the range, the band for one of them, how many were refused there."""
    t = arrays.open(data, stored[f"nis_{sensor}_t"])
    rows = window(t, t0, t1)
    good = np.asarray(arrays.open(data, stored[f"nis_{sensor}_accepted"])[rows], bool)
    nis = np.asarray(arrays.open(data, stored[f"nis_{sensor}"])[rows], np.float64)
    good &= np.isfinite(nis)
    found = running_nis(np.asarray(t[rows])[good], nis[good], dof, WINDOWS)
    return {
        "t": found.t.tolist(),
        "mean": numbers(found.mean),
        "window": found.window,
        "band": list(found.band),
        "readings": int(good.size),
        "rejected": int(good.size - good.sum()),
        "rejected_t": np.asarray(t[rows])[~good][:2000].tolist(),
    }


def _nees(data: Path, stored: Mapping[str, str], t0: float | None, t1: float | None, points: int) -> dict[str, Any]:
    t = arrays.open(data, stored["nees_t"])
    rows = window(t, t0, t1)
    shown_t, shown = thin(t[rows], arrays.open(data, stored["nees"])[rows], points)
    return {"t": shown_t.tolist(), "y": numbers(shown), "total": len(t[rows]), "shown": len(shown_t)}


def sentence(judged: Mapping[str, Any] | None) -> str:
    """One to three short sentences on the whole run."""
    if judged is None:
        return "This path was estimated before its innovations were judged: estimate again."
    sensors, nees = judged["sensors"], judged["nees"]
    if not sensors and nees is None:
        return "This method predicts no readings and states no uncertainty that truth could judge."
    parts = [_noise(sensors), _white(sensors), _claims(nees)]
    return " ".join(p for p in parts if p)


def _noise(sensors: Mapping[str, Any]) -> str:
    advised = {name: s["advice"] for name, s in sensors.items() if s["advice"] and s["advice"]["factor"]}
    if not advised:
        return "Too few readings to say how noisy the sensors are." if sensors else ""
    wrong = {name: a for name, a in advised.items() if not a["fits"]}
    if not wrong:
        return "Every sensor is about as noisy as the filter expects."
    # Of wheels the filter's own motion noise has a large share in what it expects: others first, whose R it mostly is.
    name = min(wrong, key=lambda n: (n in MOTION, not wrong[n]["single"], -abs(np.log(max(wrong[n]["factor"], 1e-9)))))
    do = "does" if len(wrong) == 2 else "do"
    others = f" {len(wrong) - 1} more of {len(advised)} sensors {do} not fit." if len(wrong) > 1 else ""
    noise = "R or the motion noise" if name in MOTION else "R"
    return f"{label(name).capitalize()} {_advice(wrong[name], noise)}.{others}"


def _advice(a: Mapping[str, Any], noise: str) -> str:
    factor, low, high = (significant(a[k], 2) for k in ("factor", "low", "high"))
    if not a["single"]:
        wide = significant(a["wide"], 2)
        half = f"half of them call for {factor} times the {noise} that is set"
        return f"are not spread evenly: {half}, the widest tenth for {wide} times"
    size = significant(float(a["factor"]) ** 0.5, 2)
    advice = f"{noise} should be about {factor} times what it is ({low} to {high})"
    return f"stray {size} times as far as the filter expects: {advice}"


def _white(sensors: Mapping[str, Any]) -> str:
    """Which sensors' readings hang together more than chance allows."""
    found = [label(n) for n, s in sensors.items() if s["whiteness"] and _correlated(s["whiteness"])]
    if not found:
        return ""
    return f"What the filter leaves of {' and '.join(found)} is not white: errors that last are taken for noise."


def _correlated(white: Mapping[str, Any]) -> bool:
    p = white["p_value"]
    first = white["autocorrelation"][0] if white["autocorrelation"] else 0.0
    return p is not None and p < NOT_WHITE and first > max(white["limit"], 0.1)


def _claims(nees: Mapping[str, Any] | None) -> str:
    if nees is None:
        return ""
    return f"Truth lies inside the claimed 95 % at {significant(100 * nees['inside'], 3)} % of its stamps."
