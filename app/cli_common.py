"""What every command needs: exit status, the run that RUN names, JSON out, progress."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from app.store.offline import Store
    from core.run import Run

T = TypeVar("T")
OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
RUN_HELP = "a run folder, a .zip of one, any other file that can be imported, or the id of a stored run"


def run_of(source: str, data: Path | None) -> Run:
    """The run that RUN names: what lies there, else what is stored under that id."""
    if Path(source).exists():
        from core.formats import read_run

        return read_run(Path(source))
    return _stored(source, data, lambda store: store.load(source))


def simulated_beside(source: str, data: Path | None) -> Run | None:
    """The simulated run in `sim/` beside the run that RUN names, None without."""
    if Path(source).exists():
        from core.formats import read_simulated

        return read_simulated(Path(source))
    return _stored(source, data, lambda store: store.load_simulated(source))


def _stored(source: str, data: Path | None, load: Callable[[Store], T]) -> T:
    from app.errors import NotFoundError
    from app.settings import Settings
    from app.store.offline import Store
    from core.errors import FormatError

    settings = Settings.from_env(data=data)
    try:
        with Store(settings, create=False) as store:
            return load(store)
    except (NotFoundError, FileNotFoundError):
        raise FormatError(
            f"{source}: no such file or folder, and no stored run of that id in {settings.data}", file=source
        ) from None


def write_json(target: str, value: object) -> None:
    import json

    text = json.dumps(value, indent=2, allow_nan=False) + "\n"
    if target == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
    else:
        Path(target).write_text(text, encoding="utf-8")


def progress_on_terminal(what: str) -> Any:
    """Progress on standard error, on a terminal only."""
    if not sys.stderr.isatty():
        return lambda fraction, message: None

    def show(fraction: float, message: str) -> None:
        end = "\n" if fraction >= 1 else ""
        sys.stderr.write(f"\r\x1b[K{what}: {message} {fraction:.0%}{end}")
        sys.stderr.flush()

    return show
