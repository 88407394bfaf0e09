"""Frames from files, good and bad."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.camera.image_folder import DRIVER, ImageFolderCamera
from srvs_cell.alarms import Alarm
from srvs_cell.ports import DriverContext, FrameError, NotConnectedError
from tests.drivers.stepped import SteppedClock, SteppedTime


def _write(folder: Path, *names: str, size: tuple[int, int] = (64, 48)) -> None:
    for value, name in enumerate(names):
        image = np.full((size[1], size[0]), 10 * value, np.uint8)
        image[:, ::3] = 99  # something to compress
        assert cv2.imwrite(str(folder / name), image)


async def _camera(folder: Path, **settings: object) -> ImageFolderCamera:
    config = DRIVER.config_model.model_validate({"folder": folder, **settings})
    camera = DRIVER.factory(config, DriverContext(SteppedClock(SteppedTime())))
    assert isinstance(camera, ImageFolderCamera)
    await camera.connect()
    await camera.activate()
    return camera


async def test_files_are_shown_in_the_order_of_their_names(tmp_path: Path) -> None:
    _write(tmp_path, "a.png", "b.png")
    camera = await _camera(tmp_path)
    frames = [await camera.grab(0.0, 1.0) for _ in range(2)]
    assert [int(frame.image[0, 1]) for frame in frames] == [0, 10]
    assert [frame.sequence for frame in frames] == [1, 2]
    with pytest.raises(FrameError) as end:
        await camera.grab(0.0, 1.0)
    assert end.value.alarm is Alarm.CAMERA_TIMEOUT


async def test_the_folder_can_be_shown_again_and_again(tmp_path: Path) -> None:
    _write(tmp_path, "a.png", "b.png")
    camera = await _camera(tmp_path, repeat=True)
    assert [int((await camera.grab(0.0, 1.0)).image[0, 1]) for _ in range(4)] == [0, 10, 0, 10]


async def test_an_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(NotConnectedError) as error:
        await _camera(tmp_path)
    assert error.value.alarm is Alarm.CAMERA_UNAVAILABLE
    assert str(tmp_path) in error.value.detail


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".pgm"])
async def test_a_truncated_image_is_invalid(tmp_path: Path, suffix: str) -> None:
    _write(tmp_path, f"a{suffix}", f"b{suffix}")
    path = tmp_path / f"b{suffix}"
    path.write_bytes(path.read_bytes()[:-40])
    camera = await _camera(tmp_path, pattern=f"*{suffix}")
    await camera.grab(0.0, 1.0)
    with pytest.raises(FrameError) as error:
        await camera.grab(0.0, 1.0)
    assert error.value.alarm is Alarm.IMAGE_INVALID
    assert path.name in error.value.detail


async def test_a_missing_an_empty_and_an_odd_sized_image_are_invalid(tmp_path: Path) -> None:
    _write(tmp_path, "a.png", "b.png", "c.png")
    _write(tmp_path, "d.png", size=(63, 48))
    camera = await _camera(tmp_path)
    await camera.grab(0.0, 1.0)
    (tmp_path / "b.png").unlink()
    (tmp_path / "c.png").write_bytes(b"")
    details = []
    for _ in range(3):
        with pytest.raises(FrameError) as error:
            await camera.grab(0.0, 1.0)
        assert error.value.alarm is Alarm.IMAGE_INVALID
        details.append(error.value.detail)
    assert "No such file" in details[0]
    assert "0 bytes" in details[1]
    assert "(63, 48)" in details[2]


async def test_the_config_may_demand_a_size(tmp_path: Path) -> None:
    _write(tmp_path, "a.png")
    camera = await _camera(tmp_path, width=640, height=480)
    with pytest.raises(FrameError) as error:
        await camera.grab(0.0, 1.0)
    assert error.value.alarm is Alarm.IMAGE_INVALID
