"""A whole unit on object-level doubles: real journal, real planner, real steps; only the pixels are missing."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.sim.doubles import Block, FakeArm, FakeCamera, FakeGripper, StepClock, World
from srvs_cell.calibration import Calibration, CameraIntrinsics, HandEye
from srvs_cell.cell import Command, Devices, Equipment, Journal, RunRecorder, StereoLook, Unit
from srvs_cell.config import CellParameters, LookParameters, PoseParameters, WorkspaceBox
from srvs_cell.geometry import Xyzwpr
from srvs_cell.planning import CellPlan, KeptPlaces, PlanningParameters, Workspace, plan_relocation
from srvs_cell.scene import Grasp, Perception, PlaneImage, Workpiece

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Sequence
    from pathlib import Path

WIDTH_PX, HEIGHT_PX = 64, 48
OBSERVE = Xyzwpr(300.0, 0.0, 400.0, 180.0, 0.0, 0.0)
COVARIANCE_MM2 = np.eye(3)

CALIBRATION = Calibration(
    camera=CameraIntrinsics(
        width=WIDTH_PX, height=HEIGHT_PX, fx=60.0, fy=60.0, cx=31.5, cy=23.5, distortion=(0.0, 0.0, 0.0, 0.0, 0.0)
    ),
    hand_eye=HandEye(xyz_mm=(0.0, 80.0, -60.0), wpr_deg=(0.0, 0.0, 0.0)),
)
PARAMETERS = CellParameters(
    look=LookParameters(
        observe_pose=PoseParameters(xyz_mm=(300.0, 0.0, 400.0), wpr_deg=(180.0, 0.0, 0.0)), baseline_mm=30.0
    ),
    workspace=WorkspaceBox(x_mm=(0.0, 600.0), y_mm=(-300.0, 300.0), z_mm=(0.0, 500.0)),
    table_z_mm=0.0,
)


def three_blocks() -> list[Block]:
    """Return three blocks whose order of height is wrong: the lowest stands at the largest y."""
    return [
        Block("low", 300.0, 120.0, 30.0),
        Block("middle", 300.0, 0.0, 45.0),
        Block("tall", 300.0, -120.0, 60.0),
    ]


def standing(cell: Cell) -> set[tuple[float, float]]:
    """Return where the blocks stand."""
    return {(round(block.x_mm, 1), round(block.y_mm, 1)) for block in cell.world.blocks}


def seen(world: World, covariance_mm2: np.ndarray[Any, np.dtype[np.float64]] = COVARIANCE_MM2) -> Perception:
    """Return what a perfect eye perceives of the blocks that stand on the table."""
    standing = [block for block in world.blocks if world.held is None or world.held[0] is not block]
    image = PlaneImage(np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8), np.zeros((HEIGHT_PX, WIDTH_PX), np.int32), ())
    workpieces = tuple(
        Workpiece(
            id=i,
            kind="cuboid",
            position_mm=(block.x_mm, block.y_mm, world.table_z_mm + block.height_mm),
            height_mm=block.height_mm,
            yaw_deg=block.yaw_deg % 180.0,
            size_mm=(block.length_mm, block.width_mm),
            covariance_mm2=covariance_mm2,
            footprint_mm=_footprint_mm(block),
            surfaces=(i,),
            grasp=Grasp(
                (block.x_mm, block.y_mm, world.table_z_mm + block.height_mm - 15.0),
                block.yaw_deg + 90.0,
                block.width_mm,
            ),
        )
        for i, block in enumerate(standing)
    )
    disparity = np.full((HEIGHT_PX, WIDTH_PX), np.nan, np.float32)
    return Perception(image, image, (), disparity, (), workpieces, {"recognition": 1.0})


def _footprint_mm(block: Block) -> np.ndarray[Any, np.dtype[np.float64]]:
    signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    cos, sin = np.cos(np.deg2rad(block.yaw_deg)), np.sin(np.deg2rad(block.yaw_deg))
    corners = signs * (block.length_mm / 2, block.width_mm / 2) @ np.array([[cos, sin], [-sin, cos]])
    footprint: np.ndarray[Any, np.dtype[np.float64]] = corners + np.array([block.x_mm, block.y_mm])
    return footprint


@dataclass
class Cell:
    """A unit with everything that a test may turn."""

    unit: Unit
    clock: StepClock
    world: World
    arm: FakeArm
    camera: FakeCamera
    gripper: FakeGripper
    journal: Journal

    @property
    def state(self) -> str:
        return self.unit.state.title

    @property
    def alarms(self) -> list[str]:
        return [alarm["name"] for alarm in self.unit.snapshot()["alarms"]]

    async def reaches(self, *states: str) -> str:
        """Wait until one of the states is reached; the test's time-out is the limit."""
        version = -1
        while self.state not in states:
            version = await self.unit.wait_change(version)
        return self.state

    async def until(self, key: str, value: object) -> None:
        """Wait until the snapshot has a value under a key."""
        version = -1
        while self.unit.snapshot()[key] != value:
            version = await self.unit.wait_change(version)

    async def give(self, *commands: Command) -> None:
        """Give commands that must be accepted."""
        for command in commands:
            answer = await self.unit.command(command, "test")
            assert answer.accepted, answer

    async def to_idle(self) -> None:
        await self.give(Command.CLEAR)
        await self.reaches("Stopped")
        await self.give(Command.RESET)
        await self.reaches("Idle")

    async def start(self) -> None:
        await self.to_idle()
        await self.give(Command.START)


