"""Crowded tables in the simulated cell: every plan is carried out without touching anything else, or refused before.

    python benchmarks/crowded.py [--scenes 100] [--first 0] [--verbose] [--plan-only]

The real unit with its steps, planner, validator and journal drives the simulated arm and gripper in MuJoCo; only the
wires and the eyes are left out: the unit is told the true poses. Each scene has 5 to 10 parts at random places a few
millimetres apart that the camera shows whole; some are said to be of unknown shape. Plans keep to what all pictures
show, computed from the calibration of a drawn camera as in the cell. At every step of the physics the contacts are
looked at: hand against any part but the one it stands above, and any part against any other. With ``--plan-only``
nothing is carried out: what the planner says, and how much of it is proven.

That a refusal is true is looked up by a search of its own that knows only what the validator allows, with a far place
for each part to wait in: where even so there is no plan there is none.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import statistics
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from drivers.sim.arm import CLOSE_OUTPUT, HELD_INPUT, OPEN_INPUT, OPEN_OUTPUT, SimArm
from drivers.sim.controlled_arm import MotionRefusedError
from drivers.sim.doubles import FakeArm, FakeCamera, FakeGripper, StepClock
from drivers.sim.doubles import World as NoWorld
from drivers.sim.gripper_geometry import CameraMount, GripperGeometry
from drivers.sim.imperfections import LEVELS, make_camera, write_calibration
from drivers.sim.kinematics import Kinematics
from drivers.sim.parts import CUBOID, CYLINDER, KINDS, PRISM
from drivers.sim.scenario import ScenarioParameters, _shape
from drivers.sim.simulation import OBSERVE_POSE, TABLE_CENTRE_MM
from drivers.sim.world import World
from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.calibration import Calibration
from srvs_cell.cell import Command, Devices, Equipment, Journal, RunRecorder, Unit
from srvs_cell.config import parse_config
from srvs_cell.config.embedded import embedded_config
from srvs_cell.geometry import Transform
from srvs_cell.planning import Problem, RankGoal, Workspace, has_plan, plan_relocation, validate
from srvs_cell.planning.clearance import convex_hull, too_close
from srvs_cell.planning.problem import Polygon
from srvs_cell.ports import CommandRejectedError, DeviceFaultError, GripState
from srvs_cell.scene import UNKNOWN_KIND, Grasp, Move, Perception, Place, PlaceKind, PlaneImage, PlanStatus, Workpiece
from srvs_cell.service.common_view import CommonView

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.sim.parts import Part
    from srvs_cell.cell import StereoLook
    from srvs_cell.config import CellConfig
    from srvs_cell.geometry import Xyzwpr
    from srvs_cell.planning import CellPlan, KeptPlaces

WIDTH_PX, HEIGHT_PX = 640, 480
HALF_TABLE_MM = (115.0, 145.0)
GAPS_MM = (4.0, 20.0)
UNKNOWN_SHARE = 0.1
GRASP_DEPTH_MM, GRASP_LEAST_MM, WIDEST_MM = 12.0, 3.0, 80.0
OTHER_TURNS_DEG = {CYLINDER: (90.0, 45.0, 135.0), PRISM: (60.0, 120.0)}
SIGMA_MM = 0.3
FALLEN_DEG = 5.0
GRIP_STEPS, SETTLE_STEPS = 1500, 75
LOOK_EVERY = 3
"""Time steps of 2 ms between two looks at the contacts: 1.5 mm of the fastest travel."""

BETWEEN_FINGERS_MM = 8.0
DISTURBED_MM = 1.0
AS_WANTED = {
    "carried out",
    "refused",
    "refused, truly",
    "refused, not looked up",
    "planned, proven",
    "planned, moves proven",
    "planned",
}
REFUSALS = {"PLAN_INFEASIBLE", "NO_BUFFER_PLACE", "UNCERTAIN_POSITION"}
RIGHT_MM = 5.0
MOST_STATES = 5000
"""Arrangements that are looked at for a refusal."""


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("--plan-only", action="store_true")
    arguments = parser.parse_args()
    results = []
    for seed in range(arguments.first, arguments.first + arguments.scenes):
        result = run_scene(seed, plan_only=arguments.plan_only)
        results.append(result)
        if arguments.verbose or result.contacts or result.how not in AS_WANTED:
            print(f"seed {seed}: {result.parts} parts, {result.how}, {result.moves} moves, {result.said}", flush=True)
            for contact, count in result.contacts.items():
                print(f"    {contact}: {count} steps", flush=True)
    how = Counter(result.how for result in results)
    reasons = Counter(result.alarm for result in results if result.how.startswith("refused"))
    print(f"{len(results)} scenes, {sum(result.parts for result in results)} parts: {dict(how)}")
    print(f"refused with: {dict(reasons)}")
    print(f"moves: {sum(result.moves for result in results)}")
    print(f"scenes with a contact: {sum(bool(result.contacts) for result in results)}")
    for count in sorted({result.parts for result in results if result.plan_s is not None}):
        times_s = [result.plan_s for result in results if result.parts == count and result.plan_s is not None]
        print(
            f"planning {count:2} parts, processor s: median {statistics.median(times_s):.2f}, worst {max(times_s):.2f}"
        )


@dataclass
class Result:
    """What became of a scene."""

    parts: int
    how: str
    alarm: str
    said: str
    moves: int
    contacts: Counter[str]
    plan_s: float | None = None


@dataclass
class Physics:
    """World and arm, stepped by whoever waits for them."""

    world: World
    arm: SimArm
    contacts: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        """Look up the geoms."""
        model = self.world.model
        self.names = [model.geom(i).name for i in range(model.ngeom)]
        self.is_part = np.array([name.startswith("part") for name in self.names])
        self.is_table = np.array([name == "table" for name in self.names])
        self.steps = 0

    def step(self) -> None:
        """Go on by one time step and look at the contacts now and then."""
        self.arm.step()
        self.world.step()
        self.steps += 1
        if self.steps % LOOK_EVERY:
            return
        geoms = self.world._data.contact.geom  # noqa: SLF001 - the world tells of forces, not of contacts
        geoms = geoms[self.is_part[geoms].any(axis=1) & ~self.is_table[geoms].any(axis=1)]
        if not len(geoms):
            return
        touching = {tuple(sorted(self.names[geom] for geom in pair)) for pair in geoms.tolist()}
        tcp = self.world.base_T_tcp[:2, 3]
        distance = [np.linalg.norm(pose.base_T_part[:2, 3] - tcp) for pose in self.world.part_poses()]
        for one, other in touching:
            if one.startswith("finger") and distance[int(other.removeprefix("part"))] < BETWEEN_FINGERS_MM:
                continue
            self.contacts[f"{one} touches {other}"] += 1


class PhysicsArm(FakeArm):
    """The arm's port straight onto the simulated arm."""

    def __init__(self, clock: StepClock, physics: Physics) -> None:
        super().__init__(clock, NoWorld([]), physics.arm.pose)
        self._physics = physics

    async def _move(self, target: Xyzwpr, speed_mm_s: float) -> Xyzwpr:
        arm = self._physics.arm
        try:
            arm.start_linear(target, speed_mm_s)
        except MotionRefusedError as error:
            raise CommandRejectedError(Alarm.TARGET_UNREACHABLE, f"{error}: {target}.") from error
        while arm.moving:
            self._physics.step()
        self.pose = arm.pose
        if arm.fault is not None:
            self.present = replace(self.present, fault=arm.fault)
            raise DeviceFaultError(Alarm.COLLISION, f"{arm.fault}.")
        return self.pose


