"""What a unit works with, made from the config: devices, journal, run folder, and the rooms of vision and planning."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from srvs_cell.cell import Equipment, Journal, RunRecorder, Unit, make_devices
from srvs_cell.planning import Workspace, plan_relocation
from srvs_cell.service.common_view import CommonView, check_places
from srvs_cell.vision import LeftAnalysis, StereoView, analyse_left, perceive
from srvs_cell.vision.overlay import draw_matches, draw_views

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from srvs_cell.calibration import Calibration
    from srvs_cell.cell import StereoLook
    from srvs_cell.config import CellConfig
    from srvs_cell.geometry import Transform
    from srvs_cell.planning import CellPlan, KeptPlaces
    from srvs_cell.scene import Perception, Workpiece
    from srvs_cell.vision.recognition import ObjectKind

_JOURNAL = "journal.sqlite"


def make_unit(config: CellConfig, state_dir: Path) -> Unit:
    """Return the unit, with devices that are not connected yet.

    Args:
        config: the cell.
        state_dir: folder of the journal and of the run folders.

    Raises:
        AlarmError: CALIBRATION_INVALID; CONFIG_INVALID where the library of objects is wrong, or a configured
            place is not in view; BASELINE_INVALID.
    """
    calibration = config.load_calibration()
    library = config.load_library()
    view = CommonView.of(config.cell, calibration)
    check_places(config, view)
    workspace = Workspace(*config.cell.workspace.x_mm, *config.cell.workspace.y_mm, view)
    equipment = Equipment(
        parameters=config.cell,
        devices=make_devices(config),
        journal=Journal(state_dir / _JOURNAL),
        recorder=RunRecorder(state_dir, config.service.keep_runs),
        calibration=calibration,
        perceive=partial(_perceive, config, calibration, library.kinds),
        plan=partial(_plan, config, workspace),
        pictures=_pictures,
        analyse_left=partial(_analyse_left, config, calibration),
        in_every_look=view.shows,
    )
    return Unit(equipment, simulation=config.simulation)


def _plan(
    config: CellConfig, workspace: Workspace, workpieces: Sequence[Workpiece], kept: KeptPlaces | None
) -> CellPlan:
    return plan_relocation(workpieces, config.planning, workspace, hand=config.cell.hand(), kept=kept)


def _analyse_left(
    config: CellConfig,
    calibration: Calibration,
    left: NDArray[np.uint8],
    base_T_tcp_left: Transform,
    planned_base_T_tcp_right: Transform,
) -> LeftAnalysis:
    return analyse_left(left, config.vision, _view(config, calibration, base_T_tcp_left, planned_base_T_tcp_right))


def _perceive(
    config: CellConfig, calibration: Calibration, kinds: tuple[ObjectKind, ...], look: StereoLook
) -> Perception:
    view = _view(config, calibration, look.base_T_tcp_left, look.base_T_tcp_right)
    clock = time.perf_counter
    return perceive(look.left, look.right, config.vision, view=view, early=look.early, kinds=kinds, stopwatch=clock)


def _view(config: CellConfig, calibration: Calibration, left: Transform, right: Transform) -> StereoView:
    """Return where the images were taken from; left and right: base_T_tcp."""
    highest_mm = config.vision.recognition.max_height_mm
    return StereoView(calibration, left, right, config.cell.table_z_mm, highest_mm)


def _pictures(perception: Perception) -> dict[str, NDArray[np.uint8]]:
    """Return the paper's Fig. 6 and Fig. 7 of a look."""
    above, beside = draw_views(perception.workpieces)
    return {"planes": draw_matches(perception), "seen_from_above": above, "seen_from_the_side": beside}
