"""The calibration file: camera intrinsics, hand-eye transform, how sure both are, and what they were made with."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeVar

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked_dataclass

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.geometry import Transform, Xyzwpr

if TYPE_CHECKING:
    from collections.abc import Mapping

    from srvs_cell.geometry import Array

SCHEMA_VERSION = 1
_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)

_Pixels = Annotated[int, Field(strict=True, ge=16, le=32768)]
_Focal = Annotated[float, Field(strict=True, gt=0.0, le=1e6)]
_Coordinate = Annotated[float, Field(strict=True, ge=-1e5, le=1e5)]
_Coefficient = Annotated[float, Field(strict=True, ge=-100.0, le=100.0)]
_Angle = Annotated[float, Field(strict=True, ge=-360.0, le=360.0)]
_Number = Annotated[int, Field(strict=True, ge=0, le=255)]


@checked_dataclass(frozen=True, kw_only=True, config=_STRICT)
class CameraIntrinsics:
    """OpenCV's camera model; pixel (0, 0) is the centre of the top left pixel.

    Attributes:
        width, height: image size in pixels.
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels.
        distortion: k1, k2, p1, p2, k3.
    """

    width: _Pixels
    height: _Pixels
    fx: _Focal
    fy: _Focal
    cx: _Coordinate
    cy: _Coordinate
    distortion: tuple[_Coefficient, _Coefficient, _Coefficient, _Coefficient, _Coefficient]


@checked_dataclass(frozen=True, kw_only=True, config=_STRICT)
class HandEye:
    """Where the camera sits on the tool: tcp_T_camera, camera x right, y down, z forward.

    Attributes:
        xyz_mm: camera origin in the TCP frame.
        wpr_deg: FANUC W, P, R.
    """

    xyz_mm: tuple[_Coordinate, _Coordinate, _Coordinate]
    wpr_deg: tuple[_Angle, _Angle, _Angle]


@checked_dataclass(frozen=True, kw_only=True, config=_STRICT)
class RobotFrames:
    """User frame and tool numbers that were active during the calibration; poses of other frames do not fit it."""

    user_frame: _Number | None = None
    user_tool: _Number | None = None


@checked_dataclass(frozen=True, kw_only=True, config=_STRICT)
class Uncertainty:
    """One standard deviation of each calibrated number; the defaults are those of a carefully calibrated real cell.

    Attributes:
        focal_relative: of fx and fy together, as a share.
        principal_point_px: of cx and cy, each.
        hand_eye_mm: of the camera's position on the tool, per axis.
        hand_eye_deg: of the camera's orientation on the tool, per axis.
        pose_mm: of the right pose against the left one, per axis.
        pose_deg: of the right orientation against the left one, per axis.
        distortion_k1: of the lens' first radial coefficient.
        distortion_k2: of the second one.
        table_mm: of the table's height in the base frame.
    """

    focal_relative: Annotated[float, Field(ge=0.0, le=0.5, description="share of f")] = 0.001
    principal_point_px: Annotated[float, Field(ge=0.0, le=1000.0, description="per axis")] = 0.5
    hand_eye_mm: Annotated[float, Field(ge=0.0, le=1000.0, description="per axis")] = 0.3
    hand_eye_deg: Annotated[float, Field(ge=0.0, le=180.0, description="per axis")] = 0.05
    pose_mm: Annotated[float, Field(ge=0.0, le=1000.0, description="right pose against left, per axis")] = 0.03
    pose_deg: Annotated[float, Field(ge=0.0, le=180.0, description="right pose against left, per axis")] = 0.005
    distortion_k1: Annotated[float, Field(ge=0.0, le=10.0, description="first radial coefficient")] = 0.003
    distortion_k2: Annotated[float, Field(ge=0.0, le=10.0, description="second radial coefficient")] = 0.006
    table_mm: Annotated[float, Field(ge=0.0, le=100.0, description="height of the table")] = 0.1


_Section = TypeVar("_Section")
_SECTIONS: dict[str, tuple[str, type[Any], bool]] = {
    "camera": ("camera", CameraIntrinsics, True),
    "tcp_T_camera": ("hand_eye", HandEye, True),
    "robot": ("robot", RobotFrames, False),
    "uncertainty": ("uncertainty", Uncertainty, False),
}
"""Key in the file: (attribute, type, required)."""


@dataclass(frozen=True)
class Calibration:
    """What is known of one camera on one tool.

    Attributes:
        camera: intrinsics.
        hand_eye: the camera on the tool.
        robot: frame and tool numbers of the poses that it was made with.
        uncertainty: one standard deviation of each number.
    """

    camera: CameraIntrinsics
    hand_eye: HandEye
    robot: RobotFrames = field(default_factory=RobotFrames)
    uncertainty: Uncertainty = field(default_factory=Uncertainty)

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], source: str) -> Self:
        """Check and take what a calibration file holds.

        Args:
            data: the file's content.
            source: the file's name, for messages.

        Raises:
            AlarmError: CALIBRATION_INVALID naming source, key, value and bound.
        """
        if not isinstance(data, dict):
            raise _invalid(source, f"a mapping is expected, not {type(data).__name__}.")
        version = data.get("schema_version")
        if isinstance(version, bool) or version != SCHEMA_VERSION:
            raise _invalid(source, f"schema_version = {version!r}: must be {SCHEMA_VERSION}.")
        for key in data:
            if key != "schema_version" and key not in _SECTIONS:
                raise _invalid(source, f"{key}: unknown key; known are schema_version, {', '.join(_SECTIONS)}.")
        sections = {}
        for key, (attribute, section, required) in _SECTIONS.items():
            if key in data:
                sections[attribute] = _section(section, data[key], key, source)
            elif required:
                raise _invalid(source, f"{key}: missing.")
        return cls(**sections)

    def to_mapping(self) -> dict[str, Any]:
        """Return the content of the calibration file: plain dicts, lists and numbers."""
        mapping: dict[str, Any] = {"schema_version": SCHEMA_VERSION}
        for key, (attribute, _, _) in _SECTIONS.items():
            values = asdict(getattr(self, attribute))
            mapping[key] = {
                name: list(value) if isinstance(value, tuple) else value
                for name, value in values.items()
                if value is not None
            }
        return {key: value for key, value in mapping.items() if value != {}}

    @property
    def image_size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.camera.width, self.camera.height

    @property
    def camera_matrix(self) -> Array:
        """The 3x3 camera matrix, pixels."""
        camera = self.camera
        return np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> Array:
        """k1, k2, p1, p2, k3, shape (5,)."""
        return np.array(self.camera.distortion)

    @property
    def tcp_T_camera(self) -> Transform:
        """The hand-eye transform."""
        return Transform.from_xyzwpr("tcp", "camera", Xyzwpr(*self.hand_eye.xyz_mm, *self.hand_eye.wpr_deg))


def _section(section: type[_Section], value: Any, key: str, source: str) -> _Section:
    if not isinstance(value, dict):
        raise _invalid(source, f"{key} = {value!r}: a mapping is expected.")
    try:
        return TypeAdapter(section).validate_python(value)
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join([key, *(str(part) for part in first["loc"])])
        given = "" if first["type"] == "missing" else f" = {first['input']!r}"
        raise _invalid(source, f"{path}{given}: {first['msg']}.") from error


def _invalid(source: str, detail: str) -> AlarmError:
    return AlarmError(Alarm.CALIBRATION_INVALID, f"{source}: {detail}")
