"""Judging a path: against truth (ATE, RPE, final, heading) and against its own claims (NEES, NIS).

Given: a `Trajectory` and a `TruthLog`. Done: truth's stamps are matched to the path (what has no match is counted), the
path is aligned only where asked for, and every metric that can be computed is; the others are None.
"""

from core.metrics.alignment import ALIGNMENTS, Alignment
from core.metrics.association import Match, match
from core.metrics.consistency import Consistency, chi2_band, nees
from core.metrics.innovations import InnovationCheck, NoiseAdvice, Running, Whiteness, check_innovations, running_nis
from core.metrics.pose_error import PoseErrors, RelativeError, evaluate

__all__ = [
    "ALIGNMENTS",
    "Alignment",
    "Consistency",
    "InnovationCheck",
    "Match",
    "NoiseAdvice",
    "PoseErrors",
    "RelativeError",
    "Running",
    "Whiteness",
    "check_innovations",
    "chi2_band",
    "evaluate",
    "match",
    "nees",
    "running_nis",
]