class PhysicsGripper(FakeGripper):
    """The gripper's port straight onto the simulated gripper."""

    def __init__(self, clock: StepClock, physics: Physics, arm: PhysicsArm) -> None:
        super().__init__(clock, NoWorld([]), arm)
        self._physics = physics

    async def state(self) -> GripState:
        """Read the sensors."""
        arm = self._physics.arm
        if arm.input(HELD_INPUT):
            return GripState.HOLDING
        return GripState.OPEN if arm.input(OPEN_INPUT) else GripState.CLOSED_EMPTY

    async def open(self) -> None:
        """Open and wait for the sensor."""
        self._switch(OPEN_OUTPUT, CLOSE_OUTPUT)
        self._wait(lambda: self._physics.arm.input(OPEN_INPUT))

    async def close(self) -> GripState:
        """Close and wait for the sensor."""
        self._switch(CLOSE_OUTPUT, OPEN_OUTPUT)
        self._wait(lambda: self._physics.arm.input(HELD_INPUT))
        return await self.state()

    def _switch(self, on: int, off: int) -> None:
        self._physics.arm.set_output(off, on=False)
        self._physics.arm.set_output(on, on=True)

    def _wait(self, reached: Any) -> None:
        settled = 0
        for _ in range(GRIP_STEPS):
            self._physics.step()
            settled = settled + 1 if reached() else 0
            if settled >= SETTLE_STEPS:
                return


