"""What the cell asks of the outside: clock, camera, robot arm, digital I/O, gripper.

Every port is async, cancellable and bounded by a time-out. A device goes through
disconnected -> inactive (may be read) -> active (may move) and back; `Device.connect` never moves anything and
never makes it active. Errors are of the `PortError` family and carry an alarm. No implementation re-sends a command
that could move something twice: where the outcome is not known it raises `OutcomeUnknownError`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar, runtime_checkable

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from contextlib import AbstractContextManager

    import numpy as np
    from numpy.typing import NDArray
    from pydantic import BaseModel

    from srvs_cell.geometry import Xyzwpr


class PortError(AlarmError):
    """Something outside failed; the base of all errors that a driver raises."""


class NotConnectedError(PortError):
    """The device cannot be reached, or the connection was cut while nothing was under way."""


class NotReadyError(PortError):
    """The device refuses to act in its present condition; nothing has moved."""


class CommandRejectedError(PortError):
    """The device looked at the command and refused it before acting; nothing has moved."""


class DeviceFaultError(PortError):
    """The device reported a fault while or after acting; the motion has ended, not necessarily at its target."""


class MotionStoppedError(PortError):
    """A move ended before its target because a stop was requested; it is never continued by itself."""


class OutcomeUnknownError(PortError):
    """A command was sent and it is not known whether it was carried out."""


class FrameError(PortError):
    """No frame that satisfies the request came in time."""


class Lifecycle(StrEnum):
    """The life of a device."""

    DISCONNECTED = "disconnected"
    INACTIVE = "inactive"
    ACTIVE = "active"


@runtime_checkable
class Clock(Protocol):
    """The time authority of the process. Wire time-outs do not use it; waits, deadlines and heartbeats do."""

    def now_s(self) -> float:
        """Return monotonic seconds."""
        ...

    async def sleep(self, seconds: float) -> None:
        """Return after ``seconds`` of this clock; raises `PortError` if the clock itself has stopped."""
        ...

    def working(self) -> AbstractContextManager[None]:
        """Say that a computation is going on, so that a simulated clock does not run ahead of it."""
        ...


class Device(Protocol):
    """The life that camera, arm and gripper share."""

    @property
    def lifecycle(self) -> Lifecycle:
        """Where the device is in its life."""
        ...

    @property
    def description(self) -> str:
        """What stands behind the port and where, for people."""
        ...

    async def connect(self) -> None:
        """Reach the device and check it; afterwards inactive. Raises `PortError` with the reason."""
        ...

    async def activate(self) -> None:
        """Allow motion (camera: streaming); afterwards active. Raises `PortError` with the reason."""
        ...

    async def deactivate(self) -> None:
        """Forbid motion; afterwards inactive."""
        ...

    async def disconnect(self) -> None:
        """Let go of the device; never raises for a device that is already gone."""
        ...


@dataclass(frozen=True, eq=False)
class Frame:
    """An image and when it was exposed.

    Attributes:
        image: uint8, shape (H, W) grey or (H, W, 3) BGR.
        exposed_at_s: start of exposure on the process's `Clock`.
        sequence: counts frames of the stream, gaps where frames were dropped.
    """

    image: NDArray[np.uint8]
    exposed_at_s: float
    sequence: int


class Camera(Device, Protocol):
    """A camera on the arm."""

    async def grab(self, not_before_s: float, timeout_s: float) -> Frame:
        """Return the first frame *exposed after* ``not_before_s`` (clock time); raises `FrameError` at the time-out."""
        ...


class RobotMode(StrEnum):
    """The controller's mode switch."""

    AUTO = "AUTO"
    T1 = "T1"
    T2 = "T2"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class RobotStatus:
    """What the controller says of itself; what a wire cannot tell is None.

    Attributes:
        pose: base_T_tcp.
        mode: mode switch.
        pendant_enabled: teach pendant on.
        servo_on: drives powered and no E-stop.
        moving: a command of ours is being carried out.
        override_percent: speed override, 1 to 100.
        fault: the controller's or its program's fault, or None.
        user_frame, user_tool: active frame numbers.
        session_owner: who owns the motion session, as far as the wire tells.
        read_at_s: clock time of the reading.
    """

    pose: Xyzwpr
    mode: RobotMode
    pendant_enabled: bool
    servo_on: bool
    moving: bool
    override_percent: int
    fault: str | None
    user_frame: int | None
    user_tool: int | None
    session_owner: str | None
    read_at_s: float


class RobotArm(Device, Protocol):
    """An arm that moves its TCP to poses in the base frame."""

    async def status(self) -> RobotStatus:
        """Read the controller's state; allowed while inactive and while a move is under way."""
        ...

    async def move_linear(self, target: Xyzwpr, speed_mm_s: float) -> Xyzwpr:
        """Move in a straight line, return the pose reported at the end (standing still).

        Raises:
            NotReadyError, CommandRejectedError: nothing has moved.
            MotionStoppedError: stopped on request on the way.
            DeviceFaultError: the motion ended in a fault.
            OutcomeUnknownError: silence, cut wire or nonsense after the command was sent.
        """
        ...

    async def move_joint(self, target: Xyzwpr, speed_percent: float) -> Xyzwpr:
        """Move joint-interpolated; otherwise as `move_linear`."""
        ...

    async def request_stop(self) -> None:
        """Ask the controller to stop the move in progress; acts at once, also while a move is awaited.

        A request, not a safety function. The interrupted move raises `MotionStoppedError` and is never continued.
        """
        ...

    async def reset_fault(self) -> None:
        """Ask the controller to reset its fault; only ever called on an operator's command. Moves nothing."""
        ...


