"""Gyro bias by every method. To add one: a function from a run, its IMU and settings to a `BiasEstimate`, and a row in
METHODS (`track`)."""

from __future__ import annotations

from core.imu.bias.drift import BiasNoise
from core.imu.bias.errors import heading_errors
from core.imu.bias.filtered import FilterConfig, known_rests
from core.imu.bias.result import BiasErrors, BiasEstimate, SegmentVerdicts
from core.imu.bias.segment_methods import SegmentConfig
from core.imu.bias.track import METHODS, BiasMethod, track_bias

__all__ = [
    "METHODS",
    "BiasErrors",
    "BiasEstimate",
    "BiasMethod",
    "BiasNoise",
    "FilterConfig",
    "SegmentConfig",
    "SegmentVerdicts",
    "heading_errors",
    "known_rests",
    "track_bias",
]
