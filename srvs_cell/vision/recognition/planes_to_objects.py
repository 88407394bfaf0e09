"""Step 11: planes to objects.

From above a camera sees top faces, slivers of side faces, shadows and print. A surface that rises over the table and
whose outline, fitted to the edges of both images, is a rectangle, a circle or a hexagon is a top face; what lies in
the column under it (its side faces) or in it (print) belongs to it. The library says which top faces make which kind
of object. Surfaces at the height of the table, shadows among them, are table. What rises and is no known figure, or is
in no library, is reported as unknown with its surfaces.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Self

import cv2
import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass as checked_dataclass

from srvs_cell.vision.limit_pairs import check_pairs
from srvs_cell.vision.recognition.brightness import face_brightness
from srvs_cell.vision.recognition.clearances import with_clearances
from srvs_cell.vision.recognition.evidence import Evidence
from srvs_cell.vision.recognition.grasping import GraspParameters
from srvs_cell.vision.recognition.kind_matching import group_faces
from srvs_cell.vision.recognition.kinds import BUILT_IN_KINDS
from srvs_cell.vision.recognition.recovery import (
    find_places,
    is_cut_off,
    place_unknown,
    rising_regions,
    unmatched_planes,
)
from srvs_cell.vision.recognition.tops import (
    add_tops,
    explained_polygons,
    on_tops,
    one_per_place,
    outline_px,
    rising_test,
    share_out,
)
from srvs_cell.vision.recognition.verification import verify_tops
from srvs_cell.vision.recognition.workpieces import (
    CUT_OFF,
    IN_NO_LIBRARY,
    corrected,
    make_workpiece,
    measure_face,
    unrecognised,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from srvs_cell.calibration import TableReference
    from srvs_cell.geometry import Array
    from srvs_cell.scene import PlaneImage, Surface, Workpiece
    from srvs_cell.vision.recognition.kinds import ObjectKind
    from srvs_cell.vision.recognition.recovery import Region
    from srvs_cell.vision.recognition.tops import Top
    from srvs_cell.vision.rectification import RectifiedRig
    from srvs_cell.vision.relief import Relief


@checked_dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class RecognitionParameters:
    """Limits of the recognition."""

    min_height_mm: Annotated[
        float, Field(gt=0.0, le=500.0, description="what rises less above the table is table, shadow or print")
    ] = 8.0
    max_height_mm: Annotated[
        float, Field(gt=0.0, le=2000.0, description="what rises more is a false match; at most what both cameras see")
    ] = 200.0
    min_size_mm: Annotated[float, Field(gt=0.0, le=500.0, description="least side of a top face")] = 10.0
    max_size_mm: Annotated[
        float,
        Field(
            gt=0.0, le=2000.0, description="greatest side of a top face; borders in space propose none longer than 160"
        ),
    ] = 160.0
    min_unknown_area_mm2: Annotated[
        float,
        Field(
            gt=0.0,
            le=1e6,
            description="least area of a matched surface that is reported as unknown or as one of an unknown part's; "
            "what rises over the table is reported however small its surfaces are",
        ),
    ] = 200.0
    max_rms_px: Annotated[
        float, Field(gt=0.0, le=3.0, description="greatest distance between a figure and the edges")
    ] = 1.2
    min_support: Annotated[
        float,
        Field(
            gt=0.0,
            le=1.0,
            description="least share of a figure's outline that has an edge in both images; 11/14 of it for a figure "
            "that explains what rises",
        ),
    ] = 0.7
    min_gradient: Annotated[
        float, Field(gt=0.0, le=100.0, description="least gradient of an edge, grey values per pixel")
    ] = 0.5
    min_inclination_deg: Annotated[
        float, Field(gt=0.0, lt=90.0, description="a top face inclined by less is level")
    ] = 5.0
    max_inclination_deg: Annotated[
        float, Field(gt=0.0, lt=90.0, description="a face inclined by more is a side face")
    ] = 50.0
    inclined_gain: Annotated[
        float, Field(gt=0.0, le=1.0, description="an inclined figure must fit better than the level one by this factor")
    ] = 0.7
    recover: Annotated[
        bool, Field(description="look for planes without a partner by their grey values (beyond the paper)")
    ] = True
    grasp: GraspParameters = Field(default_factory=GraspParameters)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        check_pairs(
            self,
            ("min_height_mm", "max_height_mm"),
            ("min_size_mm", "max_size_mm"),
            ("min_inclination_deg", "max_inclination_deg"),
        )
        return self


def recognise(
    surfaces: Iterable[Surface],
    left: PlaneImage,
    right: PlaneImage,
    rig: RectifiedRig,
    table_z_mm: float,
    parameters: RecognitionParameters | None = None,
    reference: TableReference | None = None,
    relief: Relief | None = None,
    kinds: Sequence[ObjectKind] = BUILT_IN_KINDS,
) -> tuple[Workpiece, ...]:
    """Group surfaces into objects, recognise their kinds and measure them.

    Args:
        surfaces: matched planes in the base frame.
        left: the rectified left image with its planes.
        right: the rectified right image with its planes.
        rig: the rectified cameras.
        table_z_mm: height of the table in the base frame.
        parameters: limits; the defaults where None.
        reference: corrects what calibration and poses misplace; None corrects nothing.
        relief: what rises over the table; None where that was not measured.
        kinds: the library; the first kind that fits wins.

    Returns:
        Workpieces, the highest first; shapes that are in no library have the kind ``unknown``.
    """
    limits = parameters or RecognitionParameters()
    evidence = Evidence.of(left, right, rig, table_z_mm, limits)
    matched = tuple(surfaces)
    planes = unmatched_planes(left, {surface.id for surface in matched}) if limits.recover else []
    tops: list[Top] = []
    unseen: list[Array] = []
    if relief is None:
        add_tops(matched, tops, evidence)
        seen = on_tops(tops, rig)
        add_tops(find_places([plane for plane in planes if not seen(plane.outline_px)], evidence), tops, evidence)
        tops = one_per_place(tops)
    else:
        rises = rising_test(tops, relief, rig, table_z_mm)
        add_tops([surface for surface in matched if rises(outline_px(surface, rig))], tops, evidence)
        tops, unseen = verify_tops(tops, planes, relief, evidence)
    tops, others = share_out(matched, tops, rig, table_z_mm)
    rising = [surface for surface in others if _rises(surface, table_z_mm, limits)]
    if relief is None:
        unknown = [
            unrecognised(
                surface,
                rig.error_budget.systematic_mm2(surface.centre_mm),
                (surface.id,),
                table_z_mm,
                _brightness(surface, left, rig),
                IN_NO_LIBRARY,
            )
            for surface in rising
        ]
    else:
        regions = rising_regions(unseen, explained_polygons(tops, rig, table_z_mm), left.grey.shape)
        unknown = [
            unrecognised(
                *corrected(surface, rig, reference),
                _lying_in(region, rising, rig),
                table_z_mm,
                _brightness(surface, left, rig),
                CUT_OFF if is_cut_off(region, relief) else IN_NO_LIBRARY,
            )
            for region, surface in zip(regions, place_unknown(regions, relief, evidence), strict=True)
            if surface is not None
        ]
    faces = [measure_face(top, left.grey, rig, reference) for top in tops]
    workpieces = [
        make_workpiece(group, faces, table_z_mm, limits.grasp)
        for group in group_faces([one.face for one in faces], table_z_mm, kinds)
    ]
    workpieces += unknown
    workpieces = with_clearances(workpieces, table_z_mm)
    workpieces.sort(key=lambda workpiece: -workpiece.height_mm)
    return tuple(replace(workpiece, id=number) for number, workpiece in enumerate(workpieces))


def _lying_in(region: Region, surfaces: Iterable[Surface], rig: RectifiedRig) -> tuple[int, ...]:
    """Return the ids of the surfaces whose middle lies in a region of the left image."""
    middles = ((surface.id, *rig.project_px(np.array(surface.centre_mm))) for surface in surfaces)
    return tuple(id_ for id_, x, y, _ in middles if region.holds(float(x), float(y)))


def _brightness(surface: Surface, left: PlaneImage, rig: RectifiedRig) -> float | None:
    return face_brightness(surface.outline_mm, left.grey, rig)


def _plan_area_mm2(surface: Surface) -> float:
    return float(cv2.contourArea(surface.outline_mm[:, :2].astype(np.float32)))


def _rises(surface: Surface, table_z_mm: float, limits: RecognitionParameters) -> bool:
    """Whether a surface is a face of something that stands on the table, and no wall."""
    height_mm = surface.centre_mm[2] - table_z_mm
    steepest = float(np.cos(np.deg2rad(limits.max_inclination_deg)))
    return (
        limits.min_height_mm <= height_mm <= limits.max_height_mm
        and surface.normal[2] > steepest
        and _plan_area_mm2(surface) >= limits.min_unknown_area_mm2
    )