def crowded_parts(random: np.random.Generator, view: CommonView) -> tuple[Part, ...]:
    """Return 5 to 10 parts in view, each at least a random gap away from every other, room for fingers or not."""
    limits = ScenarioParameters()
    while True:
        count = int(random.integers(5, 11))
        gap_mm = random.uniform(*GAPS_MM)
        placed: list[Part] = []
        for _ in range(count):
            height_mm = float(random.uniform(*limits.height_mm))
            kind = KINDS[int(random.integers(len(KINDS)))]
            part = _shape(kind, height_mm, count, random, limits)
            for _ in range(200):
                x_mm, y_mm = random.uniform(-1.0, 1.0, 2) * HALF_TABLE_MM + TABLE_CENTRE_MM[:2]
                trial = replace(part, x_mm=float(x_mm), y_mm=float(y_mm))
                if _in_view(trial, view) and not any(_near(trial, other, gap_mm) for other in placed):
                    placed.append(trial)
                    break
        if len(placed) == count:
            return tuple(placed)


def _in_view(part: Part, view: CommonView) -> bool:
    """Tell whether both pictures from the observe pose show the whole of a part, foot and top."""
    at_mm = part.footprint_mm() + np.array([part.x_mm, part.y_mm])
    solid = [np.column_stack([at_mm, np.full(len(at_mm), height_mm)]) for height_mm in (0.0, part.height_mm)]
    return bool(view.sees(np.concatenate(solid), from_aside=False).all())


def _near(one: Part, other: Part, gap_mm: float) -> bool:
    a, b = (Polygon(tuple(map(tuple, convex_hull(part.footprint_mm()).tolist()))) for part in (one, other))
    displacement = np.array([[other.x_mm - one.x_mm, other.y_mm - one.y_mm]])
    return bool(too_close(a, b, displacement, gap_mm)[0])


def true_workpieces(world: World, unknown: Sequence[bool]) -> tuple[Workpiece, ...]:
    """Return what perfect eyes would see, with grasps by the rules of the vision."""
    found = []
    for number, (part, pose, hidden) in enumerate(zip(world.parts, world.part_poses(), unknown, strict=True)):
        base_T_part = pose.base_T_part
        top = base_T_part[:3, :3] @ part.top_centre_mm + base_T_part[:3, 3]
        turned = base_T_part[:2, :2]
        footprint = convex_hull(part.outline_mm() @ turned.T + base_T_part[:2, 3])
        grasp, refusal = _grasp(part, pose.yaw_deg, (float(top[0]), float(top[1])), world.table_z_mm)
        known = not hidden and pose.tilt_deg < FALLEN_DEG
        found.append(
            Workpiece(
                id=number,
                kind=part.kind if known else UNKNOWN_KIND,
                position_mm=(float(top[0]), float(top[1]), float(top[2])),
                height_mm=part.height_mm,
                yaw_deg=None if part.kind == CYLINDER else pose.yaw_deg,
                size_mm=(part.length_mm, part.width_mm),
                covariance_mm2=np.eye(3) * SIGMA_MM**2,
                footprint_mm=footprint,
                surfaces=(number,),
                grasp=grasp if known else None,
                grasp_refusal=refusal,
            )
        )
    return tuple(found)


def _grasp(part: Part, yaw_deg: float, point_mm: tuple[float, float], table_z_mm: float) -> tuple[Grasp | None, str]:
    if part.grip_width_mm > WIDEST_MM:
        return None, f"too wide: {part.grip_width_mm:.1f} mm"
    wall_mm = float(part.top_centre_mm[2])
    tips_mm = max(GRASP_LEAST_MM, wall_mm - GRASP_DEPTH_MM)
    closing_deg = yaw_deg + part.grip_yaw_deg - part.yaw_deg
    others = [(turn_deg, part.grip_width_mm) for turn_deg in OTHER_TURNS_DEG.get(part.kind, ())]
    if part.kind == CUBOID and part.length_mm <= WIDEST_MM:
        others.append((90.0, part.length_mm))
    first, *further = (
        Grasp((*point_mm, table_z_mm + tips_mm), (closing_deg + turn_deg) % 180.0, opening_mm)
        for turn_deg, opening_mm in [(0.0, part.grip_width_mm), *others]
    )
    return replace(first, others=tuple(further)), ""


