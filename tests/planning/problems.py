"""Problems for planning tests: small ones made here, and the file of problems with proven optima."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from srvs_cell.planning import Disc, Problem, ProblemObject, RankGoal
from srvs_cell.scene import Grasp, Place, PlaceKind, Workpiece

PROBLEM_FILE = Path("planning") / "problems.json"


def problem_file() -> Path:
    """Return the file of problems with proven optima, beside the data folder; skip where it is absent."""
    data = os.environ.get("SRVS_DATA")
    shared = Path(data).parent if data else Path(__file__).parents[2].parent / "shared"
    path = shared / PROBLEM_FILE
    if not path.is_file():
        pytest.skip(f"no {PROBLEM_FILE} beside the data folder ($SRVS_DATA)")
    return path


def instances() -> list[dict[str, Any]]:
    """Return the instances of the problem file."""
    loaded: list[dict[str, Any]] = json.loads(problem_file().read_text(encoding="utf-8"))["instances"]
    return loaded


def line_problem(
    heights_mm: Sequence[float], *, tolerance_mm: float = 0.0, buffers: int = 1, spacing_mm: float = 100.0
) -> Problem:
    """Return objects of 10 mm radius in a row of slots, ranked from the left, with buffer places beside the row."""
    n = len(heights_mm)
    slots = [Place(i, i * spacing_mm, 0.0, PlaceKind.SLOT) for i in range(n)]
    spare = [Place(n + i, i * spacing_mm, -spacing_mm, PlaceKind.BUFFER) for i in range(buffers)]
    return Problem(
        id="line",
        places=(*slots, *spare),
        objects=tuple(ProblemObject(i, h, Disc(10.0), i, (), f"object {i}") for i, h in enumerate(heights_mm)),
        obstacles=(),
        goal=RankGoal(tuple(range(n)), tolerance_mm),
        home_mm=(0.0, 200.0),
        clearance_mm=5.0,
    )


def wire_problem() -> dict[str, Any]:
    """Return a valid planning-problem/1 object: two objects to swap, gripper, obstacle, one buffer place."""
    return {
        "id": "swap",
        "n": 2,
        "k": 1,
        "home_mm": [0.0, 0.0],
        "clearance_mm": 5.0,
        "places": [
            {"id": 0, "x_mm": 100.0, "y_mm": 0.0, "kind": "slot", "reachable": True},
            {"id": 1, "x_mm": 200.0, "y_mm": 0.0, "kind": "slot", "reachable": True},
            {"id": 2, "x_mm": 150.0, "y_mm": 100.0, "kind": "buffer", "reachable": True},
        ],
        "objects": [
            {"id": 0, "height_mm": 20.0, "shape": "disc", "r_mm": 10.0, "start": 0},
            {"id": 1, "height_mm": 40.0, "shape": "rect", "hx_mm": 12.0, "hy_mm": 8.0, "start": 1},
        ],
        "gripper": {"axes": ["x", "y"], "gap_mm": 5.0, "thick_mm": 10.0, "width_mm": 16.0},
        "obstacles": [{"shape": "disc", "x_mm": 400.0, "y_mm": 400.0, "r_mm": 5.0}],
        "goal": {"type": "rank", "slots": [0, 1], "tol_mm": 0.0, "semantics": "pairwise"},
    }


def workpiece(
    number: int,
    xy_mm: tuple[float, float],
    height_mm: float,
    *,
    size_mm: tuple[float, float] = (40.0, 30.0),
    yaw_deg: float = 0.0,
    kind: str = "cuboid",
    refusal: str = "",
) -> Workpiece:
    """Return a cuboid that is gripped across its short side, or not at all where there is a refusal."""
    length, width = size_mm
    cos, sin = np.cos(np.deg2rad(yaw_deg)), np.sin(np.deg2rad(yaw_deg))
    corners = np.array([[-length, -width], [length, -width], [length, width], [-length, width]]) / 2.0
    grasp = Grasp((*xy_mm, height_mm / 2.0), (yaw_deg + 90.0) % 180.0, width)
    return Workpiece(
        id=number,
        kind=kind,
        position_mm=(*xy_mm, height_mm),
        height_mm=height_mm,
        yaw_deg=yaw_deg,
        size_mm=size_mm,
        covariance_mm2=np.eye(3) * 0.1,
        footprint_mm=corners @ np.array([[cos, -sin], [sin, cos]]).T + np.array(xy_mm),
        surfaces=(number,),
        grasp=None if refusal else grasp,
        grasp_refusal=refusal,
    )
