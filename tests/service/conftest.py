from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING

import httpx2
import pytest

from srvs_cell.service.api import create_app
from srvs_cell.service.listeners import serving, tcp_listener, unix_listener
from tests.service.fakes import FakeJournal, FakeUnit

if TYPE_CHECKING:
    from collections.abc import AsyncIterator
    from pathlib import Path


@dataclass
class Served:
    unit: FakeUnit
    socket: Path
    port: int
    runs: Path
    commands: httpx2.AsyncClient
    reads: httpx2.AsyncClient


@pytest.fixture
async def served(tmp_path: Path) -> AsyncIterator[Served]:
    """The API over a real unix socket and a real loopback port."""
    unit, closing = FakeUnit(), asyncio.Event()
    path, runs = tmp_path / "run" / "api.sock", tmp_path / "runs"
    tcp = tcp_listener("127.0.0.1", 0)
    port = tcp.getsockname()[1]
    page = f"http://127.0.0.1:{port}/"
    app = create_app(unit, FakeJournal(), runs, closing=closing, page_url=page, heartbeat_s=0.05)
    uds = httpx2.AsyncHTTPTransport(uds=str(path))
    with unix_listener(path) as unix:
        async with (
            serving(app, unix, tcp),
            httpx2.AsyncClient(transport=uds, base_url="http://cell") as commands,
            httpx2.AsyncClient(base_url=f"http://127.0.0.1:{port}", trust_env=False) as reads,
        ):
            yield Served(unit, path, port, runs, commands, reads)
            closing.set()
