"""How Alembic reaches the database: the program's own connection, else DRIFTSCOPE_* as the program reads them."""

from __future__ import annotations

from alembic import context
from sqlalchemy import Connection

from app.db.session import make_engine
from app.db.tables import Base, UtcDateTime
from app.settings import Settings


def render_item(kind: str, item: object, _context: object) -> str | bool:
    """Write our own column type as the plain one beneath it, so that a migration never depends on the program."""
    return "sa.DateTime(timezone=True)" if kind == "type" and isinstance(item, UtcDateTime) else False


def run(connection: Connection) -> None:
    context.configure(
        connection=connection,
        target_metadata=Base.metadata,
        compare_type=True,
        render_item=render_item,
        render_as_batch=connection.dialect.name == "sqlite",
    )
    with context.begin_transaction():
        context.run_migrations()


given = context.config.attributes.get("connection")
if given is not None:
    run(given)
else:
    settings = Settings.from_env()
    settings.data.mkdir(parents=True, exist_ok=True)
    engine = make_engine(settings.url)
    with engine.execution_options(write=True).begin() as connection:
        run(connection)
    engine.dispose()
