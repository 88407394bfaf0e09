"""The API: one app for the command line, the operator page and the plant's tools.

Reads are open to both listeners; the three commanding routes ask the ASGI scope whether this connection may command.
FastAPI reads annotations while the app runs, hence no postponed evaluation in this file.
"""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Annotated, Any

from fastapi import Depends, FastAPI, HTTPException, Query, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse, Response
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from srvs_cell import __version__
from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell import Command, CommandAnswer, Mode
from srvs_cell.service.listeners import MAY_COMMAND
from srvs_cell.service.metrics import Metrics
from srvs_cell.service.models import (
    ModeRequest,
    ResolveRequest,
    ServedJournal,
    ServedUnit,
    alarm_body,
    answer_body,
)
from srvs_cell.service.page import add_page

PREFIX = "/api/v1"
_MAX_RECORDS = 10_000
_LEAST_INTERVAL_S = 0.1  # between two events: a fast cell must not drown its page
_FORBIDDEN, _NOT_FOUND, _CONFLICT, _UNPROCESSABLE, _INTERNAL = 403, 404, 409, 422, 500
_SECURITY_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}

Limit = Annotated[int, Query(ge=1, le=_MAX_RECORDS)]


def create_app(
    unit: ServedUnit,
    journal: ServedJournal,
    runs_dir: Path,
    *,
    closing: asyncio.Event,
    page_url: str | None = None,
    heartbeat_s: float = 2.0,
) -> FastAPI:
    """Return the app.

    Args:
        unit: the cell.
        journal: what happened.
        runs_dir: one folder a run, whose files the API serves.
        page_url: where the operator page is, for the status; None where nothing listens on TCP.
        closing: set when the daemon stops, so that event streams end.
        heartbeat_s: an event stream says at least this often that it is alive.
    """
    app = FastAPI(title="srvs-cell", version=__version__, docs_url=None, redoc_url=None)
    metrics = Metrics(unit.snapshot)

    def current() -> dict[str, Any]:
        return {**unit.snapshot(), "service": {"version": __version__, "page": page_url}}

    app.add_middleware(_SecurityHeaders)
    _add_error_answers(app)
    _add_commands(app, unit, metrics)
    add_page(app, unit.snapshot)

    @app.get(PREFIX + "/status")
    async def status() -> dict[str, Any]:
        return current()

    @app.get(PREFIX + "/alarms")
    async def alarms(limit: Limit = 100) -> dict[str, Any]:
        return {"alarms": [_with_remedy(row) for row in await journal.alarms(limit)]}

    @app.get(PREFIX + "/history")
    async def history(limit: Limit = 100) -> dict[str, Any]:
        return {"history": await journal.history(limit)}

    @app.get(PREFIX + "/events")
    async def events() -> EventSourceResponse:
        return EventSourceResponse(_changes(unit, current, closing, heartbeat_s), ping=0)

    @app.get(PREFIX + "/runs/{run}/files/{name:path}")
    def run_file(run: str, name: str) -> FileResponse:
        root = (runs_dir / run).resolve()
        path = (root / name).resolve()
        if root.parent != runs_dir.resolve() or not path.is_relative_to(root) or not path.is_file():
            raise HTTPException(_NOT_FOUND, f"Run {run!r} has no file {name!r}.")
        return FileResponse(path, headers={"Cache-Control": "private, max-age=3600"})

    @app.get("/metrics")
    async def show_metrics() -> Response:
        return Response(generate_latest(metrics.registry), media_type=CONTENT_TYPE_LATEST)

    return app


def _source(request: Request) -> str:
    """Return who commands; raises `AlarmError` NOT_AUTHORISED where the connection may only read."""
    if request.scope.get(MAY_COMMAND) is not True:
        raise AlarmError(Alarm.NOT_AUTHORISED, f"{request.method} {request.url.path} came over a reading connection.")
    return f"unix:{request.client.host}" if request.client else "unix"


Source = Annotated[str, Depends(_source)]


