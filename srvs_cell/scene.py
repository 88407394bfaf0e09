"""What the cell knows of the world: planes, matches, surfaces, workpieces, places, moves, plans.

Frozen values. Pixels are (x right, y down) with (0, 0) at the centre of the top left pixel;
disparity is x_left - x_right, positive; millimetres are in the robot's base frame unless the name says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Point2 = tuple[float, float]
Point3 = tuple[float, float, float]
DisparityPlane = tuple[float, float, float]
"""(a, b, c) of d = a x + b y + c in pixels of the rectified left image."""


@dataclass(frozen=True)
class Plane:
    """A region of one image with the paper's six parameters.

    Attributes:
        id: the region's label in its image, 1 and up.
        centre_px: mean pixel position.
        area_px: number of pixels.
        perimeter_px: length of the boundary.
        short_cut_px: least distance from the centre to the boundary.
        long_cut_px: greatest distance from the centre to the boundary.
        brightness: mean grey value, 0 to 255.
        box_px: bounding box (x, y, width, height).
        touches_border: whether the region is cut by the image border.
    """

    id: int
    centre_px: Point2
    area_px: float
    perimeter_px: float
    short_cut_px: float
    long_cut_px: float
    brightness: float
    box_px: tuple[int, int, int, int]
    touches_border: bool


@dataclass(frozen=True, eq=False)
class PlaneImage:
    """The planes of one rectified image.

    Attributes:
        grey: the rectified image, uint8, shape (H, W).
        labels: int32, shape (H, W): the id of the plane at each pixel, 0 where there is none.
        planes: the planes, ascending id.
    """

    grey: NDArray[np.uint8]
    labels: NDArray[np.int32]
    planes: tuple[Plane, ...]


@dataclass(frozen=True)
class PlaneMatch:
    """A plane of the left image and the plane of the right image that is the same face.

    Attributes:
        left, right: plane ids.
        score: the match function's value, 0 to 1.
        disparity_px: disparity at the left plane's centre.
        disparity_plane: (a, b, c) of d = a x + b y + c.
        disparity_sigma_px: one standard deviation of ``disparity_px``.
    """

    left: int
    right: int
    score: float
    disparity_px: float
    disparity_plane: DisparityPlane
    disparity_sigma_px: float = 0.5


@dataclass(frozen=True, eq=False)
class Surface:
    """A matched plane with its place in the base frame.

    Attributes:
        id: the left plane's id.
        centre_mm: the point of the surface at the left plane's centre.
        normal: unit normal, pointing towards the camera.
        outline_mm: boundary polygon on the surface, shape (N, 3).
        covariance_mm2: 3x3 of ``centre_mm``.
        match: the match it was made from.
    """

    id: int
    centre_mm: Point3
    normal: Point3
    outline_mm: NDArray[np.float64]
    covariance_mm2: NDArray[np.float64]
    match: PlaneMatch


@dataclass(frozen=True)
class Grasp:
    """How a parallel gripper takes a workpiece from above.

    Attributes:
        position_mm: TCP position of the grasp, base frame.
        yaw_deg: direction of the jaws' closing motion, from base x towards base y, modulo 180.
        opening_mm: distance of the parts of the jaws that touch, when closed on the workpiece.
        clearance_mm: free room beside the gripped walls, along the closing motion and as wide as a finger's pad: the
            distance of the nearest other workpiece that is higher than the finger tips; None where there is none.
        others: further grasps of the same workpiece, the next best first; they have no others themselves.
    """

    position_mm: Point3
    yaw_deg: float
    opening_mm: float
    clearance_mm: float | None = None
    others: tuple[Grasp, ...] = ()

    @property
    def choices(self) -> tuple[Grasp, ...]:
        """This grasp and the others."""
        return (replace(self, others=()), *self.others)


UNKNOWN_KIND = "unknown"


@dataclass(frozen=True, eq=False)
class Workpiece:
    """A recognised object.

    Attributes:
        id: number in this perception, 0 and up.
        kind: cuboid, cylinder, wedge, prism, a user's own, or unknown.
        position_mm: centre of the top face (for a wedge of the inclined face), base frame.
        height_mm: highest point above the table.
        yaw_deg: direction of the long side from base x towards base y, modulo 180; None for cylinder and prism.
        size_mm: footprint's (length, width); a prism's (across corners, across flats).
        covariance_mm2: 3x3 of ``position_mm``, random and systematic; of an unknown part of the place of what was seen
            of it, which need not be the middle of its top.
        footprint_mm: convex polygon on the table, shape (N, 2).
        surfaces: ids of the surfaces that it is made of.
        grasp: how to take it; None where it cannot be taken, with ``grasp_refusal``.
        grasp_refusal: why there is no grasp; empty where there is one.
        rise_deg: direction in which an inclined top face rises, from base x towards base y, modulo 360; None where it
            is level, and for an object of several faces.
        brightness: median grey value of the top face (of several the largest) in the left image, 0 to 255; None where
            it was not measured.
        systematic_mm2: the part of ``covariance_mm2`` that calibration and poses cause, 3x3: it does not average out,
            and most of it is the same for all that is seen in one look; the rest is random. None where the two were not
            told apart.
    """

    id: int
    kind: str
    position_mm: Point3
    height_mm: float
    yaw_deg: float | None
    size_mm: tuple[float, float]
    covariance_mm2: NDArray[np.float64]
    footprint_mm: NDArray[np.float64]
    surfaces: tuple[int, ...]
    grasp: Grasp | None
    grasp_refusal: str = ""
    rise_deg: float | None = None
    brightness: float | None = None
    systematic_mm2: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class TableCheck:
    """What the table, whose place is known, told of calibration and poses.

    Attributes:
        blocks: number of blocks of table that the measurement rests on.
        disparity_px: by how much the table's disparity in the middle of the image differs from the expected one.
        row_px: by how much its rows differ there.
        sigma_px: standard deviation of ``disparity_px``.
        correction_mm: what was added to a point of the table there, base frame.
        refusal: why nothing was corrected; empty where it was.
    """

    blocks: int
    disparity_px: float
    row_px: float
    sigma_px: float
    correction_mm: Point3
    refusal: str = ""


@dataclass(frozen=True, eq=False)
class Perception:
    """All that one stereo pair told.

    Attributes:
        left, right: rectified images and their planes.
        matches: matched planes.
        disparity_px: float32, shape (H, W) of the rectified left image; NaN outside matched planes, unless it was asked
            to be filled.
        surfaces: matched planes in the base frame; empty without calibration.
        workpieces: recognised objects; empty without calibration.
        timings_ms: milliseconds per step, in the order of the steps.
        table: what the table told of calibration and poses; None where it was not asked.
        ambiguous_planes: left planes that have no match because several partners are alike, or because the best one
            crosses better matches, and that are part of no matched surface; their ids are of before surfaces were
            joined.
    """

    left: PlaneImage
    right: PlaneImage
    matches: tuple[PlaneMatch, ...]
    disparity_px: NDArray[np.float32]
    surfaces: tuple[Surface, ...]
    workpieces: tuple[Workpiece, ...]
    timings_ms: dict[str, float]
    table: TableCheck | None = None
    ambiguous_planes: tuple[Plane, ...] = ()


class PlaceKind(StrEnum):
    """What a place is for."""

    SLOT = "slot"
    LOOSE = "loose"
    STOCK = "stock"
    BUFFER = "buffer"
    BIN = "bin"


@dataclass(frozen=True)
class Place:
    """Where an object can stand: position of the footprint's centre on the table, base frame."""

    id: int
    x_mm: float
    y_mm: float
    kind: PlaceKind
    reachable: bool = True


