"""A Robotiq 2F-85 or 2F-140 over Modbus RTU, straight from a serial port of this PC.

`RobotiqGripper` is the shell that talks and waits; `robotiq_registers` packs, `robotiq_faults` says what a fault
means, `serial_wire` names failures. The gripper feels a part by itself: fingers that are stopped before the position
that was asked for have met something (gOBJ 1 or 2); fingers that arrive (3) have not, or have lost it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NoReturn

from drivers.gripper import robotiq_registers as registers
from drivers.gripper.robotiq_config import RobotiqGripperConfig
from drivers.gripper.robotiq_faults import describe, fault_of
from drivers.gripper.robotiq_registers import MODELS, Action, Activation, Contact, Status
from drivers.gripper.serial_wire import SerialWire
from srvs_cell.alarms import Alarm
from srvs_cell.ports import (
    DeviceFaultError,
    DriverContext,
    DriverSpec,
    Finding,
    GripState,
    Lifecycle,
    NotConnectedError,
    NotReadyError,
    OutcomeUnknownError,
    PortError,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from srvs_cell.ports import Clock

_CLOSED: Final = frozenset({GripState.HOLDING, GripState.CLOSED_EMPTY})
_OPEN: Final = frozenset({GripState.OPEN})
_GO: Final = Action.ACTIVATE | Action.GO


class RobotiqGripper:
    """Gripper on its own serial wire.

    A silence ends the connection: afterwards nothing is known until an operator's `clear` connects anew and reads.
    """

    def __init__(self, config: RobotiqGripperConfig, clock: Clock) -> None:
        self._config, self._clock = config, clock
        self._wire = SerialWire(config.port, config.baud_rate, config.device_id, config.answer_timeout_s)
        self._stroke, model = config.stroke_line(), MODELS[config.model]
        self._speed = registers.to_count(config.speed_mm_s, model.speed_mm_s)
        self._force = registers.to_count(config.force_n, model.force_n)
        self._lifecycle = Lifecycle.DISCONNECTED
        self._held_mm: float | None = None

    @property
    def lifecycle(self) -> Lifecycle:
        """Where the gripper is in its life."""
        return self._lifecycle if self._wire.open else Lifecycle.DISCONNECTED

    @property
    def description(self) -> str:
        """What stands behind the port, for people."""
        return f"Robotiq {self._config.model} at {self._wire.address}"

    async def connect(self) -> None:
        """Open the port and read the gripper once; moves nothing, also where it has to be activated.

        Raises:
            NotConnectedError: no port, no permission, in use, or silence; the detail says which.
            PortError: PROTOCOL_ERROR where what answers is no such gripper.
        """
        if self.lifecycle != Lifecycle.DISCONNECTED:
            return
        await self._wire.connect()
        try:
            await self._read()
        except PortError as error:
            self._wire.close()
            if error.alarm is Alarm.CONNECTION_TIMEOUT:
                raise NotConnectedError(error.alarm, f"{error.detail} {_silent_because(self._config)}") from error
            raise
        self._lifecycle = Lifecycle.INACTIVE

    async def activate(self) -> None:
        """Allow motion. A gripper that has lost its activation is activated: **the fingers open and close fully**.

        Raises:
            NotReadyError: GRIPPER_STATE_UNKNOWN, once, where it lost its activation while it held a part, which the
                activation would drop.
            DeviceFaultError: GRIPPER_FAULT where the activation fails, or a fault stays.
            OutcomeUnknownError: the gripper did not answer, or not in time.
        """
        self._require(Lifecycle.INACTIVE, Lifecycle.ACTIVE)
        status = await self._read()
        row = fault_of(status.fault)
        if status.activation is not Activation.ACTIVE or (row is not None and row.ends_activation):
            self._say_once_what_would_be_dropped(status)
            await self._activation_sequence()
        elif row is not None and not row.passes:
            self._raise_fault(status)
        self._lifecycle = Lifecycle.ACTIVE

    async def deactivate(self) -> None:
        """Forbid motion; rACT stays, so that a part in the fingers is not dropped."""
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE

    async def disconnect(self) -> None:
        """Let go of the port; the fingers stay as they are."""
        self._wire.close()
        self._lifecycle = Lifecycle.DISCONNECTED

    async def state(self) -> GripState:
        """Read what the gripper feels; UNKNOWN where it is not activated or stands in between.

        Raises:
            DeviceFaultError: GRIPPER_FAULT where it is in a fault that ends its activation; GRIPPER_STATE_UNKNOWN,
                once, where a held part has slipped, or the activation was lost while it was held.
        """
        self._require(Lifecycle.INACTIVE, Lifecycle.ACTIVE)
        status = await self._read()
        row = fault_of(status.fault)
        if row is not None and row.ends_activation:
            self._raise_fault(status)
        state = self._judge(status)
        self._notice_what_became_of_a_held_part(status, state)
        return state

    async def open(self) -> None:
        """Open to ``open_mm``.

        Raises:
            DeviceFaultError: GRIPPER_FAULT.
            OutcomeUnknownError: GRIP_TIMEOUT where the fingers do not arrive, also where something stops them; the
                wire's alarm where it fails after the command was sent.
        """
        await self._act(self._stroke.request(self._config.opening_mm()), _OPEN)

    async def close(self) -> GripState:
        """Close; return HOLDING or CLOSED_EMPTY; raises as `open`."""
        return await self._act(registers.FULLY_CLOSED, _CLOSED)

    async def diagnose(self) -> list[Finding]:
        """Open the port and read once; see `srvs_cell.ports.Diagnosable`."""
        other = RobotiqGripper(self._config, self._clock)
        try:
            await other.connect()
            status = await other._read()
        except PortError as error:
            return [Finding.failed("connection", error)]
        finally:
            await other.disconnect()
        return [Finding.fine("connection", self.description), *self._findings(status)]

    def _findings(self, status: Status) -> list[Finding]:
        row = fault_of(status.fault)
        fault = Finding.fine("fault", describe(status.fault))
        if row is not None and not row.passes:
            error = DeviceFaultError(Alarm.GRIPPER_FAULT, f"Fault 0x{status.fault:02X}: {row.cause}")
            fault = Finding.failed("fault", error, row.remedy)
        active = Finding.fine("activation", "active")
        if status.activation is not Activation.ACTIVE:
            detail = f"It is not active (gSTA {status.activation.name.lower()})."
            remedy = "The next reset activates it: the fingers open and close fully. Take out what they hold."
            active = Finding.doubtful("activation", Alarm.GRIPPER_FAULT, detail, remedy)
        opening_mm = self._stroke.opening_mm(status.position)
        fingers = Finding.fine(
            "fingers",
            f"{self._judge(status).value}, {opening_mm:.1f} mm (gPO {status.position}, gOBJ {int(status.contact)})",
            opening_mm=round(opening_mm, 2),
        )
        return [fault, active, fingers]

    async def _act(self, request: int, wanted: frozenset[GripState]) -> GripState:
        """Command the fingers once and wait until what is wanted has been read for ``settle_s``."""
        self._require(Lifecycle.ACTIVE)
        before = await self._read()
        if before.activation is not Activation.ACTIVE:
            raise NotReadyError(Alarm.GRIPPER_FAULT, f"{self.description} is not activated: clear and reset.")
        row = fault_of(before.fault)
        if row is not None and not row.passes:
            raise NotReadyError(Alarm.GRIPPER_FAULT, f"{self.description}: {describe(before.fault)}")
        self._held_mm = None
        try:
            await self._wire.write_words(
                registers.FIRST_OUTPUT, registers.encode(_GO, request, self._speed, self._force)
            )
            return await self._follow(request, wanted)
        except (DeviceFaultError, OutcomeUnknownError):
            raise
        except PortError as error:
            # Silence, an unplugged port, nonsense: the fingers may or may not have moved, so nothing is sent again.
            raise OutcomeUnknownError(error.alarm, f"After the command to the fingers: {error.detail}") from error

    async def _follow(self, request: int, wanted: frozenset[GripState]) -> GripState:
        begun_s = self._clock.now_s()
        since_s, last = begun_s, GripState.UNKNOWN
        while True:
            status, now_s = await self._read(), self._clock.now_s()
            row = fault_of(status.fault)
            if status.activation is not Activation.ACTIVE or (row is not None and not row.passes):
                self._raise_fault(status)
            # The echo tells this command's reading from one that was made before it.
            seen = self._judge(status) if status.request == request else GripState.MOVING
            if seen != last:
                since_s, last = now_s, seen
            if seen in wanted and now_s - since_s >= self._config.settle_s:
                if seen is GripState.HOLDING:
                    self._held_mm = self._stroke.opening_mm(status.position)
                return seen
            if now_s - begun_s > self._config.timeout_s:
                names = " or ".join(sorted(state.value for state in wanted))
                raise OutcomeUnknownError(
                    Alarm.GRIP_TIMEOUT,
                    f"{self.description}: after {self._config.timeout_s} s the fingers are {seen.value}, not {names}: "
                    f"{self._describe(status)}.",
                )
            await self._clock.sleep(self._config.poll_s)

    async def _activation_sequence(self) -> None:
        """Reset and activate (manual, section 4.7): rACT falls and rises, then gSTA reaches 3."""
        try:
            await self._wire.write_words(registers.FIRST_OUTPUT, registers.encode(Action(0)))
            await self._await(lambda status: status.activation is Activation.RESET, "reset", faults=False)
            await self._wire.write_words(registers.FIRST_OUTPUT, registers.encode(Action.ACTIVATE))
            await self._await(lambda status: status.activation is Activation.ACTIVE, "activated", faults=True)
        except (DeviceFaultError, OutcomeUnknownError):
            raise
        except PortError as error:
            raise OutcomeUnknownError(error.alarm, f"While the gripper is activated: {error.detail}") from error

    async def _await(self, reached: Callable[[Status], bool], what: str, *, faults: bool) -> None:
        """Read until a condition is met; raises for a fault on the way where ``faults`` counts."""
        begun_s = self._clock.now_s()
        while not reached(status := await self._read()):
            row = fault_of(status.fault)
            if faults and row is not None and row.ends_activation:
                self._raise_fault(status)
            if self._clock.now_s() - begun_s > self._config.activation_timeout_s:
                raise OutcomeUnknownError(
                    Alarm.GRIP_TIMEOUT,
                    f"{self.description} is not {what} after {self._config.activation_timeout_s} s: "
                    f"{self._describe(status)}.",
                )
            await self._clock.sleep(self._config.poll_s)

    def _judge(self, status: Status) -> GripState:
        """Return what a reading means; gOBJ counts only while the gripper goes to a position (manual, gOBJ)."""
        if status.activation is Activation.ACTIVATING:
            return GripState.MOVING
        if status.activation is not Activation.ACTIVE or not status.going:
            return GripState.UNKNOWN
        if status.contact is Contact.MOVING:
            return GripState.MOVING
        opening_mm = self._stroke.opening_mm(status.position)
        if opening_mm <= self._config.empty_below_mm:
            return GripState.CLOSED_EMPTY
        if status.contact is not Contact.ARRIVED:
            return GripState.HOLDING
        arrived_open = opening_mm >= self._config.opening_mm() - self._config.open_tolerance_mm
        return GripState.OPEN if arrived_open else GripState.UNKNOWN

    def _notice_what_became_of_a_held_part(self, status: Status, state: GripState) -> None:
        """Raise, once, where it is no longer known what the fingers hold; a person looks, then the sensors count."""
        held_mm = self._held_mm
        if held_mm is None:
            return
        now_mm = self._stroke.opening_mm(status.position)
        if state is GripState.HOLDING and abs(now_mm - held_mm) <= self._config.slip_tolerance_mm:
            return
        if status.activation is not Activation.ACTIVE:  # stays remembered: the activation would drop the part
            raise DeviceFaultError(
                Alarm.GRIPPER_STATE_UNKNOWN,
                f"{self.description} has lost its activation while it held a part of {held_mm:.1f} mm: was it without "
                "power?",
            )
        self._held_mm = None
        if state is GripState.HOLDING:
            raise DeviceFaultError(
                Alarm.GRIPPER_STATE_UNKNOWN,
                f"{self.description}: gripped at {held_mm:.1f} mm, the fingers now stand at {now_mm:.1f} mm: the part "
                "has slipped or tipped.",
            )

    def _say_once_what_would_be_dropped(self, status: Status) -> None:
        held_mm, self._held_mm = self._held_mm, None
        if held_mm is not None:
            raise NotReadyError(
                Alarm.GRIPPER_STATE_UNKNOWN,
                f"{self.description} has lost its activation while it held a part of {held_mm:.1f} mm "
                f"({describe(status.fault)}). Activating it opens the fingers: take the part out, then clear and "
                "reset again.",
            )

    async def _read(self) -> Status:
        try:
            return registers.decode(await self._wire.read_inputs(registers.FIRST_INPUT, registers.WORD_COUNT))
        except PortError as error:
            if self._wire.open and error.alarm is Alarm.PROTOCOL_ERROR:
                raise PortError(error.alarm, f"{self._wire.address}: {error.detail}") from error
            raise

    def _raise_fault(self, status: Status) -> NoReturn:
        what = describe(status.fault) if status.fault else "it is not activated any more: it has lost its power."
        raise DeviceFaultError(Alarm.GRIPPER_FAULT, f"{self.description}: {what} {self._describe(status)}.")

    def _describe(self, status: Status) -> str:
        return (
            f"gSTA {status.activation.name.lower()}, gOBJ {status.contact.name.lower()}, opening "
            f"{self._stroke.opening_mm(status.position):.1f} mm (gPO {status.position}, gPR {status.request}), "
            f"{status.current_ma} mA, {describe(status.fault)}"
        )

    def _require(self, *allowed: Lifecycle) -> None:
        if self.lifecycle == Lifecycle.DISCONNECTED and self._lifecycle != Lifecycle.DISCONNECTED:
            raise self._wire.not_connected("what the gripper holds is not known")
        if self.lifecycle not in allowed:
            needed = " or ".join(state.value for state in allowed)
            raise NotReadyError(Alarm.DEVICE_UNAVAILABLE, f"The gripper is {self.lifecycle.value}, not {needed}.")


def _silent_because(config: RobotiqGripperConfig) -> str:
    return (
        f"The port opens: check the gripper's 24 V supply, the RS-485 pair (A and B exchanged?), device id "
        f"{config.device_id} and {config.baud_rate} baud."
    )


def _make(config: RobotiqGripperConfig, context: DriverContext) -> RobotiqGripper:
    return RobotiqGripper(config, context.clock)


DRIVER = DriverSpec(RobotiqGripperConfig, _make)
