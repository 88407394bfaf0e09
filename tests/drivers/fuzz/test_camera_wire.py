"""The simulated camera's frame socket, both ends, against anybody."""

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from drivers.camera.grabber import FrameStamp
from drivers.sim.camera_client import SimCameraConfig, SimCapture
from drivers.sim.camera_wire import HEADER
from srvs_cell.alarms import Alarm
from srvs_cell.ports import FrameError, NotConnectedError, PortError
from tests.drivers.contracts.simulated import simulated_camera


@contextmanager
def facing(answer: bytes) -> Iterator[SimCapture]:
    """A client of a server that says this, whatever it is asked, and hangs up."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            connection, _ = listener.accept()
            with connection, contextlib.suppress(OSError):  # whoever has seen enough hangs up
                connection.sendall(answer)
                connection.shutdown(socket.SHUT_WR)
                connection.recv(16)

        thread = threading.Thread(target=serve)
        thread.start()
        capture = SimCapture(SimCameraConfig(port=listener.getsockname()[1], timeout_s=5.0))
        try:
            yield capture
        finally:
            capture.close()
            thread.join()


HEADERS = st.builds(
    HEADER.pack,
    st.integers(0, 255),
    st.integers(0, 2**32 - 1),
    st.floats(width=64),
    st.integers(0, 65535),
    st.integers(0, 65535),
)


@given(st.binary(max_size=40) | st.builds(lambda header, rest: header + rest, HEADERS, st.binary(max_size=64)))
@example(HEADER.pack(1, 1, float("nan"), 4, 4) + bytes(16))
@settings(max_examples=30)
def test_any_answer_is_a_frame_or_is_named(answer: bytes) -> None:
    for ask in (SimCapture.grab, SimCapture.retrieve):
        with facing(answer) as capture:
            try:
                found = ask(capture)
            except PortError as error:
                assert error.detail.isprintable()
            else:
                assert found is None or isinstance(found, FrameStamp) or found.shape == (4, 4) or found.size <= 64


def test_a_picture_larger_than_any_camera_is_not_waited_for() -> None:
    with facing(HEADER.pack(1, 1, 0.0, 65535, 65535)) as capture, pytest.raises(FrameError) as error:
        capture.retrieve()
    assert error.value.alarm is Alarm.IMAGE_INVALID
    assert "65535" in error.value.detail


@pytest.mark.parametrize("stamp_s", [float("nan"), float("inf"), -float("inf")])
def test_a_stamp_that_is_no_time_is_refused(stamp_s: float) -> None:
    with facing(HEADER.pack(1, 1, stamp_s, 0, 0)) as capture, pytest.raises(PortError) as error:
        capture.grab()
    assert error.value.alarm is Alarm.PROTOCOL_ERROR


def test_an_answer_that_ends_early_is_a_lost_camera() -> None:
    with facing(HEADER.pack(1, 1, 0.0, 4, 4) + bytes(3)) as capture, pytest.raises(NotConnectedError):
        capture.retrieve()


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    with simulated_camera(tmp_path_factory.mktemp("camera")) as (camera, _, _):
        name = camera.description
        yield int(name.rsplit(":", 1)[1])


@given(data=st.binary(max_size=30) | st.lists(st.sampled_from([b"R", b"G"]), max_size=4).map(b"".join))
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_request_is_answered_or_ends_the_connection_and_the_next_reader_is_served(port: int, data: bytes) -> None:
    with socket.create_connection(("127.0.0.1", port), 10.0) as connection, contextlib.suppress(OSError):
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
    with socket.create_connection(("127.0.0.1", port), 10.0) as connection:
        connection.sendall(b"R")
        status, *_ = struct.unpack("!BIdHH", connection.recv(HEADER.size, socket.MSG_WAITALL))
        assert status == 2  # no frame was grabbed on this connection
