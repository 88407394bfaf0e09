"""The simulated tool: a synchronous parallel gripper with a camera beside it. One place for its numbers.

The TCP lies between the finger tips, at their very end; its z axis points out of the tool, so that W = 180, P = 0,
R = yaw points the tool down. The jaws close along the TCP's **y** axis. The camera sits on the TCP's +x side above
the finger tips, its x axis (image right) along the TCP's +y and its y axis (image down) along the TCP's -x.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from srvs_cell.geometry import Transform, Xyzwpr


@dataclass(frozen=True, kw_only=True)
class GripperGeometry:
    """Dimensions and forces of the gripper.

    Attributes:
        max_opening_mm: distance between the inner faces of the fully open fingers.
        finger_thickness_mm: extent of a finger along the closing motion (TCP y).
        finger_width_mm: extent of a finger across it (TCP x).
        finger_length_mm: from the palm to the finger tip; longer than the highest part, so that the palm passes
            above the neighbours of a low part.
        palm_size_mm: extent of the palm along TCP x, y and z.
        flange_to_tcp_mm: length of the whole tool.
        grip_force_n: force of each finger.
        friction: sliding friction of the pads.
    """

    max_opening_mm: float = 84.0
    finger_thickness_mm: float = 10.0
    finger_width_mm: float = 16.0
    finger_length_mm: float = 125.0
    palm_size_mm: tuple[float, float, float] = (50.0, 120.0, 50.0)
    flange_to_tcp_mm: float = 240.0
    grip_force_n: float = 40.0
    friction: float = 0.6


@dataclass(frozen=True, kw_only=True)
class CameraMount:
    """Where the camera sits on the tool."""

    tcp_T_camera: Xyzwpr = field(  # noqa: N815 - the notation of transforms
        default_factory=lambda: Xyzwpr(75.0, 0.0, -140.0, 0.0, 0.0, 90.0)
    )

    def transform(self) -> Transform:
        """Return tcp_T_camera."""
        return Transform.from_xyzwpr("tcp", "camera", self.tcp_T_camera)
