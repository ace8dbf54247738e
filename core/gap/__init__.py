"""The gap between a robot and its simulator: where it lies, which effect causes it, how far it shrinks.

`diagnose(runs, simulator, held_out, config) -> Diagnosis`. Inside, in order of the walk: `world` (each channel
predicted from the recorded stream before it), `floor` (noise from the data), `whiten`, `linear` (normal equations by
channel and block), `candidates`, `places`, `fit`, `selection`, `scatter` (noise effects), `generic` and `unknown`,
`explain` (both links), `judge`, `where`, `shrink`, `experiment`, and `diagnose`, the story.
"""

from __future__ import annotations

from core.gap.as_json import as_json
from core.gap.diagnose import diagnose
from core.gap.types import Config, Diagnosis

__all__ = ["Config", "Diagnosis", "as_json", "diagnose"]
