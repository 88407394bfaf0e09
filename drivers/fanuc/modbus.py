"""FANUC arm and its digital I/O over Modbus TCP (option R553): the handshake of docs/reference/modbus-map.md.

`FanucModbusArm` is the shell that talks and waits; `registers` packs, `judgement` decides, `wire` names failures.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Self

from pydantic import Field, model_validator

from drivers.fanuc import judgement, registers
from drivers.fanuc.modbus_diagnosis import diagnose_modbus, peek_inputs_modbus
from drivers.fanuc.registers import Command, Snapshot
from drivers.fanuc.settings import MotionSettings
from drivers.fanuc.silence import OwnSilence
from drivers.fanuc.wire import ModbusWire
from srvs_cell.alarms import Alarm
from srvs_cell.ports import (
    CommandRejectedError,
    DeviceFaultError,
    DriverContext,
    DriverSpec,
    Lifecycle,
    MotionStoppedError,
    NotConnectedError,
    NotReadyError,
    OutcomeUnknownError,
    PortError,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.ports import Clock, Finding, RobotStatus


class FanucModbusConfig(MotionSettings):
    """The robot's part of the cell's YAML."""

    host: str = Field(default="127.0.0.1", min_length=1, description="the controller's address or name")
    port: int = Field(default=502, ge=1, le=65535, description="``$SNPX_PARAM.$MODBUS_PORT``")
    unit_id: int = Field(default=1, ge=1, le=247, description="``$SNPX_PARAM.$MODBUS_ADR``")
    timeout_s: float = Field(default=1.0, gt=0.0, le=10.0, description="real seconds for one request on the wire")
    heartbeat_s: float = Field(
        default=0.25,
        ge=0.05,
        le=1.0,
        description="clock seconds between two heartbeats of this PC; the robot's watchdog allows 2 s",
    )
    heartbeat_timeout_s: float = Field(
        default=1.5,
        ge=0.3,
        le=10.0,
        description="clock seconds after which a robot's heartbeat that does not count is lost",
    )
    hold_output: int = Field(default=3, ge=1, le=4096, description="DO that ends the move in progress")
    reset_output: int = Field(
        default=4, ge=1, le=4096, description="DO that resets the controller's fault and restarts the program"
    )
    reset_timeout_s: float = Field(default=10.0, gt=0.0, le=120.0, description="clock seconds that a reset may take")
    stop_timeout_s: float = Field(
        default=3.0, ge=0.2, le=30.0, description="clock seconds at 100 % override that a stop may take to be confirmed"
    )

    @property
    def longest_reading_s(self) -> float:
        """The request that is on the wire, and the reading itself."""
        return 2.0 * self.timeout_s

    @model_validator(mode="after")
    def _outputs_differ(self) -> Self:
        if self.hold_output == self.reset_output:
            raise ValueError(f"hold_output and reset_output are both {self.hold_output}")
        return self


class FanucModbusArm:
    """RobotArm and DigitalIO on one Modbus TCP connection."""

    def __init__(self, config: FanucModbusConfig, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._wire = ModbusWire(config.host, config.port, config.unit_id, config.timeout_s)
        self._lifecycle = Lifecycle.DISCONNECTED
        self._heartbeat: asyncio.Task[None] | None = None
        self._robot_beat = 0
        self._robot_beat_at_s = 0.0
        self._heartbeat_lost = False
        self._lost: PortError | None = None
        self._silence = OwnSilence(clock)
        self._hold_requested = False
        self._moving = asyncio.Lock()

    @property
    def lifecycle(self) -> Lifecycle:
        """Where the arm is in its life."""
        return self._lifecycle

    @property
    def description(self) -> str:
        """What stands behind the port, for people."""
        return f"FANUC controller over Modbus TCP at {self._wire.address}"

    async def connect(self) -> None:
        """Open the wire, check the protocol, refuse a robot that is busy; moves nothing.

        Raises:
            NotConnectedError: refused, no route, unknown name, or silence; the detail says which.
            PortError: PROTOCOL_VERSION where the robot's words are not mapped or of another release.
            NotReadyError: ROBOT_BUSY where a command is being carried out.
        """
        if self._lifecycle != Lifecycle.DISCONNECTED:
            return
        await self._wire.connect()
        try:
            snapshot = await self._first_reading()
            # A robot in fault must stay reachable, or its fault could not be reset.
            if snapshot.busy and judgement.fault_text(snapshot) is None:
                raise NotReadyError(
                    Alarm.ROBOT_BUSY,
                    f"{self._wire.address}: state {snapshot.state}, sequence {snapshot.sequence} written, "
                    f"{snapshot.acknowledged} acknowledged.",
                )
        except PortError:
            self._wire.close()
            raise
        self._robot_beat, self._robot_beat_at_s = snapshot.robot_heartbeat, self._clock.now_s()
        self._heartbeat_lost, self._lost = False, None
        self._lifecycle = Lifecycle.INACTIVE
        self._heartbeat = asyncio.create_task(self._beat(), name="PC heartbeat")

    async def activate(self) -> None:
        """Check that the robot may be moved, release the hold output, allow motion.

        Raises:
            NotReadyError: fault, mode, pendant, servo, a busy program, or no heartbeat, named in the detail.
        """
        self._require_connected()
        if self._lifecycle == Lifecycle.ACTIVE:
            return
        self._raise_refusal(await self._read())
        await self._await_robot_heartbeat()
        # A paused or unfinished move could go on when the hold is released; the refusal above has excluded it.
        await self._wire.write_output(self._config.hold_output, on=False)
        if await self._wire.read_output(self._config.hold_output):
            raise NotReadyError(
                Alarm.ROBOT_NOT_READY, f"DO[{self._config.hold_output}] (hold) stays on: the robot's watchdog holds it."
            )
        self._hold_requested = False
        self._silence.begin_anew()
        self._lifecycle = Lifecycle.ACTIVE

    async def deactivate(self) -> None:
        """Forbid motion; a move in progress is stopped."""
        if self._moving.locked():
            await self.request_stop()
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE

    async def disconnect(self) -> None:
        """End the heartbeat and close the wire; a move in progress is stopped by the robot's watchdog."""
        self._wire.close()
        if self._heartbeat is not None:
            self._heartbeat.cancel()
            with contextlib.suppress(asyncio.CancelledError):  # it was cancelled one line above
                await self._heartbeat
            self._heartbeat = None
        await asyncio.sleep(0)  # the socket is closed in the loop's next turn; the controller takes one client
        self._lifecycle = Lifecycle.DISCONNECTED

    async def status(self) -> RobotStatus:
        """Read the controller's state."""
        self._require_connected()
        return judgement.robot_status(await self._read(), self._clock.now_s())

    async def move_linear(self, target: Xyzwpr, speed_mm_s: float) -> Xyzwpr:
        """Move in a straight line to base_T_tcp at mm/s; errors as in `srvs_cell.ports.RobotArm`."""
        return await self._move(Command.MOVE_LINEAR, target, speed_mm_s, speed_mm_s)

    async def move_joint(self, target: Xyzwpr, speed_percent: float) -> Xyzwpr:
        """Move joint-interpolated to base_T_tcp at per cent of the joints' speed."""
        covered_mm_s = self._config.joint_speed_mm_s * speed_percent / 100.0
        return await self._move(Command.MOVE_JOINT, target, speed_percent, covered_mm_s)

    async def request_stop(self) -> None:
        """Switch the hold output on; no motion until the next `activate`.

        The robot's program ends the move and forgets it. Waits for at most the request that is on the wire.
        """
        self._hold_requested = True
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE
        await self._wire.write_output(self._config.hold_output, on=True)

    async def reset_fault(self) -> None:
        """Switch the reset output on until the fault has gone and the program runs anew, then off; moves nothing.

        The robot's wiring aborts what is paused before it starts the program, and a program that starts takes no
        command that was sent before, so that an interrupted move is not continued.

        Raises:
            DeviceFaultError: the fault stays.
        """
        self._require_connected()
        output, deadline_s = self._config.reset_output, self._clock.now_s() + self._config.reset_timeout_s
        await self._wire.write_output(output, on=True)
        try:
            snapshot = await self._read()
            while (fault := judgement.fault_text(snapshot)) is not None or snapshot.busy:
                if self._clock.now_s() > deadline_s:
                    raise DeviceFaultError(
                        Alarm.ROBOT_FAULT, f"Not reset after {self._config.reset_timeout_s} s: {fault or 'still busy'}."
                    )
                await self._clock.sleep(self._config.poll_s)
                snapshot = await self._read()
        finally:
            await self._wire.write_output(output, on=False)

    async def read_input(self, number: int) -> bool:
        """Read DI[number]."""
        self._require_connected()
        return await self._wire.read_input(number)

    async def read_output(self, number: int) -> bool:
        """Read DO[number] back."""
        self._require_connected()
        return await self._wire.read_output(number)

    async def write_output(self, number: int, *, on: bool) -> None:
        """Write DO[number] and read it back.

        Raises:
            CommandRejectedError: the output belongs to this driver (hold, reset).
            OutcomeUnknownError: the write is not confirmed.
        """
        self._require_connected()
        if number in {self._config.hold_output, self._config.reset_output}:
            raise CommandRejectedError(Alarm.ROBOT_NOT_READY, f"DO[{number}] is the driver's own hold or reset output.")
        try:
            await self._wire.write_output(number, on=on)
            confirmed = await self._wire.read_output(number) == on
        except PortError as error:
            raise OutcomeUnknownError(
                error.alarm, f"DO[{number}] may or may not have been written: {error.detail}"
            ) from error
        if not confirmed:
            raise OutcomeUnknownError(Alarm.PROTOCOL_ERROR, f"DO[{number}] was written {on} but reads {not on}.")

    async def diagnose(self) -> list[Finding]:
        """Say what keeps the arm from working; see `srvs_cell.ports.Diagnosable`."""
        return await diagnose_modbus(self._config, self._clock)

    async def peek_inputs(self, numbers: Sequence[int]) -> tuple[bool, ...]:
        """Read inputs over a connection of its own; see `srvs_cell.ports.InputPeek`."""
        return await peek_inputs_modbus(self._config, numbers)

    async def _move(self, command: Command, target: Xyzwpr, speed: float, covered_mm_s: float) -> Xyzwpr:
        self._require_active()
        if self._moving.locked():
            raise NotReadyError(Alarm.ROBOT_BUSY, "This PC is already moving the arm.")
        async with self._moving:
            before = await self._read()
            self._raise_refusal(before)
            sequence = registers.next_sequence(before.sequence)
            words = registers.encode(sequence, command, target, speed)
            await self._wire.write_words(registers.COMMAND_WORD, words)
            if await self._wire.read_words(registers.COMMAND_WORD, len(words)) != words:
                raise NotReadyError(Alarm.PROTOCOL_ERROR, "The parameters read back differ from those written.")
            if self._hold_requested:
                raise MotionStoppedError(Alarm.MOTION_STOPPED, f"Stopped at {before.pose} before the move began.")
            turn_deg_s, grace_s = self._config.turn_speed_deg_s, self._config.move_grace_s
            budget = judgement.MotionBudget.of(before.pose, target, covered_mm_s, turn_deg_s, grace_s)
            try:
                await self._wire.write_words(registers.SEQUENCE_WORD, [sequence])
                return await self._follow(sequence, before.pose, target, budget)
            except asyncio.CancelledError:
                await self._stop_as_well_as_possible()
                raise
            except (MotionStoppedError, CommandRejectedError, DeviceFaultError):
                raise
            except PortError as error:
                # Silence, a cut wire, nonsense: the robot may or may not have moved, so nothing is sent again.
                await self._stop_as_well_as_possible()
                alarm = Alarm.HEARTBEAT_LOST if self._heartbeat_lost else Alarm.MOTION_OUTCOME_UNKNOWN
                why = self._lost or error  # the heartbeat may have met it first
                raise OutcomeUnknownError(alarm, f"After the command to move to {target}: {why.detail}") from error

    async def _follow(self, sequence: int, start: Xyzwpr, target: Xyzwpr, budget: judgement.MotionBudget) -> Xyzwpr:
        """Read until the command is finished."""
        last_s = self._clock.now_s()
        while True:
            snapshot = await self._read()
            try:
                if judgement.finished(snapshot, sequence, start, hold_requested=self._hold_requested):
                    break
            except MotionStoppedError as error:
                if self._lifecycle == Lifecycle.ACTIVE:
                    self._lifecycle = Lifecycle.INACTIVE  # the hold output may still be on
                if self._heartbeat_lost:
                    raise MotionStoppedError(Alarm.HEARTBEAT_LOST, error.detail) from error
                silence = self._silence.noticed
                if silence is not None and not self._hold_requested:
                    raise MotionStoppedError(Alarm.HEARTBEAT_LOST, f"{error.detail} {silence}") from error
                raise
            now_s = self._clock.now_s()
            if not budget.spend(now_s - last_s, snapshot.override_percent):
                raise OutcomeUnknownError(
                    Alarm.MOTION_OUTCOME_UNKNOWN,
                    f"not finished after {budget.spent_s:.1f} s at full override, the arm stands at {snapshot.pose}.",
                )
            if self._hold_requested:
                budget.limit(self._config.stop_timeout_s)
            last_s = now_s
            await self._clock.sleep(self._config.poll_s)
        # Words of one reading may stem from two instants; the pose of a second one is of the standing arm.
        standing = await self._read()
        astray = judgement.arrival_error(
            standing.pose, target, self._config.arrival_tolerance_mm, self._config.arrival_tolerance_deg
        )
        if astray is not None:
            raise astray
        return standing.pose

    async def _beat(self) -> None:
        """Count this PC's heartbeat and watch the robot's, for as long as the wire holds."""
        beat = 0
        try:
            while True:
                beat = registers.next_sequence(beat)
                await self._wire.write_words(registers.PC_HEARTBEAT_WORD, [beat])
                self._silence.end()
                self._note_robot_beat((await self._wire.read_words(registers.ROBOT_HEARTBEAT_WORD, 1))[0])
                if self._heartbeat_lost and self._lifecycle == Lifecycle.ACTIVE:
                    await self.request_stop()
                await self._clock.sleep(self._config.heartbeat_s)
        except PortError as error:
            # Without a heartbeat nothing may move; who needs the arm next is told why by `_require_connected`.
            self._lost = error
            if self._moving.locked():
                await self._stop_as_well_as_possible()
            self._wire.close()
            self._lifecycle = Lifecycle.DISCONNECTED

    def _note_robot_beat(self, beat: int) -> None:
        now_s = self._clock.now_s()
        if beat != self._robot_beat:
            self._robot_beat, self._robot_beat_at_s = beat, now_s
        self._heartbeat_lost = now_s - self._robot_beat_at_s > self._config.heartbeat_timeout_s

    async def _await_robot_heartbeat(self) -> None:
        begun_s, seen = self._clock.now_s(), self._robot_beat
        while self._robot_beat == seen:
            if self._clock.now_s() - begun_s > self._config.heartbeat_timeout_s:
                raise NotReadyError(
                    Alarm.HEARTBEAT_LOST, f"R[114] has stood at {seen} for {self._config.heartbeat_timeout_s} s."
                )
            await self._clock.sleep(self._config.heartbeat_s)
            self._require_connected()

    async def _first_reading(self) -> Snapshot:
        try:
            return await self._read()
        except NotConnectedError as error:
            raise NotConnectedError(
                error.alarm,
                f"{error.detail} The TCP connection stands: check $SNPX_PARAM.$MODBUS_ADR (unit id "
                f"{self._config.unit_id}) and that no other program holds the controller's connection.",
            ) from error

    async def _read(self) -> Snapshot:
        return registers.decode(await self._wire.read_words(registers.FIRST_WORD, registers.WORD_COUNT))

    async def _stop_as_well_as_possible(self) -> None:
        """Ask for a stop where the outcome is already unknown or the move was cancelled."""
        with contextlib.suppress(PortError):  # a dead wire cannot carry it; the robot's watchdog stops the move
            await asyncio.shield(self.request_stop())

    def _require_connected(self) -> None:
        if self._lifecycle == Lifecycle.DISCONNECTED and self._lost is not None:
            raise NotConnectedError(self._lost.alarm, f"The connection was given up: {self._lost.detail}")
        if self._lifecycle == Lifecycle.DISCONNECTED:
            raise NotConnectedError(Alarm.CONNECTION_LOST, f"{self._wire.address}: not connected.")

    def _require_active(self) -> None:
        self._require_connected()
        if self._heartbeat_lost:
            raise NotReadyError(Alarm.HEARTBEAT_LOST, f"R[114] stands at {self._robot_beat}.")
        if self._lifecycle != Lifecycle.ACTIVE:
            why = "a stop was requested; activate first" if self._hold_requested else "activate first"
            raise NotReadyError(Alarm.ROBOT_NOT_READY, f"The arm is {self._lifecycle.value}: {why}.")

    @staticmethod
    def _raise_refusal(snapshot: Snapshot) -> None:
        refusal = judgement.refusal(snapshot)
        if refusal is not None:
            raise refusal


def _make(config: FanucModbusConfig, context: DriverContext) -> FanucModbusArm:
    return FanucModbusArm(config, context.clock)


DRIVER = DriverSpec(FanucModbusConfig, _make)
