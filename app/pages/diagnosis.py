"""`/diagnoses/{id}`: the report. One sentence, then where, which, how far, what is left, what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from fastapi import APIRouter, Request, Response

from app.api.diagnosis_rows import detail
from app.db.session import reading
from app.exports.effects import TARGETS
from app.figures.gap_report import parts, runs
from app.figures.verdict import READINGS, faults
from app.pages.base import Page, environment, render, route
from app.paths import STATIC
from app.store import diagnoses as store
from app.store import results

router = APIRouter()


@dataclass(frozen=True)
class DiagnosisPage(Page):
    """`diagnosis` and `evidence` as the API has them; `drawn`: figures that the server draws; `targets` of a patch;
    `faults`: what is wrong with the readings of each run, by the run's name."""

    template: ClassVar[str] = "diagnosis.html"
    place: ClassVar[str] = "diagnoses"
    diagnosis: dict[str, Any]
    evidence: dict[str, Any] | None
    drawn: Any
    targets: list[dict[str, str]]
    faults: dict[str, list[str]]


@route(router, "/diagnoses/{diagnosis_id}")
def diagnosis(request: Request, diagnosis_id: str) -> Response:
    with reading(request.app.state.engine) as session:
        row = store.get_diagnosis(session, diagnosis_id, evidence=True)
        found = detail(session, row).model_dump(mode="json")
        evidence = row.evidence
        notes = results.notes_by_run(session, row.run_ids)
    page = DiagnosisPage(
        found["name"],
        found["sentence"],
        found,
        evidence,
        parts(found["result"], evidence),
        [{"name": name, "label": t.label, "what": t.what} for name, t in TARGETS.items()],
        {r["name"]: told for r in found["runs"] if (told := faults(notes.get(r["id"], ()), READINGS))},
    )
    return render(request, page)


def report(found: Mapping[str, Any], evidence: Mapping[str, Any] | None) -> str:
    """The diagnosis as one HTML page with its style and drawings inside: opens anywhere, and prints."""
    css = "\n".join((STATIC / "css" / name).read_text(encoding="utf-8") for name in ("tokens.css", "gap.css"))
    template = environment().get_template("diagnosis_report.html")
    return template.render(found=found, d=parts(found["result"], evidence), runs=runs(evidence), css=css)
