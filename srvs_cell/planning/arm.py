"""What the arm can reach: inverse kinematics and joint limits of the arm that the config describes.

Straight moves keep the configuration, so that every pose is solved in one and the same: the configuration in which the
arm is at the observe pose. Joints are counted from there, too, without whole turns in between.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass
from scipy.spatial.transform import Rotation

from srvs_cell.geometry import Transform, Xyzwpr
from srvs_cell.planning.opw import Configuration, OpwGeometry, beyond_reach_mm, forward, inverse

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.geometry import Array

_STRICT = ConfigDict(extra="forbid")
_TURN_DEG = 360.0
_SINGULAR_J5_DEG = 1.0
_JUMP_DEG = 20.0
"""A joint that turns farther between two samples of a way has gone round a singular pose."""
_STEP_MM = 5.0
_LEAST_SAMPLES = 5

Length = Annotated[float, Field(ge=-10_000.0, le=10_000.0)]
Angle = Annotated[float, Field(ge=-720.0, le=720.0)]
Six = tuple[Angle, Angle, Angle, Angle, Angle, Angle]
Switches = tuple[bool, bool, bool, bool, bool, bool]


@dataclass(frozen=True, kw_only=True, config=_STRICT)
class ArmParameters:
    """The arm by its OPW parameters (Brandstoetter et al. 2014), its tool and its joint limits."""

    a1_mm: Annotated[Length, Field(description="from axis 1 to axis 2, horizontally")]
    a2_mm: Annotated[Length, Field(description="from axis 3 to axis 4, across the forearm; negative: axis 4 is above")]
    b_mm: Annotated[Length, Field(description="from axis 1 to the arm's plane, sideways")] = 0.0
    c1_mm: Annotated[
        Length, Field(description="from the origin of the robot's World to axis 2; 0 on a FANUC, whose World is there")
    ] = 0.0
    c2_mm: Annotated[float, Field(gt=0.0, le=10_000.0, description="from axis 2 to axis 3")]
    c3_mm: Annotated[float, Field(gt=0.0, le=10_000.0, description="from axis 3 to the wrist centre, along axis 4")]
    c4_mm: Annotated[float, Field(ge=0.0, le=10_000.0, description="from the wrist centre to the flange")]
    offsets_deg: Annotated[Six, Field(description="what is taken off each joint angle to get OPW's")] = (0.0,) * 6
    flipped_axes: Annotated[Switches, Field(description="joints that turn the other way round than OPW's")] = (
        False,
    ) * 6
    joint_limits_deg: Annotated[
        tuple[
            tuple[Angle, Angle],
            tuple[Angle, Angle],
            tuple[Angle, Angle],
            tuple[Angle, Angle],
            tuple[Angle, Angle],
            tuple[Angle, Angle],
        ],
        Field(description="least and greatest angle of each joint; joint 3 relative to link 2, not to the horizontal"),
    ]
    margin_deg: Annotated[float, Field(ge=0.0, le=90.0, description="distance that is kept from every joint limit")] = (
        1.0
    )
    configuration: Annotated[
        str,
        Field(
            pattern="^[NF][UD][TB]$",
            description="configuration at the observe pose as on the pendant: N or F (joint 5 negative or positive), "
            "U or D (elbow up or down), T or B (arm toward or backward)",
        ),
    ] = "NUT"
    tool_xyz_mm: Annotated[tuple[Length, Length, Length], Field(description="the TCP in the flange's frame")]
    tool_wpr_deg: Annotated[tuple[Angle, Angle, Angle], Field(description="its W, P, R there")] = (0.0, 0.0, 0.0)
    base_xyz_mm: Annotated[
        tuple[Length, Length, Length], Field(description="the cell's base frame (the user frame) in the robot's World")
    ] = (0.0, 0.0, 0.0)
    base_wpr_deg: Annotated[tuple[Angle, Angle, Angle], Field(description="its W, P, R there")] = (0.0, 0.0, 0.0)


class ArmReach:
    """Tells whether the arm can be somewhere and go straight from one pose to another.

    Args:
        parameters: the arm.
        observe: pose of the TCP from which joints are counted, base frame.
    """

    def __init__(self, parameters: ArmParameters, observe: Xyzwpr) -> None:
        p = parameters
        self._geometry = OpwGeometry(p.a1_mm, p.a2_mm, p.b_mm, p.c1_mm, p.c2_mm, p.c3_mm, p.c4_mm)
        self._offsets_deg = np.array(p.offsets_deg)
        self._signs = np.where(p.flipped_axes, -1.0, 1.0)
        wrist, elbow, arm = tuple(p.configuration)
        positive_5 = (wrist == "F") != bool(p.flipped_axes[4])
        self._configuration = Configuration(arm == "T", elbow == "U", positive_5)
        self._low_deg, self._high_deg = np.array(p.joint_limits_deg).T + np.array([[1.0], [-1.0]]) * p.margin_deg
        tool = Transform.from_xyzwpr("flange", "tcp", Xyzwpr(*p.tool_xyz_mm, *p.tool_wpr_deg))
        world = Transform.from_xyzwpr("world", "base", Xyzwpr(*p.base_xyz_mm, *p.base_wpr_deg))
        self._tcp_T_flange, self._flange_T_tcp = tool.inverse().matrix, tool.matrix
        self._world_T_base, self._base_T_world = world.matrix, world.inverse().matrix
        self._observe_deg = np.zeros(6)
        self._observe_deg = np.nan_to_num(self.joints_deg(_poses(np.array([observe.as_tuple()]))))[0]

    def joints_deg(self, base_T_tcp: Array) -> Array:
        """Return joint angles, shape (N, 6), of TCP poses (N, 4, 4); NaN where a pose is out of reach."""
        theta = inverse(self._flanges(base_T_tcp), self._geometry, self._configuration)
        joints = (np.rad2deg(theta) + self._offsets_deg) * self._signs
        counted: Array = joints - _TURN_DEG * np.round((joints - self._observe_deg) / _TURN_DEG)
        return counted

    def poses(self, joints_deg: Array) -> Array:
        """Return TCP poses (N, 4, 4) of joint angles of shape (N, 6)."""
        theta = np.deg2rad(joints_deg * self._signs - self._offsets_deg)
        base_T_tcp: Array = self._base_T_world @ forward(theta, self._geometry) @ self._flange_T_tcp
        return base_T_tcp

    def within(self, base_T_tcp: Array) -> NDArray[np.bool_]:
        """Return, per TCP pose (N, 4, 4), whether it is in reach, within joint limits and not singular."""
        joints = self.joints_deg(base_T_tcp)
        with np.errstate(invalid="ignore"):
            inside = (joints >= self._low_deg) & (joints <= self._high_deg)
        regular: NDArray[np.bool_] = inside.all(axis=1) & (np.abs(joints[:, 4]) >= _SINGULAR_J5_DEG)
        return regular

    def why_not(self, ways: Sequence[Sequence[Xyzwpr]]) -> list[str]:
        """Return, per way, why the arm cannot go straight from pose to pose, or an empty string where it can.

        Args:
            ways: TCP poses, one at least in each; between two of them the TCP goes straight and turns evenly.
        """
        if not ways:
            return []
        rows = [_along(way) for way in ways]
        begins = np.cumsum([0, *map(len, rows)])
        poses = _poses(np.concatenate(rows))
        beyond_mm = beyond_reach_mm(self._flanges(poses), self._geometry, self._configuration)
        joints = self.joints_deg(poses)
        with np.errstate(invalid="ignore"):
            beyond_deg = np.maximum(self._low_deg - joints, joints - self._high_deg)
            jumps = np.abs(np.diff(joints, axis=0, prepend=joints[:1])).max(axis=1) > _JUMP_DEG
        jumps[begins[:-1]] = False
        singular = jumps | (np.abs(joints[:, 4]) < _SINGULAR_J5_DEG)
        wrong = np.logical_or.reduceat((beyond_mm != 0.0) | singular | (beyond_deg.max(axis=1) > 0.0), begins[:-1])
        reasons = [""] * len(ways)
        for number in np.flatnonzero(wrong).tolist():
            way = slice(begins[number], begins[number + 1])
            reasons[number] = _reason(beyond_mm[way], singular[way], beyond_deg[way])
        return reasons

    def _flanges(self, base_T_tcp: Array) -> Array:
        flanges: Array = self._world_T_base @ base_T_tcp @ self._tcp_T_flange
        return flanges


def _reason(beyond_mm: Array, singular: NDArray[np.bool_], beyond_deg: Array) -> str:
    """Say what is wrong with a way, of samples (N,), (N,) and (N, 6)."""
    worst_mm = float(beyond_mm[np.abs(beyond_mm).argmax()])
    if worst_mm:
        if not np.isfinite(worst_mm):
            return "out of reach: too near to axis 1"
        return f"out of reach by {abs(worst_mm):.0f} mm{'' if worst_mm > 0.0 else ', too near'}"
    if singular.any():
        return "the wrist would pass a singular pose"
    most_deg = beyond_deg.max(axis=0)
    joint = int(most_deg.argmax())
    return f"joint {joint + 1} beyond its limit by {most_deg[joint]:.1f} deg"


def _along(way: Sequence[Xyzwpr]) -> Array:
    """Return X, Y, Z, W, P, R of shape (N, 6) along straight moves.

    The angles are interpolated, which for a tool that keeps pointing the same way is the even turn about its axis.
    """
    values = [np.array([way[0].as_tuple()])]
    for start, end in pairwise(way):
        a, b = np.array(start.as_tuple()), np.array(end.as_tuple())
        samples = max(_LEAST_SAMPLES, math.ceil(math.dist(a[:3], b[:3]) / _STEP_MM))
        values.append(a + np.linspace(0.0, 1.0, samples + 1)[1:, None] * (b - a))
    return np.concatenate(values)


def _poses(rows: Array) -> Array:
    """Return poses (N, 4, 4) of X, Y, Z, W, P, R of shape (N, 6)."""
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, 3] = rows[:, :3]
    # W, P, R turn about fixed axes (`srvs_cell.geometry.fanuc_rotation`).
    poses[:, :3, :3] = Rotation.from_euler("xyz", rows[:, 3:], degrees=True).as_matrix()
    return poses
