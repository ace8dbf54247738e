"""Gyro bias by every method. To add one: a function from stamps and readings to a `BiasEstimate`, and a row in
METHODS."""

from __future__ import annotations

from core.imu.bias.errors import heading_errors
from core.imu.bias.result import BiasErrors, BiasEstimate, SegmentVerdicts
from core.imu.bias.segment_methods import SegmentConfig, method_a, method_b, method_c

METHODS = {"A": method_a, "B": method_b, "C": method_c}

__all__ = ["METHODS", "BiasErrors", "BiasEstimate", "SegmentConfig", "SegmentVerdicts", "heading_errors"]