@runtime_checkable
class DigitalIO(Protocol):
    """The robot's digital inputs and outputs, 1-based as on the pendant."""

    async def read_input(self, number: int) -> bool:
        """Read DI[number]."""
        ...

    async def read_output(self, number: int) -> bool:
        """Read DO[number] back."""
        ...

    async def write_output(self, number: int, *, on: bool) -> None:
        """Write DO[number]; raises `OutcomeUnknownError` where the write is not confirmed."""
        ...


class GripState(StrEnum):
    """What the gripper's sensors say."""

    OPEN = "open"
    HOLDING = "holding"
    CLOSED_EMPTY = "closed_empty"
    MOVING = "moving"
    UNKNOWN = "unknown"


class Gripper(Device, Protocol):
    """A parallel gripper that confirms by a sensor."""

    async def state(self) -> GripState:
        """Read the sensors."""
        ...

    async def open(self) -> None:
        """Open; returns when the sensors confirm, raises `OutcomeUnknownError` when they do not in time."""
        ...

    async def close(self) -> GripState:
        """Close; return HOLDING or CLOSED_EMPTY; raises `OutcomeUnknownError` when the sensors tell neither in time."""
        ...


class FindingLevel(StrEnum):
    """How a finding counts."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True)
class Finding:
    """One thing that a diagnosis has looked at.

    Attributes:
        check: what was looked at, in a few words.
        level: whether it is all right.
        detail: what was found: names, values, bounds.
        alarm: the registry's row; None where it is all right.
        remedy: what to do in this case; empty where the alarm's own remedy says it.
        facts: what was read, by name, for whoever compares it with something else: ``user_frame`` and ``user_tool`` of
            an arm, ``width`` and ``height`` of a camera's pictures.
    """

    check: str
    level: FindingLevel
    detail: str
    alarm: Alarm | None = None
    remedy: str = ""
    facts: Mapping[str, bool | float | str] = field(default_factory=dict)

    @classmethod
    def fine(cls, check: str, detail: str, **facts: bool | float | str) -> Finding:
        """Return the finding that something is all right."""
        return cls(check, FindingLevel.OK, detail, facts=facts)

    @classmethod
    def doubtful(cls, check: str, alarm: Alarm, detail: str, remedy: str = "") -> Finding:
        """Return the finding that something may not be as it should."""
        return cls(check, FindingLevel.WARNING, detail, alarm, remedy)

    @classmethod
    def failed(cls, check: str, error: AlarmError, remedy: str = "") -> Finding:
        """Return the finding that something keeps the cell from working."""
        return cls(check, FindingLevel.FAILED, error.detail, error.alarm, remedy)


@runtime_checkable
class Diagnosable(Protocol):
    """A device that can say what keeps it from working; optional.

    `diagnose` is called on a device that is disconnected, and leaves it so. It reads over a connection of its own;
    it moves nothing, writes no output, takes no motion control, resets no fault, starts and ends no program.
    """

    async def diagnose(self) -> Sequence[Finding]:
        """Look at everything, in the order in which it has to be put right; never raises `PortError`."""
        ...


@runtime_checkable
class InputPeek(Protocol):
    """An arm whose inputs can be read for a diagnosis while it is disconnected; optional."""

    async def peek_inputs(self, numbers: Sequence[int]) -> tuple[bool, ...]:
        """Read DI[number] of each; raises `PortError` where that cannot be without starting something."""
        ...


@dataclass(frozen=True)
class DriverContext:
    """What a driver's factory may use: the process's clock, and the arm's I/O for devices wired through the robot."""

    clock: Clock
    digital_io: DigitalIO | None = None


ConfigT = TypeVar("ConfigT", bound="BaseModel")


@runtime_checkable
class Counting(Protocol):
    """A device that counts what happens to it, for people and for metrics."""

    @property
    def counters(self) -> dict[str, int]:
        """Events since this process began, by name."""
        ...


@runtime_checkable
class KnowsItsPatience(Protocol):
    """A driver's config that says how long a reading may take before the driver gives the device up."""

    @property
    def longest_reading_s(self) -> float:
        """Seconds, what the reading may have to wait for on the same wire included."""
        ...


@dataclass(frozen=True)
class DriverSpec(Generic[ConfigT]):
    """What an entry point of the group ``srvs_cell.drivers`` yields.

    Attributes:
        config_model: pydantic model (``extra="forbid"``) of the driver's part of the YAML, without the key ``driver``.
        factory: makes the device from its config and the context; must not connect. A clock's factory ignores the
            context's clock.
    """

    config_model: type[ConfigT]
    factory: Callable[[ConfigT, DriverContext], Any]