@dataclass(frozen=True)
class Move:
    """One pick and place: object ``object`` from place ``from_place`` to place ``to_place`` (ids)."""

    object: int
    from_place: int
    to_place: int


class PlanStatus(StrEnum):
    """How sure the planner is: both moves and travel proven, no plan exists, or valid but not proven least."""

    SOLVED = "solved"
    INFEASIBLE = "infeasible"
    NOT_PROVEN = "not_proven"


@dataclass(frozen=True)
class RelocationPlan:
    """The answer to a planning problem.

    Attributes:
        status: solved means that moves and travel are both proven least.
        moves: pick and place operations in order.
        travel_mm: straight xy travel home -> pick -> place ... -> home.
        moves_proven, travel_proven: whether each is proven least; where the arm's time is what is to be least, that.
        bound_moves, bound_travel_mm: proven lower bounds.
        reasons: why there is no plan, or why it is not proven; one line per workpiece or cause.
        time_s, bound_time_s: the arm's time with all legs above everything, and a proven lower bound of that; None
            where the length is what is to be least.
    """

    status: PlanStatus
    moves: tuple[Move, ...]
    travel_mm: float
    moves_proven: bool
    travel_proven: bool
    bound_moves: int
    bound_travel_mm: float
    reasons: tuple[str, ...] = field(default=())
    time_s: float | None = None
    bound_time_s: float | None = None
