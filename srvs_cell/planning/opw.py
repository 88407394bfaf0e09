"""Inverse kinematics of a six-axis arm with an ortho-parallel base and a spherical wrist, in closed form.

Brandstoetter, Angerer, Hofbauer: An Analytical Solution of the Inverse Kinematics Problem of Industrial Serial
Manipulators with an Ortho-parallel Basis and a Spherical Wrist (Austrian Robotics Workshop, 2014), with its symbols:
theta 1 to 6 are the joint angles of the paper's own zero position. Vectorised over poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from srvs_cell.geometry import Array


@dataclass(frozen=True)
class OpwGeometry:
    """The seven lengths of the paper's figure 2, millimetres.

    Attributes:
        a1: from axis 1 to axis 2, horizontally.
        a2: from axis 3 to the forearm's axis 4, across it; negative where axis 4 is above.
        b: from axis 1 to the arm's plane, sideways.
        c1: from the base to axis 2, vertically.
        c2: from axis 2 to axis 3.
        c3: from axis 3 to the wrist centre, along axis 4.
        c4: from the wrist centre to the flange.
    """

    a1: float
    a2: float
    b: float
    c1: float
    c2: float
    c3: float
    c4: float


@dataclass(frozen=True)
class Configuration:
    """Which of the eight solutions.

    Attributes:
        toward: the arm's plane faces the target; otherwise it leans over backwards.
        elbow_up: the elbow is above the line from axis 2 to the wrist centre.
        positive_5: theta 5 is positive.
    """

    toward: bool
    elbow_up: bool
    positive_5: bool


def wrist_centres(poses: Array, geometry: OpwGeometry) -> Array:
    """Return the wrist centre, shape (N, 3), of flange poses of shape (N, 4, 4) in the arm's frame."""
    centres: Array = poses[:, :3, 3] - geometry.c4 * poses[:, :3, 2]
    return centres


def beyond_reach_mm(poses: Array, geometry: OpwGeometry, configuration: Configuration) -> Array:
    """Return by how much each pose (N, 4, 4) is too far away for the arm.

    Positive is too far, negative too near, 0 neither. The length is that of the wrist centre's distance from axis 2.
    """
    distance = _from_axis_2(wrist_centres(poses, geometry), geometry, configuration)[0]
    forearm = np.hypot(geometry.a2, geometry.c3)
    too_far = np.maximum(distance - (geometry.c2 + forearm), 0.0)
    too_near = np.minimum(distance - abs(geometry.c2 - forearm), 0.0)
    # Beside axis 1 the arm's plane cannot be turned to the point at all.
    return np.where(np.isnan(distance), -np.inf, too_far + too_near)


def forward(theta: Array, geometry: OpwGeometry) -> Array:
    """Return the flange poses (N, 4, 4) of angles theta in radians, shape (N, 6)."""
    t1, t2, t3, t4, t5, t6 = theta.T
    psi = np.arctan2(geometry.a2, geometry.c3)
    forearm = np.hypot(geometry.a2, geometry.c3)
    x = geometry.c2 * np.sin(t2) + forearm * np.sin(t2 + t3 + psi) + geometry.a1
    z = geometry.c2 * np.cos(t2) + forearm * np.cos(t2 + t3 + psi) + geometry.c1
    y = geometry.b
    poses = np.tile(np.eye(4), (len(theta), 1, 1))
    poses[:, :3, :3] = _about_z(t1) @ _about_y(t2 + t3) @ _about_z(t4) @ _about_y(t5) @ _about_z(t6)
    centre = np.column_stack([x * np.cos(t1) - y * np.sin(t1), x * np.sin(t1) + y * np.cos(t1), z])
    poses[:, :3, 3] = centre + geometry.c4 * poses[:, :3, 2]
    return poses


def inverse(poses: Array, geometry: OpwGeometry, configuration: Configuration) -> Array:
    """Return the angles theta in radians, shape (N, 6), of flange poses (N, 4, 4); NaN where a pose is out of reach."""
    centres = wrist_centres(poses, geometry)
    distance, along, up = _from_axis_2(centres, geometry, configuration)
    forearm = np.hypot(geometry.a2, geometry.c3)
    sign = 1.0 if configuration.toward else -1.0
    # The elbow is up where the upper arm stands steeper than the line from axis 2 to the wrist centre.
    steeper = -sign if configuration.elbow_up else sign
    towards = np.arctan2(centres[:, 1], centres[:, 0])
    aside = np.arctan2(geometry.b, sign * (along + geometry.a1))
    theta_1 = towards - aside if configuration.toward else towards + aside - np.pi
    with np.errstate(invalid="ignore", divide="ignore"):
        at_2 = np.arccos((distance**2 + geometry.c2**2 - forearm**2) / (2.0 * distance * geometry.c2))
        at_3 = np.arccos((distance**2 - geometry.c2**2 - forearm**2) / (2.0 * geometry.c2 * forearm))
    theta_2 = np.arctan2(along, up) + steeper * at_2
    theta_3 = -steeper * at_3 - np.arctan2(geometry.a2, geometry.c3)
    wrist = np.swapaxes(_about_z(theta_1) @ _about_y(theta_2 + theta_3), 1, 2) @ poses[:, :3, :3]
    flip = 1.0 if configuration.positive_5 else -1.0
    theta_5 = flip * np.arctan2(np.hypot(wrist[:, 0, 2], wrist[:, 1, 2]), wrist[:, 2, 2])
    theta_4 = np.arctan2(flip * wrist[:, 1, 2], flip * wrist[:, 0, 2])
    theta_6 = np.arctan2(flip * wrist[:, 2, 1], -flip * wrist[:, 2, 0])
    return np.column_stack([theta_1, theta_2, theta_3, theta_4, theta_5, theta_6])


def _from_axis_2(centres: Array, geometry: OpwGeometry, configuration: Configuration) -> tuple[Array, Array, Array]:
    """Return distance, way along the arm's plane and height of wrist centres from axis 2; NaN beside axis 1."""
    with np.errstate(invalid="ignore"):
        out = np.sqrt(centres[:, 0] ** 2 + centres[:, 1] ** 2 - geometry.b**2)
    along = (out if configuration.toward else -out) - geometry.a1
    up = centres[:, 2] - geometry.c1
    return np.hypot(along, up), along, up


def _about_z(angle: Array) -> Array:
    cos, sin, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]]).transpose(2, 0, 1)


def _about_y(angle: Array) -> Array:
    cos, sin, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.array([[cos, zero, sin], [zero, one, zero], [-sin, zero, cos]]).transpose(2, 0, 1)
