"""Squares of a chessboard, rows of equals, matched on real photographs: their depth against the board's own plane.

    python benchmarks/perceive_chessboard.py [DATA]

DATA is the folder that holds ``opencv_samples``: 13 pairs of 640 x 480, a board of 9 x 6 inner corners and squares of
25 mm. Each camera has the supplied intrinsics: of the two sets supplied for it the one that fits the board's corners
better (``left_intrinsics.yml`` or its own of ``intrinsics.yml``). How the cameras stand to each other is not supplied
and is found from the corners of all pairs, intrinsics fixed (`cv2.stereoCalibrate`). The pairs are rectified and
perceived without any knowledge of the board.

Judged is every match whose left centre lies on the board: its depth f b / d at the centre against the depth of the
plane that `cv2.solvePnP` gives for the board from the left corners. A match is wrong where the two differ by more than
5 %: the next square of a row is off by a quarter, what lies on the board by nothing. The aim: median within 0.3 %, no
wrong match. An ambiguous square is one that the matching gave up because several partners are alike. How good the
plane is that is judged by, the last two columns say: the same error of the board's own corners, triangulated, and by
how many rows the two cameras see them apart.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from srvs_cell.vision import VisionParameters, perceive

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Image = NDArray[np.uint8]
    Array = NDArray[np.float64]

BOARD = (9, 6)
SQUARE_MM = 25.0
NUMBERS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14)
WRONG = 0.05
_STEP = 1e-4
_HALF_WINDOW_PX = 5
_DEPTH_MARGIN = 1.3
"""The disparity range reaches from the nearest to the farthest board and so much beyond."""


@dataclass(frozen=True, eq=False)
class View:
    """One picture of the board: the image and its inner corners, shape (54, 1, 2)."""

    image: Image
    corners_px: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Camera:
    """Intrinsics: 3x3 matrix and distortion."""

    matrix: Array
    distortion: Array


def board_points() -> NDArray[np.float32]:
    """Return the board's inner corners in its own frame, millimetres, shape (54, 3)."""
    x, y = np.meshgrid(np.arange(BOARD[0]), np.arange(BOARD[1]))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]).astype(np.float32) * np.float32(SQUARE_MM)


def read_view(path: Path) -> View:
    """Read a picture and find its corners; raises `FileNotFoundError` or `ValueError`."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise FileNotFoundError(path)
    found, corners = cv2.findChessboardCorners(image, BOARD)
    if not found:
        raise ValueError(path)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, _STEP)
    refined = cv2.cornerSubPix(image, corners, (_HALF_WINDOW_PX, _HALF_WINDOW_PX), (-1, -1), criteria)
    return View(np.asarray(image, dtype=np.uint8), np.asarray(refined, dtype=np.float32))


def supplied(folder: Path) -> tuple[list[Camera], list[Camera]]:
    """Return the supplied intrinsics that may be the left camera's, and the right one's."""
    both = cv2.FileStorage(str(folder / "intrinsics.yml"), cv2.FILE_STORAGE_READ)
    single = cv2.FileStorage(str(folder / "left_intrinsics.yml"), cv2.FILE_STORAGE_READ)
    of_left = Camera(_matrix(single, "camera_matrix"), _matrix(single, "distortion_coefficients"))
    first, second = (Camera(_matrix(both, f"M{k}"), _matrix(both, f"D{k}")) for k in (1, 2))
    return [of_left, first], [second, of_left]


def _matrix(storage: cv2.FileStorage, name: str) -> Array:
    return np.asarray(storage.getNode(name).mat(), dtype=np.float64)


def reprojection_px(camera: Camera, views: Sequence[View]) -> float:
    """Return the rms over the views of the corners against the board's best pose."""
    squares = []
    for view in views:
        _, rotation, translation = cv2.solvePnP(board_points(), view.corners_px, camera.matrix, camera.distortion)
        seen, _ = cv2.projectPoints(board_points(), rotation, translation, camera.matrix, camera.distortion)
        squares.append(np.mean(np.sum((seen - view.corners_px) ** 2, axis=2)))
    return float(np.sqrt(np.mean(squares)))


