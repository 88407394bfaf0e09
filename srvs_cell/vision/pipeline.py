"""The steps in their order: two images in, planes, matches, disparities, surfaces and workpieces out.

Two stages, so that the first image can be worked on while the arm travels: `analyse_image` extracts the planes of one
rectified image; `perceive` does the rest and takes over an analysis made before. Where a calibration turns the images
(`StereoView`), an early analysis of the left image is made by `analyse_left` with the *planned* right pose and is only
used where the reported one turns the picture by no more than a fraction of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from srvs_cell.alarms import Alarm, AlarmError
from srvs_cell.scene import Perception, PlaneImage, PlaneMatch
from srvs_cell.vision.dense import fill_disparity
from srvs_cell.vision.edges import extract_edges
from srvs_cell.vision.filtering import filter_edges
from srvs_cell.vision.grouping import Grouping, group_surfaces
from srvs_cell.vision.interpolation import disparity_at, fill_plane, fill_rows, find_row_ends, fit_disparity_plane
from srvs_cell.vision.lateral_stereo import surfaces_from_matches
from srvs_cell.vision.matching import find_matches
from srvs_cell.vision.picture_check import check_different, check_pair, check_picture
from srvs_cell.vision.planes import measure_planes
from srvs_cell.vision.recognition import BUILT_IN_KINDS, recognise
from srvs_cell.vision.rectification import rectify_pair, to_grey
from srvs_cell.vision.refinement import SMOOTHING_PX, GreyPair, refine_matches
from srvs_cell.vision.region_growing import grow_regions
from srvs_cell.vision.relief import measure_relief
from srvs_cell.vision.table_alignment import align_table
from srvs_cell.vision.thinning import thin
from srvs_cell.vision.tracking import track_edges

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from srvs_cell.calibration import Calibration
    from srvs_cell.geometry import Transform
    from srvs_cell.scene import Plane, Surface, Workpiece
    from srvs_cell.vision.parameters import VisionParameters
    from srvs_cell.vision.recognition import ObjectKind
    from srvs_cell.vision.rectification import RectifiedRig

    Image = NDArray[np.uint8]
    Mask = NDArray[np.bool_]

MIN_SIDE_PX = 16
"""An image with a shorter side shows no plane."""
_CHANNELS = 3
_DIMENSIONS = (2, 3)
_MILLISECONDS = 1000.0
_REUSE_SHIFT_PX = 0.5
_MOSTLY = 0.5


@dataclass(frozen=True, eq=False)
class StereoView:
    """Where the two images were taken from, and what stands there.

    Attributes:
        calibration: intrinsics and hand-eye.
        base_T_tcp_left, base_T_tcp_right: reported poses.
        table_z_mm: height of the table in the base frame.
        max_height_mm: greatest height of a part above the table: it bounds the disparity. What is more than both
            cameras can see below them counts as that.
    """

    calibration: Calibration
    base_T_tcp_left: Transform  # noqa: N815 - the house's notation for transforms
    base_T_tcp_right: Transform  # noqa: N815 - as above
    table_z_mm: float
    max_height_mm: float = 200.0


@dataclass(frozen=True, eq=False)
class LeftAnalysis:
    """The planes of the left image, found before the right one was taken.

    Attributes:
        image: the rectified left image and its planes.
        rig: the cameras by the planned right pose; None without calibration.
    """

    image: PlaneImage
    rig: RectifiedRig | None


class _Steps:
    """Measures the steps; without a stopwatch it measures nothing."""

    def __init__(self, stopwatch: Callable[[], float] | None) -> None:
        self._stopwatch = stopwatch
        self._since = stopwatch() if stopwatch else 0.0
        self.timings_ms: dict[str, float] = {}

    def done(self, step: str) -> None:
        """Add the time since the last call to a step."""
        if self._stopwatch:
            now = self._stopwatch()
            self.timings_ms[step] = self.timings_ms.get(step, 0.0) + _MILLISECONDS * (now - self._since)
            self._since = now


def analyse_image(grey: Image, parameters: VisionParameters, valid: Mask | None = None) -> PlaneImage:
    """Extract the planes of one rectified image: edges, filter, thinning, tracking, region growing, parameters.

    Args:
        grey: uint8, shape (H, W).
        parameters: of the vision.
        valid: bool, shape (H, W): pixels that the camera saw; all where None.
    """
    return _analyse(grey, parameters, valid, _Steps(None))


def analyse_left(left: Image, parameters: VisionParameters, view: StereoView) -> LeftAnalysis:
    """Analyse the left image early, with the planned right pose in ``view``.

    Raises:
        AlarmError: IMAGE_INVALID, IMAGE_UNUSABLE or BASELINE_INVALID.
    """
    grey = _checked(left, "left")
    check_picture(grey, "left")
    pair = rectify_pair(grey, grey, view.calibration, view.base_T_tcp_left, view.base_T_tcp_right)
    return LeftAnalysis(analyse_image(pair.left, parameters, pair.left_valid), pair.rig)


def perceive(
    left: Image,
    right: Image,
    parameters: VisionParameters,
    *,
    view: StereoView | None = None,
    early: LeftAnalysis | None = None,
    kinds: Sequence[ObjectKind] = BUILT_IN_KINDS,
    stopwatch: Callable[[], float] | None = None,
) -> Perception:
    """See: from two images to planes, matches and disparities, with calibration to workpieces.

    Args:
        left: uint8, shape (H, W) grey or (H, W, 3) BGR; without ``view`` already rectified.
        right: the other image, of the same size.
        parameters: of the vision; without ``view`` its disparity range is used.
        view: calibration and poses; None to work in pixels alone.
        early: what `analyse_left` found in the same left image; used where the reported poses allow it.
        kinds: the library of objects; the first kind that fits wins.
        stopwatch: returns seconds; None measures no times.

    Raises:
        AlarmError: IMAGE_INVALID where an image is no image, too small, or not of the other's or the calibration's
            size; IMAGE_UNUSABLE where it shows nothing; PAIR_INCONSISTENT where both are one picture, or do not show
            one scene from their poses; BASELINE_INVALID where the poses make no baseline.
    """
    steps = _Steps(stopwatch)
    left_grey, right_grey = checked_pair(left, right)
    pair, valid_left, valid_right, rig = None, None, None, None
    reference, table, relief = None, None, None
    disparity_range = (parameters.min_disparity_px, parameters.max_disparity_px)
    if view is not None:
        pair = rectify_pair(left_grey, right_grey, view.calibration, view.base_T_tcp_left, view.base_T_tcp_right)
        left_grey, right_grey, rig = pair.left, pair.right, pair.rig
        valid_left, valid_right = pair.left_valid, pair.right_valid
        view = before_camera(view, rig, left_grey.shape[1], parameters.recognition.min_height_mm)
        highest_mm = min(parameters.recognition.max_height_mm, visible_height_mm(view, rig, left_grey.shape[1]))
        parameters = replace(parameters, recognition=replace(parameters.recognition, max_height_mm=highest_mm))
        height, width = left_grey.shape
        disparity_range = rig.disparity_range(view.table_z_mm, view.table_z_mm + view.max_height_mm, (width, height))
        steps.done("rectification")
    smoothed = GreyPair.of(left_grey, right_grey)
    if view is not None and pair is not None:
        if parameters.table.enabled:
            reference, table = align_table(pair, view.table_z_mm, parameters.table)
        if table is None or table.refusal:
            # nothing has shown yet that the pictures belong to the poses
            check_pair(pair, view.table_z_mm, view.max_height_mm)
        if reference is not None:
            relief = measure_relief(pair, smoothed, view.table_z_mm, reference)
        steps.done("table")
    if early is not None and _usable(early, rig, left_grey):
        left_planes = replace(early.image, grey=left_grey)
    else:
        left_planes = _analyse(left_grey, parameters, valid_left, steps, smoothed.left)
    right_planes = _analyse(right_grey, parameters, valid_right, steps, smoothed.right)
    seen, disparity_px, ambiguous = _match(
        left_planes, right_planes, smoothed, disparity_range, parameters, (valid_left, valid_right), steps
    )
    surfaces: tuple[Surface, ...] = ()
    workpieces: tuple[Workpiece, ...] = ()
    if rig is not None and view is not None:
        surfaces = surfaces_from_matches(seen.left, seen.matches, rig)
        steps.done("depth")
        workpieces = recognise(
            surfaces, seen.left, seen.right, rig, view.table_z_mm, parameters.recognition, reference, relief, kinds
        )
        steps.done("recognition")
    return Perception(
        seen.left,
        seen.right,
        seen.matches,
        disparity_px,
        surfaces,
        workpieces,
        steps.timings_ms,
        table,
        ambiguous,
    )


def visible_height_mm(view: StereoView, rig: RectifiedRig, width_px: int) -> float:
    """Return the height over the table above which the two cameras have nothing in common: disparity is the width."""
    nearest_mm = rig.f_px * rig.baseline_mm / width_px
    return float(rig.base_T_camera.translation_mm[2]) - nearest_mm - view.table_z_mm


def before_camera(view: StereoView, rig: RectifiedRig, width_px: int, min_height_mm: float) -> StereoView:
    """Return the view with no greater height of parts than both cameras can see.

    A greater one is no mistake of the integrator: it says that the parts do not bound what is looked for.

    Args:
        view: where the images were taken from.
        rig: the rectified cameras.
        width_px: of the rectified images.
        min_height_mm: least height of a part above the table.

    Raises:
        AlarmError: PAIR_INCONSISTENT where no part on the table could be seen at all.
    """
    visible_mm = visible_height_mm(view, rig, width_px)
    if visible_mm <= min_height_mm:
        raise AlarmError(
            Alarm.PAIR_INCONSISTENT,
            f"By its poses the camera is {rig.base_T_camera.translation_mm[2]:.0f} mm high, the table "
            f"{view.table_z_mm:.0f} mm: nothing that stands there is in both pictures. Check poses and table height.",
        )
    return replace(view, max_height_mm=min(view.max_height_mm, visible_mm))


def checked_pair(left: Image, right: Image) -> tuple[Image, Image]:
    """Return both images in grey where something can be seen in them.

    Args:
        left: uint8, shape (H, W) grey or (H, W, 3) BGR.
        right: the other image.

    Raises:
        AlarmError: IMAGE_INVALID where an image is no 8-bit picture, too small, or not of the other's size;
            IMAGE_UNUSABLE where it shows nothing; PAIR_INCONSISTENT where both are one picture.
    """
    left_grey, right_grey = _checked(left, "left"), _checked(right, "right")
    if left_grey.shape != right_grey.shape:
        raise AlarmError(
            Alarm.IMAGE_INVALID, f"The left image is {_size(left_grey)}, the right one {_size(right_grey)} pixels."
        )
    for grey, name in ((left_grey, "left"), (right_grey, "right")):
        check_picture(grey, name)
    check_different(left_grey, right_grey)
    return left_grey, right_grey


def _checked(image: Image, name: str) -> Image:
    """Return the image in grey; raises `AlarmError` IMAGE_INVALID where it is no 8-bit picture of a useful size."""
    if image.ndim not in _DIMENSIONS or image.dtype != np.uint8 or (image.ndim > 2 and image.shape[2] != _CHANNELS):  # noqa: PLR2004 - more than rows and columns
        raise AlarmError(
            Alarm.IMAGE_INVALID,
            f"The {name} image has shape {image.shape} and type {image.dtype}; 8-bit grey or BGR is expected.",
        )
    if min(image.shape[:2]) < MIN_SIDE_PX:
        raise AlarmError(
            Alarm.IMAGE_INVALID,
            f"The {name} image is {_size(image)} pixels; each side must be at least {MIN_SIDE_PX}.",
        )
    return to_grey(image)


def _usable(early: LeftAnalysis, rig: RectifiedRig | None, grey: Image) -> bool:
    """Whether the early analysis' labels lie where they belong in the picture as it is rectified now."""
    if early.rig is None or rig is None:
        return early.rig is rig and early.image.grey.shape == grey.shape
    height, width = grey.shape
    corners = np.array([[0.0, 0.0], [width - 1.0, 0.0], [0.0, height - 1.0], [width - 1.0, height - 1.0]])
    x, y = corners.T
    rays = np.stack([(x - rig.cx_px) / rig.f_px, (y - rig.cy_px) / rig.f_px, np.ones_like(x)], axis=-1)
    turned = rays @ rig.base_T_camera.rotation.T @ early.rig.base_T_camera.rotation
    seen = early.rig.f_px * turned[:, :2] / turned[:, 2:] + (early.rig.cx_px, early.rig.cy_px)
    return bool(np.abs(seen - corners).max() <= _REUSE_SHIFT_PX)


