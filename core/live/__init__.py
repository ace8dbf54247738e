"""The causal estimators, stepped as readings come: the kernels of `estimation` and `imu.bias`, their state kept.

Given: a run's description, then pieces of its streams in order. Done: each piece is put behind what is there, and every
method goes on from where it stood (`estimator.py`). Memory stays level however long the run.
"""

from core.live.estimator import LiveEstimator, Step
from core.live.links import LinkState

__all__ = ["LinkState", "LiveEstimator", "Step"]
