"""What keeps the arm from working over RMI: takes the session, reads, gives it back.

FRC_Initialize is not sent, so that RMI_MOVE is not started; only what works without it is asked for (B-84184EN/03
section 2.3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from drivers.fanuc.diagnosis import Conditions, judge, not_connected
from drivers.fanuc.rmi import judgement, messages
from drivers.fanuc.rmi.errors import NOT_RUNNING, UNKNOWN_COMMAND
from drivers.fanuc.rmi.session import RESET_WITHOUT_INITIALIZE, RefusedError, RmiSession
from srvs_cell.alarms import Alarm
from srvs_cell.ports import Finding, NotReadyError, PortError, RobotStatus

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.fanuc.rmi.config import FanucRmiConfig
    from drivers.fanuc.rmi.messages import Status
    from srvs_cell.ports import Clock

_KNOWN_VERSIONS: Final = range(1, 10)
_ASCII_SWITCH: Final = "$RMI_CFG.$ASBN_ENB"
_ASCII_OFF: Final = f"Set {_ASCII_SWITCH} to FALSE (MENU, SYSTEM, Variables) and restart the controller."
_ENDED_BY_DAEMON: Final = "The daemon aborts it when it connects; so does ABORT on the pendant."


async def diagnose_rmi(config: FanucRmiConfig, clock: Clock) -> list[Finding]:
    """Look at session, version, format, robot and frames; each only where what comes before it is all right."""
    session = RmiSession(config.host, config.port, config.timeout_s, clock)
    try:
        await session.open()
    except PortError as error:
        return [not_connected(error)]
    findings = [Finding.fine("connection", f"{session.address}, RMI, the session was free")]
    try:
        findings.append(_version(session.major_version, session.minor_version))
        findings.append(await _format(session))
        status = messages.read_status(await session.command("FRC_GetStatus"))
        place = messages.read_place(await session.command("FRC_ReadCartesianPosition"))
        fault = None if status.servo_ready and not status.paused else await _alarm(session)
        robot = RobotStatus(
            pose=place.pose,
            mode=judgement.mode(status),
            pendant_enabled=status.pendant_enabled,
            servo_on=status.servo_ready,
            moving=False,
            override_percent=status.override_percent,
            fault=fault,
            user_frame=place.configuration.user_frame,
            user_tool=place.configuration.user_tool,
            session_owner=None,
            read_at_s=clock.now_s(),
        )
        selects = config.user_frame, config.user_tool
        findings += judge(robot, Conditions(single_step=status.single_step, mode_known=False, selects=selects))
        findings.append(_program(status))
    except PortError as error:
        findings.append(Finding.failed("reading", error))
    finally:
        await session.close()
    return findings


async def peek_inputs_rmi(config: FanucRmiConfig, clock: Clock, numbers: Sequence[int]) -> tuple[bool, ...]:
    """Read DI[number] of each in a session of its own; raises `NotReadyError` where that needs RMI_MOVE to run."""
    session = RmiSession(config.host, config.port, config.timeout_s, clock)
    await session.open()
    try:
        replies = [await session.command("FRC_ReadDIN", PortNumber=number) for number in numbers]
    except RefusedError as error:
        if error.error_id not in NOT_RUNNING:
            raise
        detail = "This controller reads inputs only while RMI_MOVE runs, which a diagnosis does not start."
        raise NotReadyError(Alarm.ROBOT_NOT_READY, detail) from error
    finally:
        await session.close()
    return tuple(messages.whole(reply, "PortValue", 0, 1) == 1 for reply in replies)


def _version(major: int, minor: int) -> Finding:
    text = f"RMI {major}.{minor}"
    if major not in _KNOWN_VERSIONS:
        detail = f"{text} is newer than the versions that this driver knows, 1 to {_KNOWN_VERSIONS[-1]}."
        remedy = "Try every step of docs/how-to/connect-fanuc-rmi.md at 10 % override first."
        return Finding.doubtful("version", Alarm.PROTOCOL_VERSION, detail, remedy)
    if major < RESET_WITHOUT_INITIALIZE:
        detail = f"{text} resets faults only while RMI runs."
        return Finding.doubtful("version", Alarm.PROTOCOL_VERSION, detail, "Reset faults on the pendant.")
    return Finding.fine("version", text)


async def _format(session: RmiSession) -> Finding:
    """Read whether the controller takes ASCII packets, with a command that FANUC's own driver has, not the manual."""
    try:
        reply = await session.command("FRC_ReadVariable", VariableName=_ASCII_SWITCH)
    except RefusedError as error:
        if error.error_id not in UNKNOWN_COMMAND:
            raise
        detail = f"{_ASCII_SWITCH} cannot be read over this version; TRUE would make it refuse JSON (RMIT-049)."
        remedy = "Look on the pendant (MENU, SYSTEM, Variables): it must be FALSE."
        return Finding.doubtful("packet format", Alarm.ROBOT_NOT_READY, detail, remedy)
    if reply.fields.get("VariableValue") == 0:
        return Finding.fine("packet format", "JSON")
    error_text = f"{_ASCII_SWITCH} is TRUE: the controller takes ASCII packets and refuses JSON (RMIT-049)."
    return Finding.failed("packet format", NotReadyError(Alarm.ROBOT_NOT_READY, error_text), _ASCII_OFF)


async def _alarm(session: RmiSession) -> str | None:
    return messages.read_errors(await session.command("FRC_ReadError"))


def _program(status: Status) -> Finding:
    if not status.rmi_running:
        return Finding.fine("program RMI_MOVE", "not running")
    state = "paused" if status.paused else "running"
    detail = f"An earlier client has left it {state}."
    return Finding.doubtful("program RMI_MOVE", Alarm.ROBOT_BUSY, detail, _ENDED_BY_DAEMON)
