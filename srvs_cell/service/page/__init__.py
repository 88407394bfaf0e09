"""The operator page: what the cell is, sees and will do. It reads only; nothing on it gives a command.

The server renders everything (one renderer, autoescaped); the script in the browser only asks for the changed part
again when the event stream says so, and says loudly when it has not heard from the daemon.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fastapi.responses import FileResponse, HTMLResponse, Response
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from srvs_cell.cell import Command, Mode, State, leads_there

if TYPE_CHECKING:
    from collections.abc import Callable

    from fastapi import FastAPI

_FOLDER = Path(__file__).parent
_NO_CONTENT = 204
_LOOK_NUMBER = re.compile(r"_(\d+)$")


def add_page(app: FastAPI, snapshot: Callable[[], dict[str, Any]]) -> None:
    """Serve the page at ``/``, its changing part at ``/page/cell``, and its script and style beside them."""
    templates = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )

    @app.get("/", include_in_schema=False)
    async def page() -> HTMLResponse:
        return HTMLResponse(templates.get_template("page.html").render(_view(snapshot())))

    @app.get("/page/cell", include_in_schema=False)
    async def cell() -> HTMLResponse:
        return HTMLResponse(templates.get_template("cell.html").render(_view(snapshot())))

    @app.get("/page/page.js", include_in_schema=False)
    async def script() -> FileResponse:
        return FileResponse(_FOLDER / "page.js", media_type="text/javascript")

    @app.get("/favicon.ico", include_in_schema=False)
    async def icon() -> Response:
        return Response(status_code=_NO_CONTENT)  # every browser asks for one

    @app.get("/page/page.css", include_in_schema=False)
    async def style() -> FileResponse:
        return FileResponse(_FOLDER / "page.css", media_type="text/css")


def _view(snapshot: dict[str, Any]) -> dict[str, Any]:
    """Return what the templates show: the snapshot, pictures' addresses, what is done of the plan, the way to a job."""
    moves_left = snapshot["moves_total"] - snapshot["moves_done"]
    way = leads_there(State(snapshot["state_number"]), Command.START, Mode(snapshot["mode_number"]))
    return {
        "cell": snapshot,
        "pictures": _last_pictures(snapshot["artefacts"]),
        "moves_done_of_plan": len(snapshot["plan"]) - moves_left,
        # from anywhere else a start would give up the job under way
        "way_to_start": [command.title for command in way] if way[:1] in {(Command.CLEAR,), (Command.RESET,)} else [],
    }


def _last_pictures(artefacts: dict[str, str]) -> dict[str, str]:
    """Return name -> address of the images of the last look; artefacts of a look are called ``NAME_<look>``."""
    images = {name: Path(path) for name, path in artefacts.items() if path.endswith(".png")}
    last = max((_look(name) for name in images), default=0)
    return {
        name.replace("_", " "): f"/api/v1/runs/{path.parent.name}/files/{path.name}"
        for name, path in images.items()
        if _look(name) == last
    }


def _look(name: str) -> int:
    found = _LOOK_NUMBER.search(name)
    return int(found[1]) if found else 0
