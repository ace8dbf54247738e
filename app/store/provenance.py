"""What a result says of its making, beside its run's hash: the code and the configuration."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any


@cache
def code_version() -> str:
    """The package's version and a hash of the sources of `core`: exact in a checkout with changes too."""
    import core

    root = Path(core.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    try:
        package = version("driftscope")
    except PackageNotFoundError:
        package = "0"
    return f"{package}+core.{digest.hexdigest()[:12]}"


def config_hash(config: Mapping[str, Any]) -> str:
    """The hash of a configuration, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(config, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
