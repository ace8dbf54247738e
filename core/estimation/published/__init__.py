"""`published`: the navigation system of Lee, Shin and Cho (IMU, encoders, active beacon), whole, from their paper.

Lee, Shin, Cho, "Position Estimation for Mobile Robot Using In-plane 3-Axis IMU and Active Beacon", IEEE International
Symposium on Industrial Electronics, 2009. What the paper leaves open, and what we chose, is in `decisions.py`.
"""

from core.estimation.published.decisions import Decisions
from core.estimation.published.navigate import missing, navigate, published

__all__ = ["Decisions", "missing", "navigate", "published"]
