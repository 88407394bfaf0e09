"""A parallel gripper wired to the robot's digital inputs and outputs: a double-acting valve and three sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from srvs_cell.alarms import Alarm
from srvs_cell.ports import (
    DriverContext,
    DriverSpec,
    Finding,
    GripState,
    InputPeek,
    Lifecycle,
    NotReadyError,
    OutcomeUnknownError,
    PortError,
)

if TYPE_CHECKING:
    from srvs_cell.ports import Clock, DigitalIO

_CLOSED: Final = frozenset({GripState.HOLDING, GripState.CLOSED_EMPTY})
_OPEN: Final = frozenset({GripState.OPEN})


class RobotIoGripperConfig(BaseModel):
    """The gripper's part of the cell's YAML."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    close_output: int = Field(
        default=1,
        ge=1,
        le=4096,
        description="DO of the two valve coils; one is switched off before the other is switched on",
    )
    open_output: int = Field(
        default=2,
        ge=1,
        le=4096,
        description="DO of the two valve coils; one is switched off before the other is switched on",
    )
    held_input: int = Field(default=1, ge=1, le=4096, description="DI that is on while a part is between the fingers")
    open_input: int = Field(default=2, ge=1, le=4096, description="DI that is on while the gripper is fully open")
    closed_empty_input: int = Field(
        default=3, ge=1, le=4096, description="DI that is on while the fingers are closed as far as they go"
    )
    timeout_s: float = Field(
        default=3.0, gt=0.0, le=60.0, description="clock seconds within which the sensors must confirm"
    )
    settle_s: float = Field(
        default=0.15,
        ge=0.0,
        le=5.0,
        description="clock seconds for which they must say the same: a part may still be pushed about, or slip out",
    )
    poll_s: float = Field(default=0.05, ge=0.01, le=1.0, description="clock seconds between two readings")

    @model_validator(mode="after")
    def _numbers_differ(self) -> Self:
        if self.close_output == self.open_output:
            raise ValueError(f"close_output and open_output are both {self.close_output}")
        inputs = (self.held_input, self.open_input, self.closed_empty_input)
        if len(set(inputs)) < len(inputs):
            raise ValueError(f"held_input, open_input and closed_empty_input must differ, got {inputs}")
        return self


