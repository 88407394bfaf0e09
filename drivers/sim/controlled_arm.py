"""What the controller doubles need of the arm that they drive, and of simulated time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.ports import RobotMode


class MotionRefusedError(Exception):
    """The arm cannot begin a motion; the text says why."""


class ControlledArm(Protocol):
    """What the controller needs of the arm that it drives."""

    mode: RobotMode
    pendant_enabled: bool
    servo_on: bool
    override_percent: int

    @property
    def moving(self) -> bool:
        """Whether a motion is under way."""
        ...

    @property
    def stopped_short(self) -> bool:
        """Whether the last motion ended before its target."""
        ...

    @property
    def pose(self) -> Xyzwpr:
        """The reported base_T_tcp."""
        ...

    @property
    def fault(self) -> str | None:
        """The controller's alarm, spelt as on the pendant ("SRVO-050 ..."), or None."""
        ...

    def start_linear(self, target: Xyzwpr, speed_mm_s: float) -> None:
        """Begin a straight motion."""
        ...

    def start_joint(self, target: Xyzwpr, speed_percent: float) -> None:
        """Begin a joint motion."""
        ...

    def stop(self) -> None:
        """Decelerate to a stand."""
        ...

    def reset_fault(self) -> None:
        """Clear the fault."""
        ...

    def set_output(self, n: int, on: bool) -> None:
        """Switch DO[n]."""
        ...

    def output(self, n: int) -> bool:
        """Read DO[n]."""
        ...

    def input(self, n: int) -> bool:
        """Read DI[n]."""
        ...


@runtime_checkable
class JointedArm(Protocol):
    """An arm that knows its joints, and can be told to move them."""

    @property
    def joints_deg(self) -> tuple[float, ...]:
        """J1 to J6, J3 relative to link 2."""
        ...

    def start_joints(self, target_deg: Sequence[float], speed_percent: float) -> None:
        """Begin a joint motion to joint angles."""
        ...


class HoldableTime(Protocol):
    """The part of the simulated time that a server needs."""

    def hold(self) -> AbstractContextManager[None]:
        """Let simulated time stand still inside the block."""
        ...

    def hold_while(self, unread: Callable[[], bool]) -> None:
        """Let simulated time stand still also while ``unread`` says that something has come over a wire."""
        ...


class ControllerTime(HoldableTime, Protocol):
    """Simulated time for threads."""

    def now_s(self) -> float:
        """Return simulated seconds."""
        ...

    def sleep(self, seconds: float) -> None:
        """Return after ``seconds`` of simulated time."""
        ...
