"""The doctor's own judgement: pictures against the calibration, drivers without a diagnosis, one that hangs."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import pytest

from srvs_cell.alarms import Alarm
from srvs_cell.calibration import Calibration
from srvs_cell.ports import Finding, FindingLevel, Lifecycle, NotConnectedError
from srvs_cell.service import doctor
from srvs_cell.service.doctor import Examined, verdict
from tests.cli.test_doctor import CALIBRATION

if TYPE_CHECKING:
    from collections.abc import Sequence


class _Plain:
    """A device whose driver has no diagnosis."""

    lifecycle = Lifecycle.DISCONNECTED
    description = "something of somebody else"

    def __init__(self, error: NotConnectedError | None = None) -> None:
        self.calls: list[str] = []
        self._error = error

    async def connect(self) -> None:
        self.calls.append("connect")
        if self._error is not None:
            raise self._error

    async def activate(self) -> None:
        self.calls.append("activate")

    async def deactivate(self) -> None:
        self.calls.append("deactivate")

    async def disconnect(self) -> None:
        self.calls.append("disconnect")


class _Hanging(_Plain):
    async def diagnose(self) -> Sequence[Finding]:
        await asyncio.Event().wait()
        return []


async def test_a_driver_without_a_diagnosis_is_connected_and_let_go() -> None:
    device = _Plain()
    assert [one.level for one in await doctor._diagnose(device)] == [FindingLevel.OK]
    assert device.calls == ["connect", "disconnect"]
    device = _Plain(NotConnectedError(Alarm.DEVICE_UNAVAILABLE, "gone."))
    (found,) = await doctor._diagnose(device)
    assert (found.level, found.alarm) == (FindingLevel.FAILED, Alarm.DEVICE_UNAVAILABLE)
    assert device.calls == ["connect", "disconnect"]


async def test_a_diagnosis_without_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "_PATIENCE_S", 0.01)
    (found,) = await doctor._diagnose(_Hanging())
    assert (found.level, found.alarm) == (FindingLevel.FAILED, Alarm.CONNECTION_TIMEOUT)
    assert "something of somebody else" in found.detail


@pytest.mark.parametrize(
    ("facts", "wrong"),
    [
        ({"width": 640, "height": 480, "user_frame": 1, "user_tool": 1}, {}),
        ({"width": 1280, "height": 720}, {"fits the camera": Alarm.IMAGE_INVALID}),
        ({"user_frame": 0, "user_tool": 1}, {"fits the robot's frames": Alarm.FRAME_CHANGED}),
        ({"user_frame": 1, "user_tool": 2}, {"fits the robot's frames": Alarm.FRAME_CHANGED}),
        ({}, {}),
    ],
)
def test_what_was_read_is_compared_with_the_calibration(facts: dict[str, int], wrong: dict[str, Alarm]) -> None:
    findings = doctor._fits(Calibration.from_mapping(CALIBRATION, "test"), facts)
    assert {one.check: one.alarm for one in findings if one.level is not FindingLevel.OK} == wrong


def test_a_calibration_that_names_no_frames_fits_all() -> None:
    nameless = {key: value for key, value in CALIBRATION.items() if key != "robot"}
    assert doctor._fits(Calibration.from_mapping(nameless, "test"), {"user_frame": 7, "user_tool": 3}) == []


def test_the_worst_finding_is_the_verdict() -> None:
    fine = Examined("arm", Finding.fine("a", "b"))
    doubtful = Examined("arm", Finding.doubtful("a", Alarm.ROBOT_NOT_READY, "b"))
    failed = Examined("arm", Finding.failed("a", NotConnectedError(Alarm.CONNECTION_LOST, "b")))
    assert verdict([]) is verdict([fine]) is FindingLevel.OK
    assert verdict([fine, doubtful]) is FindingLevel.WARNING
    assert verdict([fine, failed, doubtful]) is FindingLevel.FAILED


def test_a_remedy_of_its_own_stands_before_the_registrys() -> None:
    error = NotConnectedError(Alarm.CONNECTION_LOST, "cut.")
    assert Examined("arm", Finding.failed("a", error)).remedy == Alarm.CONNECTION_LOST.value.remedy
    own = Examined("arm", Finding.failed("a", error, "Do this."))
    assert own.remedy == own.as_json()["remedy"] == "Do this."
    assert "[1003 CONNECTION_LOST]" in own.line
    assert Examined("arm", Finding.fine("a", "b")).line == "ok       arm, a: b"


def test_an_alarm_of_a_daemon_of_another_version_is_shown_as_it_is() -> None:
    told = {"code": 9999, "name": "NEW", "detail": "d.", "cause": "c.", "remedy": "r."}
    assert doctor._alarm_of({**told, "code": 1003}).alarm is Alarm.CONNECTION_LOST
    unknown = doctor._alarm_of(told)
    assert unknown.alarm is Alarm.INTERNAL_ERROR
    assert "9999 NEW: d. c. r." in unknown.detail
