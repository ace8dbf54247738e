"""The gap between a robot and its simulator: where it lies, which effect causes it, how far it shrinks.

`diagnose(runs, simulator, held_out, config) -> Diagnosis`. Inside, in order of the walk: `checks`, `aligned` (clocks),
`world` (each channel predicted from the recorded stream before it), `rolling` (a drive's past), `floor` (noise from the
data), `whiten`, `linear` (normal equations by channel and block), `candidates`, `places`, `fit`, `selection`, `scatter`
(noise effects), `generic` and `unknown`, `explain` (both links), `leftover`, `remainder`, `rejected`, `judge`, `where`,
`shrink`, `experiment`, `conclude`, and `diagnose`, the story. `evidence` is what a report shows; `as_json` and
`evidence_json` write both.
"""

from __future__ import annotations

from core.gap.as_json import as_json
from core.gap.diagnose import diagnose
from core.gap.evidence import Evidence
from core.gap.evidence_json import evidence_json
from core.gap.types import Config, Diagnosis

__all__ = ["Config", "Diagnosis", "Evidence", "as_json", "diagnose", "evidence_json"]
