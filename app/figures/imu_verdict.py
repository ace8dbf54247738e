"""The sentence of the IMU tab: what a colleague could repeat of this gyro. The human edge."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from app.figures.units import angle, bias, duration, significant

Parts = Mapping[str, Any]  # rows of `imu_results` by part
METHODS = ("best", "C", "smoothed", "B", "A")  # whose word counts, in this order


def sentence(parts: Parts, duration_s: float) -> str:
    """One sentence in up to three clauses: noise, how far the bias moved, where the headings end."""
    clauses = [c for c in (_noise(parts), _moved(parts, duration_s), _headings(parts)) if c]
    if not clauses:
        return "Nothing could be said of this gyro: see below what each figure would need."
    text = "; ".join(clauses) + "."
    return text if text.startswith("Gyro") else text[0].upper() + text[1:]


def _noise(parts: Parts) -> str:
    row = parts.get("allan.gz")
    if row is None or row.error:
        return ""
    if row.figures.get("readings") == "whole" and row.figures.get("rest_share", 0.0) < 0.9:
        return "Gyro z: hardly a rest, so its noise is not known"
    terms = row.figures.get("terms") or {}
    told = []
    n, b = (terms.get(name, {}).get("value") for name in ("N", "B"))
    if n:
        told.append(f"{significant(math.degrees(n), 2)} °/s/√Hz white (two-sided)")
    told.append(f"bias instability {bias(b)}" if b else "bias instability not seen in this record")
    return "Gyro z: " + ", ".join(told)


def _moved(parts: Parts, duration_s: float) -> str:
    for method in ("smoothed", "best", "C"):
        row = parts.get(f"bias.{method}")
        if row is not None and not row.error:
            moved = row.figures.get("bias_drift")
            if moved is None or not row.figures.get("accepted"):
                return ""
            return f"bias moved {bias(abs(moved))} in {duration(duration_s)}"
    return ""


def _headings(parts: Parts) -> str:
    """Ours first, then the paper's best; without truth what ours claims of itself."""
    rows = {m: parts[f"bias.{m}"] for m in METHODS if f"bias.{m}" in parts and not parts[f"bias.{m}"].error}
    judged = {m: abs(row.figures["final_rad"]) for m, row in rows.items() if row.figures.get("final_rad") is not None}
    if judged:
        lead = next(iter(judged))
        told = f"{_name(lead)} heading ends {angle(judged[lead])} from truth"
        return told + (f", C {angle(judged['C'])}" if "C" in judged and lead != "C" else "")
    claimed = rows["best"].figures.get("theta_sd_end") if "best" in rows else None
    if claimed is None:
        return ""
    if not rows["best"].figures.get("accepted"):
        return "no rest was found, so the heading is the raw integral"
    return f"best heading claims ± {angle(claimed)} at its end; there is no truth to judge it by"


def _name(method: str) -> str:
    return method if method in ("best", "smoothed") else f"method {method}"
