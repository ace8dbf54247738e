"""The sentence at the top of a run: what a colleague could repeat. The human edge: cm, degrees, °/h."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from app.figures.units import angle, bias, duration, length
from app.store.results import PREFERENCE

Metrics = Mapping[str, float | None]

SETTLED = math.radians(1.0) / 3600  # rad/s: a bias that moves less than that has not moved
NAMES = {"encoders+gyro": "encoders with gyro"}
PATHS = {"encoders": "Encoder path", "encoders+gyro": "Path by encoders with gyro"}
EVENT_NAMES = {
    "beacon_loss": "beacon loss",
    "beacon_lying": "stretch of false beacon readings",
    "kidnap": "kidnapping",
    "pushed": "push",
    "stuck": "blocked stretch",
}
PLURALS = {
    "beacon loss": "beacon losses",
    "stretch of false beacon readings": "stretches of false beacon readings",
    "push": "pushes",
    "blocked stretch": "blocked stretches",
}
# Of an estimate's notes, those that say that something is wrong with the run: its units, signs, names, or sight.
FAULTS = (
    "converted", "exchanged", "upside down", "mirrored", " encoder ", "on one line", "unsurveyed", "disagree about",
    "ambiguous", "not observable", "hardly observable", "times the stated one",
)  # fmt: skip
READINGS = (
    "converted",
    "exchanged",
    "upside down",
    "mirrored",
    " encoder ",
    "its sign is changed",
)  # not the robot's ways
MOST_FAULTS = 2


@dataclass(frozen=True)
class Judged:
    """What one method's estimate contributes: its figures (SI), its events, the deviation it claims at the end [m], its
    notes."""

    method: str
    metrics: Metrics
    events: Sequence[Mapping[str, Any]] = ()  # with the user's `decision`, where there is one
    final_sd: float | None = None
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Case:
    """What the sentence goes by. `reasons`: why a method cannot run, None where it can; `job`: the newest estimate."""

    duration_s: float
    estimates: Sequence[Judged] = ()
    reasons: Mapping[str, str | None] = field(default_factory=dict)
    has_truth: bool = False
    job: Mapping[str, Any] | None = None


def verdict(case: Case) -> str:
    """One to six short sentences."""
    if not case.estimates:
        return _without_estimates(case)
    lead = lead_of(case.estimates)
    parts = [_position(case, lead), _bias(case, lead), _events(case), _faults(case)]
    return " ".join(p for p in parts if p)


def lead_of(estimates: Sequence[Judged]) -> Judged:
    """The estimate that speaks for the run: the smallest error against truth, else by PREFERENCE.

    `smoothed` knows each pose's future, so it is told beside `fused` and does not lead it.
    """
    if any(e.method == "fused" for e in estimates):
        estimates = [e for e in estimates if e.method != "smoothed"]
    judged = [e for e in estimates if e.metrics.get("ate_rmse_m") is not None]
    if judged:
        return min(judged, key=lambda e: e.metrics["ate_rmse_m"] or 0.0)
    return min(estimates, key=lambda e: PREFERENCE.index(e.method) if e.method in PREFERENCE else len(PREFERENCE))


def events_of(estimates: Sequence[Judged]) -> Judged | None:
    """The estimate whose events are the run's: `fused`, else the first that found any; None without events."""
    order = ("fused", "smoothed", "encoders+gyro", "published")
    having = [e for e in estimates if e.events]
    return min(having, key=lambda e: order.index(e.method) if e.method in order else len(order), default=None)


def _faults(case: Case) -> str:
    """What `fused`, else the first method that says so, found to be wrong with the run."""
    order = sorted(case.estimates, key=lambda e: e.method != "fused")
    return " ".join(next((found for e in order if (found := faults(e.notes))), [])[:MOST_FAULTS])


def faults(notes: Sequence[str], words: Sequence[str] = FAULTS) -> list[str]:
    """Of an estimate's notes, those that say that something is wrong with the run; READINGS: with what it recorded."""
    return [note for note in notes if any(word in note for word in words)]


def _name(method: str) -> str:
    return NAMES.get(method, method)


