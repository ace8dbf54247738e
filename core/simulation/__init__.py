"""The simulator: commands in, every stream out, with any of `core.effects` added.

What you give: a run (its commands, stamps and robot) and an effect set. What comes back: a run like it, or for many
effect sets at once the expected readings as arrays. `links` has each link of the chain alone, `scenarios` drives.
"""

from __future__ import annotations

from core.simulation.ready import warm
from core.simulation.simulate import simulate, simulate_many

__all__ = ["simulate", "simulate_many", "warm"]
