"""A workpiece as the snapshot, the run folder and the journal hold it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from srvs_cell.cell.export import workpiece_json
from srvs_cell.scene import Grasp, Workpiece
from srvs_cell.vision import workpiece_to_json

THIRD = 1.0 / 3.0
WORKPIECE = Workpiece(
    id=3,
    kind="cuboid",
    position_mm=(THIRD, 2.0, -0.00004),
    height_mm=40.0 + THIRD,
    yaw_deg=None,
    size_mm=(50.0, 30.0 + THIRD),
    covariance_mm2=THIRD * np.eye(3),
    footprint_mm=np.full((4, 2), THIRD),
    surfaces=(1, 12345),
    grasp=Grasp((THIRD, 2.0, -9.0), 90.0 + THIRD, 30.0),
    brightness=131.0,
    systematic_mm2=0.1 * THIRD * np.eye(3),
)


def fractions(value: Any) -> list[float]:
    """Return all fractions of a plain value, in their order."""
    if isinstance(value, dict):
        return [one for each in value.values() for one in fractions(each)]
    if isinstance(value, list):
        return [one for each in value for one in fractions(each)]
    return [value] if isinstance(value, float) else []


def test_it_has_what_perceive_tells_to_a_tenth_of_a_micrometre() -> None:
    kept, told = workpiece_json(WORKPIECE), workpiece_to_json(WORKPIECE)
    assert list(kept) == list(told)
    assert kept["surfaces"] == [1, 12345]
    assert kept["grasp"]["yaw_deg"] == 90.3333
    assert kept["yaw_deg"] is None
    # the same numbers, rounded to four decimals each
    assert fractions(kept) == pytest.approx(fractions(told), abs=0.5001e-4)
    assert fractions(kept) == [round(one, 4) for one in fractions(told)]
