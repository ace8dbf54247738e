"""The migrations make the tables that the code expects, on SQLite and, where a server can be started, PostgreSQL."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import Engine, inspect

from app.db.migrate import config, migrate
from app.db.session import make_engine, reading, writing
from app.db.tables import Base
from app.store import runs
from app.store.run_list import RunQuery, list_runs


def postgres_binaries() -> Path | None:
    """The newest installed server's programs; None where there is only a client, or we could not run them."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    if found:
        return found[-1].parent
    initdb = shutil.which("initdb")
    return Path(initdb).resolve().parent if initdb else None


POSTGRES = postgres_binaries()


@pytest.fixture
def sqlite_url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path / 'x.db'}"


@pytest.fixture(scope="module")
def postgres_url() -> Iterator[str]:
    """A throw-away server that listens on a socket in a folder of its own; run by `postgres` where we are root."""
    assert POSTGRES is not None
    folder = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))
    user = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
    if user:
        shutil.chown(folder, "postgres")
    run = [*user, "env", "-C", str(folder)]
    subprocess.run(
        [*run, str(POSTGRES / "initdb"), "-D", str(folder / "db"), "-U", "drift", "-A", "trust", "-N"],
        check=True, capture_output=True,
    )  # fmt: skip
    options = f"-c listen_addresses= -c unix_socket_directories={folder} -c fsync=off"
    control = [*run, str(POSTGRES / "pg_ctl"), "-D", str(folder / "db"), "-w", "-l", str(folder / "log")]
    subprocess.run([*control, "-o", options, "start"], check=True, capture_output=True)
    try:
        yield f"postgresql+psycopg://drift@/postgres?host={folder}"
    finally:
        subprocess.run([*control, "-m", "immediate", "stop"], check=True, capture_output=True)
        shutil.rmtree(folder, ignore_errors=True)


def check(engine: Engine) -> None:
    assert migrate(engine) is True
    assert migrate(engine) is False
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
    settings = config()
    with engine.execution_options(write=True).begin() as connection:
        settings.attributes["connection"] = connection
        command.downgrade(settings, "base")
    assert inspect(engine).get_table_names() == ["alembic_version"]
    assert migrate(engine) is True


def test_sqlite(sqlite_url: str) -> None:
    engine = make_engine(sqlite_url)
    check(engine)
    with engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
        assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar() == 1
    engine.dispose()


if POSTGRES is not None and shutil.which("runuser"):

    def test_postgresql(postgres_url: str) -> None:
        """Tables, a run with an upload's worth of text, its list, its deletion."""
        engine = make_engine(postgres_url)
        check(engine)
        manifest = {
            "id": "0" * 16, "sha256": "0" * 64, "name": "lap", "robot": "mill", "tags": ["wet"], "t0": 0.0, "t1": 1.0,
            "duration_s": 1.0, "size_bytes": 2**40, "meta": {}, "warnings": [], "source": {}, "sparkline": [],
            "streams": [
                {
                    "name": "imu", "rows": 2**33, "t0": 0.0, "t1": 1.0, "rate_hz": 1.0, "gaps": [],
                    "columns": {"t": "0" * 64}, "names": [],
                }
            ],
        }  # fmt: skip
        with writing(engine) as session:
            runs.add_run(session, manifest)
            runs.update_run(session, "0" * 16, notes="long " * 5000)
        for sort in ("-created_at", "best_ate_m", "-robot", "name"):
            with reading(engine) as session:
                page = list_runs(session, RunQuery(q="LAP long robot:Mill tag:wet has:imu", sort=sort))
                assert page.total == 1 and page.facets["streams"] == {"imu": 1}
        with writing(engine) as session:
            runs.delete_run(session, "0" * 16)
            assert runs.purge(session, -1.0) == 1
        engine.dispose()
