"""Quantities as people read them: where SI and radians end. The pages' `format.js` says the same for numbers."""

from __future__ import annotations

import math


def significant(value: float, digits: int = 3) -> str:
    """`digits` significant digits without an exponent, thousands apart, a true minus."""
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "–"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:,.{min(decimals, 8)}f}".replace("-", "−")


def length(metres: float) -> str:
    """Metres; centimetres below 0.1 m, millimetres below 1 mm."""
    if 0 < abs(metres) < 0.001:
        return f"{significant(metres * 1000, 2)} mm"
    return f"{significant(metres * 100, 2)} cm" if abs(metres) < 0.1 else f"{significant(metres)} m"


def angle(radians: float) -> str:
    """Degrees."""
    return f"{significant(math.degrees(radians))}°"


def bias(radians_per_second: float) -> str:
    """Degrees per hour, as a gyro's bias and its drift are told; a very large one in degrees per second."""
    if abs(radians_per_second) >= math.radians(1.0):
        return f"{significant(math.degrees(radians_per_second), 2)}°/s"
    return f"{significant(math.degrees(radians_per_second) * 3600, 2)} °/h"


def duration(seconds: float) -> str:
    """42 s, 12 min 05 s, 3 h 20 min."""
    if seconds < 60:
        return f"{significant(seconds, 2 if seconds < 10 else 3)} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
