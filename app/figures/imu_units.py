"""Noise figures of an IMU axis as a data sheet gives them, with the conversion written out. The human edge."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

GRAVITY = 9.80665  # m/s²
DEG = 180 / math.pi
UG = 1e6 / GRAVITY  # µg per m/s²


@dataclass(frozen=True)
class Form:
    """One way to write a figure: its unit, the factor from SI, and that factor as a reader can check it."""

    unit: str
    factor: float
    conversion: str


@dataclass(frozen=True)
class Figure:
    """A fitted term: its name, what it is called, its SI unit, and its other forms."""

    name: str
    label: str
    unit: str
    forms: tuple[Form, ...]


GYRO: tuple[Figure, ...] = (
    Figure(
        "N",
        "white noise (angle random walk)",
        "rad/s/√Hz",
        (
            Form("°/√h", 60 * DEG, "× 180/π × 60"),
            Form("°/s/√Hz", DEG, "× 180/π, two-sided"),
            Form("°/s/√Hz one-sided", math.sqrt(2) * DEG, "× √2 × 180/π, as data sheets mostly give it"),
        ),
    ),
    Figure("B", "bias instability", "rad/s", (Form("°/h", 3600 * DEG, "× 180/π × 3600; the floor is 0.664 B"),)),
    Figure("K", "rate random walk", "rad/s/√s", (Form("°/h/√h", 3600 * 60 * DEG, "× 180/π × 3600 × 60"),)),
    Figure("Q", "quantisation", "rad", (Form("″", 3600 * DEG, "× 180/π × 3600"),)),
    Figure("markov_sd", "Gauss-Markov, deviation", "rad/s", (Form("°/h", 3600 * DEG, "× 180/π × 3600"),)),
    Figure("markov_tau", "Gauss-Markov, correlation time", "s", (Form("s", 1.0, ""),)),
)
ACCELEROMETER: tuple[Figure, ...] = (
    Figure(
        "N",
        "white noise (velocity random walk)",
        "m/s²/√Hz",
        (
            Form("m/s/√h", 60.0, "× 60"),
            Form("µg/√Hz", UG, "× 10⁶/9.80665, two-sided"),
            Form("µg/√Hz one-sided", math.sqrt(2) * UG, "× √2 × 10⁶/9.80665, as data sheets mostly give it"),
        ),
    ),
    Figure("B", "bias instability", "m/s²", (Form("µg", UG, "× 10⁶/9.80665; the curve's floor is 0.664 B"),)),
    Figure("K", "acceleration random walk", "m/s²/√s", (Form("µg/√h", 60 * UG, "× 10⁶/9.80665 × 60"),)),
    Figure("Q", "quantisation", "m/s", (Form("mm/s", 1e3, "× 10³"),)),
    Figure("markov_sd", "Gauss-Markov, deviation", "m/s²", (Form("µg", UG, "× 10⁶/9.80665"),)),
    Figure("markov_tau", "Gauss-Markov, correlation time", "s", (Form("s", 1.0, ""),)),
)


def is_gyro(axis: str) -> bool:
    """Whether the axis is one of the gyro's."""
    return axis.startswith("g")


def unit_of(axis: str) -> str:
    """SI unit of an axis' readings."""
    return "rad/s" if is_gyro(axis) else "m/s²"


def noise_table(axis: str, terms: Mapping[str, Mapping[str, float | None]]) -> list[dict[str, Any]]:
    """The fitted terms of an axis: SI value and deviation (None: not identifiable) and every other form of them."""
    rows = []
    for figure in GYRO if is_gyro(axis) else ACCELEROMETER:
        term = terms.get(figure.name) or {}
        value, sd = term.get("value"), term.get("sd")
        forms = [
            {
                "unit": form.unit,
                "value": None if value is None else value * form.factor,
                "sd": None if sd is None else sd * form.factor,
                "conversion": form.conversion,
            }
            for form in figure.forms
        ]
        rows.append(
            {
                "name": figure.name,
                "label": figure.label,
                "value": value,
                "sd": sd,
                "unit": figure.unit,
                "forms": forms,
            }
        )
    return rows