class RobotIoGripper:
    """Gripper through `DigitalIO`; it is reachable when the robot is."""

    def __init__(self, config: RobotIoGripperConfig, clock: Clock, io: DigitalIO) -> None:
        self._config, self._clock, self._io = config, clock, io
        self._lifecycle = Lifecycle.DISCONNECTED

    @property
    def lifecycle(self) -> Lifecycle:
        """Where the gripper is in its life."""
        return self._lifecycle

    @property
    def description(self) -> str:
        """What stands behind the port, for people."""
        c = self._config
        return (
            f"gripper on the robot's DO[{c.close_output}] close, DO[{c.open_output}] open, DI[{c.held_input}] held, "
            f"DI[{c.open_input}] open, DI[{c.closed_empty_input}] closed empty"
        )

    async def connect(self) -> None:
        """Read the sensors once. Raises `PortError` GRIPPER_STATE_UNKNOWN where they contradict each other."""
        await self._consistent_state()
        self._lifecycle = Lifecycle.INACTIVE

    async def activate(self) -> None:
        """Allow motion; raises as `connect`."""
        self._require(Lifecycle.INACTIVE, Lifecycle.ACTIVE)
        await self._consistent_state()
        self._lifecycle = Lifecycle.ACTIVE

    async def deactivate(self) -> None:
        """Forbid motion; the outputs stay as they are, so that a part in the fingers is not dropped."""
        if self._lifecycle == Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE

    async def disconnect(self) -> None:
        """Let go of the I/O; the outputs stay as they are."""
        self._lifecycle = Lifecycle.DISCONNECTED

    async def state(self) -> GripState:
        """Read the sensors: none on is MOVING, more than one is UNKNOWN."""
        self._require(Lifecycle.INACTIVE, Lifecycle.ACTIVE)
        return await self._sensors()

    async def open(self) -> None:
        """Open; raises `OutcomeUnknownError` GRIP_TIMEOUT where the sensors do not confirm."""
        await self._act(self._config.close_output, self._config.open_output, _OPEN)

    async def close(self) -> GripState:
        """Close; return HOLDING or CLOSED_EMPTY; raises `OutcomeUnknownError` GRIP_TIMEOUT where neither comes."""
        return await self._act(self._config.open_output, self._config.close_output, _CLOSED)

    async def diagnose(self) -> list[Finding]:
        """Read the sensors once, where the arm's driver lets them be read; see `srvs_cell.ports.Diagnosable`."""
        c, check = self._config, "sensors"
        if not isinstance(self._io, InputPeek):
            detail = "The arm's driver reads no inputs for a diagnosis."
            return [Finding.doubtful(check, Alarm.GRIPPER_STATE_UNKNOWN, detail, "Look at the inputs on the pendant.")]
        numbers = {"held": c.held_input, "open": c.open_input, "closed empty": c.closed_empty_input}
        try:
            values = await self._io.peek_inputs(tuple(numbers.values()))
        except NotReadyError as error:
            return [Finding.doubtful(check, error.alarm, error.detail, "Look at the inputs on the pendant.")]
        except PortError as error:
            return [Finding.failed(check, error)]
        on = [name for name, value in zip(numbers, values, strict=True) if value]
        read = ", ".join(f"DI[{n}] {name} {'on' if name in on else 'off'}" for name, n in numbers.items())
        if len(on) == 1:
            return [Finding.fine(check, read)]
        if on:
            contradiction = PortError(Alarm.GRIPPER_STATE_UNKNOWN, f"Several are on at once: {read}.")
            return [Finding.failed(check, contradiction, "Check the sensors' wiring and the numbers in the config.")]
        remedy = "Check air, the sensors' supply and the numbers in the config; fingers in mid-travel read so, too."
        return [Finding.doubtful(check, Alarm.GRIPPER_STATE_UNKNOWN, f"None is on: {read}.", remedy)]

    async def _act(self, off: int, on: int, wanted: frozenset[GripState]) -> GripState:
        self._require(Lifecycle.ACTIVE)
        await self._io.write_output(off, on=False)
        await self._io.write_output(on, on=True)
        begun_s = self._clock.now_s()
        since_s, last = begun_s, GripState.UNKNOWN
        while True:
            seen, now_s = await self._sensors(), self._clock.now_s()
            if seen != last:
                since_s, last = now_s, seen
            if seen in wanted and now_s - since_s >= self._config.settle_s:
                return seen
            if now_s - begun_s > self._config.timeout_s:
                names = " or ".join(sorted(state.value for state in wanted))
                raise OutcomeUnknownError(
                    Alarm.GRIP_TIMEOUT,
                    f"DO[{on}] is on for {self._config.timeout_s} s, the sensors say {seen.value}, not {names}.",
                )
            await self._clock.sleep(self._config.poll_s)

    async def _sensors(self) -> GripState:
        c = self._config
        on = [
            state
            for state, number in (
                (GripState.HOLDING, c.held_input),
                (GripState.OPEN, c.open_input),
                (GripState.CLOSED_EMPTY, c.closed_empty_input),
            )
            if await self._io.read_input(number)
        ]
        if not on:
            return GripState.MOVING
        return on[0] if len(on) == 1 else GripState.UNKNOWN

    async def _consistent_state(self) -> None:
        if await self._sensors() == GripState.UNKNOWN:
            raise PortError(Alarm.GRIPPER_STATE_UNKNOWN, f"Several sensors of the {self.description} are on at once.")

    def _require(self, *allowed: Lifecycle) -> None:
        if self._lifecycle not in allowed:
            needed = " or ".join(state.value for state in allowed)
            raise NotReadyError(Alarm.DEVICE_UNAVAILABLE, f"The gripper is {self._lifecycle.value}, not {needed}.")


def _make(config: RobotIoGripperConfig, context: DriverContext) -> RobotIoGripper:
    if context.digital_io is None:
        raise PortError(Alarm.CONFIG_INVALID, "gripper.robot_io needs an arm driver that lends its digital I/O.")
    return RobotIoGripper(config, context.clock, context.digital_io)


DRIVER = DriverSpec(RobotIoGripperConfig, _make)
