"""Remembered column mappings: how a logger's columns become streams, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.tables import ColumnMapping, now
from app.errors import NotFoundError
from core.formats import ColumnMap


def list_mappings(session: Session) -> Sequence[ColumnMapping]:
    """All of them, by name."""
    return session.scalars(select(ColumnMapping).order_by(ColumnMapping.name)).all()


def get_mapping(session: Session, name: str) -> ColumnMapping:
    """NotFoundError if there is none of that name."""
    row = session.get(ColumnMapping, name)
    if row is None:
        raise NotFoundError(f"there is no mapping {name!r}", what="mapping", id=name)
    return row


def put_mapping(session: Session, name: str, mapping: Mapping[str, Any]) -> ColumnMapping:
    """Remember, or replace. ParameterError, naming the key, if it could map nothing."""
    checked = ColumnMap.from_json(mapping).to_json()
    row = session.get(ColumnMapping, name) or ColumnMapping(name=name)
    row.mapping, row.updated_at = checked, now()
    session.add(row)
    session.flush()
    return row


def delete_mapping(session: Session, name: str) -> None:
    """Forget."""
    session.delete(get_mapping(session, name))
