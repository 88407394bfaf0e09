"""What the planner may be told: tolerances, gripper geometry, buffer places, search caps."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from srvs_cell.planning.arm import ArmParameters

_STRICT = ConfigDict(extra="forbid")

Coordinate = Annotated[float, Field(ge=-5000.0, le=5000.0)]
PalmSize = Annotated[float, Field(gt=0.0, le=1000.0)]


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class SearchLimits:
    """Caps of the search, counted in moves tried so that the same problem always gives the same plan."""

    max_moves_search: Annotated[
        int, Field(ge=1, le=100_000_000, description="moves that the search for the fewest moves may try")
    ] = 1_000_000
    max_travel_search: Annotated[
        int, Field(ge=1, le=100_000_000, description="moves that the search for the least travel may try")
    ] = 300_000


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class FingerGeometry:
    """The parallel gripper's fingers as seen from above."""

    thickness_mm: Annotated[
        float, Field(gt=0.0, le=100.0, description="extent of a finger along the closing motion")
    ] = 10.0
    width_mm: Annotated[float, Field(gt=0.0, le=200.0, description="extent of a finger across the closing motion")] = (
        16.0
    )
    clearance_mm: Annotated[
        float, Field(ge=0.0, le=100.0, description="distance of each open finger from the workpiece; unless open_mm")
    ] = 8.0
    open_mm: Annotated[
        float | None,
        Field(gt=0.0, le=500.0, description="distance of the fingers of a gripper that always opens as far as it goes"),
    ] = None
    length_mm: Annotated[
        float | None, Field(gt=0.0, le=1000.0, description="from the tips to the palm; null: the palm is not looked at")
    ] = None
    palm_mm: Annotated[
        tuple[PalmSize, PalmSize],
        Field(description="extent of the palm, and of all that is beside it, along the closing motion and across it"),
    ] = (120.0, 60.0)


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class PlanningParameters:
    """Everything that a config may say about planning."""

    rule: Annotated[
        str, Field(min_length=1, max_length=80, description="goal rule: height_order, or the name of another one")
    ] = "height_order"
    rule_settings: Annotated[
        dict[str, Any],
        Field(description="the goal rule's own settings; without any, height_order takes the tolerances below"),
    ] = Field(default_factory=dict)
    height_tolerance_mm: Annotated[
        float, Field(ge=0.0, le=50.0, description="two heights nearer than this may stand in either order")
    ] = 2.0
    place_tolerance_mm: Annotated[
        float, Field(ge=0.0, le=50.0, description="two y nearer than this are equal: the smaller x comes first")
    ] = 3.0
    clearance_mm: Annotated[
        float, Field(ge=0.0, le=100.0, description="least distance between two workpieces on the table")
    ] = 5.0
    buffer_places_mm: Annotated[
        tuple[tuple[Coordinate, Coordinate], ...],
        Field(max_length=8, description="x and y of the buffer places; empty: free places are found on the table"),
    ] = ()
    max_found_buffers: Annotated[
        int, Field(ge=1, le=8, description="buffer places that may be looked for on the table")
    ] = 4
    buffer_grid_mm: Annotated[
        float, Field(ge=2.0, le=100.0, description="grid on which a free buffer place is looked for")
    ] = 10.0
    home_mm: Annotated[tuple[Coordinate, Coordinate], Field(description="x and y where the hand starts and ends")] = (
        200.0,
        0.0,
    )
    fingers: FingerGeometry = Field(default_factory=FingerGeometry)
    unknown_height_mm: Annotated[
        float, Field(ge=0.0, le=2000.0, description="height that a part of unknown shape is taken to have at least")
    ] = 120.0
    objective: Annotated[
        Literal["time", "length"],
        Field(description="what is least among the plans with the fewest moves: the arm's time or the straight way"),
    ] = "time"
    acceleration_mm_s2: Annotated[
        float, Field(gt=0.0, le=50_000.0, description="acceleration of the TCP on straight moves, for the time")
    ] = 2000.0
    wrist_speed_deg_s: Annotated[
        float, Field(gt=0.0, le=2000.0, description="speed at which the TCP turns on straight moves, for the time")
    ] = 90.0
    wrist_acceleration_deg_s2: Annotated[
        float, Field(gt=0.0, le=20_000.0, description="acceleration of that turn, for the time")
    ] = 500.0
    grip_time_s: Annotated[
        float, Field(ge=0.0, le=20.0, description="time to open or close the gripper, for the time")
    ] = 0.5
    arm: Annotated[
        ArmParameters | None, Field(description="the arm; null: reach and joint limits are not checked beforehand")
    ] = None
    # A cell that waits for a proof wastes more time than the shorter travel saves: less patience than the default.
    limits: SearchLimits = Field(
        default_factory=lambda: SearchLimits(max_moves_search=60_000, max_travel_search=60_000)
    )

    @property
    def names_a_rule(self) -> bool:
        """Whether a rule has to be made; otherwise it is height_order with the tolerances of this section."""
        return self.rule != "height_order" or bool(self.rule_settings)
