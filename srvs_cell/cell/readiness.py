"""Reaching the devices, making them ready, watching the arm, forbidding motion. Nothing here moves anything."""

from __future__ import annotations

from typing import TYPE_CHECKING

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.cell.interlocks import check_frame, check_robot_ready
from srvs_cell.cell.notices import CELL
from srvs_cell.cell.packml import State
from srvs_cell.ports import DeviceFaultError, Lifecycle, PortError

if TYPE_CHECKING:
    from srvs_cell.cell.job import Equipment
    from srvs_cell.cell.notices import Notices
    from srvs_cell.ports import Device, RobotStatus

_ARM_WATCHED = frozenset(State) - {State.ABORTED, State.ABORTING, State.CLEARING}
_READINESS_WATCHED = frozenset(
    {
        State.STARTING,
        State.EXECUTE,
        State.UNHOLDING,
        State.SUSPENDING,
        State.SUSPENDED,
        State.UNSUSPENDING,
        State.COMPLETING,
    }
)


class Readiness:
    """The devices as the unit's states need them.

    Attributes:
        status: what the arm said last, or None where it does not answer.
    """

    def __init__(self, equipment: Equipment, notices: Notices) -> None:
        self.status: RobotStatus | None = None
        self._devices, self._parameters = equipment.devices, equipment.parameters
        self._calibration = equipment.calibration
        self._notices = notices

    async def connect(self) -> None:
        """Reach the devices, so that they can be read; an alarm for each that does not answer."""
        for name, device in self._devices.named():
            try:
                await device.connect()
            except PortError as error:
                self._notices.raise_alarm(AlarmError(error.alarm, f"{name}: {error.detail}"))
            self._notices.changed()

    async def clear(self) -> None:
        """Reach what cannot be reached, reset the controller's fault: both only because an operator has asked.

        The fault is reset before the gripper is reached: a gripper that is wired through the robot can be read only by
        a controller that is not in a fault.

        Raises:
            AlarmError: the first device's that does not answer, naming all of them; ROBOT_FAULT where the fault stays.
        """
        journal = self._notices.journal
        await self._notices.written(journal.event("clear", "devices", run=None, source=CELL, detail={}))
        failed = []
        for name, device in self._devices.named():
            try:
                if self._notices.contact_lost or device is self._devices.camera:
                    await device.disconnect()  # a camera that is open and not read does not tell that it is gone
                await self._reach(device)
                if device is self._devices.arm:
                    await self._end_fault()
            except PortError as error:
                failed.append((name, error))
        if failed:
            raise AlarmError(failed[0][1].alarm, " ".join(f"{name}: {error.detail}" for name, error in failed))
        self._notices.contact_lost = False

    async def allow_motion(self) -> None:
        """Make every device active, on an operator's command."""
        for _, device in self._devices.named():
            if device.lifecycle is not Lifecycle.ACTIVE:
                await device.activate()

    async def make_ready(self) -> None:
        """Allow motion and see whether the robot may be moved; raises as `check_robot_ready`."""
        await self.allow_motion()
        check_robot_ready(await self._read_status(), self._calibration.robot)

    async def check_camera(self) -> None:
        """See whether the camera delivers what the calibration is for; raises as `check_frame`."""
        not_before_s = self._devices.clock.now_s()
        frame = await self._devices.camera.grab(not_before_s, self._parameters.look.frame_timeout_s)
        check_frame(frame, not_before_s, self._calibration.camera)

    async def watch(self, state: State) -> None:
        """See what must not go unnoticed between motions.

        Raises:
            AlarmError: an arm that does not answer, is in fault or may not be moved, where that matters in ``state``.
        """
        if self._devices.arm.lifecycle is Lifecycle.DISCONNECTED and state not in _ARM_WATCHED:
            self.status = None
            return
        try:
            status = await self._read_status()
        except PortError:
            if state in _ARM_WATCHED:
                raise
            self.status = None
            return
        if state in _READINESS_WATCHED:
            check_robot_ready(status, self._calibration.robot)
        elif state in _ARM_WATCHED and status.fault is not None:
            raise AlarmError(Alarm.ROBOT_FAULT, f"The controller reports: {status.fault}.")

    def keep_status(self, status: RobotStatus) -> None:
        """Keep a status that somebody has read."""
        self.status = status
        self._notices.changed()

    async def forbid_motion(self) -> None:
        """Make arm and gripper inactive; what is held stays held."""
        await self._devices.arm.deactivate()
        await self._devices.gripper.deactivate()

    async def forbid_as_far_as_possible(self) -> None:
        """Make every device inactive that still answers; an alarm for each that does not."""
        for name, device in self._devices.named():
            if device.lifecycle is not Lifecycle.ACTIVE:
                continue
            try:
                await device.deactivate()
            except PortError as error:
                self._notices.raise_alarm(AlarmError(error.alarm, f"{name}: {error.detail}"))

    async def disconnect(self) -> None:
        """Let go of the devices."""
        for _, device in self._devices.named():
            await device.disconnect()

    async def _reach(self, device: Device) -> None:
        """Connect a device; an arm that does not answer is connected afresh."""
        if device is self._devices.arm and device.lifecycle is not Lifecycle.DISCONNECTED:
            try:
                await self._devices.arm.status()
            except PortError as error:
                detail = {"alarm": error.alarm.name, "detail": error.detail}
                journal = self._notices.journal
                await self._notices.written(
                    journal.event("device", "reconnect arm", run=None, source=CELL, detail=detail)
                )
                await device.disconnect()
        if device.lifecycle is Lifecycle.DISCONNECTED:
            await device.connect()

    async def _end_fault(self) -> None:
        """Reset the controller where it is in a fault; raises `DeviceFaultError` ROBOT_FAULT where the fault stays."""
        if (await self._read_status()).fault is None:
            return
        await self._devices.arm.reset_fault()
        status = await self._read_status()
        if status.fault is not None:
            raise DeviceFaultError(Alarm.ROBOT_FAULT, f"The controller still reports after a reset: {status.fault}.")

    async def _read_status(self) -> RobotStatus:
        status = await self._devices.arm.status()
        self.keep_status(status)
        return status
