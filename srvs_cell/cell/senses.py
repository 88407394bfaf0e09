"""What the unit asks of vision and planning, as callables, so that both can be replaced in tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from srvs_cell.planning import CellPlan, KeptPlaces
from srvs_cell.scene import Perception, Workpiece

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from srvs_cell.geometry import Transform


@dataclass(frozen=True, eq=False)
class StereoLook:
    """The two images of one lateral path and the poses that the arm reported at its ends.

    Attributes:
        left, right: uint8, shape (H, W) or (H, W, 3).
        base_T_tcp_left, base_T_tcp_right: reported poses.
        early: what `AnalyseLeft` made of the left image, where there is one.
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    base_T_tcp_left: Transform  # noqa: N815 - the notation of transforms
    base_T_tcp_right: Transform  # noqa: N815 - the notation of transforms
    early: Any = None


AnalyseLeft = Callable[["NDArray[np.uint8]", "Transform", "Transform"], Any]
"""(left image, reported left pose, planned right pose) -> what `Perceive` can use. Called in a worker thread while the
arm travels to the right end; raises `AlarmError` where the image does not allow it."""


Perceive = Callable[[StereoLook], Perception]
"""Raises `AlarmError` where the images do not allow a perception. Called in a worker thread."""

PlanJob = Callable[[Sequence[Workpiece], KeptPlaces | None], CellPlan]
"""(workpieces, places of the job where it has begun) -> plan. Raises `AlarmError` as
`srvs_cell.planning.plan_relocation`. Called in a worker thread."""

Pictures = Callable[[Perception], Mapping[str, "NDArray[np.uint8]"]]
"""Name -> image, of what was perceived, for the run folder and the operator's page."""
