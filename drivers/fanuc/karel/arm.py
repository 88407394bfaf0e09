"""FANUC arm and its digital I/O over the KAREL line protocol: docs/reference/karel-protocol.md.

`FanucKarelArm` is the shell that talks and waits; `lines` and `messages` pack, `link` carries, `session` matches who
answers what, `judgement` says what it means.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from drivers.fanuc.judgement import MotionBudget, arrival_error
from drivers.fanuc.karel import judgement, messages
from drivers.fanuc.karel.diagnosis import diagnose_karel, peek_inputs_karel
from drivers.fanuc.karel.link import make_link
from drivers.fanuc.karel.messages import State
from drivers.fanuc.karel.session import LineSession, NoAnswerError
from drivers.fanuc.silence import OwnSilence
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
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.fanuc.karel.config import FanucKarelConfig
    from drivers.fanuc.karel.messages import Status
    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.ports import Clock, Finding, RobotStatus


class FanucKarelArm:
    """RobotArm and DigitalIO on one line, over Ethernet or RS-232."""

    def __init__(self, config: FanucKarelConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._session = LineSession(make_link(config), config.timeout_s, config.read_tries)
        self._lifecycle = Lifecycle.DISCONNECTED
        self._heartbeat: asyncio.Task[None] | None = None
        self._silence = OwnSilence(clock)
        self._moving = asyncio.Lock()
        self._stop_requested = False
        self._stops = 0

    @property
    def lifecycle(self) -> Lifecycle:
        """Where the arm is in its life."""
        return self._lifecycle if self._session.connected else Lifecycle.DISCONNECTED

    @property
    def description(self) -> str:
        """What stands behind the port, for people."""
        return f"FANUC controller over the KAREL line protocol at {self._session.address}"

    async def connect(self) -> None:
        """Open the wire, check the protocol, refuse a robot that is moving; moves nothing.

        Raises:
            NotConnectedError: the wire cannot be opened, silence, or somebody else's session; the detail says which.
            PortError: PROTOCOL_ERROR, PROTOCOL_VERSION where what answers is not this release's program.
            NotReadyError: ROBOT_BUSY where a move is under way.
        """
        if self.lifecycle != Lifecycle.DISCONNECTED:
            return
        await self._end_heartbeat()
        await self._session.open()
        try:
            self._raise(judgement.moving(await self._read()))
        except BaseException:
            self._session.close()
            await asyncio.sleep(0)  # a socket is closed in the loop's next turn
            raise
        self._lifecycle = Lifecycle.INACTIVE
        self._heartbeat = asyncio.create_task(self._beat(), name="PC heartbeat")

    async def activate(self) -> None:
        """Check that the robot may be moved, and let its program take moves.

        Raises:
            NotReadyError: fault, mode, pendant, servo, or a move under way, named in the detail.
        """
        self._require_connected()
        if self._lifecycle == Lifecycle.ACTIVE:
            return
        stops = self._stops
        async with self._moving:  # a move that is being stopped comes to its end first
            self._raise(judgement.refusal(await self._read()))
            await self._session.read("ENBL")
        if self._stops != stops:
            await self.request_stop()
            raise NotReadyError(Alarm.ROBOT_NOT_READY, "A stop was requested meanwhile.")
        self._stop_requested = False
        self._silence.begin_anew()
        self._lifecycle = Lifecycle.ACTIVE

    async def deactivate(self) -> None:
        """Forbid motion; a move in progress is stopped."""
        if self._moving.locked():
            await self.request_stop()
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE

    async def disconnect(self) -> None:
        """Say goodbye, which ends a move in progress, and close; where that is not heard the robot's watchdog does."""
        await self._end_heartbeat()
        if self._session.connected:
            with contextlib.suppress(PortError):  # it is let go of in any case
                await self._session.ask("QUIT")
        self._session.close()
        await asyncio.sleep(0)  # the socket is closed in the loop's next turn; the robot takes one client at a time
        self._lifecycle = Lifecycle.DISCONNECTED

    async def status(self) -> RobotStatus:
        """Read the controller's state."""
        self._require_connected()
        return judgement.robot_status(await self._read(), self._clock.now_s())

    async def move_linear(self, target: Xyzwpr, speed_mm_s: float) -> Xyzwpr:
        """Move in a straight line to base_T_tcp at mm/s; errors as in `srvs_cell.ports.RobotArm`."""
        return await self._move("MOVL", target, speed_mm_s, speed_mm_s)

    async def move_joint(self, target: Xyzwpr, speed_percent: float) -> Xyzwpr:
        """Move joint-interpolated to base_T_tcp at per cent of the joints' speed."""
        covered_mm_s = self._config.joint_speed_mm_s * speed_percent / 100.0
        return await self._move("MOVJ", target, speed_percent, covered_mm_s)

    async def request_stop(self) -> None:
        """Send STOP at once, past whatever is waited for; no motion until the next `activate`.

        The robot's program aborts the move and forgets it. Sent again where no answer comes, because it does no harm.
        """
        self._stop_requested = True
        self._stops += 1
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE
        self._require_connected()
        await self._session.read("STOP", urgent=True)

    async def reset_fault(self) -> None:
        """Ask the controller to reset, and wait until the fault has gone; a move is never continued. Moves nothing.

        Raises:
            DeviceFaultError: the fault stays.
        """
        self._require_connected()
        limit_s = self._config.reset_timeout_s
        deadline_s = self._clock.now_s() + limit_s
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE  # the robot's program takes no move after a reset, either
        reply = await self._session.ask("RSET", timeout_s=limit_s)
        if not reply.accepted:
            raise messages.refused("RSET", reply)
        status = await self._read()
        while status.fault is not None or status.state is State.BUSY:
            if self._clock.now_s() > deadline_s:
                raise DeviceFaultError(
                    Alarm.ROBOT_FAULT, f"Not reset after {limit_s} s: {status.fault or 'a move is still under way'}."
                )
            await self._clock.sleep(self._config.poll_s)
            status = await self._read()

    async def read_input(self, number: int) -> bool:
        """Read DI[number]."""
        self._require_connected()
        return messages.read_signal("RDIN", await self._session.read("RDIN", number))

    async def read_output(self, number: int) -> bool:
        """Read DO[number] back."""
        self._require_connected()
        return messages.read_signal("RDOU", await self._session.read("RDOU", number))

    async def write_output(self, number: int, *, on: bool) -> None:
        """Write DO[number]; the robot's program reads it back.

        Raises:
            CommandRejectedError: there is no such output; nothing was written.
            OutcomeUnknownError: the write is not confirmed.
        """
        self._require_connected()
        try:
            reply = await self._session.ask("WDOU", number, int(on))
            if not reply.accepted:
                raise messages.refused("WDOU", reply)
            confirmed = messages.read_signal("WDOU", reply) == on
        except CommandRejectedError:
            raise
        except PortError as error:
            raise OutcomeUnknownError(
                error.alarm, f"DO[{number}] may or may not have been written: {error.detail}"
            ) from error
        if not confirmed:
            raise OutcomeUnknownError(Alarm.PROTOCOL_ERROR, f"DO[{number}] was written {on} but reads {not on}.")

    async def diagnose(self) -> list[Finding]:
        """Say what keeps the arm from working; see `srvs_cell.ports.Diagnosable`."""
        return await diagnose_karel(self._config, self._clock)

    async def peek_inputs(self, numbers: Sequence[int]) -> tuple[bool, ...]:
        """Read inputs in a conversation of its own; see `srvs_cell.ports.InputPeek`."""
        return await peek_inputs_karel(self._config, numbers)

    async def _move(self, name: str, target: Xyzwpr, speed: float, covered_mm_s: float) -> Xyzwpr:
        self._require_active()
        if self._moving.locked():
            raise NotReadyError(Alarm.ROBOT_BUSY, "This PC is already moving the arm.")
        values = messages.move_values(target, speed)
        async with self._moving:
            before = await self._read()
            self._raise(judgement.refusal(before))
            if self._stop_requested:
                raise MotionStoppedError(Alarm.MOTION_STOPPED, f"Stopped at {before.pose} before the move began.")
            turn_deg_s, grace_s = self._config.turn_speed_deg_s, self._config.move_grace_s
            budget = MotionBudget.of(before.pose, target, covered_mm_s, turn_deg_s, grace_s)
            try:
                sequence = await self._command(name, values, before.pose)
                return await self._follow(sequence, before.pose, target, budget)
            except asyncio.CancelledError:
                await self._stop_as_well_as_possible()
                raise
            except (MotionStoppedError, CommandRejectedError, DeviceFaultError, NotReadyError):
                raise
            except PortError as error:
                # Silence, a cut wire, nonsense: the robot may or may not have moved, so nothing is sent again.
                await self._stop_as_well_as_possible()
                raise OutcomeUnknownError(
                    Alarm.MOTION_OUTCOME_UNKNOWN, f"After the command to move to {target}: {error.detail}"
                ) from error

    async def _command(self, name: str, values: tuple[int, ...], start: Xyzwpr) -> int:
        """Send the move once; return its number when it is known that the robot has taken it.

        Where the answer is lost the robot is asked for the number of its last move. Lines keep their order on either
        carrier, so that a move which it has not taken by then has not reached it and never will.

        Raises:
            NotReadyError, CommandRejectedError, MotionStoppedError: nothing has moved.
            NotConnectedError: the robot cannot be asked any more.
        """
        try:
            reply = await self._session.move(name, *values)
        except NoAnswerError as lost:
            if (await self._read()).move == lost.sequence:
                return lost.sequence
            raise NotReadyError(lost.alarm, f"{lost.detail} The robot has not taken the move.") from lost
        if reply.accepted:
            return reply.sequence
        if reply.values[0] == messages.Refusal.ENABLE:
            self._lifecycle = Lifecycle.INACTIVE
            if self._stop_requested:
                raise MotionStoppedError(Alarm.MOTION_STOPPED, f"Stopped at {start} before the move began.")
            silence = self._silence.noticed
            if silence is not None:
                raise MotionStoppedError(Alarm.HEARTBEAT_LOST, f"The move has not begun. {silence}")
        raise messages.refused(name, reply)

    async def _follow(self, sequence: int, start: Xyzwpr, target: Xyzwpr, budget: MotionBudget) -> Xyzwpr:
        """Read until the move has ended, and judge how."""
        last_s = self._clock.now_s()
        while True:
            status = await self._read()
            if judgement.ended(status, sequence):
                break
            now_s = self._clock.now_s()
            if not budget.spend(now_s - last_s, status.override_percent):
                raise OutcomeUnknownError(
                    Alarm.MOTION_OUTCOME_UNKNOWN,
                    f"not ended after {budget.spent_s:.1f} s at full override, the arm stands at {status.pose}.",
                )
            if self._stop_requested:
                budget.limit(self._config.stop_timeout_s)
            last_s = now_s
            await self._clock.sleep(self._config.poll_s)
        if status.state is State.DONE:
            stands = (await self._read()).pose
            tolerance_mm, tolerance_deg = self._config.arrival_tolerance_mm, self._config.arrival_tolerance_deg
            error = arrival_error(stands, target, tolerance_mm, tolerance_deg)
        else:
            self._lifecycle = Lifecycle.INACTIVE  # the robot's program takes no further move, either
            stands = await self._standing()
            error = judgement.shortfall(status, start, stands)
        if error is not None:
            raise error
        return stands

    async def _standing(self) -> Xyzwpr:
        """Return the pose of the arm as soon as two readings agree."""

        async def pose() -> Xyzwpr:
            return (await self._read()).pose

        return await standstill(pose, self._clock, self._config, "its move has ended")

    async def _beat(self) -> None:
        """Let the robot hear this PC, and hear the robot, for as long as the wire holds."""
        with contextlib.suppress(PortError):  # `LineSession.lost` keeps it for who needs the arm next
            while True:
                await self._session.read("BEAT")
                self._silence.end()
                await self._clock.sleep(self._config.heartbeat_s)

    async def _end_heartbeat(self) -> None:
        task, self._heartbeat = self._heartbeat, None
        if task is not None:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):  # it was cancelled one line above
                await task

    async def _read(self) -> Status:
        return messages.read_status(await self._session.read("STAT"))

    async def _stop_as_well_as_possible(self) -> None:
        """Ask for a stop where the outcome is already unknown or the move was cancelled."""
        with contextlib.suppress(PortError):  # a dead wire cannot carry it; the robot's watchdog stops the move
            await asyncio.shield(self.request_stop())

    def _require_connected(self) -> None:
        if self._session.connected:
            return
        lost = self._session.lost
        if lost is not None:
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
