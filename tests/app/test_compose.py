"""docker-compose.yml and the image, as far as they can be checked without Docker: commands and variables are real."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from app import cli
from app.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
DOCKERFILE = (ROOT / "app" / "Dockerfile").read_text()


@pytest.fixture(scope="module")
def services() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]
    return found


def test_the_parts_are_there_and_say_how_they_are(services: dict[str, Any]) -> None:
    assert set(services) == {"web", "scheduler", "worker", "database"}
    assert all("healthcheck" in services[name] for name in ("web", "scheduler", "database"))
    assert services["web"]["build"]["dockerfile"] == "app/Dockerfile"
    assert len({services[name]["image"] for name in ("web", "scheduler", "worker")}) == 1


def test_only_the_web_is_reached_from_outside(services: dict[str, Any]) -> None:
    assert [name for name, service in services.items() if "ports" in service] == ["web"]
    assert all("outside" not in services[name]["networks"] for name in ("scheduler", "worker", "database"))


def test_web_and_worker_share_the_data(services: dict[str, Any]) -> None:
    assert services["web"]["volumes"] == services["worker"]["volumes"] == ["data:/data"]


def test_the_web_command_and_its_variables_are_ours(services: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    web = services["web"]
    options = cli.parser().parse_args(web["command"][1:])
    assert (options.host, options.data) == ("0.0.0.0", Path("/data"))
    for name, value in web["environment"].items():
        monkeypatch.setenv(name, re.sub(r"\$\{(\w+):\?[^}]*\}", r"secret-\1", value))
    settings = Settings.from_env(host=options.host, data=options.data)
    assert settings.token == "secret-DRIFTSCOPE_TOKEN"
    assert settings.scheduler == "tcp://scheduler:8786"
    assert settings.url == "postgresql+psycopg://driftscope:secret-POSTGRES_PASSWORD@database/driftscope"


def test_secrets_have_no_default(services: dict[str, Any]) -> None:
    for value in (*services["web"]["environment"].values(), *services["database"]["environment"].values()):
        assert "PASSWORD" not in value.upper() or ":?" in value


@pytest.mark.parametrize("name", ["scheduler", "worker"])
def test_dask_knows_the_options(services: dict[str, Any], name: str) -> None:
    program, verb, *rest = services[name]["command"]
    assert program == "dask"
    done = subprocess.run([sys.executable, "-m", program, verb, "--help"], capture_output=True, text=True, timeout=60)
    for option in (part for part in rest if part.startswith("--")):
        assert option in done.stdout


def test_dask_variables_are_known_settings(services: dict[str, Any]) -> None:
    import dask
    import distributed  # noqa: F401  (registers its settings)

    for service in services.values():
        for name in service.get("environment", {}):
            if name.startswith("DASK_"):
                path = name.removeprefix("DASK_").lower().replace("__", ".").replace("_", "-")
                assert dask.config.get(path, default="unknown") != "unknown", name


def test_the_image_copies_what_exists_and_runs_as_nobody_special() -> None:
    assert re.search(r"^USER (?!root)", DOCKERFILE, re.M)
    last_stage = DOCKERFILE.rsplit("FROM ", 1)[1]
    assert "npm" not in last_stage
    for line in re.findall(r"^COPY (?!--from)(.+) \S+$", DOCKERFILE, re.M):
        assert all((ROOT / source).exists() for source in line.split())
