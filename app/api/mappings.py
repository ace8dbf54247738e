"""Remembered column mappings."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Body, Path

from app.api import schemas
from app.api.deps import ReadSession, WriteSession
from app.store import mappings as store

router = APIRouter(tags=["mappings"])
Name = Annotated[str, Path(min_length=1, max_length=100, description="the mapping's name", examples=["lab logger"])]


@router.get("/mappings", summary="List column mappings")
def list_mappings(session: ReadSession) -> list[schemas.Mapping]:
    """All remembered mappings, by name."""
    return [schemas.Mapping.model_validate(row) for row in store.list_mappings(session)]


@router.get("/mappings/{name}", summary="Get a column mapping")
def get_mapping(session: ReadSession, name: Name) -> schemas.Mapping:
    """One remembered mapping."""
    return schemas.Mapping.model_validate(store.get_mapping(session, name))


@router.put("/mappings/{name}", summary="Remember a column mapping")
def put_mapping(
    session: WriteSession, name: Name, mapping: Annotated[dict[str, Any], Body(examples=[schemas.MAPPING])]
) -> schemas.Mapping:
    """Say which column of a table is what, in which unit and with which sign; replaces one of the same name."""
    return schemas.Mapping.model_validate(store.put_mapping(session, name, mapping))


@router.delete("/mappings/{name}", summary="Forget a column mapping", status_code=204)
def delete_mapping(session: WriteSession, name: Name) -> None:
    """Runs that were read with it stay as they are."""
    store.delete_mapping(session, name)