def build(
    tmp_path: Path,
    blocks: Sequence[Block] | None = None,
    parameters: CellParameters = PARAMETERS,
    planning: PlanningParameters = PlanningParameters(),  # noqa: B008 - frozen
) -> Cell:
    """Return a cell that is not running yet."""
    world = World(list(three_blocks() if blocks is None else blocks))
    clock = StepClock()
    arm = FakeArm(clock, world, OBSERVE)
    camera = FakeCamera(clock, (WIDTH_PX, HEIGHT_PX))
    gripper = FakeGripper(clock, world, arm)
    journal = Journal(tmp_path / "journal.sqlite")
    workspace = Workspace(0.0, 600.0, -300.0, 300.0)

    def perceive(_: StereoLook) -> Perception:
        return seen(world)

    def plan(workpieces: Sequence[Workpiece], kept: KeptPlaces | None) -> CellPlan:
        return plan_relocation(workpieces, planning, workspace, hand=parameters.hand(), kept=kept)

    equipment = Equipment(
        parameters=parameters,
        devices=Devices(clock, camera, arm, gripper),
        journal=journal,
        recorder=RunRecorder(tmp_path),
        calibration=CALIBRATION,
        perceive=perceive,
        plan=plan,
        pictures=lambda _: {},
    )
    return Cell(Unit(equipment, simulation=True), clock, world, arm, camera, gripper, journal)


@asynccontextmanager
async def running(cell: Cell) -> AsyncIterator[Cell]:
    """Run the unit while a test looks at it."""
    task = asyncio.create_task(cell.unit.run())
    try:
        yield cell
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await cell.unit.close()


async def connected(cell: Cell) -> None:
    """Wait until the unit has reached its devices."""
    version = -1
    while cell.unit.snapshot()["devices"]["gripper"]["lifecycle"] == "disconnected":
        version = await cell.unit.wait_change(version)


ENDS = ("Complete", "Held", "Stopped", "Aborted", "Suspended")


async def job(cell: Cell) -> str:
    """Connect, start a job and return the state that it ends in."""
    await connected(cell)
    await cell.start()
    return await cell.reaches(*ENDS)


def see(cell: Cell, as_seen: Callable[[int, StereoLook, Perception], Perception]) -> None:
    """Let looks, counted from 0, see what a function makes of what is there."""
    plain, number = cell.unit.equipment.perceive, count()
    equipment = replace(cell.unit.equipment, perceive=lambda look: as_seen(next(number), look, plain(look)))
    cell.unit = Unit(equipment, simulation=True)


async def in_step(cell: Cell, step: str, *, moves_done: int = 0) -> None:
    """Wait until the arm is moving in a step of a job."""
    version = -1
    while True:
        snapshot = cell.unit.snapshot()
        if snapshot["step"] == step and snapshot["moves_done"] >= moves_done and (await cell.arm.status()).moving:
            return
        version = await cell.unit.wait_change(version)
