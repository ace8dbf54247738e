"""Where the parts that aren't Python live: beside the code in a checkout, inside the package once installed."""

from __future__ import annotations

from pathlib import Path

APP = Path(__file__).resolve().parent


def _part(name: str) -> Path:
    packaged = APP / f"_{name}"
    return packaged if packaged.is_dir() else APP.parent / name


STATIC = _part("static")
MIGRATIONS = _part("migrations")
EXAMPLES = APP / "examples"
TEMPLATES = APP / "templates"