def run_scene(seed: int, *, plan_only: bool) -> Result:
    """Plan one scene and carry it out."""
    random = np.random.default_rng([seed, 77])
    config = parse_config(embedded_config(), "embedded")
    calibration = drawn_calibration(np.random.default_rng([seed, 78]))
    view = CommonView.of(config.cell, calibration)
    parts = crowded_parts(random, view)
    unknown = (random.random(len(parts)) < UNKNOWN_SHARE).tolist()
    gripper = GripperGeometry()
    world = World(parts, gripper, TABLE_CENTRE_MM, Transform.from_xyzwpr("base", "tcp", OBSERVE_POSE).matrix)
    clock = SimpleNamespace(lock=threading.RLock())
    arm = SimArm(
        clock,  # type: ignore[arg-type]
        world,
        Kinematics(gripper.flange_to_tcp_mm),
        OBSERVE_POSE,
        LEVELS["real"].repeatability,
        random,
    )
    physics = Physics(world, arm)
    for _ in range(SETTLE_STEPS):
        physics.step()
    # Perfect eyes need no second look; that the cell looks after each move changes nothing but the time.
    look = replace(config.cell.look, agreeing_looks=1, verify="each_plan")
    config = replace(config, cell=replace(config.cell, look=look, unmovable_parts="leave"))
    if plan_only:
        return _planned(config, view, true_workpieces(world, unknown))
    with tempfile.TemporaryDirectory(prefix="srvs-") as folder:
        return asyncio.run(_run(config, calibration, view, physics, unknown, Path(folder)))


def drawn_calibration(random: np.random.Generator) -> Calibration:
    """Return what the calibration file says of a camera of the simulated cell; the arm here knows no frame numbers."""
    with tempfile.TemporaryDirectory(prefix="srvs-") as folder:
        path = Path(folder) / "calibration.yaml"
        write_calibration(make_camera(LEVELS["real"], CameraMount().transform(), random), path)
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    del content["robot"]
    return Calibration.from_mapping(content, path.name)


def _plan(
    config: CellConfig, view: CommonView, workpieces: Sequence[Workpiece], kept: KeptPlaces | None = None
) -> CellPlan:
    box = config.cell.workspace
    workspace = Workspace(*box.x_mm, *box.y_mm, view)
    return plan_relocation(workpieces, config.planning, workspace, hand=config.cell.hand(), kept=kept)


def is_possible(problem: Problem) -> bool | None:
    """Tell whether a problem has a plan with a far place for each part to wait in, by what the validator allows.

    None where that is too much to look at.
    """
    count = len(problem.places)
    far = tuple(Place(count + item.id, 1e4 + 1e3 * item.id, 1e4, PlaceKind.BUFFER) for item in problem.objects)
    wide = replace(problem, places=problem.places + far)
    if isinstance(problem.goal, RankGoal):
        goals = [_ranks(problem.goal, item.height_mm, problem) for item in problem.objects]
    else:
        goals = list(problem.goal.allowed)
    start = tuple(item.start for item in problem.objects)
    waiting, seen = [start], {start}
    while waiting and len(seen) < MOST_STATES:
        stands = waiting.pop()
        here = replace(wide, objects=tuple(replace(i, start=p) for i, p in zip(wide.objects, stands, strict=True)))
        if not validate(here, []):
            return True
        for item, origin in enumerate(stands):
            for target in goals[item] | {count + item}:
                after = (*stands[:item], target, *stands[item + 1 :])
                # Waiting hinders nobody: whoever has left his place for another goal can as well wait.
                if after in seen or (origin != start[item] and origin < count):
                    continue
                if not any(said.startswith("move 1") for said in validate(here, [Move(item, origin, target)])):
                    seen.add(after)
                    waiting.append(after)
    return None if waiting else False


def _ranks(goal: RankGoal, height_mm: float, problem: Problem) -> frozenset[int]:
    """Return the slots on which a part of a height may end: those certainly taller stand before, lower ones behind."""
    first = sum(other.height_mm > height_mm + goal.tolerance_mm for other in problem.objects)
    behind = sum(other.height_mm < height_mm - goal.tolerance_mm for other in problem.objects)
    return frozenset(goal.slots[first : len(goal.slots) - behind])


def _refused(problem: Problem) -> str:
    """Return what a refusal is found to be."""
    possible = is_possible(problem)
    return "refused, not looked up" if possible is None else "refused, falsely" if possible else "refused, truly"


def _planned(config: CellConfig, view: CommonView, workpieces: Sequence[Workpiece]) -> Result:
    """Say what the planner makes of a scene."""
    began_s = time.process_time()
    try:
        made = _plan(config, view, workpieces)
    except AlarmError as error:
        if error.alarm.name not in REFUSALS:
            raise
        plan_s = time.process_time() - began_s
        return Result(len(workpieces), "refused", error.alarm.name, error.detail, 0, Counter(), plan_s)
    plan_s = time.process_time() - began_s
    answer = made.relocation
    if not has_plan(answer):
        infeasible = answer.status is PlanStatus.INFEASIBLE
        how = _refused(made.table.problem) if infeasible else "search ended at its cap"
        return Result(len(workpieces), how, "PLAN_INFEASIBLE", "; ".join(answer.reasons), 0, Counter(), plan_s)
    proven = ", proven" if answer.travel_proven else ", moves proven" if answer.moves_proven else ""
    return Result(len(workpieces), f"planned{proven}", "", "", len(made.moves), Counter(), plan_s)


