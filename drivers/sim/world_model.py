"""The MuJoCo model of table, parts and gripper, in metres and kilograms.

Recipes and measurements behind the options and contact parameters: references/sim.md section 3. The arm itself is
kinematic: a mocap body leads the hand through a weld, so that what holds a part has a velocity for the contact solver.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree as ET  # only written here, never parsed

import mujoco
import numpy as np

from drivers.sim.parts import CUBOID, CYLINDER

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.sim.gripper_geometry import GripperGeometry
    from drivers.sim.parts import Part

MM: Final = 1e-3
TIMESTEP_S: Final = 0.002
TABLE_SIZE_M: Final = (1.5, 1.5, 0.05)
_DENSITY: Final = "1100"
_HAND_MASS: Final = "2.0"
_FINGER_MASS: Final = "0.2"
_PART_CONTACT: Final[dict[str, Any]] = {"condim": "4", "friction": "0.5 .0005 .0001", "solref": ".005 1"}


def build_model(
    parts: Sequence[Part], gripper: GripperGeometry, table_centre_mm: tuple[float, float, float]
) -> mujoco.MjModel:
    """Return the model; part ``i`` is the body and the geom ``part{i}``, its body frame is the part's own frame.

    Args:
        parts: what stands on the table.
        gripper: the tool.
        table_centre_mm: centre of the table's top face, base frame.
    """
    root = ET.Element("mujoco", model="srvs_cell")
    ET.SubElement(root, "compiler", autolimits="true")
    option = ET.SubElement(
        root, "option", timestep=str(TIMESTEP_S), integrator="implicitfast", cone="elliptic", impratio="10"
    )
    ET.SubElement(option, "flag", sleep="enable")  # parts at rest cost nothing until something touches them
    asset = ET.SubElement(root, "asset")
    world = ET.SubElement(root, "worldbody")
    x, y, z = np.multiply(table_centre_mm, MM)
    depth = TABLE_SIZE_M[2] / 2.0
    ET.SubElement(
        world,
        "geom",
        name="table",
        type="box",
        pos=_text(x, y, z - depth),
        size=_text(TABLE_SIZE_M[0] / 2.0, TABLE_SIZE_M[1] / 2.0, depth),
        **_PART_CONTACT,
    )
    for index, part in enumerate(parts):
        _add_part(world, asset, index, part, table_centre_mm[2])
    _add_hand(world, gripper)
    equality = ET.SubElement(root, "equality")
    # the weld must come first: `World` reads the force on the hand from the first rows of the constraints
    ET.SubElement(
        equality, "weld", body1="lead", body2="hand", relpose="0 0 0 1 0 0 0", solref=".01 1", solimp=".95 .999 .0005"
    )
    ET.SubElement(equality, "joint", joint1="finger0", joint2="finger1", polycoef="0 1 0 0 0", solref=".005 1")
    contact = ET.SubElement(root, "contact")
    ET.SubElement(contact, "exclude", body1="finger0", body2="finger1")
    actuator = ET.SubElement(root, "actuator")
    force = gripper.grip_force_n
    for finger in range(2):
        ET.SubElement(
            actuator,
            "position",
            name=f"drive{finger}",
            joint=f"finger{finger}",
            kp="4000",
            kv="100",
            forcerange=_text(-force, force),
        )
    return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))


def _add_part(world: ET.Element, asset: ET.Element, index: int, part: Part, table_z_mm: float) -> None:
    name = f"part{index}"
    yaw = np.deg2rad(part.yaw_deg) / 2.0
    body = ET.SubElement(
        world,
        "body",
        name=name,
        pos=_text(part.x_mm * MM, part.y_mm * MM, table_z_mm * MM),
        quat=_text(np.cos(yaw), 0.0, 0.0, np.sin(yaw)),
    )
    ET.SubElement(body, "freejoint")
    half_height = part.height_mm * MM / 2.0
    geom: dict[str, Any] = {"name": name, "density": _DENSITY, **_PART_CONTACT}
    if part.kind == CUBOID:
        size = _text(part.length_mm * MM / 2.0, part.width_mm * MM / 2.0, half_height)
        ET.SubElement(body, "geom", type="box", size=size, pos=_text(0, 0, half_height), **geom)
    elif part.kind == CYLINDER:
        size = _text(part.width_mm * MM / 2.0, half_height)
        ET.SubElement(body, "geom", type="cylinder", size=size, pos=_text(0, 0, half_height), **geom)
    else:
        ET.SubElement(asset, "mesh", name=name, vertex=_text(*(part.vertices_mm() * MM).ravel()))
        ET.SubElement(body, "geom", type="mesh", mesh=name, **geom)


def _add_hand(world: ET.Element, gripper: GripperGeometry) -> None:
    """Add the leading mocap body and the hand. The hand's frame is the TCP: z out of the tool, jaws along y."""
    ET.SubElement(world, "body", name="lead", mocap="true")
    hand = ET.SubElement(world, "body", name="hand", gravcomp="1")
    ET.SubElement(hand, "freejoint")
    palm_x, palm_y, palm_z = (size * MM / 2.0 for size in gripper.palm_size_mm)
    length = gripper.finger_length_mm * MM
    ET.SubElement(
        hand,
        "geom",
        name="palm",
        type="box",
        size=_text(palm_x, palm_y, palm_z),
        pos=_text(0, 0, -length - palm_z),
        mass=_HAND_MASS,
    )
    thick = gripper.finger_thickness_mm * MM / 2.0
    width = gripper.finger_width_mm * MM / 2.0
    for finger, side in enumerate((1.0, -1.0)):
        body = ET.SubElement(hand, "body", name=f"finger{finger}", gravcomp="1")
        ET.SubElement(
            body,
            "joint",
            name=f"finger{finger}",
            type="slide",
            axis=_text(0, side, 0),
            range=_text(0, gripper.max_opening_mm * MM / 2.0),
            armature=".5",
            damping="20",
        )
        ET.SubElement(
            body,
            "geom",
            name=f"finger{finger}",
            type="box",
            size=_text(width, thick, length / 2.0),
            pos=_text(0, side * thick, -length / 2.0),
            mass=_FINGER_MASS,
            condim="4",
            friction=f"{gripper.friction} .0005 .0001",
            priority="1",
            solref=".004 1",
            solimp=".95 .99 .0005",
        )


def _text(*values: float) -> str:
    return " ".join(f"{float(value):.12g}" for value in values)
