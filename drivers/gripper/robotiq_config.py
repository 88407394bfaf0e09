"""The gripper's part of the cell's YAML."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.gripper.robotiq_registers import MODELS, Stroke

_Point = tuple[Annotated[int, Field(ge=0, le=255)], Annotated[float, Field(ge=-5.0, le=300.0)]]


class RobotiqGripperConfig(BaseModel):
    """The gripper's part of the cell's YAML, for the driver ``robotiq``."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(
        pattern=r"^/", description="serial port; one of /dev/serial/by-id/ stays the same when others are plugged in"
    )
    model: Literal["2f85", "2f140"] = Field(default="2f85", description="bounds stroke, speed and force")
    device_id: int = Field(default=9, ge=1, le=247, description="Modbus address of the gripper, 9 from the factory")
    baud_rate: Literal[9600, 19200, 38400, 57600, 115200] = Field(
        default=115200, description="bits per second; 8 data bits, no parity, 1 stop bit"
    )
    answer_timeout_s: float = Field(
        default=1.0, gt=0.0, le=10.0, description="real seconds for one answer; the gripper takes some milliseconds"
    )
    stroke: tuple[_Point, ...] | None = Field(
        default=None,
        min_length=2,
        max_length=32,
        description="measured pairs of position (gPO, rising) and opening in mm (falling), straight lines between "
        "them; null: the model's usual ends, which other finger tips change",
    )
    open_mm: float | None = Field(
        default=None, gt=0.0, le=200.0, description="opening that is asked for before a pick; null: as far as it goes"
    )
    speed_mm_s: float = Field(default=80.0, gt=0.0, le=250.0, description="of the fingers, within the model's bounds")
    force_n: float = Field(default=40.0, gt=0.0, le=235.0, description="grip force, within the model's bounds")
    open_tolerance_mm: float = Field(
        default=1.5, gt=0.0, le=10.0, description="how far from open_mm fingers that have arrived count as open"
    )
    empty_below_mm: float = Field(
        default=1.0,
        ge=0.0,
        le=50.0,
        description="closed further than this they hold nothing, also where contact is felt: the finger tips touch",
    )
    slip_tolerance_mm: float = Field(
        default=2.0,
        gt=0.0,
        le=50.0,
        description="how far the fingers may move on a held part before it is no longer known what they hold",
    )
    timeout_s: float = Field(
        default=8.0, gt=0.0, le=60.0, description="clock seconds within which the fingers must arrive or meet a part"
    )
    activation_timeout_s: float = Field(
        default=15.0, gt=0.0, le=60.0, description="clock seconds that the activation may take"
    )
    settle_s: float = Field(
        default=0.15, ge=0.0, le=5.0, description="clock seconds for which it must say the same before it is believed"
    )
    poll_s: float = Field(default=0.05, ge=0.01, le=0.5, description="clock seconds between two readings")

    @model_validator(mode="after")
    def _within_the_model(self) -> Self:
        model = MODELS[self.model]
        for key, value, (least, greatest) in (
            ("speed_mm_s", self.speed_mm_s, model.speed_mm_s),
            ("force_n", self.force_n, model.force_n),
        ):
            if not least <= value <= greatest:
                raise ValueError(f"{key} = {value} is outside {least} to {greatest} of the {self.model}")
        widest_mm = self.stroke_line().widest_mm
        if self.opening_mm() > widest_mm:
            raise ValueError(f"open_mm = {self.open_mm} is more than the {widest_mm} mm of its stroke")
        if self.opening_mm() - self.open_tolerance_mm <= self.empty_below_mm:
            raise ValueError(
                f"open_mm - open_tolerance_mm = {self.opening_mm() - self.open_tolerance_mm} is not more than "
                f"empty_below_mm = {self.empty_below_mm}: open and closed could not be told apart"
            )
        return self

    def stroke_line(self) -> Stroke:
        """Return the measured stroke, or the model's usual one."""
        return Stroke.usual(MODELS[self.model]) if self.stroke is None else Stroke(self.stroke)

    def opening_mm(self) -> float:
        """Return the opening of open fingers."""
        return self.stroke_line().widest_mm if self.open_mm is None else self.open_mm
