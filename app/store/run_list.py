"""The list of runs: a small query language, facets, sorting, and paging by key rather than by offset."""

from __future__ import annotations

import base64
import binascii
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Select, and_, func, literal, or_, select, union_all
from sqlalchemy.orm import InstrumentedAttribute, Session, selectinload

from app.db.tables import Robot, Run, RunWords, Tag
from core.errors import ParameterError

MAX_LIMIT = 500


@dataclass(frozen=True)
class RunQuery:
    """What to list. `q` understands `robot:x tag:y has:imu gap:none` (quotes for blanks) and free words, all of which
    must match; the lists add to it. `sort` is a key of SORTS, with `-` for descending; runs without the value are last.
    """

    q: str = ""
    robots: tuple[str, ...] = ()
    tags: tuple[str, ...] = ()
    has: tuple[str, ...] = ()
    verdicts: tuple[str, ...] = ()
    sort: str = "-created_at"
    limit: int = 50
    cursor: str | None = None


@dataclass(frozen=True)
class RunPage:
    """One page of the list; `facets` count over all that match: robots, tags, streams, verdicts: {name: n} each."""

    items: list[Run]
    total: int
    next: str | None
    facets: dict[str, dict[str, int]] = field(default_factory=dict)


SORTS: dict[str, ColumnElement[Any] | InstrumentedAttribute[Any]] = {
    "created_at": Run.created_at,
    "name": func.lower(Run.name),
    "robot": func.lower(Robot.name),
    "duration_s": Run.duration_s,
    "size_bytes": Run.size_bytes,
    "best_ate_m": Run.best_ate_m,
    "bias_drift_rad_s": Run.bias_drift,
    "verdict": Run.verdict,
}
NULLABLE = ("robot", "best_ate_m", "bias_drift_rad_s", "verdict")
_FIELDS = {"robot": "robots", "tag": "tags", "has": "has", "gap": "verdicts"}
_TERM = re.compile(r'(?:(?P<key>robot|tag|has|gap):)?(?:"(?P<quoted>[^"]*)"|(?P<word>\S+))', re.IGNORECASE)


def parse(query: RunQuery) -> tuple[RunQuery, list[str]]:
    """The query with the terms of `q` moved to their lists, and the free words that remain, case-folded."""
    found: dict[str, list[str]] = {name: list(getattr(query, name)) for name in _FIELDS.values()}
    words: list[str] = []
    for match in _TERM.finditer(query.q):
        text = match["quoted"] if match["quoted"] is not None else match["word"]
        if match["key"] and text:
            found[_FIELDS[match["key"].lower()]].append(text)
        elif text:
            words.append(text.casefold())
    return replace(
        query,
        q="",
        robots=tuple(found["robots"]),
        tags=tuple(found["tags"]),
        has=tuple(found["has"]),
        verdicts=tuple(found["verdicts"]),
    ), words


def list_runs(session: Session, query: RunQuery) -> RunPage:
    """The runs that match, one page of them, and how many there are by robot, tag and stream."""
    if not 1 <= query.limit <= MAX_LIMIT:
        raise ParameterError(f"limit is {query.limit}, expected 1 to {MAX_LIMIT}", parameter="limit", found=query.limit)
    parsed, words = parse(query)
    conditions = [Run.deleted_at.is_(None), *_conditions(parsed, words)]
    total, facets = _facets(session, conditions)
    ids, following = _page(session, query, conditions)
    rows = session.scalars(
        select(Run).where(Run.id.in_(ids)).options(selectinload(Run.streams), selectinload(Run.tags))
    ).unique()
    by_id = {run.id: run for run in rows}
    return RunPage([by_id[i] for i in ids], total, following, facets)


def _conditions(query: RunQuery, words: Iterable[str]) -> Iterable[ColumnElement[bool]]:
    holding = [RunWords.text.contains(word, autoescape=True) for word in words]
    if holding:
        yield Run.id.in_(select(RunWords.run_id).where(*holding))
    if query.robots:
        names = [r.lower() for r in query.robots]
        yield Run.robot_id.in_(select(Robot.id).where(func.lower(Robot.name).in_(names)))
    for tag in query.tags:
        yield Run.id.in_(select(Tag.run_id).where(func.lower(Tag.tag) == tag.lower()))
    for stream in query.has:
        yield (" " + Run.stream_names + " ").contains(f" {stream.lower()} ", autoescape=True)
    if query.verdicts:
        yield Run.verdict.in_([v.lower() for v in query.verdicts])


