"""Bring the database to the version that this code expects, from within the program."""

from __future__ import annotations

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine

from app import paths
from app.db.tables import Base


def config() -> Config:
    """Alembic's configuration without a file."""
    made = Config()
    made.set_main_option("script_location", str(paths.MIGRATIONS).replace("%", "%%"))
    return made


def migrate(engine: Engine) -> bool:
    """Upgrade to the newest version; whether there was anything to do."""
    settings = config()
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"target_metadata": Base.metadata})
        current = context.get_current_heads()
    if set(current) == set(ScriptDirectory.from_config(settings).get_heads()):
        return False
    with engine.execution_options(write=True).begin() as connection:
        settings.attributes["connection"] = connection
        command.upgrade(settings, "head")
    return True
