from __future__ import annotations

import os
import socket
import stat
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.service.listeners import lock, tcp_listener, unix_listener

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def folder() -> Iterator[Path]:
    """A short path: the name of a unix socket has 107 bytes at most."""
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_socket_is_for_owner_and_group_and_so_is_its_directory(folder: Path) -> None:
    path = folder / "run" / "api.sock"
    with unix_listener(path):
        assert mode_of(path) == 0o660
        assert mode_of(path.parent) == 0o750
    assert not path.exists()


def test_socket_is_never_open_to_others_not_even_while_it_is_bound(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "api.sock"
    seen: list[int] = []
    bind, chmod = socket.socket.bind, os.chmod

    def watched_bind(self: socket.socket, address: str) -> None:
        bind(self, address)
        seen.append(mode_of(Path(address)))

    monkeypatch.setattr(socket.socket, "bind", watched_bind)
    monkeypatch.setattr(os, "chmod", lambda *_, **__: pytest.fail("the mode must be right without a chmod"))
    previous = os.umask(0)
    try:
        with unix_listener(path):
            pass
        assert os.umask(0) == 0, "the process's umask is restored"
    finally:
        os.umask(previous)
        monkeypatch.setattr(os, "chmod", chmod)
    assert seen == [0o660]


def test_stale_socket_of_a_killed_daemon_is_replaced(folder: Path) -> None:
    path = folder / "api.sock"
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(path))
    assert path.is_socket()
    with unix_listener(path) as listener, socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))
        listener.accept()[0].close()


def test_second_daemon_is_refused_and_the_first_keeps_its_socket(folder: Path) -> None:
    path = folder / "api.sock"
    with unix_listener(path):
        with pytest.raises(AlarmError, match="in use") as refusal, unix_listener(path):
            pass
        assert refusal.value.alarm is Alarm.ALREADY_RUNNING
        assert path.is_socket()
    with unix_listener(path):
        assert path.is_socket()


def test_somebody_elses_file_is_not_removed(folder: Path) -> None:
    path = folder / "notes.txt"
    path.write_text("mine")
    with pytest.raises(AlarmError, match="not a socket") as refusal, unix_listener(path):
        pass
    assert refusal.value.alarm is Alarm.CONFIG_INVALID
    assert path.read_text() == "mine"


def test_directory_that_everybody_may_write_to_is_refused(folder: Path) -> None:
    folder.chmod(0o777)
    with pytest.raises(AlarmError, match="everybody may write") as refusal, unix_listener(folder / "api.sock"):
        pass
    assert refusal.value.alarm is Alarm.CONFIG_INVALID


def test_too_long_a_path_names_the_path(folder: Path) -> None:
    path = folder / ("x" * 120)
    with pytest.raises(AlarmError, match="too long") as refusal, unix_listener(path):
        pass
    assert refusal.value.alarm is Alarm.CONFIG_INVALID


def test_lock_is_free_again_afterwards(folder: Path) -> None:
    with (
        lock(folder / "lock", "The state"),
        pytest.raises(AlarmError, match="The state is in use"),
        lock(folder / "lock", "The state"),
    ):
        pass
    with lock(folder / "lock", "The state"):
        pass


def test_taken_port_names_the_port() -> None:
    with tcp_listener("127.0.0.1", 0) as first:
        port = first.getsockname()[1]
        with pytest.raises(AlarmError, match=f"{port}: another program") as refusal:
            tcp_listener("127.0.0.1", port)
    assert refusal.value.alarm is Alarm.CONFIG_INVALID