def _page(session: Session, query: RunQuery, conditions: list[ColumnElement[bool]]) -> tuple[list[str], str | None]:
    name, descending = query.sort.removeprefix("-"), query.sort.startswith("-")
    if name not in SORTS:
        raise ParameterError(
            f"cannot sort by {name!r}; it can be by {', '.join(SORTS)}", parameter="sort", found=name, expected=[*SORTS]
        )
    key = SORTS[name]
    statement: Select[Any] = select(Run.id, key).where(*conditions)
    if name == "robot":
        statement = statement.outerjoin(Robot, Robot.id == Run.robot_id)
    if query.cursor:
        value, last_id = _decode(query.cursor, query.sort, parse_time=name == "created_at")
        statement = statement.where(_after(key, value, last_id, descending, name in NULLABLE))
    order: list[Any] = [key.desc(), Run.id.desc()] if descending else [key.asc(), Run.id.asc()]
    if name in NULLABLE:
        order.insert(0, key.is_(None))
    rows = session.execute(statement.order_by(*order).limit(query.limit + 1)).all()
    page = rows[: query.limit]
    following = _encode(query.sort, page[-1][1], page[-1][0]) if len(rows) > query.limit else None
    return [row[0] for row in page], following


def _after(key: Any, value: Any, last_id: str, descending: bool, nullable: bool) -> ColumnElement[bool]:
    beyond: Callable[[Any, Any], Any] = (lambda a, b: a < b) if descending else (lambda a, b: a > b)
    same = and_(key.is_(None) if value is None else key == value, beyond(Run.id, last_id))
    if value is None:
        return same
    return or_(beyond(key, value), same, *([key.is_(None)] if nullable else []))


def _encode(sort: str, value: Any, last_id: str) -> str:
    plain = value.isoformat() if isinstance(value, datetime) else value
    return base64.urlsafe_b64encode(json.dumps([sort, plain, last_id]).encode()).decode().rstrip("=")


def _decode(cursor: str, sort: str, *, parse_time: bool) -> tuple[Any, str]:
    try:
        given, value, last_id = json.loads(base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)))
        if given != sort or not isinstance(last_id, str) or not isinstance(value, str | int | float | None):
            raise ValueError(given)
        return (datetime.fromisoformat(str(value)) if parse_time else value), last_id
    except (ValueError, TypeError, binascii.Error):
        raise ParameterError(
            "the cursor is not one that this list gave for this order", parameter="cursor", found=cursor[:100]
        ) from None


def _facets(session: Session, conditions: list[ColumnElement[bool]]) -> tuple[int, dict[str, dict[str, int]]]:
    """How many match in all, by robot, tag, stream, verdict; in one statement, so that the matches are found once."""
    hit = select(Run.id, Run.robot_id, Run.stream_names).where(*conditions).cte("hit")
    count = func.count()
    if len(conditions) == 1:  # nothing but "not deleted": the few that are deleted are sooner left out
        tagged = Tag.run_id.not_in(select(Run.id).where(Run.deleted_at.is_not(None)))
    else:
        tagged = Tag.run_id.in_(select(hit.c.id))
    parts = union_all(
        select(literal("robots"), Robot.name, count).join(hit, hit.c.robot_id == Robot.id).group_by(Robot.name),
        select(literal("tags"), Tag.tag, count).where(tagged).group_by(Tag.tag),
        # a handful of combinations, so the streams are counted from them rather than from a row per stream
        select(literal("combinations"), hit.c.stream_names, count).group_by(hit.c.stream_names),
        select(literal("verdicts"), Run.verdict, count)
        .where(*conditions, Run.verdict.is_not(None))
        .group_by(Run.verdict),
    )
    counts: dict[str, Counter[str]] = {
        "robots": Counter(),
        "tags": Counter(),
        "streams": Counter(),
        "verdicts": Counter(),
    }
    total = 0
    for kind, name, n in session.execute(parts):
        if kind == "combinations":
            total += n
            counts["streams"].update(dict.fromkeys(name.split(), n))
        else:
            counts[kind][name] = n
    return total, {kind: dict(sorted(c.items(), key=lambda item: (-item[1], item[0]))) for kind, c in counts.items()}
