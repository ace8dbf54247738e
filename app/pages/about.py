"""`/about`: versions, licences, the data folder and the database."""

from __future__ import annotations

import platform
import re
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import ClassVar

from fastapi import APIRouter, Request, Response

from app.pages.base import Page, render, route, version
from app.paths import STATIC

router = APIRouter()

DATABASES = {"sqlite": "SQLite", "postgresql": "PostgreSQL"}


@dataclass(frozen=True)
class Package:
    """An installed package that Driftscope stands on."""

    name: str
    version: str
    licence: str
    summary: str


@dataclass(frozen=True)
class AboutPage(Page):
    template: ClassVar[str] = "about.html"
    place: ClassVar[str] = "about"
    version: str
    python: str
    system: str
    database: str
    data: str
    data_bytes: int
    data_files: int
    packages: tuple[Package, ...]


def _field(meta: metadata.PackageMetadata, name: str) -> str:
    """The first value of a metadata field, or nothing."""
    values: list[str] = meta.get_all(name) or []
    return values[0] if values else ""


def _licence(meta: metadata.PackageMetadata) -> str:
    """The licence's short name: the SPDX expression, else the classifiers, else the field's first line."""
    if expression := _field(meta, "License-Expression"):
        return expression
    classifiers = [c.split(" :: ")[-1] for c in meta.get_all("Classifier") or [] if c.startswith("License ::")]
    lines = _field(meta, "License").strip().splitlines()
    return ", ".join(classifiers) or (lines[0][:60] if lines else "see the package")


def chart_version() -> str:
    """The version in the head of the chart library that the pages load."""
    script = STATIC / "vendor" / "uPlot.esm.js"
    head = script.read_text(encoding="utf-8")[:600] if script.is_file() else ""
    found = re.search(r"\(v([\d.]+)\)", head)
    return found.group(1) if found else "not built"


@cache
def packages() -> tuple[Package, ...]:
    """The packages that Driftscope asks for, by name, and the chart library that it ships."""
    found = [Package("uPlot", chart_version(), "MIT", "Charts in the pages (a script of this server).")]
    for line in metadata.requires("driftscope") or []:
        if "extra ==" in line:
            continue
        meta = metadata.metadata(re.split(r"[^\w.-]", line, maxsplit=1)[0])
        found.append(Package(meta["Name"], meta["Version"], _licence(meta), _field(meta, "Summary")))
    return tuple(sorted(found, key=lambda p: p.name.lower()))


def folder_size(folder: Path) -> tuple[int, int]:
    """Bytes and files below a folder; what vanishes meanwhile does not count."""
    total = count = 0
    for path in folder.rglob("*"):
        try:
            if path.is_file():
                total, count = total + path.stat().st_size, count + 1
        except FileNotFoundError:
            continue
    return total, count


@route(router, "/about")
def about(request: Request) -> Response:
    settings = request.app.state.settings
    size, files = folder_size(settings.data)
    kind = request.app.state.engine.dialect.name
    database = DATABASES.get(kind, kind)
    page = AboutPage(
        title="About",
        sentence=f"Driftscope {version()} on Python {platform.python_version()}, keeping its runs in {database}.",
        version=version(),
        python=platform.python_version(),
        system=f"{platform.system()} {platform.machine()}",
        database=database,
        data=str(settings.data),
        data_bytes=size,
        data_files=files,
        packages=packages(),
    )
    return render(request, page)