@dataclass(frozen=True, eq=False)
class Rig:
    """A rectified pair of cameras.

    Attributes:
        maps: of the left and the right image, as `cv2.remap` takes them, shape (2, 2, H, W).
        rotations: from the left and the right camera to the rectified ones.
        projections: 3x4 of the rectified cameras.
        baseline_mm: distance of the cameras.
        cameras: the left and the right one as they are.
    """

    maps: NDArray[np.float32]
    rotations: tuple[Array, Array]
    projections: tuple[Array, Array]
    baseline_mm: float
    cameras: tuple[Camera, Camera]

    def rectified(self, side: int, view: View) -> Array:
        """Return a view's corners in the rectified image, shape (54, 2)."""
        camera, turn, projection = self.cameras[side], self.rotations[side], self.projections[side]
        seen = cv2.undistortPoints(view.corners_px, camera.matrix, camera.distortion, R=turn, P=projection)
        return np.asarray(seen, dtype=np.float64).reshape(-1, 2)


def make_rig(left: Sequence[View], right: Sequence[View], cameras: tuple[Camera, Camera]) -> tuple[Rig, float]:
    """Find how the cameras stand and rectify them; returns the rig and the rms reprojection error in px."""
    height, width = left[0].image.shape
    size = (width, height)
    error, *_, rotation, translation, _, _ = cv2.stereoCalibrate(
        [board_points()] * len(left),
        [view.corners_px for view in left],
        [view.corners_px for view in right],
        cameras[0].matrix,
        cameras[0].distortion,
        cameras[1].matrix,
        cameras[1].distortion,
        size,
        flags=cv2.CALIB_FIX_INTRINSIC,
    )
    turned = cv2.stereoRectify(
        cameras[0].matrix,
        cameras[0].distortion,
        cameras[1].matrix,
        cameras[1].distortion,
        size,
        rotation,
        translation,
        alpha=0,
    )
    maps = [
        cv2.initUndistortRectifyMap(camera.matrix, camera.distortion, turn, projection, size, cv2.CV_32FC1)
        for camera, turn, projection in zip(cameras, turned[:2], turned[2:4], strict=True)
    ]
    return Rig(
        np.array(maps, dtype=np.float32),
        (np.asarray(turned[0], dtype=np.float64), np.asarray(turned[1], dtype=np.float64)),
        (np.asarray(turned[2], dtype=np.float64), np.asarray(turned[3], dtype=np.float64)),
        float(np.linalg.norm(translation)),
        cameras,
    ), float(error)


def board_plane(view: View, rig: Rig) -> tuple[Array, float]:
    """Return normal n and distance of the board in the rectified left camera, n . P = distance, by `cv2.solvePnP`."""
    camera, turn = rig.cameras[0], rig.rotations[0]
    _, rotation, translation = cv2.solvePnP(board_points(), view.corners_px, camera.matrix, camera.distortion)
    normal = turn @ cv2.Rodrigues(rotation)[0][:, 2]
    return normal, float(normal @ (turn @ translation[:, 0]))


def depth_errors(points_px: Array, disparity_px: Array, view: View, rig: Rig) -> Array:
    """Return the relative depth errors of points of the left image, shape (N, 2), against the board's plane."""
    normal, distance = board_plane(view, rig)
    projection = rig.projections[0]
    f = projection[0, 0]
    rays = np.column_stack([(points_px - projection[:2, 2]) / f, np.ones(len(points_px))])
    return np.asarray(f * rig.baseline_mm / disparity_px / (distance / (rays @ normal)) - 1.0)


def judge_corners(left: View, right: View, rig: Rig) -> tuple[float, float]:
    """Return the median depth error of the board's own corners, and by how many rows the cameras see them apart."""
    one, other = rig.rectified(0, left), rig.rectified(1, right)
    off = depth_errors(one, one[:, 0] - other[:, 0], left, rig)
    return float(np.median(np.abs(off))), float(np.median(one[:, 1] - other[:, 1]))


