"""FANUC arm and its digital I/O over the Remote Motion Interface (option R912, B-84184EN/03).

`FanucRmiArm` is the shell that talks and waits; `framing` and `messages` pack, `session` matches who answers what,
`errors` and `judgement` say what it means.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Any, Final, NoReturn

from drivers.fanuc.judgement import MotionBudget, arrival_error
from drivers.fanuc.rmi import judgement, messages
from drivers.fanuc.rmi.diagnosis import diagnose_rmi, peek_inputs_rmi
from drivers.fanuc.rmi.errors import NOT_RUNNING, NOTHING_RUNNING, UNKNOWN_COMMAND
from drivers.fanuc.rmi.messages import Path
from drivers.fanuc.rmi.session import RESET_WITHOUT_INITIALIZE, RefusedError, RmiSession
from drivers.fanuc.standstill import standstill
from srvs_cell.alarms import Alarm
from srvs_cell.ports import (
    CommandRejectedError,
    DeviceFaultError,
    Lifecycle,
    MotionStoppedError,
    NotConnectedError,
    NotReadyError,
    OutcomeUnknownError,
    PortError,
    RobotStatus,
)

if TYPE_CHECKING:
    from asyncio import Future
    from collections.abc import Sequence

    from drivers.fanuc.rmi.config import FanucRmiConfig
    from drivers.fanuc.rmi.messages import Packet, Place, Status
    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.ports import Clock, Finding

_FIRST_SEQUENCE: Final = 1


class FanucRmiArm:
    """RobotArm and DigitalIO in one motion session.

    The controller runs its program RMI_MOVE from `activate`, or from the first input or output that needs it, until an
    abort; meanwhile it runs no other program.
    """

    def __init__(self, config: FanucRmiConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._session = RmiSession(config.host, config.port, config.timeout_s, clock)
        self._lifecycle = Lifecycle.DISCONNECTED
        self._running = False
        self._starting = asyncio.Lock()
        self._moving = asyncio.Lock()
        self._stop_requested = False
        self._stops = 0
        self._abort: asyncio.Task[None] | None = None
        self._abort_sent = asyncio.Event()
        self._fault: str | None = None

    @property
    def lifecycle(self) -> Lifecycle:
        """Where the arm is in its life."""
        return self._lifecycle if self._session.connected else Lifecycle.DISCONNECTED

    @property
    def description(self) -> str:
        """What stands behind the port, for people."""
        version = f"{self._session.major_version}.{self._session.minor_version}" if self._session.connected else "?"
        return f"FANUC controller over RMI {version} at {self._session.address}"

    async def connect(self) -> None:
        """Take the motion session; a program that an earlier client left running is aborted. Moves nothing.

        Raises:
            NotConnectedError: refused, no route, unknown name, silence, or somebody else's session.
            PortError: PROTOCOL_ERROR, PROTOCOL_VERSION where what answers is not the interface of the manual.
        """
        if self.lifecycle != Lifecycle.DISCONNECTED:
            return
        await self._session.open()
        self._running, self._fault, self._abort = False, None, None
        self._lifecycle = Lifecycle.INACTIVE
        try:
            if (await self._read_status()).rmi_running:
                await self._abort_program(self._config.abort_timeout_s)
        except BaseException:
            await self._session.close()
            raise

    async def activate(self) -> None:
        """Check that the robot may be moved, start RMI, select user frame and tool, allow motion.

        Raises:
            NotReadyError: fault, pendant, servo, single step, or what FRC_Initialize is refused for; see the detail.
        """
        self._require_connected()
        if self._lifecycle == Lifecycle.ACTIVE:
            return
        stops = self._stops
        async with self._moving:  # a move that is being stopped comes to its end first
            self._require_connected()
        await self._start()
        frame, tool = self._config.user_frame, self._config.user_tool
        await self._session.command("FRC_SetUFrameUTool", UFrameNumber=frame, UToolNumber=tool)
        self._raise(judgement.frame_refusal(await self._read_place(), frame, tool))
        if self._stops != stops:
            raise NotReadyError(Alarm.ROBOT_NOT_READY, "A stop was requested meanwhile.")
        self._stop_requested = False
        self._lifecycle = Lifecycle.ACTIVE

    async def deactivate(self) -> None:
        """Forbid motion; a move in progress is stopped."""
        if self._moving.locked():
            await self.request_stop()
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE

    async def disconnect(self) -> None:
        """Abort, give the session back, close; a controller that does not answer is left after a bounded time."""
        if self._session.connected:
            with contextlib.suppress(PortError):  # it is let go of in any case
                await self._abort_program(self._config.leave_timeout_s)
            await self._session.close()
        self._running = False
        self._lifecycle = Lifecycle.DISCONNECTED

    async def status(self) -> RobotStatus:
        """Read the controller's state."""
        self._require_connected()
        status = await self._read_status()
        place = await self._read_place()
        fault = await self._read_fault(status)
        return RobotStatus(
            pose=place.pose,
            mode=judgement.mode(status),
            pendant_enabled=status.pendant_enabled,
            servo_on=status.servo_ready,
            moving=self._moving.locked() and fault is None,
            override_percent=status.override_percent,
            fault=fault,
            user_frame=place.configuration.user_frame,
            user_tool=place.configuration.user_tool,
            session_owner="this cell",
            read_at_s=self._clock.now_s(),
        )

    async def move_linear(self, target: Xyzwpr, speed_mm_s: float) -> Xyzwpr:
        """Move in a straight line to base_T_tcp at mm/s; errors as in `srvs_cell.ports.RobotArm`."""
        return await self._move(Path.LINEAR, target, speed_mm_s, speed_mm_s)

    async def move_joint(self, target: Xyzwpr, speed_percent: float) -> Xyzwpr:
        """Move joint-interpolated to base_T_tcp at per cent of the joints' speed."""
        return await self._move(
            Path.JOINT, target, speed_percent, self._config.joint_speed_mm_s * speed_percent / 100.0
        )

    async def request_stop(self) -> None:
        """Send FRC_Abort, which ends the move and forgets it; no motion until the next `activate`.

        Returns when it is on its way: the abort's own reply may take a minute, and whoever moves, activates or
        disconnects waits for it. Waits for at most the command that is on the wire.
        """
        self._stop_requested = True
        self._stops += 1
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE
        self._require_connected()
        await self._begin_abort().wait()
        self._require_connected()

    async def reset_fault(self) -> None:
        """Abort what is paused, reset the controller, wait until its fault has gone; moves nothing.

        Raises:
            NotReadyError: this version resets only while RMI runs; reset on the pendant.
            DeviceFaultError: the fault stays.
        """
        self._require_connected()
        await self._abort_done()
        status = await self._read_status()
        if status.rmi_running:
            await self._abort_program(self._config.abort_timeout_s)
        if self._session.major_version < RESET_WITHOUT_INITIALIZE:
            raise NotReadyError(
                Alarm.ROBOT_FAULT,
                f"RMI version {self._session.major_version} resets only while RMI runs (from version "
                f"{RESET_WITHOUT_INITIALIZE} on always): press RESET on the pendant.",
            )
        deadline_s = self._clock.now_s() + self._config.reset_timeout_s
        try:
            await self._session.lengthy("FRC_Reset", self._config.reset_timeout_s)
        except RefusedError as error:
            raise DeviceFaultError(Alarm.ROBOT_FAULT, error.detail) from error
        self._fault = self._session.system_fault = None
        status = await self._read_status()
        while not status.servo_ready or status.paused:
            if self._clock.now_s() > deadline_s:
                fault = await self._read_fault(status) or "servo power stays off"
                raise DeviceFaultError(Alarm.ROBOT_FAULT, f"Not reset after {self._config.reset_timeout_s} s: {fault}.")
            await self._clock.sleep(self._config.poll_s)
            status = await self._read_status()

    async def read_input(self, number: int) -> bool:
        """Read DI[number]."""
        reply = await self._io_command("FRC_ReadDIN", PortNumber=number)
        return messages.whole(reply, "PortValue", 0, 1) == 1

    async def read_output(self, number: int) -> bool:
        """Read DO[number] back; raises `NotReadyError` on controllers whose interface has no FRC_ReadIOPort."""
        try:
            reply = await self._io_command("FRC_ReadIOPort", PortType="DO", PortNumber=number)
        except RefusedError as error:
            if error.error_id not in UNKNOWN_COMMAND:
                raise
            raise NotReadyError(
                Alarm.ROBOT_NOT_READY,
                f"DO[{number}] cannot be read back: RMI version {self._session.major_version} has no FRC_ReadIOPort.",
            ) from error
        return messages.whole(reply, "PortValue", 0, 1) == 1

    async def write_output(self, number: int, *, on: bool) -> None:
        """Write DO[number]; the controller's reply confirms it.

        Raises:
            CommandRejectedError: the controller refuses it; nothing was written.
            OutcomeUnknownError: the write is not confirmed.
        """
        try:
            await self._io_command("FRC_WriteDOUT", PortNumber=number, PortValue="ON" if on else "OFF")
        except RefusedError as error:
            raise CommandRejectedError(error.alarm, f"DO[{number}]: {error.detail}") from error
        except NotReadyError:
            raise
        except PortError as error:
            raise OutcomeUnknownError(
                error.alarm, f"DO[{number}] may or may not have been written: {error.detail}"
            ) from error

    async def diagnose(self) -> list[Finding]:
        """Say what keeps the arm from working; see `srvs_cell.ports.Diagnosable`."""
        return await diagnose_rmi(self._config, self._clock)

    async def peek_inputs(self, numbers: Sequence[int]) -> tuple[bool, ...]:
        """Read inputs in a session of its own; see `srvs_cell.ports.InputPeek`."""
        return await peek_inputs_rmi(self._config, self._clock, numbers)

    async def _io_command(self, name: str, **fields: Any) -> Packet:
        """Send a command of the I/O; where the controller refuses it because RMI does not run, start RMI first."""
        self._require_connected()
        try:
            return await self._session.command(name, **fields)
        except RefusedError as error:
            if error.error_id not in NOT_RUNNING or self._moving.locked():
                raise
        self._running = False
        await self._start()
        return await self._session.command(name, **fields)

    async def _move(self, path: Path, target: Xyzwpr, speed: float, covered_mm_s: float) -> Xyzwpr:
        self._require_active()
        if self._moving.locked():
            raise NotReadyError(Alarm.ROBOT_BUSY, "This PC is already moving the arm.")
        if speed < 1.0:
            raise CommandRejectedError(Alarm.TARGET_REJECTED, f"Speed {speed} is below 1, the least that RMI takes.")
        async with self._moving:
            status = await self._read_status()
            self._raise(judgement.refusal(status, await self._read_fault(status)))
            start = await self._read_place()
            self._raise(judgement.frame_refusal(start, self._config.user_frame, self._config.user_tool))
            # A linear move cannot leave the posture that the arm is in, and another one would make the wrist spin.
            fields = messages.move_fields(target, start.configuration, path, speed)
            if self._stop_requested:
                raise MotionStoppedError(Alarm.MOTION_STOPPED, f"Stopped at {start.pose} before the move began.")
            self._session.system_fault = None
            reply = self._session.instruct(path.value, fields)
            turn_deg_s, grace_s = self._config.turn_speed_deg_s, self._config.move_grace_s
            budget = MotionBudget.of(start.pose, target, covered_mm_s, turn_deg_s, grace_s)
            try:
                return await self._follow(reply, start.pose, target, budget)
            except asyncio.CancelledError:
                await self._stop_as_well_as_possible()
                raise
            except (MotionStoppedError, CommandRejectedError, DeviceFaultError):
                raise
            except PortError as error:
                # Silence, a cut wire, nonsense: the robot may or may not have moved, so nothing is sent again.
                await self._stop_as_well_as_possible()
                raise OutcomeUnknownError(
                    Alarm.MOTION_OUTCOME_UNKNOWN, f"After the command to move to {target}: {error.detail}"
                ) from error

    async def _follow(self, reply: Future[Packet], start: Xyzwpr, target: Xyzwpr, budget: MotionBudget) -> Xyzwpr:
        """Wait for the reply that says that the move is done, and for what comes instead."""
        last_s = self._clock.now_s()
        while True:
            status = await self._read_status()
            if self._stop_requested:
                return await self._stopped(reply, start, target)
            if reply.done():
                return await self._ended(reply, start, target)
            if status.paused or not status.servo_ready or self._session.system_fault is not None:
                await self._faulted(status, start, target)
            now_s = self._clock.now_s()
            if not budget.spend(now_s - last_s, status.override_percent):
                stands = (await self._read_place()).pose
                raise OutcomeUnknownError(
                    Alarm.MOTION_OUTCOME_UNKNOWN,
                    f"not finished after {budget.spent_s:.1f} s at full override, the arm stands at {stands}.",
                )
            last_s = now_s
            await self._clock.sleep(self._config.poll_s)

    async def _ended(self, reply: Future[Packet], start: Xyzwpr, target: Xyzwpr) -> Xyzwpr:
        """Judge the reply to a move."""
        packet, stands = reply.result(), (await self._read_place()).pose
        if packet.error_id:
            error = judgement.instruction_error(packet, target, start, stands)
            self._fault = judgement.holds_until_reset(packet) or self._fault
            await self._never_continue()
            raise error
        astray = arrival_error(stands, target, self._config.arrival_tolerance_mm, self._config.arrival_tolerance_deg)
        if astray is not None:
            raise astray
        return stands

    async def _stopped(self, reply: Future[Packet], start: Xyzwpr, target: Xyzwpr) -> Xyzwpr:
        """Wait for the abort and for the arm to stand."""
        await self._abort_done()
        if reply.done() and reply.exception() is None and reply.result().error_id == 0:
            return await self._ended(reply, start, target)  # it had arrived before the abort
        stands = await self._standing()
        if self._running:
            raise OutcomeUnknownError(Alarm.MOTION_OUTCOME_UNKNOWN, f"the stop was refused, the arm is at {stands}.")
        raise MotionStoppedError(Alarm.MOTION_STOPPED, f"Stopped on request at {stands}, on the way to {target}.")

    async def _faulted(self, status: Status, start: Xyzwpr, target: Xyzwpr) -> NoReturn:
        """Name the alarm that has ended the move, and abort what is left of it: it is never continued."""
        alarm = messages.read_errors(await self._session.command("FRC_ReadError"))
        if alarm is None and not status.servo_ready:
            alarm = "servo power is off"
        self._fault = alarm
        await self._never_continue()
        raise judgement.alarm_error(alarm, target, start, await self._standing())

    async def _never_continue(self) -> None:
        self._lifecycle = Lifecycle.INACTIVE
        self._begin_abort()
        await self._abort_done()

    async def _standing(self) -> Xyzwpr:
        """Return the pose of the arm as soon as two readings agree."""

        async def pose() -> Xyzwpr:
            return (await self._read_place()).pose

        return await standstill(pose, self._clock, self._config, "the abort")

    async def _start(self) -> None:
        """Let the controller run RMI_MOVE, which takes instructions; raises where it may not. Moves nothing."""
        async with self._starting:
            await self._abort_done()
            status = await self._read_status()
            self._raise(judgement.refusal(status, await self._read_fault(status)))
            if self._running and status.rmi_running:
                return
            if status.rmi_running:
                await self._abort_program(self._config.abort_timeout_s)
            fields = {} if self._config.group_mask is None else {"GroupMask": self._config.group_mask}
            await self._session.lengthy("FRC_Initialize", self._config.initialize_timeout_s, fields=fields)
            self._session.number_from((await self._read_status()).next_sequence or _FIRST_SEQUENCE)
            self._running = True

    def _begin_abort(self) -> asyncio.Event:
        """Abort in the background, because the reply may take long; the event tells that the command is on its way."""
        if self._abort is None or self._abort.done():
            self._abort_sent = asyncio.Event()
            limit_s = self._config.abort_timeout_s
            self._abort = asyncio.create_task(self._abort_program(limit_s, self._abort_sent), name="FRC_Abort")
            self._abort.add_done_callback(_look_at)
        return self._abort_sent

    async def _abort_done(self) -> None:
        """Wait for an abort under way; raises what it ended in, once."""
        task = self._abort
        if task is not None:
            try:
                await asyncio.shield(task)
            finally:
                if task.done() and self._abort is task:
                    self._abort = None

    async def _abort_program(self, limit_s: float, sent: asyncio.Event | None = None) -> None:
        """Abort RMI_MOVE and with it every instruction, and wait for the reply."""
        try:
            await self._session.lengthy("FRC_Abort", limit_s, sent=sent)
        except RefusedError as error:
            if error.error_id not in NOTHING_RUNNING:
                raise
        finally:
            if sent is not None:
                sent.set()
        self._running = False
        self._session.abandon_instructions()

    async def _stop_as_well_as_possible(self) -> None:
        """Ask for a stop where the outcome is already unknown or the move was cancelled."""
        with contextlib.suppress(PortError):  # a dead wire cannot carry it; `RmiSession.give_up` has tried
            await asyncio.shield(self.request_stop())

    async def _read_status(self) -> Status:
        return messages.read_status(await self._session.command("FRC_GetStatus"))

    async def _read_place(self) -> Place:
        return messages.read_place(await self._session.command("FRC_ReadCartesianPosition"))

    async def _read_fault(self, status: Status) -> str | None:
        """Return what only an operator's reset ends; the error log is read only where something is wrong."""
        if self._fault is not None:
            return self._fault
        if status.servo_ready and not (status.rmi_running and status.paused):
            return None
        return messages.read_errors(await self._session.command("FRC_ReadError"))

    def _require_connected(self) -> None:
        if self._session.connected:
            return
        if self._session.lost is not None:
            lost = self._session.lost
            raise NotConnectedError(lost.alarm, f"The connection was given up: {lost.detail}")
        raise NotConnectedError(Alarm.CONNECTION_LOST, f"{self._session.address}: not connected.")

    def _require_active(self) -> None:
        self._require_connected()
        if self._lifecycle != Lifecycle.ACTIVE:
            why = "a stop was requested; activate first" if self._stop_requested else "activate first"
            raise NotReadyError(Alarm.ROBOT_NOT_READY, f"The arm is {self._lifecycle.value}: {why}.")

    @staticmethod
    def _raise(refusal: NotReadyError | None) -> None:
        if refusal is not None:
            raise refusal


def _look_at(task: asyncio.Task[None]) -> None:
    """Take note of an error that may have nobody to raise to any more."""
    if not task.cancelled():
        task.exception()
