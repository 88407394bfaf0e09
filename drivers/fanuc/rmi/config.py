"""The robot's part of the cell's YAML."""

from __future__ import annotations

from pydantic import Field

from drivers.fanuc.settings import MotionSettings


class FanucRmiConfig(MotionSettings):
    """The robot's part of the cell's YAML, for the driver ``fanuc_rmi``."""

    host: str = Field(default="127.0.0.1", min_length=1, description="the controller's address or name")
    port: int = Field(default=16001, ge=1, le=65535, description="where the controller waits for FRC_Connect")
    timeout_s: float = Field(
        default=2.0, gt=0.0, le=10.0, description="real seconds for a connection, and for a reply to a command"
    )
    user_frame: int = Field(default=1, ge=0, le=9, description="user frame that poses are given in; 0 is the world")
    user_tool: int = Field(default=1, ge=1, le=10, description="tool frame whose TCP is moved")
    group_mask: int | None = Field(
        default=None, ge=1, le=128, description="bit field for FRC_Initialize; needed with several motion groups"
    )
    initialize_timeout_s: float = Field(
        default=15.0, gt=0.0, le=120.0, description="clock seconds that FRC_Initialize may take"
    )
    abort_timeout_s: float = Field(
        default=60.0, gt=0.0, le=300.0, description="clock seconds that FRC_Abort may take; a minute has been seen"
    )
    leave_timeout_s: float = Field(
        default=5.0, gt=0.0, le=25.0, description="clock seconds for the abort when the daemon lets go of the arm"
    )
    reset_timeout_s: float = Field(default=15.0, gt=0.0, le=120.0, description="clock seconds that a reset may take")
    stop_timeout_s: float = Field(
        default=3.0, ge=0.2, le=30.0, description="clock seconds after an abort within which the arm must stand still"
    )

    @property
    def longest_reading_s(self) -> float:
        """The lengthy command that must be answered first, and the reading's own two or three."""
        lengthy_s = max(self.abort_timeout_s, self.reset_timeout_s, self.initialize_timeout_s)
        return lengthy_s + 3.0 * self.timeout_s
