from __future__ import annotations

import getpass
import json
from typing import TYPE_CHECKING

import httpx2
import pytest

from srvs_cell import __version__
from srvs_cell.cell import Command, State

if TYPE_CHECKING:
    from tests.service.conftest import Served


async def test_status_is_the_units_snapshot_and_where_the_page_is(served: Served) -> None:
    for client in (served.commands, served.reads):
        answer = await client.get("/api/v1/status")
        service = {"version": __version__, "page": f"http://127.0.0.1:{served.port}/"}
        assert answer.json() == {**served.unit.snapshot(), "service": service}


async def test_command_over_the_socket_is_carried_out_in_the_callers_name(served: Served) -> None:
    answer = await served.commands.post("/api/v1/command/clear")
    assert (answer.status_code, answer.json()["accepted"], answer.json()["state"]) == (200, True, "Stopped")
    assert served.unit.sources == [f"unix:{getpass.getuser()}"]


async def test_refused_command_names_the_commands_that_lead_there(served: Served) -> None:
    answer = await served.commands.post("/api/v1/command/start")
    body = answer.json()
    assert answer.status_code == 409
    assert body["accepted"] is False
    assert body["leads_there"] == ["clear", "reset", "start"]
    assert body["alarm"]["code"] == 5001
    assert served.unit.state is State.ABORTED


async def test_unknown_command_is_answered_with_the_known_ones(served: Served) -> None:
    answer = await served.commands.post("/api/v1/command/explode")
    assert answer.status_code == 404
    assert "unhold" in answer.json()["reason"]


@pytest.mark.parametrize(
    ("path", "body"), [("command/clear", None), ("mode", {"mode": "manual"}), ("resolve", {"gripper": "empty"})]
)
async def test_tcp_refuses_every_command(served: Served, path: str, body: dict[str, str] | None) -> None:
    headers = {"srvs_cell.may_command": "1", "X-Forwarded-For": "unix", "Forwarded": "for=unix"}
    answer = await served.reads.post(f"/api/v1/{path}", json=body, headers=headers)
    assert answer.status_code == 403
    assert answer.json()["alarm"]["name"] == "NOT_AUTHORISED"
    assert (served.unit.sources, served.unit.state) == ([], State.ABORTED)


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
async def test_tcp_refuses_another_sites_host(served: Served, host: str) -> None:
    answer = await served.reads.get("/api/v1/status", headers={"Host": host})
    assert answer.status_code == 421
    assert "state" not in answer.json()


async def test_tcp_takes_the_loopbacks_names(served: Served) -> None:
    for host in (f"localhost:{served.port}", "127.0.0.1", f"[::1]:{served.port}"):
        assert (await served.reads.get("/api/v1/status", headers={"Host": host})).status_code == 200


async def test_mode_is_changed_and_a_wrong_one_is_named(served: Served) -> None:
    assert (await served.commands.post("/api/v1/mode", json={"mode": "dry-run"})).json()["accepted"]
    assert served.unit.mode.title == "Dry run"
    wrong = await served.commands.post("/api/v1/mode", json={"mode": "turbo"})
    assert wrong.status_code == 422
    assert "Maintenance" in wrong.json()["reason"]


async def test_resolve_takes_only_what_a_gripper_can_hold(served: Served) -> None:
    assert (await served.commands.post("/api/v1/resolve", json={"gripper": "holding"})).json()["accepted"]
    assert served.unit.gripper == "holding"
    for wrong in ({"gripper": "perhaps"}, {}, {"gripper": "empty", "force": True}):
        answer = await served.commands.post("/api/v1/resolve", json=wrong)
        assert (answer.status_code, answer.json()["accepted"]) == (422, False)
    assert served.unit.gripper == "holding"


async def test_events_deliver_the_state_now_and_each_change(served: Served) -> None:
    async with served.reads.sse("/api/v1/events") as stream:
        states = []
        async for event in stream:
            if event.event != "status":
                continue
            states.append(json.loads(event.data)["state"])
            if len(states) == 1:
                await served.commands.post("/api/v1/command/clear")
            else:
                break
    assert states == ["Aborted", "Stopped"]


