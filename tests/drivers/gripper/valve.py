"""A parallel gripper's valve, fingers and sensors behind digital I/O, in the time of a clock."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.gripper.robot_io import RobotIoGripperConfig

if TYPE_CHECKING:
    from srvs_cell.ports import Clock

CONFIG = RobotIoGripperConfig(
    close_output=11, open_output=12, held_input=21, open_input=22, closed_empty_input=23, timeout_s=2.0
)
TRAVEL_S = 0.4


class Valve:
    """DigitalIO of a robot with a gripper.

    Attributes:
        part: whether something is between the fingers.
        stuck: the fingers do not move.
        flickers: a closing gripper touches the part and loses it again.
        forced: DI -> what it reads whatever happens.
        writes: every output written, in order.
    """

    def __init__(self, clock: Clock) -> None:
        self.part = False
        self.stuck = False
        self.flickers = False
        self.forced: dict[int, bool] = {}
        self.writes: list[tuple[int, bool]] = []
        self.outputs = {CONFIG.close_output: False, CONFIG.open_output: True}
        self._clock = clock
        self._changed_at_s = clock.now_s() - 10.0

    async def read_input(self, number: int) -> bool:
        if number in self.forced:
            return self.forced[number]
        since_s = self._clock.now_s() - self._changed_at_s
        closing = self.outputs[CONFIG.close_output]
        if self.stuck or since_s < TRAVEL_S:
            touched = closing and self.flickers and TRAVEL_S / 2 <= since_s < TRAVEL_S / 2 + 0.06
            return touched and number == CONFIG.held_input
        on = CONFIG.open_input
        if closing:
            on = CONFIG.held_input if self.part else CONFIG.closed_empty_input
        return number == on

    async def read_output(self, number: int) -> bool:
        return self.outputs[number]

    async def write_output(self, number: int, *, on: bool) -> None:
        self.writes.append((number, on))
        if self.outputs[number] != on:
            self.outputs[number] = on
            self._changed_at_s = self._clock.now_s()