def _without_estimates(case: Case) -> str:
    job = case.job
    if job and job["state"] in ("queued", "running"):
        doing = "is being estimated" if job["state"] == "running" else "waits to be estimated"
        return f"This run of {duration(case.duration_s)} {doing}; its paths appear here when they are done."
    if job and job["state"] == "failed":
        detail = (job.get("error") or {}).get("detail") or job.get("message") or "no reason was given"
        return f"The estimate failed: {detail.rstrip('.')}."
    if job and job["state"] == "cancelled":
        return "The estimate was cancelled; this run has no path yet."
    if case.reasons and all(case.reasons.values()):
        return f"No method can give a path for these {duration(case.duration_s)}: see below what each would need."
    return f"These {duration(case.duration_s)} have not been estimated yet."


def _position(case: Case, lead: Judged) -> str:
    name = PATHS.get(lead.method, f"{lead.method.capitalize()} path")
    final, ate = lead.metrics.get("final_m"), lead.metrics.get("ate_rmse_m")
    if final is not None:
        other = _baseline(case.estimates, lead, "final_m")
        return f"{name} ends {length(final)} from truth{other}."
    if ate is not None:
        other = _baseline(case.estimates, lead, "ate_rmse_m")
        return f"{name} is {length(ate)} from truth on average{other}."
    heading = [e for e in case.estimates if e.metrics.get("heading_rmse_rad") is not None]
    if heading:
        best = min(heading, key=lambda e: e.metrics["heading_rmse_rad"] or 0.0)
        error = angle(best.metrics["heading_rmse_rad"] or 0.0)
        return f"Heading by {_name(best.method)} is {error} from truth on average; positions have no truth."
    return _unjudged(case, lead, name)


def _baseline(estimates: Sequence[Judged], lead: Judged, metric: str) -> str:
    """The plainest other method, for comparison, and what hindsight makes of `fused`."""
    order = ("encoders", "beacon", "encoders+gyro", "fused")
    others = {e.method: v for e in estimates if e.method != lead.method and (v := e.metrics.get(metric)) is not None}
    plainest = next((m for m in order if m in others), None)
    told = [plainest] if plainest else []
    if lead.method == "fused" and "smoothed" in others:
        told.append("smoothed")
    return f" ({', '.join(f'{_name(m)} {length(others[m])}' for m in told)})" if told else ""


def _unjudged(case: Case, lead: Judged, name: str) -> str:
    why = "the truth does not overlap the path" if case.has_truth else "there is no truth to judge it by"
    distance = lead.metrics.get("distance_m")
    way = f" is {length(distance)} long" if distance is not None else ""
    claim = f" and claims ± {length(lead.final_sd)} at its end" if way and lead.final_sd is not None else ""
    return f"{name}{way}{claim}; {why}." if way else f"{name} is ready; {why}."


def _bias(case: Case, lead: Judged) -> str:
    drifts = [e.metrics.get("bias_drift_rad_s") for e in (lead, *case.estimates)]
    drift = next((d for d in drifts if d is not None), None)
    if drift is None:
        return ""
    if abs(drift) < SETTLED:
        return f"Gyro bias stayed within {bias(SETTLED)} in {duration(case.duration_s)}."
    return f"Gyro bias moved {bias(abs(drift))} in {duration(case.duration_s)}."


def _events(case: Case) -> str:
    source = events_of(case.estimates)
    events = [e for e in source.events if e.get("decision") != "dismissed"] if source else []
    kinds = Counter(str(e["kind"]) for e in events)
    if not kinds:
        return ""
    told = []
    for kind, n in sorted(kinds.items()):
        name = EVENT_NAMES.get(kind, kind.replace("_", " "))
        text = f"{n} {name if n == 1 else PLURALS.get(name, name + 's')}"
        if kind == "beacon_loss":
            lasted = sum(float(e["t1"]) - float(e["t0"]) for e in events if e["kind"] == kind)
            text += f" of {duration(lasted)}" if n == 1 else f", {duration(lasted)} in all"
        told.append(text)
    return ", ".join(told) + "."
