"""The run folder: what a job saw, understood and planned, as files beside the journal."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import cv2

from srvs_cell.alarms import Alarm, AlarmError

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

RUN_FOLDER = "runs/{run:06d}"


class RunRecorder:
    """Writes run folders under the state folder. Blocking: call its methods in a worker thread."""

    def __init__(self, state_dir: Path) -> None:
        self.state_dir = state_dir

    def begin(self, run: int) -> Path:
        """Make and return the folder of a run."""
        folder = self.state_dir / RUN_FOLDER.format(run=run)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _failed(folder, error) from error
        return folder

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
