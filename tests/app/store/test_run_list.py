"""The list of runs against a plain Python model: filters, sorting, facets, pages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import Engine

from app.db.migrate import migrate
from app.db.session import make_engine, reading, writing
from app.store import runs
from app.store.run_list import SORTS, RunQuery, list_runs, parse
from core.errors import ParameterError

START = datetime(2026, 1, 1, tzinfo=UTC)
STREAMS = ("wheels", "imu", "beacon", "truth")


@dataclass(frozen=True)
class Row:
    id: str
    name: str
    robot: str | None
    tags: tuple[str, ...]
    streams: tuple[str, ...]
    minutes: int
    duration_s: float
    best_ate_m: float | None
    deleted: bool


def world() -> list[Row]:
    """60 runs with ties and gaps in every key, the same each time."""
    made = []
    for i in range(60):
        made.append(
            Row(
                id=f"{(i * 7919) % 4096:016x}",
                name=("Wet lap", "dry lap", "100% Ä_b", 'the "mill"')[i % 4] + f" {i % 7}",
                robot=(None, "mill", "Hall Bot", "drum")[i % 4],
                tags=tuple(sorted({("wet", "night", "Ost")[i % 3], f"t{i % 5}"})),
                streams=tuple(s for j, s in enumerate(STREAMS) if (i >> j) & 1) or ("imu",),
                minutes=i // 3,
                duration_s=float(i % 11),
                best_ate_m=None if i % 4 == 0 else (i % 9) / 10,
                deleted=i % 13 == 0,
            )
        )
    return made


WORLD = world()
ALIVE = [r for r in WORLD if not r.deleted]


def manifest(row: Row) -> dict:
    streams = [
        {
            "name": s,
            "rows": 2,
            "t0": 0.0,
            "t1": 1.0,
            "rate_hz": 1.0,
            "gaps": [],
            "columns": {"t": "0" * 64},
            "names": [],
        }
        for s in row.streams
    ]
    return {
        "id": row.id, "sha256": row.id * 4, "name": row.name, "robot": row.robot, "tags": row.tags, "t0": 0.0,
        "t1": row.duration_s, "duration_s": row.duration_s, "size_bytes": 8, "meta": {}, "warnings": [],
        "source": {"file_name": f"{row.id}.zip"}, "sparkline": [], "streams": streams,
    }  # fmt: skip


@pytest.fixture(scope="module")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Engine]:
    folder: Path = tmp_path_factory.mktemp("runs")
    made = make_engine(f"sqlite:///{folder / 'x.db'}")
    migrate(made)
    with writing(made) as session:
        for row in WORLD:
            run = runs.add_run(session, manifest(row))
            run.created_at, run.best_ate_m = START + timedelta(minutes=row.minutes), row.best_ate_m
            run.deleted_at = START if row.deleted else None
    yield made
    made.dispose()


def ids(engine: Engine, query: RunQuery) -> list[str]:
    """All pages, one after the other."""
    found: list[str] = []
    for _ in range(len(WORLD) + 2):
        with reading(engine) as session:
            page = list_runs(session, query)
        assert len(page.items) <= query.limit
        found += [run.id for run in page.items]
        if page.next is None:
            assert page.total == len(found)
            return found
        query = RunQuery(**{**query.__dict__, "cursor": page.next})
    raise AssertionError("the pages never end")


def key(row: Row, name: str) -> object:
    return {
        "created_at": row.minutes,
        "name": row.name.lower(),
        "robot": row.robot.lower() if row.robot else None,
        "duration_s": row.duration_s,
        "size_bytes": 8,
        "best_ate_m": row.best_ate_m,
        "bias_drift_rad_s": None,
        "verdict": None,
    }[name]


@pytest.mark.parametrize("descending", [False, True])
@pytest.mark.parametrize("name", list(SORTS))
@pytest.mark.parametrize("limit", [13, 500])
def test_every_order_over_pages(engine: Engine, name: str, descending: bool, limit: int) -> None:
    known = [r for r in ALIVE if key(r, name) is not None]
    unknown = [r for r in ALIVE if key(r, name) is None]
    expected = sorted(known, key=lambda r: (key(r, name), r.id), reverse=descending)
    expected += sorted(unknown, key=lambda r: r.id, reverse=descending)
    found = ids(engine, RunQuery(sort=f"-{name}" if descending else name, limit=limit))
    assert found == [r.id for r in expected]


WORDS = ["lap", "wet", "LAP 3", "100%", "a_b", "%", "ä_b", "mill", "zzz", '"the', "t1"]


@given(
    words=st.lists(st.sampled_from(WORDS), max_size=2),
    robots=st.lists(st.sampled_from(["mill", "hall bot", "DRUM", "none"]), max_size=2),
    tags=st.lists(st.sampled_from(["wet", "ost", "t1", "zzz"]), max_size=2),
    has=st.lists(st.sampled_from([*STREAMS, "ranges"]), max_size=2),
)
def test_filters_and_facets(
    engine: Engine, words: list[str], robots: list[str], tags: list[str], has: list[str]
) -> None:
    def fits(row: Row) -> bool:
        text = "\n".join([row.name, row.robot or "", *row.tags, f"{row.id}.zip"]).casefold()
        return (
            all(part.casefold() in text for word in words for part in word.replace('"', "").split())
            and (not robots or (row.robot or "").lower() in [r.lower() for r in robots])
            and all(t.lower() in [x.lower() for x in row.tags] for t in tags)
            and all(h in row.streams for h in has)
        )

    expected = [r for r in ALIVE if fits(r)]
    query = RunQuery(
        q=" ".join(w.replace('"', "") for w in words), robots=tuple(robots), tags=tuple(tags), has=tuple(has)
    )
    assert sorted(ids(engine, query)) == sorted(r.id for r in expected)
    with reading(engine) as session:
        facets = list_runs(session, query).facets
    assert facets["robots"] == Counter(r.robot for r in expected if r.robot)
    assert facets["tags"] == Counter(t for r in expected for t in r.tags)
    assert facets["streams"] == Counter(s for r in expected for s in r.streams)
    assert list(facets["tags"].values()) == sorted(facets["tags"].values(), reverse=True)


def test_the_query_language() -> None:
    query, words = parse(
        RunQuery(q='robot:"Hall Bot" TAG:wet has:imu gap:none Lap robot: "two words" x:y', tags=("t",))
    )
    assert query.robots == ("Hall Bot",) and query.tags == ("t", "wet")
    assert query.has == ("imu",) and query.verdicts == ("none",)
    assert words == ["lap", "robot:", "two words", "x:y"]


@given(text=st.text(max_size=60))
def test_any_text_can_be_searched_for(engine: Engine, text: str) -> None:
    with reading(engine) as session:
        assert list_runs(session, RunQuery(q=text)).total <= len(ALIVE)


def test_a_long_note_is_found_and_forgotten(engine: Engine) -> None:
    run_id = ALIVE[0].id
    with writing(engine) as session:
        runs.update_run(session, run_id, notes="filler " * 5000 + "Straße")
    assert ids(engine, RunQuery(q="STRASSE")) == [run_id]
    with writing(engine) as session:
        runs.update_run(session, run_id, notes="")
    assert ids(engine, RunQuery(q="STRASSE")) == []


@pytest.mark.parametrize("cursor", ["x", "AAAA", "bnVsbA", "W10", "é"])
def test_a_cursor_from_elsewhere_is_refused(engine: Engine, cursor: str) -> None:
    with reading(engine) as session, pytest.raises(ParameterError, match="cursor"):
        list_runs(session, RunQuery(cursor=cursor))


def test_a_cursor_of_another_order_is_refused(engine: Engine) -> None:
    with reading(engine) as session:
        cursor = list_runs(session, RunQuery(limit=1, sort="name")).next
        with pytest.raises(ParameterError, match="cursor"):
            list_runs(session, RunQuery(limit=1, sort="duration_s", cursor=cursor))


@pytest.mark.parametrize("bad", [RunQuery(sort="sha256"), RunQuery(limit=0), RunQuery(limit=501)])
def test_impossible_queries_are_refused(engine: Engine, bad: RunQuery) -> None:
    with reading(engine) as session, pytest.raises(ParameterError):
        list_runs(session, bad)