async def _run(
    config: CellConfig,
    calibration: Calibration,
    view: CommonView,
    physics: Physics,
    unknown: Sequence[bool],
    folder: Path,
) -> Result:
    clock = StepClock()
    arm = PhysicsArm(clock, physics)
    journal = Journal(folder / "journal.sqlite")
    plans: list[CellPlan] = []

    def perceive(_: StereoLook) -> Perception:
        image = PlaneImage(np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8), np.zeros((HEIGHT_PX, WIDTH_PX), np.int32), ())
        nothing = np.full((HEIGHT_PX, WIDTH_PX), np.nan, np.float32)
        return Perception(image, image, (), nothing, (), true_workpieces(physics.world, unknown), {})

    def plan(workpieces: Sequence[Workpiece], kept: KeptPlaces | None) -> CellPlan:
        plans.append(_plan(config, view, workpieces, kept))
        return plans[-1]

    equipment = Equipment(
        parameters=config.cell,
        devices=Devices(clock, FakeCamera(clock, (WIDTH_PX, HEIGHT_PX)), arm, PhysicsGripper(clock, physics, arm)),
        journal=journal,
        recorder=RunRecorder(folder),
        calibration=calibration,
        perceive=perceive,
        plan=plan,
        pictures=lambda _: {},
    )
    unit = Unit(equipment, simulation=True)
    task = asyncio.create_task(unit.run())
    try:
        end = await _job(unit)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await unit.close()
    return _judge(physics, unit.snapshot(), end, plans)


async def _job(unit: Unit) -> str:
    """Do one job; return the state in which it ended."""
    version = -1
    while unit.snapshot()["devices"]["gripper"]["lifecycle"] == "disconnected":
        version = await unit.wait_change(version)
    for command, states in (
        (Command.CLEAR, {"Stopped"}),
        (Command.RESET, {"Idle"}),
        (Command.START, {"Complete", "Held", "Aborted", "Stopped", "Suspended"}),
    ):
        answer = await unit.command(command, "benchmark")
        if not answer.accepted:
            raise RuntimeError(str(answer))
        version = -1
        while unit.snapshot()["state"] not in states:
            version = await unit.wait_change(version)
    return str(unit.snapshot()["state"])


def _judge(physics: Physics, snapshot: dict[str, Any], end: str, plans: list[CellPlan]) -> Result:
    alarms = [
        alarm for alarm in snapshot["alarms"] if alarm["name"] not in {"UNKNOWN_OBJECT", "PART_LEFT", "PLAN_NOT_PROVEN"}
    ]
    alarm = alarms[-1]["name"] if alarms else ""
    said = "; ".join(f"{one['name']}: {one['detail']}" for one in alarms)
    moves = int(snapshot["moves_done"])
    how = f"ended {end}"
    if end == "Complete":
        how = "carried out"
        wrong = _wrong(physics.world, plans[0])
        if wrong:
            how, said = "carried out wrongly", wrong
    elif end == "Held" and moves == 0 and alarm in REFUSALS:
        how = _refused(plans[0].table.problem) if plans else "refused"
    return Result(len(physics.world.parts), how, alarm, said, moves, physics.contacts)


def _wrong(world: World, plan: CellPlan) -> str:
    """Return which parts do not stand where the plan wants them, or were moved although they should stay."""
    poses = world.part_poses()
    goals = {goal.workpiece: goal.point_mm for goal in plan.goals}
    moved = {move.workpiece for move in plan.moves}
    wrong = []
    for number, (pose, start) in enumerate(zip(poses, world.start_poses, strict=True)):
        if pose.tilt_deg > FALLEN_DEG:
            wrong.append(f"part {number} has fallen")
        hull = convex_hull(world.parts[number].outline_mm() @ pose.base_T_part[:2, :2].T + pose.base_T_part[:2, 3])
        if number in goals and math.dist(hull.mean(axis=0), goals[number]) > RIGHT_MM:
            wrong.append(f"part {number} is not at its goal")
        if number not in moved and math.dist(pose.base_T_part[:2, 3], start.base_T_part[:2, 3]) > DISTURBED_MM:
            wrong.append(f"part {number} was moved")
    return "; ".join(wrong)


if __name__ == "__main__":
    main()