async def test_events_give_a_sign_of_life_while_nothing_changes(served: Served) -> None:
    async with served.reads.sse("/api/v1/events") as stream:
        names = []
        async for event in stream:
            names.append(event.event)
            if len(names) == 3:
                break
    assert names == ["status", "heartbeat", "heartbeat"]


async def test_alarms_come_with_cause_and_remedy(served: Served) -> None:
    known, forgotten = (await served.reads.get("/api/v1/alarms")).json()["alarms"]
    assert known["detail"] == "at place 3"
    assert "sensor" in known["remedy"]
    assert forgotten["name"] == "OF_AN_OLD_RELEASE"


@pytest.mark.parametrize(("limit", "status"), [(1, 200), (0, 422), (10_001, 422), ("many", 422)])
async def test_limits_are_bounded(served: Served, limit: int | str, status: int) -> None:
    answer = await served.reads.get("/api/v1/history", params={"limit": limit})
    assert answer.status_code == status


async def test_files_of_a_run_are_served_and_nothing_else(served: Served) -> None:
    folder = served.runs / "7" / "look-1"
    folder.mkdir(parents=True)
    (folder / "left.png").write_bytes(b"picture")
    (served.runs.parent / "secret.txt").write_text("no")
    good = await served.reads.get("/api/v1/runs/7/files/look-1/left.png")
    assert (good.status_code, good.content, good.headers["content-type"]) == (200, b"picture", "image/png")
    for bad in ("7/files/../../secret.txt", "7/files/%2e%2e/%2e%2e/secret.txt", "../files/secret.txt",
                "%2e%2e/files/secret.txt", "7/files/look-1", "8/files/left.png", "7/files//etc/hostname"):  # fmt: skip
        answer = await served.reads.send(httpx2.Request("GET", f"http://127.0.0.1:{served.port}/api/v1/runs/{bad}"))
        assert answer.status_code == 404, bad


async def test_metrics_tell_state_and_commands(served: Served) -> None:
    await served.commands.post("/api/v1/command/start")
    text = (await served.reads.get("/metrics")).text
    assert 'srvs_cell_state{state="Aborted"} 1.0' in text
    assert 'srvs_cell_state{state="Execute"} 0.0' in text
    assert 'srvs_cell_commands_total{answer="refused",command="start"} 1.0' in text
    assert "process_resident_memory_bytes" in text


async def test_page_needs_nothing_from_elsewhere_and_forbids_it(served: Served) -> None:
    answer = await served.reads.get("/")
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert "unsafe" not in answer.headers["content-security-policy"]
    assert "http://" not in answer.text
    assert "https://" not in answer.text
    assert "SIMULATION" in answer.text
    for name, kind in (("page.js", "text/javascript"), ("page.css", "text/css")):
        part = await served.reads.get(f"/page/{name}")
        assert (part.status_code, part.headers["content-type"].split(";")[0]) == (200, kind)


async def test_page_shows_alarms_workpieces_plan_and_the_last_looks_pictures(served: Served) -> None:
    text = (await served.reads.get("/page/cell")).text
    for shown in ("Aborted", "GRIP_EMPTY", "Check the part", "400.0", "travel 812 mm", "clear",
                  "/api/v1/runs/000007/files/overlay_2.png", "/api/v1/runs/000007/files/left_2.png"):  # fmt: skip
        assert shown in text, shown
    assert "left_1.png" not in text, "pictures of an earlier look"
    assert "cuboid &lt;b&gt;" in text, "what comes from outside is escaped"
    assert text.count('class="done"') == 1
    assert "clear, then reset, then start" in text
    assert "Unfinished" not in text, "a job that is under way"
    await served.unit.command(Command.CLEAR, "test")
    await served.unit.command(Command.RESET, "test")
    assert "then start" not in (await served.reads.get("/page/cell")).text
    assert (await served.reads.get("/favicon.ico")).status_code == 204