def judge(left: View, right: View, rig: Rig, disparity_range_px: tuple[float, float]) -> tuple[Array, int]:
    """Return the relative depth errors of the matches on the board, and the number of ambiguous squares."""
    images = [
        np.asarray(cv2.remap(view.image, maps[0], maps[1], cv2.INTER_LINEAR), dtype=np.uint8)
        for view, maps in zip((left, right), rig.maps, strict=True)
    ]
    low, high = disparity_range_px
    perception = perceive(images[0], images[1], VisionParameters(min_disparity_px=low, max_disparity_px=high))
    outline = cv2.convexHull(rig.rectified(0, left).astype(np.float32))
    inside = [
        (match.disparity_px, perception.left.planes[match.left - 1].centre_px)
        for match in perception.matches
        if cv2.pointPolygonTest(outline, perception.left.planes[match.left - 1].centre_px, measureDist=False) >= 0
    ]
    disparity = np.array([disparity_px for disparity_px, _ in inside])
    errors = depth_errors(np.array([centre for _, centre in inside]).reshape(-1, 2), disparity, left, rig)
    on_board = [
        cv2.pointPolygonTest(outline, plane.centre_px, measureDist=False) >= 0 for plane in perception.ambiguous_planes
    ]
    return errors, sum(on_board)


def main() -> None:
    """Print a row for each pair and the whole."""
    parser = argparse.ArgumentParser(description="Squares of a chessboard against the board's plane.")
    root = os.environ.get("SRVS_DATA") or str(Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=Path(root), help="$SRVS_DATA, or ../shared/data")
    options = parser.parse_args()
    folder = options.data / "opencv_samples"
    if not folder.is_dir():
        sys.exit(f"{folder} is not there")
    cv2.setNumThreads(1)
    left, right = ([read_view(folder / f"{side}{number:02}.jpg") for number in NUMBERS] for side in ("left", "right"))
    cameras = []
    for side, candidates, views in zip(("left", "right"), supplied(folder), (left, right), strict=True):
        rms = [reprojection_px(camera, views) for camera in candidates]
        cameras.append(candidates[int(np.argmin(rms))])
        print(f"{side} camera: supplied intrinsics reproject the corners to {' and '.join(f'{e:.2f}' for e in rms)} px")
    rig, error_px = make_rig(left, right, (cameras[0], cameras[1]))
    print(f"stereo {error_px:.2f} px, baseline {rig.baseline_mm:.2f} mm, f {rig.projections[0][0, 0]:.1f} px")
    depths = [distance / normal[2] for normal, distance in (board_plane(view, rig) for view in left)]
    scale = rig.projections[0][0, 0] * rig.baseline_mm
    limits = (scale / max(depths) / _DEPTH_MARGIN, scale / min(depths) * _DEPTH_MARGIN)
    print(f"disparity {limits[0]:.0f} to {limits[1]:.0f} px")
    print(
        f"{'pair':<6}{'matched':>8}{'wrong':>6}{'ambiguous':>10}{'median of depth error':>23}{'corners':>10}{'rows':>7}"
    )
    everything: list[Array] = []
    unsure = 0
    for number, one, other in zip(NUMBERS, left, right, strict=True):
        off, ambiguous = judge(one, other, rig, limits)
        everything.append(off)
        unsure += ambiguous
        of_corners, rows_px = judge_corners(one, other, rig)
        print(row(f"{number:02}", off, ambiguous) + f"{100.0 * of_corners:>8.3f} %{rows_px:>7.2f}")
    print(row("all", np.concatenate(everything), unsure))


def row(name: str, errors: Array, ambiguous: int) -> str:
    """Return a line of the table."""
    median = f"{100.0 * np.median(np.abs(errors)):.3f} %" if errors.size else "-"
    return f"{name:<6}{errors.size:>8}{np.count_nonzero(np.abs(errors) > WRONG):>6}{ambiguous:>10}{median:>23}"


if __name__ == "__main__":
    main()
