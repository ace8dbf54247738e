"""Odometry calibration in a worker: radii, track width, gyro scale, mounts and clocks out of runs. No database here."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from app.jobs.tasks import Progress


def calibrate(
    data: Path, progress: Progress, *, manifests: Sequence[Mapping[str, Any]], reference: str, own_clocks: bool
) -> dict[str, Any]:
    """What these runs of one robot show, as `app.store.odometry` keeps it."""
    from app.store import arrays
    from app.store.provenance import code_version
    from core.calibration.odometry import calibrate_odometry, corrected
    from core.formats.run_json import meta_to_json

    began = time.perf_counter()
    runs = [arrays.run_from_manifest(data, manifest) for manifest in manifests]
    progress(0.1, "all poses and parameters at once")
    found = calibrate_odometry(runs, reference=reference, own_clocks=own_clocks)
    robot = corrected(runs[0], found).meta.robot
    sides = [found.value(f"{side}_radius") for side in ("left", "right")]
    if sides[0] is not None and sides[1] is not None:
        robot = dataclasses.replace(robot, wheel_radius=(sides[0] + sides[1]) / 2)
    return {
        "result": found.to_json(),
        "robot": meta_to_json(dataclasses.replace(runs[0].meta, robot=robot))["robot"],
        "runtime_s": time.perf_counter() - began,
        "code_version": code_version(),
    }