def _size(image: Image) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"


def _analyse(
    grey: Image,
    parameters: VisionParameters,
    valid: Mask | None,
    steps: _Steps,
    smoothed: NDArray[np.float32] | None = None,
) -> PlaneImage:
    """Analyse as `analyse_image`; ``smoothed`` is the image as the alignment needs it, where that is at hand."""
    shared = smoothed if parameters.edges.smoothing_px == SMOOTHING_PX else None
    edges = extract_edges(grey, parameters.edges, shared).mask
    if valid is not None:
        edges &= valid
    steps.done("edges")
    edges = filter_edges(edges, parameters.filtering)
    steps.done("filtering")
    edges = thin(edges)
    steps.done("thinning")
    edges = track_edges(edges, parameters.tracking)
    steps.done("tracking")
    regions = grow_regions(grey, edges, parameters.planes, valid)
    steps.done("region_growing")
    labels, planes = measure_planes(grey, regions, parameters.planes, valid)
    steps.done("plane_parameters")
    return PlaneImage(grey, labels, planes)


def _match(
    left: PlaneImage,
    right: PlaneImage,
    pair: GreyPair,
    disparity_range_px: tuple[float, float],
    parameters: VisionParameters,
    valid: tuple[Mask | None, Mask | None],
    steps: _Steps,
) -> tuple[Grouping, NDArray[np.float32], tuple[Plane, ...]]:
    """Match planes and interpolate; returns planes and matches, the dense disparity map and the ambiguous planes."""
    matching = find_matches(left.planes, right.planes, disparity_range_px, parameters.matching)
    steps.done("matching")
    ends = (
        find_row_ends(pair.left, left.labels, len(left.planes), parameters.interpolation, valid[0]),
        find_row_ends(pair.right, right.labels, len(right.planes), parameters.interpolation, valid[1]),
    )
    matches = []
    for found in matching.pairs:
        fit = fit_disparity_plane(found.left, found.right, *ends, parameters.interpolation)
        if fit is not None:
            fitted, sigma = fit
            at_centre = float(disparity_at(fitted, *left.planes[found.left - 1].centre_px))
            matches.append(PlaneMatch(found.left, found.right, found.score, at_centre, fitted, sigma))
    steps.done("interpolation")
    if parameters.refinement.enabled:
        matches = refine_matches(left, matches, pair, disparity_range_px, parameters.refinement)
        steps.done("refinement")
    grouping = Grouping(left, right, tuple(matches))
    if parameters.grouping.enabled:
        grouping = group_surfaces(left, right, matches, pair, parameters, valid)
        steps.done("grouping")
    disparity_px = np.full(left.grey.shape, np.nan, dtype=np.float32)
    # a plane that was aligned or joined is not where its rows' ends say any more
    by_rows = not (parameters.interpolation.sub_pixel or parameters.refinement.enabled or parameters.grouping.enabled)
    low, high = disparity_range_px
    margin = parameters.matching.max_column_margin_px
    for match in grouping.matches:
        plane = grouping.left.planes[match.left - 1]
        if by_rows:
            pair_of_planes = plane, right.planes[match.right - 1]
            fill_rows(disparity_px, left.labels, pair_of_planes, ends, (max(low - margin, 0.0), high + margin))
        else:
            fill_plane(disparity_px, grouping.left.labels, plane, match.disparity_plane)
    steps.done("interpolation")
    if grouping.surfaces and parameters.dense.enabled:
        images = (left.grey, right.grey)
        disparity_px = fill_disparity(images, grouping.surfaces, parameters.dense, parameters.refinement, valid[0])
        steps.done("dense")
    return grouping, disparity_px, _unresolved([left.planes[id_ - 1] for id_ in matching.ambiguous], left, grouping)


def _unresolved(ambiguous: Sequence[Plane], left: PlaneImage, grouping: Grouping) -> tuple[Plane, ...]:
    """Return the ambiguous planes that did not become part of a matched surface when regions were joined."""
    matched = np.zeros(len(grouping.left.planes) + 1, dtype=np.bool_)
    matched[[match.left for match in grouping.matches]] = True
    unresolved = []
    for plane in ambiguous:
        x, y, width, height = plane.box_px
        box = np.s_[y : y + height, x : x + width]
        if matched[grouping.left.labels[box]][left.labels[box] == plane.id].mean() <= _MOSTLY:
            unresolved.append(plane)
    return tuple(unresolved)
