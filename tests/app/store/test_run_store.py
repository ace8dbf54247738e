"""Runs in the database: same readings once, changes, deletion with undo, purge."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import timedelta

import numpy as np
import pytest
from sqlalchemy import Engine, func, select

from app.db.migrate import migrate
from app.db.session import make_engine, reading, writing
from app.db.tables import Robot, Run, RunWords, Stream, Tag, now
from app.errors import ConflictError, NotFoundError
from app.settings import Settings
from app.store import arrays, runs
from core.errors import ParameterError

StoreRun = Callable[..., str]


@pytest.fixture
def engine(settings: Settings) -> Iterator[Engine]:
    settings.data.mkdir(parents=True)
    made = make_engine(settings.url)
    migrate(made)
    yield made
    made.dispose()


def test_the_same_readings_are_stored_once(store_run: StoreRun, engine: Engine) -> None:
    first = store_run(tags=("a",))
    second = store_run(tags=("b",), name="other name")
    with reading(engine) as session:
        run = runs.get_run(session, first)
        assert first == second
        assert run.name == "lap" and [t.tag for t in run.tags] == ["a", "b"]
        assert session.scalar(select(func.count()).select_from(Run)) == 1
        assert session.scalar(select(func.count()).select_from(Stream)) == 5


def test_load_run_maps_what_was_stored(store_run: StoreRun, engine: Engine, settings: Settings, make_run) -> None:
    loaded = runs.load_run(engine, settings, store_run())
    expected = make_run()
    assert loaded.imu is not None and np.array_equal(loaded.imu.gz, expected.imu.gz)
    assert loaded.meta.robot == expected.meta.robot
    assert loaded.wheels is not None and not loaded.wheels.left.flags.writeable


def test_a_new_name_goes_with_the_run(store_run: StoreRun, engine: Engine, settings: Settings) -> None:
    run_id = store_run()
    with writing(engine) as session:
        runs.update_run(session, run_id, name="  corridor   lap ", robot="mill", tags=["b", " a ", "b"], notes="dry")
    with reading(engine) as session:
        run = runs.get_run(session, run_id)
        assert run.name == "corridor lap" and run.robot is not None and run.robot.name == "mill"
        assert [t.tag for t in run.tags] == ["a", "b"] and run.notes == "dry"
    assert runs.load_run(engine, settings, run_id).meta.name == "corridor lap"
    with writing(engine) as session:
        assert runs.update_run(session, run_id, robot="").robot is None


@pytest.mark.parametrize(
    "change", [{"name": "  "}, {"name": "x" * 201}, {"tags": ["t" * 61]}, {"tags": [str(i) for i in range(51)]}]
)
def test_impossible_changes_are_refused_and_change_nothing(change: dict, store_run: StoreRun, engine: Engine) -> None:
    run_id = store_run()
    with pytest.raises(ParameterError), writing(engine) as session:
        runs.update_run(session, run_id, **{"notes": "new", **change})
    with reading(engine) as session:
        assert runs.get_run(session, run_id).notes == ""


def test_deleting_can_be_undone(store_run: StoreRun, engine: Engine) -> None:
    run_id = store_run()
    with writing(engine) as session:
        runs.delete_run(session, run_id)
    with reading(engine) as session, pytest.raises(NotFoundError, match="can be restored"):
        runs.get_run(session, run_id)
    with reading(engine) as session:
        assert runs.list_runs(session, runs.RunQuery()).total == 0
        assert [r.id for r in runs.deleted_runs(session)] == [run_id]
    with writing(engine) as session:
        runs.restore_run(session, run_id)
    with reading(engine) as session:
        assert runs.list_runs(session, runs.RunQuery()).total == 1
    with writing(engine) as session, pytest.raises(ConflictError):
        runs.restore_run(session, run_id)


def test_uploading_a_deleted_run_again_brings_it_back(store_run: StoreRun, engine: Engine) -> None:
    run_id = store_run()
    with writing(engine) as session:
        runs.delete_run(session, run_id)
    assert store_run() == run_id
    with reading(engine) as session:
        assert runs.get_run(session, run_id).deleted_at is None


def test_purge_takes_only_what_waited_long_enough(
    store_run: StoreRun, engine: Engine, settings: Settings, make_run
) -> None:
    old, young = store_run(robot="a"), store_run(make_run(turn=0.2), robot="b")
    with writing(engine) as session:
        runs.delete_run(session, old).deleted_at = now() - timedelta(hours=25)
        runs.delete_run(session, young).deleted_at = now() - timedelta(hours=23)
    with writing(engine) as session:
        assert runs.purge(session, 24.0) == 1
    with reading(engine) as session:
        assert [r.id for r in runs.deleted_runs(session)] == [young]
        for table in (Stream, Tag, RunWords):
            assert set(session.scalars(select(table.run_id))) <= {young}
        assert session.scalars(select(Robot.name)).all() == ["b"]


def test_arrays_go_once_no_run_names_them(store_run: StoreRun, engine: Engine, settings: Settings, make_run) -> None:
    gone, kept = store_run(), store_run(make_run(turn=0.2))
    with reading(engine) as session:
        own = {k for s in runs.manifest(session, gone)["streams"] for k in s["columns"].values()}
        shared = own & {k for s in runs.manifest(session, kept)["streams"] for k in s["columns"].values()}
    assert shared and own - shared
    with writing(engine) as session:
        runs.delete_run(session, gone)
        runs.purge(session, 0.0, now() + timedelta(seconds=1))
    with reading(engine) as session:
        assert runs.collect_arrays(session, settings.data, older_than=-1.0) > 0
    assert all(arrays.path_of(settings.data, key).exists() for key in shared)
    assert not any(arrays.path_of(settings.data, key).exists() for key in own - shared)
    assert runs.load_run(engine, settings, kept).imu is not None
