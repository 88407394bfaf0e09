from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

import srvs_cell.config
import srvs_cell.service.daemon
from srvs_cell.cli.main import run
from srvs_cell.config import ServiceConfig

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ServiceConfig]]:
    """What the daemon would have been started with."""
    calls: list[tuple[Any, ServiceConfig]] = []
    config = SimpleNamespace(service=ServiceConfig())
    monkeypatch.setattr(srvs_cell.config, "load_config", lambda _: config)
    monkeypatch.setattr(srvs_cell.service.daemon, "run_daemon", lambda *arguments: calls.append(arguments))
    return calls


def test_the_config_decides(served: list[tuple[Any, ServiceConfig]]) -> None:
    assert run(["run", "--config", "cell.yaml"]) == 0
    assert [service for _, service in served] == [ServiceConfig()]


def test_options_stand_in_for_the_configs_service(served: list[tuple[Any, ServiceConfig]], tmp_path: Path) -> None:
    socket, state = tmp_path / "api.sock", tmp_path / "state"
    options = ["--socket", str(socket), "--state-dir", str(state), "--tcp-port", "0"]
    assert run(["run", "--config", "cell.yaml", *options]) == 0
    ((_, service),) = served
    assert (service.socket, service.state_dir, service.tcp_port) == (socket, state, 0)


@pytest.mark.parametrize("arguments", [["run"], ["run", "--config", "x", "--tcp-port", "70000"]])
def test_misuse_is_two(served: list[tuple[Any, ServiceConfig]], arguments: list[str]) -> None:
    assert run(arguments) == 2
    assert served == []


def test_missing_config_is_two_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["run", "--config", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml" in capsys.readouterr().err
