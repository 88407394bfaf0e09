"""What every FANUC wire's part of the cell's YAML has: how long a move may take, and where it may end."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class MotionSettings(BaseModel):
    """Judging a move, whatever wire it was ordered on."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    poll_s: float = Field(
        default=0.05, ge=0.01, le=1.0, description="clock seconds between two readings while a move is under way"
    )
    joint_speed_mm_s: float = Field(
        default=300.0,
        ge=1.0,
        le=5000.0,
        description="what the TCP covers at 100 % of a joint move at the least, for the time a move may take",
    )
    turn_speed_deg_s: float = Field(
        default=45.0, ge=1.0, le=720.0, description="what the wrist turns at the least, likewise"
    )
    move_grace_s: float = Field(
        default=3.0, ge=0.2, le=60.0, description="clock seconds added to the time a move may take"
    )
    arrival_tolerance_mm: float = Field(
        default=0.5, gt=0.0, le=10.0, description="how far a finished move may end from its target"
    )
    arrival_tolerance_deg: float = Field(
        default=0.2, gt=0.0, le=5.0, description="how far a finished move may end from its target"
    )
