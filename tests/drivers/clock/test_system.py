import time

import pytest

from drivers.clock.system import DRIVER
from srvs_cell.ports import Clock, DriverContext


def _clock() -> Clock:
    clock = DRIVER.factory(DRIVER.config_model(), DriverContext(clock=None))  # type: ignore[arg-type]
    assert isinstance(clock, Clock)
    return clock


def test_it_is_the_clock_that_v4l2_stamps_frames_with() -> None:
    before_s = time.clock_gettime(time.CLOCK_MONOTONIC)
    now_s = _clock().now_s()
    assert before_s <= now_s <= time.clock_gettime(time.CLOCK_MONOTONIC)


def test_it_has_nothing_to_set() -> None:
    with pytest.raises(ValueError, match="speed"):
        DRIVER.config_model.model_validate({"speed": 2})
