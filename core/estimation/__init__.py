"""Where the robot was: `estimate(run, method)` by every method of METHODS, each with its uncertainty.

Given: a `Run`. Done: a path in the map with covariances, the gyro's bias, parameters, innovations, and plain notes on
what was assumed and what the run cannot show. `pipeline.py` tells the story; one file per way of estimating beside it.
"""

from core.estimation.pipeline import METHODS, Method, available, estimate
from core.estimation.result import Curve, Estimate, Event, Innovations, Value

__all__ = ["METHODS", "Curve", "Estimate", "Event", "Innovations", "Method", "Value", "available", "estimate"]
