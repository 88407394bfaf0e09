"""Perceive the rendered scenes and compare with their exact truth.

    python benchmarks/perceive_rendered.py [DATA] [--levels L0 L1 L2] [--scenes L1/004 ...] [--shaken N] [--json]
        [--pictures DIR]

DATA is the folder of the rendered scenes ($SRVS_DATA/rendered_scenes, or ../shared/data/rendered_scenes beside the
repository). A workpiece is taken for the object that is nearest in x and y, one to one, within 15 mm. Counted are the
fully visible objects; `spurious` are workpieces that are taken for no object at all, visible or not. `in 3 CR` is the
share of the objects within three times their own Cramer-Rao bound (`benchmarks.scene_truth`; printed is its median) or
1.0 mm, whichever is larger; what is missed is not. The bound is the pictures': it knows of no wrong calibration.
`order` are the scenes whose found objects come in the order of their true heights; 0.1 mm apart is no order. `random`
is the share of the truths inside the ellipsoid that holds 95 % by the random part of the covariance alone, as it should
be on L0 and L1, where calibration and poses are right.

Told apart are the objects of which something is hidden, by another one or beyond a picture's border: how many are
recognised, how far off they are and whether the error was known (`in 95 %`), and how many of the spurious workpieces
are a piece of one, farther than 15 mm from the whole's middle but over it. `grasps` are the workpieces that a robot
would take; `off` are those that are farther sideways from any object's middle than a grasp allows (4 mm): what it would
miss and nobody was told. Scenes whose pictures the vision refuses are told, and all that is in them is missed.

What hangs on the last digit in these few scenes is chance. `--shaken 10` counts each scene ten times instead, with
pictures of which two pixels in 10,000, other ones each time, are one grey value brighter or darker.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import yaml
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from benchmarks.scene_truth import position_bound_mm
from srvs_cell.alarms import AlarmError
from srvs_cell.calibration import Calibration
from srvs_cell.geometry import Transform, Xyzwpr, wrap_angle_deg
from srvs_cell.scene import UNKNOWN_KIND
from srvs_cell.vision import StereoView, VisionParameters, perceive
from srvs_cell.vision.overlay import draw_locations, draw_matches

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from srvs_cell.scene import Perception, Workpiece

MATCH_RADIUS_MM = 15.0
BOUNDS, ALLOWED_MM = 3.0, 1.0
TIE_MM = 0.1
SHAKEN_SHARE = 2e-4
LEVELS = ("L0", "L1", "L2")
_SQUARE_RATIO = 1.05
_FAR = 1e6


@dataclass(frozen=True)
class Found:
    """One object, and what was seen of it; None where nothing was."""

    scene: str
    kind: str
    seen_kind: str | None
    bound_mm: float
    """Cramer-Rao bound of its position, see `benchmarks.scene_truth.position_bound_mm`; NaN where it is not known."""
    error_mm: float | None = None
    height_error_mm: float | None = None
    yaw_error_deg: float | None = None
    offset_mm: tuple[float, float, float] | None = None
    heights_mm: tuple[float, float] | None = None
    """The true one and the one seen."""
    inside_95: bool | None = None
    """Whether the truth is inside the ellipsoid that holds it in 95 % of the cases; None for unknown shapes."""
    inside_random_95: bool | None = None
    """The same with the random part of the covariance alone; None where that is not told apart, too."""

    @property
    def near_bound(self) -> bool:
        """Whether it is as near to the truth as the noise lets anyone know, give or take."""
        return self.error_mm is not None and self.error_mm <= max(ALLOWED_MM, BOUNDS * self.bound_mm)


@dataclass(frozen=True)
class SceneResult:
    """One scene: its fully visible objects, the partly hidden ones, and what was seen where nothing is.

    ``pieces`` of the spurious workpieces are pieces of partly hidden objects. Of all workpieces ``grasps`` have a
    grasp, ``grasps_off`` one that misses.
    """

    scene: str
    objects: tuple[Found, ...]
    partly_hidden: tuple[Found, ...]
    spurious: tuple[str, ...]
    pieces: int
    grasps: int = 0
    grasps_off: int = 0
    matched_planes: int = 0
    milliseconds: float = 0.0
    refusal: str = ""
    """Why the pictures were not perceived at all."""

    @property
    def in_order(self) -> bool:
        """Whether what was found and sorted by the heights seen is in the true order; refused pictures tell none."""
        both = [one.heights_mm for one in self.objects if one.heights_mm is not None]
        true = np.array([height for height, _ in sorted(both, key=lambda pair: pair[1])])
        return not self.refusal and bool(np.all(np.maximum.accumulate(true) - true <= TIE_MM))


def data_folder() -> Path:
    """Return where the rendered scenes are expected."""
    root = os.environ.get("SRVS_DATA") or str(Path(__file__).resolve().parents[2] / "shared" / "data")
    return Path(root) / "rendered_scenes"


def run_scene(
    folder: Path, parameters: VisionParameters, shaken: int | None = None
) -> tuple[Perception, list[dict[str, Any]], float]:
    """Perceive one scene; returns the perception, the true objects with their bounds, and the milliseconds it took.

    Args:
        folder: of the scene.
        parameters: of the vision.
        shaken: which pixels are one grey value off, any number; None for the pictures as they are.

    Raises:
        AlarmError: the vision refuses the pictures.
    """
    images, view, objects = _read(folder, shaken)
    since = time.perf_counter()
    perception = perceive(images[0], images[1], parameters, view=view, stopwatch=time.perf_counter)
    return perception, objects, 1000.0 * (time.perf_counter() - since)


def _read(folder: Path, shaken: int | None) -> tuple[list[NDArray[np.uint8]], StereoView, list[dict[str, Any]]]:
    """Return a scene's pictures, where they were taken, and the true objects with their bounds."""
    calibration = Calibration.from_mapping(
        yaml.safe_load((folder / "calibration.yaml").read_text(encoding="utf-8")), str(folder / "calibration.yaml")
    )
    poses = json.loads((folder / "poses.json").read_text(encoding="utf-8"))
    left, right = (Transform.from_xyzwpr("base", "tcp", Xyzwpr(*poses[side])) for side in ("left", "right"))
    view = StereoView(calibration, left, right, poses["table_z_mm"])
    images = [
        np.asarray(cv2.imread(str(folder / f"{side}.png"), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
        for side in ("left", "right")
    ]
    if shaken is not None:
        random = np.random.default_rng(shaken)
        images = [_shaken(image, random) for image in images]
    objects = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["objects"]
    for one in objects:
        # who exported the scene may not have said how the faces lie
        one["bound_mm"] = position_bound_mm(one, images[0], view) if "face_normal" in one else float("nan")
    return images, view, objects


def _shaken(image: NDArray[np.uint8], random: np.random.Generator) -> NDArray[np.uint8]:
    changes = random.choice([-1, 0, 1], image.shape, p=[SHAKEN_SHARE / 2, 1.0 - SHAKEN_SHARE, SHAKEN_SHARE / 2])
    return np.clip(image + changes, 0, 255).astype(np.uint8)


def judge(scene: str, workpieces: Sequence[Workpiece], objects: Sequence[dict[str, Any]]) -> SceneResult:
    """Compare workpieces with the truth."""
    seen = np.array([workpiece.position_mm for workpiece in workpieces]).reshape(-1, 3)
    true = np.array([one["position_mm"] for one in objects]).reshape(-1, 3)
    distance = np.linalg.norm(true[:, None, :2] - seen[None, :, :2], axis=2)
    rows, columns = linear_sum_assignment(np.where(distance <= MATCH_RADIUS_MM, distance, _FAR))
    partner = {
        int(row): int(column)
        for row, column in zip(rows, columns, strict=True)
        if distance[row, column] <= MATCH_RADIUS_MM
    }
    found = [
        _compare(scene, one, workpieces[partner[number]] if number in partner else None)
        for number, one in enumerate(objects)
    ]
    whole = [bool(one["fully_visible"]) for one in objects]
    half_mm = np.array([np.hypot(*one["size_mm"]) / 2.0 for one in objects])
    over_hidden = (distance < half_mm[:, None])[~np.array(whole, dtype=np.bool_)].any(axis=0)
    spurious = sorted(set(range(len(workpieces))) - set(partner.values()))
    grasped = np.array([workpiece.grasp is not None for workpiece in workpieces], dtype=np.bool_)
    misses = distance.min(axis=0, initial=np.inf) > VisionParameters().recognition.grasp.tolerance_mm
    return SceneResult(
        scene,
        tuple(one for one, is_whole in zip(found, whole, strict=True) if is_whole),
        tuple(one for one, is_whole in zip(found, whole, strict=True) if not is_whole),
        tuple(_described(scene, workpieces[number]) for number in spurious),
        int(np.count_nonzero(over_hidden[spurious])),
        int(np.count_nonzero(grasped)),
        int(np.count_nonzero(grasped & misses)),
    )


def _described(scene: str, workpiece: Workpiece) -> str:
    place = [round(value, 1) for value in workpiece.position_mm]
    return f"{scene} {workpiece.kind} {place} surfaces {workpiece.surfaces}"


def _compare(scene: str, one: dict[str, Any], workpiece: Workpiece | None) -> Found:
    if workpiece is None:
        return Found(scene, one["kind"], None, one["bound_mm"])
    offset = np.array(workpiece.position_mm) - np.array(one["position_mm"])
    length, width = one["size_mm"]
    yaw_error = None
    if one["yaw_deg"] is not None and workpiece.yaw_deg is not None and length > _SQUARE_RATIO * width:
        yaw_error = abs(wrap_angle_deg(workpiece.yaw_deg - one["yaw_deg"], 180.0))
    return Found(
        scene,
        one["kind"],
        workpiece.kind,
        one["bound_mm"],
        float(np.linalg.norm(offset)),
        abs(workpiece.height_mm - one["height_mm"]),
        yaw_error,
        (float(offset[0]), float(offset[1]), float(offset[2])),
        (one["height_mm"], workpiece.height_mm),
        *_inside(offset, workpiece),
    )


def _inside(offset_mm: np.ndarray[Any, Any], workpiece: Workpiece) -> tuple[bool | None, bool | None]:
    """Return whether an error is as great as the covariance lets expect, whole and with its random part alone."""
    if workpiece.kind == UNKNOWN_KIND:
        return None, None
    whole, systematic = workpiece.covariance_mm2, workpiece.systematic_mm2
    known = [whole] if systematic is None else [whole, whole - systematic]
    inside = [float(offset_mm @ np.linalg.solve(one, offset_mm)) <= float(chi2.ppf(0.95, df=3)) for one in known]
    return inside[0], None if systematic is None else inside[1]


def evaluate(
    folder: Path,
    scenes: Sequence[str],
    pictures: Path | None = None,
    shaken: Sequence[int | None] = (None,),
    parameters: VisionParameters | None = None,
) -> list[SceneResult]:
    """Perceive and judge scenes (names like ``L0/001``), once for each way they are shaken (see `run_scene`).

    Writes overlays where a folder is given; ``parameters`` are the defaults where None.
    """
    parameters = parameters or VisionParameters()
    results = []
    for scene, seed in product(scenes, shaken):
        try:
            perception, objects, milliseconds = run_scene(folder / scene, parameters, seed)
        except AlarmError as error:
            _, _, objects = _read(folder / scene, seed)
            results.append(replace(judge(scene, (), objects), refusal=str(error)))
            continue
        judged = judge(scene, perception.workpieces, objects)
        results.append(replace(judged, matched_planes=len(perception.matches), milliseconds=milliseconds))
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
            name = scene.replace("/", "-")
            cv2.imwrite(str(pictures / f"{name}-matches.png"), draw_matches(perception))
            true = [tuple(one["position_mm"]) for one in objects]
            cv2.imwrite(str(pictures / f"{name}-locations.png"), draw_locations(perception.workpieces, true))
    return results


def summary(results: Sequence[SceneResult]) -> dict[str, float | int]:
    """Return the figures of several scenes together."""
    objects = [one for result in results for one in result.objects]
    seen = [one for one in objects if one.error_mm is not None]
    errors = np.array([one.error_mm for one in seen])
    heights = np.array([one.height_error_mm for one in seen])
    yaws = np.array([one.yaw_error_deg for one in seen if one.yaw_error_deg is not None])
    hidden = [one for result in results for one in result.partly_hidden]
    # an unknown shape claims no middle
    recognised = [one for one in hidden if one.inside_95 is not None]
    return {
        "scenes": len(results),
        "objects": len(objects),
        "found": len(seen),
        "refused": sum(bool(result.refusal) for result in results),
        "spurious": sum(len(result.spurious) for result in results),
        "kind_right": sum(one.kind == one.seen_kind for one in seen),
        "error_mean_mm": _mean(errors),
        "error_median_mm": float(np.median(errors)) if errors.size else float("nan"),
        "error_max_mm": float(errors.max(initial=0.0)),
        "height_error_mean_mm": _mean(heights),
        "yaw_error_mean_deg": _mean(yaws),
        "yaw_error_max_deg": float(yaws.max(initial=0.0)),
        "inside_95_share": _share([one.inside_95 for one in seen]),
        "inside_random_95_share": _share([one.inside_random_95 for one in seen]),
        "in_order": sum(result.in_order for result in results),
        "near_bound_share": _share([one.near_bound for one in objects]),
        "partly_hidden": len(hidden),
        "partly_hidden_recognised": len(recognised),
        "partly_hidden_error_mean_mm": _mean(np.array([one.error_mm for one in recognised])),
        "partly_hidden_inside_95_share": _share([one.inside_95 for one in recognised]),
        "pieces": sum(result.pieces for result in results),
        "grasps": sum(result.grasps for result in results),
        "grasps_off": sum(result.grasps_off for result in results),
        "bound_median_mm": float(np.median([one.bound_mm for one in objects])) if objects else float("nan"),
        "milliseconds": _mean(np.array([result.milliseconds for result in results if not result.refusal])),
    }


def _share(judged: Sequence[bool | None]) -> float:
    """Return the share of what holds among what was judged."""
    return _mean(np.array([one for one in judged if one is not None], dtype=float))


def _mean(values: np.ndarray[Any, Any]) -> float:
    return float(values.mean()) if values.size else float("nan")


def main() -> None:
    """Print one line per scene and per level."""
    parser = argparse.ArgumentParser(description="Perceive the rendered scenes and compare with their truth.")
    parser.add_argument("data", nargs="?", type=Path, default=data_folder())
    parser.add_argument("--levels", nargs="*", default=list(LEVELS))
    parser.add_argument("--scenes", nargs="*", default=None)
    parser.add_argument("--shaken", type=int, metavar="N", help="count each scene N times, a few pixels changed")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--pictures", type=Path, default=None)
    parser.add_argument("--worst-mm", type=float, default=0.6, help="list objects that are farther off than this")
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        sys.exit(f"{arguments.data} is not there: give the folder of the rendered scenes")
    cv2.setNumThreads(1)
    scenes = arguments.scenes or [
        f"{level}/{path.name}" for level in arguments.levels for path in sorted((arguments.data / level).iterdir())
    ]
    shaken = (None,) if arguments.shaken is None else range(arguments.shaken)
    results = evaluate(arguments.data, scenes, arguments.pictures, shaken)
    if arguments.json:
        print(json.dumps([asdict(result) for result in results]))
        return
    for result in results:
        for one in result.objects:
            if one.error_mm is None or one.kind != one.seen_kind or one.error_mm > arguments.worst_mm:
                place = "missed" if one.offset_mm is None else "off by " + " ".join(f"{d:+.2f}" for d in one.offset_mm)
                print(f"  {one.scene} {one.kind} seen as {one.seen_kind}: {place} (bound {one.bound_mm:.2f} mm)")
        if result.refusal:
            print(f"  {result.scene} refused: {result.refusal}")
        for line in result.spurious:
            print(f"  spurious: {line}")
    names = sorted({result.scene.split("/", maxsplit=1)[0] for result in results})
    print(
        f"{'set':<6}{'found':>9}{'spurious':>9}{'kind ok':>8}{'mean mm':>9}{'median':>8}{'max':>8}"
        f"{'height':>8}{'yaw deg':>8}{'max':>7}{'in 95 %':>9}{'random':>9}{'bound':>8}{'in 3 CR':>9}{'order':>8}"
        f"{'ms':>6}"
    )
    for name in [*names, "all"]:
        row = summary([result for result in results if name in {"all", result.scene.split("/", maxsplit=1)[0]}])
        print(
            f"{name:<6}{row['found']:>5}/{row['objects']:<3}{row['spurious']:>9}{row['kind_right']:>8}"
            f"{row['error_mean_mm']:>9.3f}{row['error_median_mm']:>8.3f}{row['error_max_mm']:>8.2f}"
            f"{row['height_error_mean_mm']:>8.3f}{row['yaw_error_mean_deg']:>8.2f}{row['yaw_error_max_deg']:>7.2f}"
            f"{100.0 * row['inside_95_share']:>7.1f} %{100.0 * row['inside_random_95_share']:>7.1f} %"
            f"{row['bound_median_mm']:>8.3f}"
            f"{100.0 * row['near_bound_share']:>7.1f} %{row['in_order']:>5}/{row['scenes']:<2}"
            f"{row['milliseconds']:>6.0f}"
        )
        print(f"      grasps {row['grasps']}, off {row['grasps_off']}")
        if row["partly_hidden"]:
            print(
                f"      partly hidden: {row['partly_hidden']}, recognised {row['partly_hidden_recognised']}, "
                f"mean {row['partly_hidden_error_mean_mm']:.2f} mm, "
                f"in 95 % {100.0 * row['partly_hidden_inside_95_share']:.0f} %; "
                f"of the spurious {row['pieces']} are pieces of them"
            )


if __name__ == "__main__":
    main()
