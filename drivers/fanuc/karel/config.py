"""The robot's part of the cell's YAML."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.fanuc.settings import MotionSettings


class TcpConfig(BaseModel):
    """The line protocol over Ethernet (srvstcp.kl)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    host: str = Field(min_length=1, description="the controller's address or name")
    port: int = Field(default=18736, ge=1, le=65535, description="TCP_PORT of srvstcp.kl")


class SerialConfig(BaseModel):
    """The line protocol over RS-232 (srvsser.kl): 8 data bits, no parity, 1 stop bit, no flow control."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    device: str = Field(min_length=1, description="serial port; /dev/serial/by-id/ stays the same on every start")
    baud: Literal[9600, 19200] = Field(default=9600, description="bits per second, as in srvsser.kl")


class FanucKarelConfig(MotionSettings):
    """The robot's part of the cell's YAML, for the driver ``fanuc_karel``; exactly one wire is named."""

    tcp: TcpConfig | None = Field(default=None, description="over Ethernet")
    serial: SerialConfig | None = Field(default=None, description="over RS-232")
    timeout_s: float = Field(default=1.0, gt=0.0, le=10.0, description="real seconds for a connection, or for a reply")
    read_tries: int = Field(
        default=3, ge=1, le=10, description="how often a reading, a greeting or a stop is sent until it is answered"
    )
    heartbeat_s: float = Field(
        default=0.5,
        ge=0.05,
        le=1.0,
        description="clock seconds between two heartbeats of this PC; the robot's watchdog allows 2 s",
    )
    reset_timeout_s: float = Field(default=10.0, gt=0.0, le=120.0, description="seconds that a reset may take")
    stop_timeout_s: float = Field(
        default=3.0, ge=0.2, le=30.0, description="clock seconds at 100 % override that a stop may take to be confirmed"
    )

    @model_validator(mode="after")
    def _one_wire(self) -> Self:
        if (self.tcp is None) == (self.serial is None):
            raise ValueError("name one wire: tcp: {host, port} or serial: {device}")
        return self
