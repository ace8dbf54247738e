"""One Settings, read once from the command line and DRIFTSCOPE_* variables, handed on explicitly."""

from __future__ import annotations

import ipaddress
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from core.errors import ParameterError

GIB = 1 << 30


@dataclass(frozen=True)
class Settings:
    """How this server runs. `data` holds the database, arrays and uploads; `token` guards it beyond loopback."""

    data: Path = field(default_factory=lambda: Path("data"))
    host: str = "127.0.0.1"
    port: int = 8000
    token: str | None = None
    database_url: str | None = None  # default: SQLite in `data`
    scheduler: str | None = None  # address of a Dask scheduler; default: embedded cluster
    workers: int = 2  # processes of the embedded cluster
    worker_memory_bytes: int = 6 * GIB  # a worker that grows beyond this is killed, and its job with it
    max_upload_bytes: int = 8 * GIB
    max_unpacked_bytes: int = 16 * GIB
    undo_hours: float = 24.0
    upload_hours: float = 48.0  # an upload that nobody touched for so long is dropped
    simulators: Path | None = None  # JSON file of simulators by name, see app.simulators
    demo: bool = False
    drive: bool = False  # real robots may be driven; virtual ones always may
    allowed_hosts: tuple[str, ...] = ("127.0.0.1", "localhost", "::1")  # names that a loopback server answers to

    def __post_init__(self) -> None:
        if not self.is_loopback and not self.token:
            raise ParameterError(
                f"refusing to listen on {self.host} without a token: set DRIFTSCOPE_TOKEN, or use --host 127.0.0.1",
                parameter="token",
            )

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach the server."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def url(self) -> str:
        """The database's SQLAlchemy URL."""
        return self.database_url or f"sqlite:///{self.data / 'driftscope.db'}"

    @classmethod
    def from_env(cls, **given: object) -> Settings:
        """Settings from DRIFTSCOPE_DATA, _HOST, _PORT, _TOKEN, _DATABASE_URL, _SCHEDULER, _WORKERS,
        _SIMULATORS; `given` wins.
        """
        env = os.environ
        values: dict[str, Any] = {}
        for name, convert in {
            "data": Path, "host": str, "port": int, "token": str, "database_url": str, "scheduler": str, "workers": int,
            "simulators": Path,
        }.items():  # fmt: skip
            raw = env.get(f"DRIFTSCOPE_{name.upper()}")
            if raw:
                try:
                    values[name] = convert(raw)
                except ValueError:
                    raise ParameterError(
                        f"DRIFTSCOPE_{name.upper()} is {raw!r}, expected {convert.__name__}", parameter=name
                    ) from None
        values.update({k: v for k, v in given.items() if v is not None})
        return cls(**values)
