"""`/diagnoses`: the stored diagnoses, and a new one from runs. `?runs=a,b&held_out=c` opens it with them chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from fastapi import APIRouter, Query, Request, Response
from sqlalchemy import or_, select
from sqlalchemy.orm import Session

from app.api.diagnosis_rows import summaries
from app.db.session import reading
from app.db.tables import Run
from app.figures.gap_sentence import VERDICTS
from app.figures.verdict import READINGS, faults
from app.pages.base import Page, render, route
from app.simulators import OURS, RECORDED
from app.store import beside, results
from app.store import diagnoses as store
from app.store import jobs as job_store
from core.effects import EFFECTS

router = APIRouter()
OFFERED = 300


@dataclass(frozen=True)
class DiagnosesPage(Page):
    """`diagnoses`, newest first; `jobs` at work on one; `runs` that can be chosen; `effects` whose size can be set."""

    template: ClassVar[str] = "diagnoses.html"
    place: ClassVar[str] = "diagnoses"
    diagnoses: list[dict[str, Any]]
    jobs: list[dict[str, Any]]
    runs: list[dict[str, Any]]
    effects: list[dict[str, Any]]
    verdicts: dict[str, str]
    simulators: list[str]


@route(router, "/diagnoses")
def diagnoses(
    request: Request,
    runs: Annotated[str, Query(max_length=2000)] = "",
    held_out: Annotated[str, Query(max_length=2000)] = "",
) -> Response:
    wanted = [part for text in (runs, held_out) for part in text.split(",") if part]
    with reading(request.app.state.engine) as session:
        rows = store.list_diagnoses(session, limit=store.MAX_LISTED)
        active = job_store.list_jobs(session, states=["active"], limit=job_store.MAX_LISTED)
        offered = _offered(session, wanted)
        notes = results.notes_by_run(session, [run.id for run in offered])
        sims = [RECORDED] if any(beside.KEY in run.source for run in offered) else []
        page = DiagnosesPage(
            title="Diagnoses",
            sentence=sentence([row.verdict for row in rows], len({row.robot for row in rows if row.robot})),
            diagnoses=[one.model_dump(mode="json") for one in summaries(session, rows)],
            jobs=[job_store.as_dict(job) for job in active if job.kind == "diagnose"],
            runs=[_choice(run, faults(notes.get(run.id, ()), READINGS)) for run in offered],
            effects=_sizes(),
            verdicts=VERDICTS,
            simulators=[OURS, *sims, *request.app.state.sandbox.simulators()],
        )
    return render(request, page)


def sentence(verdicts: list[str], robots: int) -> str:
    """What was found so far."""
    if not verdicts:
        return "No diagnosis yet: choose runs of one robot and see where its simulator goes wrong, by which effect."
    n, of = len(verdicts), f" of {robots} {'robot' if robots == 1 else 'robots'}" if robots else ""
    counts = ((verdicts.count(name), told) for name, told in VERDICTS.items())
    told = ", ".join(f"{count} {words}" for count, words in counts if count)
    return f"{n} {'diagnosis' if n == 1 else 'diagnoses'}{of}: {told}."


def _offered(session: Session, wanted: list[str]) -> list[Run]:
    """The newest runs that can drive a simulator, and those that the address names."""
    has = or_(Run.stream_names.contains("commands"), Run.stream_names.contains("wheels"))
    alive = select(Run).where(Run.deleted_at.is_(None))
    newest = session.scalars(alive.where(has).order_by(Run.created_at.desc(), Run.id).limit(OFFERED)).unique().all()
    known = {run.id for run in newest}
    missing = [run_id for run_id in wanted if run_id not in known]
    named = session.scalars(alive.where(Run.id.in_(missing))).unique().all() if missing else []
    return [*named, *newest]


def _choice(run: Run, wrong: list[str]) -> dict[str, Any]:
    return {
        "id": run.id,
        "name": run.name,
        "robot": run.robot.name if run.robot else None,
        "duration_s": run.duration_s,
        "streams": run.stream_names.split(),
        "verdict": run.verdict,
        "faults": wrong,
        "created_at": run.created_at.isoformat(),
    }


def _sizes() -> list[dict[str, Any]]:
    """Parameters whose smallest size that matters can be set, with the table's."""
    return [
        {"key": f"{effect.id}.{p.name}", "label": f"{effect.label}, {p.name}", "unit": p.unit, "small": p.small,
         "of_reach": p.small_of_reach}
        for effect in EFFECTS.values() for p in effect.parameters if p.small is not None
    ]  # fmt: skip
