"""What an integrator sets of the cell itself: where it looks, how it moves, what it tolerates, how long it waits."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from srvs_cell.geometry import Xyzwpr
from srvs_cell.planning import HandMotion

_STRICT = ConfigDict(extra="forbid")

Millimetre = Annotated[float, Field(ge=-5000.0, le=5000.0)]
Degree = Annotated[float, Field(ge=-360.0, le=360.0)]


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class PoseParameters:
    """A pose as on the pendant: millimetres, and W, P, R in degrees about the fixed axes of the base frame."""

    xyz_mm: Annotated[
        tuple[Millimetre, Millimetre, Millimetre], Field(description="X, Y, Z of the TCP in the base frame")
    ]
    wpr_deg: Annotated[tuple[Degree, Degree, Degree], Field(description="W, P, R; 180, 0, R points the tool down")]

    def pose(self) -> Xyzwpr:
        """Return the pose."""
        return Xyzwpr(*self.xyz_mm, *self.wpr_deg)


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class WorkspaceBox:
    """The box that the TCP may be in, base frame. A process check, not a safety function."""

    x_mm: Annotated[tuple[Millimetre, Millimetre], Field(description="least and greatest X of the TCP")]
    y_mm: Annotated[tuple[Millimetre, Millimetre], Field(description="least and greatest Y of the TCP")]
    z_mm: Annotated[tuple[Millimetre, Millimetre], Field(description="least and greatest Z of the TCP")]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for key in ("x_mm", "y_mm", "z_mm"):
            least, greatest = getattr(self, key)
            if least >= greatest:
                raise ValueError(f"{key}: {least} is not less than {greatest}")
        return self

    def violation(self, pose: Xyzwpr) -> str:
        """Return which coordinate of a TCP pose lies outside and by which bound, or an empty string."""
        for name, value, (least, greatest) in (
            ("X", pose.x_mm, self.x_mm),
            ("Y", pose.y_mm, self.y_mm),
            ("Z", pose.z_mm, self.z_mm),
        ):
            if not least <= value <= greatest:
                return f"{name} = {value:.1f} mm is outside {least:.1f} to {greatest:.1f} mm"
        return ""


Offset = Annotated[float, Field(ge=-100.0, le=100.0)]


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class LookParameters:
    """The lateral path and what is taken on it."""

    observe_pose: Annotated[PoseParameters, Field(description="TCP pose at the left end of the lateral path")]
    baseline_mm: Annotated[
        float, Field(gt=0.0, le=500.0, description="length of the lateral path, along the camera's x axis")
    ]
    settle_s: Annotated[
        float, Field(ge=0.0, le=10.0, description="wait between standing still and the exposure of a frame")
    ] = 0.2
    frame_timeout_s: Annotated[float, Field(gt=0.0, le=60.0, description="longest wait for a fresh frame")] = 2.0
    agreeing_looks: Annotated[
        int, Field(ge=1, le=5, description="looks in a row that must see the same parts before one is moved")
    ] = 1
    verify: Annotated[
        Literal["each_move", "each_plan"],
        Field(description="when what was planned is compared with a look: after each move, or after the last one only"),
    ] = "each_move"
    aside_mm: Annotated[
        tuple[Offset, Offset],
        Field(description="how far aside a doubtful look is repeated, along the camera's x and y axes"),
    ] = (15.0, 15.0)
    look_again_s: Annotated[
        float, Field(ge=0.1, le=3600.0, description="interval of looking again while nothing is in view")
    ] = 5.0


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class MotionParameters:
    """How the arm moves."""

    joint_speed_percent: Annotated[
        float, Field(gt=0.0, le=100.0, description="speed of joint moves to the observe pose")
    ] = 20.0
    travel_speed_mm_s: Annotated[float, Field(gt=0.0, le=4000.0, description="speed of straight moves above parts")] = (
        250.0
    )
    approach_speed_mm_s: Annotated[
        float, Field(gt=0.0, le=1000.0, description="speed down to a part and up from it, and of the lateral move")
    ] = 80.0
    speed_limit_mm_s: Annotated[
        float, Field(gt=0.0, le=4000.0, description="no straight move is commanded faster than this")
    ] = 500.0
    approach_mm: Annotated[
        float, Field(gt=0.0, le=500.0, description="height above the grasp where the slow descent begins")
    ] = 60.0
    clearance_mm: Annotated[
        float, Field(gt=0.0, le=500.0, description="between the tallest part and whatever travels above it")
    ] = 30.0
    release_gap_mm: Annotated[
        float, Field(ge=0.0, le=20.0, description="height above the table at which a part is let go")
    ] = 1.0
    jaw_axis: Annotated[Literal["x", "y"], Field(description="axis of the TCP frame along which the jaws close")] = "y"
    stop_timeout_s: Annotated[
        float, Field(gt=0.0, le=60.0, description="longest time from a requested stop to standstill")
    ] = 5.0

    @model_validator(mode="after")
    def _within_limit(self) -> Self:
        for key in ("travel_speed_mm_s", "approach_speed_mm_s"):
            if getattr(self, key) > self.speed_limit_mm_s:
                raise ValueError(f"{key} = {getattr(self, key)} is above speed_limit_mm_s = {self.speed_limit_mm_s}")
        return self


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class ToleranceParameters:
    """What is good enough."""

    grasp_mm: Annotated[
        float, Field(gt=0.0, le=100.0, description="horizontal position error that a grasp survives, at two sigma")
    ] = 5.0
    grasp_height_mm: Annotated[
        float, Field(gt=0.0, le=100.0, description="vertical position error that a grasp survives, at two sigma")
    ] = 8.0
    verify_mm: Annotated[
        float, Field(gt=0.0, le=100.0, description="distance from the goal at which a part counts as placed")
    ] = 5.0
    verify_height_mm: Annotated[
        float, Field(gt=0.0, le=100.0, description="difference in height at which a part counts as the same one")
    ] = 8.0
    verify_deg: Annotated[
        float, Field(gt=0.0, le=90.0, description="turn at which a part counts as standing as it was put")
    ] = 10.0


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class RetryParameters:
    """How often a step is tried again before an operator is asked."""

    grip: Annotated[
        int, Field(ge=0, le=10, description="looks and new plans after grips that came up empty, or lost their part")
    ] = 2
    frame: Annotated[int, Field(ge=0, le=10, description="further grabs after a frame that did not come")] = 1
    look: Annotated[
        int, Field(ge=0, le=10, description="further looks when a position is uncertain, or a part cannot be taken")
    ] = 1
    verify: Annotated[
        int, Field(ge=0, le=10, description="new plans in a row because parts are not seen where they should stand")
    ] = 3


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class CellParameters:
    """The cell's own part of the configuration."""

    look: LookParameters
    workspace: WorkspaceBox
    table_z_mm: Annotated[float, Field(ge=-2000.0, le=2000.0, description="height of the table in the base frame")]
    motion: MotionParameters = Field(default_factory=MotionParameters)
    tolerance: ToleranceParameters = Field(default_factory=ToleranceParameters)
    retries: RetryParameters = Field(default_factory=RetryParameters)
    unmovable_parts: Annotated[
        Literal["hold", "leave"],
        Field(
            description="parts that cannot be taken (unknown shape, no grasp): hold before anything moves, or leave "
            "them where they are, relocate the others round them and warn"
        ),
    ] = "hold"
    status_interval_s: Annotated[
        float, Field(gt=0.0, le=10.0, description="how often the arm's status is read while it is not moved")
    ] = 0.5

    def hand(self) -> HandMotion:
        """Return how the hand is moved, as planning asks for it."""
        motion = self.motion
        return HandMotion(
            table_z_mm=self.table_z_mm,
            clearance_mm=motion.clearance_mm,
            approach_mm=motion.approach_mm,
            release_gap_mm=motion.release_gap_mm,
            jaw_axis=motion.jaw_axis,
            observe=self.look.observe_pose.pose(),
            z_mm=self.workspace.z_mm,
            travel_speed_mm_s=motion.travel_speed_mm_s,
            approach_speed_mm_s=motion.approach_speed_mm_s,
            looks_between=self.look.verify == "each_move",
        )

    @model_validator(mode="after")
    def _observes_inside(self) -> Self:
        if violation := self.workspace.violation(self.look.observe_pose.pose()):
            raise ValueError(f"look.observe_pose: {violation} (workspace)")
        # the camera may hang at any angle, so that its steps may point anywhere
        aside_mm, pose = math.hypot(*self.look.aside_mm), self.look.observe_pose.pose()
        for x_mm, y_mm in ((aside_mm, aside_mm), (-aside_mm, -aside_mm)):
            if violation := self.workspace.violation(replace(pose, x_mm=pose.x_mm + x_mm, y_mm=pose.y_mm + y_mm)):
                raise ValueError(f"look.aside_mm: {violation} (workspace)")
        return self
