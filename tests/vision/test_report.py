"""The JSON of the command line's contract."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from srvs_cell.scene import Grasp, Perception, Plane, PlaneImage, PlaneMatch, Workpiece
from srvs_cell.vision import perception_to_json

PLANE = Plane(3, (10.5, 20.25), 400.0, 80.0, 9.5, 14.0, 120.0, (0, 0, 20, 20), touches_border=False)
IMAGE = PlaneImage(np.zeros((4, 5), np.uint8), np.zeros((4, 5), np.int32), (PLANE,))
WORKPIECE = Workpiece(
    id=0,
    kind="cylinder",
    position_mm=(1.0, 2.0, 3.0),
    height_mm=40.0,
    yaw_deg=None,
    size_mm=(30.0, 30.0),
    covariance_mm2=np.eye(3),
    footprint_mm=np.zeros((4, 2)),
    surfaces=(3,),
    grasp=None,
    grasp_refusal="test",
    brightness=131.0,
)
PERCEPTION = Perception(
    IMAGE,
    IMAGE,
    (PlaneMatch(3, 3, 0.9, 12.5, (0.0, 0.1, 12.0)),),
    np.zeros((4, 5), np.float32),
    (),
    (WORKPIECE,),
    {"edges": 1.5},
)


def test_the_keys_are_those_of_the_contract() -> None:
    report = json.loads(json.dumps(perception_to_json(PERCEPTION)))
    keys = ["planes_left", "planes_right", "matches", "ambiguous_planes", "workpieces", "timings_ms"]
    assert list(report) == keys
    assert report["planes_left"] == [
        {
            "id": 3,
            "centre_px": [10.5, 20.25],
            "area_px": 400.0,
            "perimeter_px": 80.0,
            "short_cut_px": 9.5,
            "long_cut_px": 14.0,
            "brightness": 120.0,
        }
    ]
    assert report["matches"] == [
        {"left": 3, "right": 3, "score": 0.9, "disparity_px": 12.5, "disparity_plane": [0.0, 0.1, 12.0]}
    ]
    assert report["workpieces"] == [
        {
            "id": 0,
            "kind": "cylinder",
            "position_mm": [1.0, 2.0, 3.0],
            "height_mm": 40.0,
            "yaw_deg": None,
            "rise_deg": None,
            "size_mm": [30.0, 30.0],
            "brightness": 131.0,
            "covariance_mm2": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            "systematic_mm2": None,
            "footprint_mm": [[0.0, 0.0]] * 4,
            "surfaces": [3],
            "grasp": None,
            "grasp_refusal": "test",
        }
    ]
    assert report["timings_ms"] == {"edges": 1.5}


def test_grasp_and_the_systematic_part_of_the_covariance_are_told() -> None:
    other = Grasp((1.0, 2.0, -9.0), 135.0, 30.0)
    grasp = replace(other, yaw_deg=45.0, clearance_mm=4.5, others=(other,))
    known = replace(WORKPIECE, grasp=grasp, grasp_refusal="", systematic_mm2=0.5 * np.eye(3))
    (told,) = json.loads(json.dumps(perception_to_json(replace(PERCEPTION, workpieces=(known,)))))["workpieces"]
    one = {"position_mm": [1.0, 2.0, -9.0], "yaw_deg": 45.0, "opening_mm": 30.0, "clearance_mm": 4.5}
    assert told["grasp"] == one | {"others": [one | {"yaw_deg": 135.0, "clearance_mm": None}]}
    assert told["grasp_refusal"] == ""
    assert told["systematic_mm2"] == [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]]


def test_without_calibration_there_are_no_workpieces() -> None:
    assert "workpieces" not in perception_to_json(PERCEPTION, calibrated=False)


def test_ambiguous_planes_are_told_by_place_and_shape() -> None:
    assert perception_to_json(PERCEPTION)["ambiguous_planes"] == []
    (told,) = perception_to_json(replace(PERCEPTION, ambiguous_planes=(PLANE,)))["ambiguous_planes"]
    assert told["centre_px"] == [10.5, 20.25]
    assert told["brightness"] == 120.0
    assert "id" not in told
