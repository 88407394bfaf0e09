"""The run folder: what a job saw, understood and planned, as files beside the journal."""

from __future__ import annotations

import json
import shutil
from itertools import islice
from typing import TYPE_CHECKING, Any

import cv2
import structlog

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

RUN_FOLDER = "runs/{run:06d}"
_REMOVED_AT_ONCE = 20
"""Where many are too old, a job does not wait until all have gone: the next ones remove the rest."""

_log = structlog.stdlib.get_logger("srvs_cell.cell")


class RunRecorder:
    """Writes run folders under the state folder and removes old ones. Blocking: call its methods in a worker thread.

    Args:
        state_dir: folder that holds the folder ``runs``.
        keep_runs: how many run folders are kept; None keeps all.
    """

    def __init__(self, state_dir: Path, keep_runs: int | None = None) -> None:
        self.state_dir = state_dir
        self._keep_runs = keep_runs

    def begin(self, run: int) -> Path:
        """Make and return the folder of a run."""
        folder = self.state_dir / RUN_FOLDER.format(run=run)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _failed(folder, error) from error
        return folder

    def prune(self, current: int, unresolved: Collection[int]) -> list[int]:
        """Remove the oldest run folders beyond the number that is kept, and return which.

        What cannot be removed is logged and tried again at the next run: a full job matters more than a full disk.

        Args:
            current: the run that is being recorded; stays, and so does every later one.
            unresolved: runs that an unresolved entry of the journal refers to; they stay, too.
        """
        if self._keep_runs is None:
            return []
        runs = sorted(
            int(folder.name) for folder in (self.state_dir / RUN_FOLDER).parent.glob("*") if folder.name.isdecimal()
        )
        old = (run for run in runs[: -self._keep_runs] if run < current and run not in unresolved)
        removed = []
        for run in islice(old, _REMOVED_AT_ONCE):
            try:
                shutil.rmtree(self.state_dir / RUN_FOLDER.format(run=run))
            except OSError as error:
                _log.warning("an old run folder was not removed", run=run, error=str(error))
            else:
                removed.append(run)
        return removed

    def image(self, folder: Path, name: str, image: NDArray[np.uint8]) -> Path:
        """Write ``name``.png."""
        encoded, data = cv2.imencode(".png", image)
        if not encoded:
            raise AlarmError(Alarm.IMAGE_INVALID, f"{name}: shape {image.shape}, {image.dtype} is no image.")
        return _write(folder / f"{name}.png", data.tobytes())

    def json(self, folder: Path, name: str, content: dict[str, Any]) -> Path:
        """Write ``name``.json."""
        return _write(folder / f"{name}.json", json.dumps(content, indent=1).encode())


def _write(path: Path, data: bytes) -> Path:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise _failed(path, error) from error
    return path


def _failed(path: Path, error: OSError) -> AlarmError:
    return AlarmError(Alarm.JOURNAL_FAILED, f"{path}: {error}.")