def _add_commands(app: FastAPI, unit: ServedUnit, metrics: Metrics) -> None:
    def answer(name: str, reply: CommandAnswer) -> JSONResponse:
        metrics.count_command(name, accepted=reply.accepted)
        return JSONResponse(answer_body(reply), status_code=200 if reply.accepted else _CONFLICT)

    @app.post(PREFIX + "/command/{name}")
    async def command(name: str, by: Source) -> JSONResponse:
        known = {candidate.title: candidate for candidate in Command}
        if name not in known:
            raise HTTPException(_NOT_FOUND, f"No command is called {name!r}; commands: {', '.join(known)}.")
        return answer(name, await unit.command(known[name], by))

    @app.post(PREFIX + "/mode")
    async def mode(body: ModeRequest, by: Source) -> JSONResponse:
        try:
            wanted = Mode.parse(body.mode)
        except ValueError as error:
            raise HTTPException(_UNPROCESSABLE, f"{error}.") from error
        return answer("mode", await unit.set_mode(wanted, by))

    @app.post(PREFIX + "/resolve")
    async def resolve(body: ResolveRequest, by: Source) -> JSONResponse:
        return answer("resolve", await unit.resolve_gripper(body.gripper, by))

    @app.post(PREFIX + "/forget")
    async def forget(by: Source) -> JSONResponse:
        return answer("forget", await unit.forget_job(by))


def _add_error_answers(app: FastAPI) -> None:
    """Every refusal has one shape: ``reason``, and ``alarm`` where the registry has one."""

    @app.exception_handler(AlarmError)
    async def _alarm(_: Request, error: AlarmError) -> JSONResponse:
        status = _FORBIDDEN if error.alarm is Alarm.NOT_AUTHORISED else _INTERNAL
        body = {"accepted": False, "reason": error.detail, "alarm": alarm_body(error.alarm, error.detail)}
        return JSONResponse(body, status_code=status)

    @app.exception_handler(HTTPException)
    async def _http(_: Request, error: HTTPException) -> JSONResponse:
        return JSONResponse({"accepted": False, "reason": error.detail, "alarm": None}, status_code=error.status_code)

    @app.exception_handler(RequestValidationError)
    async def _invalid(_: Request, error: RequestValidationError) -> JSONResponse:
        reason = "; ".join(f"{'.'.join(map(str, detail['loc']))}: {detail['msg']}" for detail in error.errors())
        return JSONResponse({"accepted": False, "reason": reason, "alarm": None}, status_code=_UNPROCESSABLE)


class _SecurityHeaders:
    """Adds the security headers to every answer; a plain ASGI layer, so that event streams pass unbuffered."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_with_headers)


def _with_remedy(row: dict[str, Any]) -> dict[str, Any]:
    """Return a journalled alarm with severity, cause and remedy, where this release still has it in the registry."""
    try:
        return row | alarm_body(Alarm.from_code(row["code"]), row["detail"])
    except KeyError:
        return row


async def _changes(
    unit: ServedUnit, current: Callable[[], dict[str, Any]], closing: asyncio.Event, heartbeat_s: float
) -> AsyncIterator[ServerSentEvent]:
    """Yield a ``status`` event at once and after each change, a ``heartbeat`` where nothing changes."""
    while not closing.is_set():
        status = current()
        version = status["version"]
        yield ServerSentEvent(json.dumps(status), event="status", id=str(version))
        await asyncio.sleep(_LEAST_INTERVAL_S)
        while not await _changed(unit, version, closing, heartbeat_s):
            yield ServerSentEvent("{}", event="heartbeat")


async def _changed(unit: ServedUnit, version: int, closing: asyncio.Event, timeout_s: float) -> bool:
    """Wait for a change or the end of the service; False where the time ran out before."""
    waits = {asyncio.ensure_future(unit.wait_change(version)), asyncio.ensure_future(closing.wait())}
    try:
        done, _ = await asyncio.wait(waits, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for wait in waits:
            wait.cancel()
    return bool(done)
