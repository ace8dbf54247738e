"""The diagnosis of the gap in a worker: the same call as `driftscope diagnose`, its answer as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from app.jobs.imu import plain
from app.jobs.tasks import Progress


def diagnose(
    data: Path,
    progress: Progress,
    *,
    manifests: Sequence[Mapping[str, Any]],
    held_out: Sequence[Mapping[str, Any]],
    tolerances: Mapping[str, float],
    seed: int,
    simulator: str | None = None,
    simulators: str | None = None,
) -> dict[str, Any]:
    """What stored runs say of their simulator, for `app.store.diagnoses`.

    tolerances: by "effect.parameter", in place of the table's. simulator: a name in the file `simulators`, or `sim`
    for what was recorded beside every run; None: ours.
    """
    from app.simulators import RECORDED, chosen
    from app.store import arrays, beside
    from app.store.provenance import code_version
    from core.gap import Config, as_json, evidence_json
    from core.gap import diagnose as find

    progress(0.0, "loading")
    runs, kept = ([arrays.run_from_manifest(data, m) for m in given] for given in (manifests, held_out))
    config = Config(tolerances=dict(tolerances), seed=seed)
    path = Path(simulators) if simulators else None
    asked = [
        chosen(simulator, path, partial(beside.load, data, m["source"]), m["name"])
        for m in ((*manifests, *held_out) if simulator == RECORDED else manifests[:1])
    ]
    each = [one for one in asked if one is not None]
    foreign = each if simulator == RECORDED else next(iter(each), None)
    found = find(runs, foreign, held_out=kept, config=config, progress=progress)
    progress(1.0, "saving")
    return {
        "result": plain(as_json(found)),
        "evidence": plain(evidence_json(found)),
        "model": plain({effect: dict(values) for effect, values in found.model.items()}),
        "config": {"tolerances": dict(tolerances)},
        "seed": seed,
        "simulator": simulator,
        "runtime_s": found.runtime_s,
        "code_version": code_version(),
    }
