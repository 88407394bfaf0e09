"""Who is served by a controller double, and when all that was sent is dealt with, however slow its threads are."""

import gc
import socket
import threading
from collections.abc import Iterator

import pytest

from drivers.sim.one_client import OneClient

PATIENT_S = 10.0


class Echo:
    """Answers each piece with itself, as soon as it may."""

    def __init__(self) -> None:
        self.heard: list[bytes] = []
        self.may_go_on = threading.Event()
        self.began = threading.Event()
        self.client = OneClient("echo")
        self.port = self.client.listen(0, lambda connection: self.client.take(connection, self._serve))

    def _serve(self, connection: socket.socket) -> None:
        while piece := self.client.receive(connection, 64):
            self.began.set()
            assert self.may_go_on.wait(PATIENT_S)
            self.heard.append(piece)
            self.client.send(piece)

    def call(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), PATIENT_S)


@pytest.fixture
def echo() -> Iterator[Echo]:
    served = Echo()
    try:
        yield served
    finally:
        served.may_go_on.set()
        served.client.close()


def test_bytes_count_as_unread_until_they_are_dealt_with(echo: Echo) -> None:
    with echo.call() as connection:
        connection.sendall(b"one")
        assert echo.client.unread, "wherever the threads are"
        assert echo.began.wait(PATIENT_S)
        assert echo.client.unread, "in hand"
        echo.may_go_on.set()
        assert connection.recv(64) == b"one"


def test_the_next_client_is_served_when_all_is_dealt_with_that_the_last_one_sent(echo: Echo) -> None:
    with echo.call() as gone:
        gone.sendall(b"late")
        assert echo.began.wait(PATIENT_S)
    with echo.call() as connection:
        connection.sendall(b"next")
        echo.may_go_on.set()
        assert connection.recv(64) == b"next", "the answer to the other one is not sent to this one"
        assert echo.heard == [b"late", b"next"]


def test_a_second_client_is_hung_up_on(echo: Echo) -> None:
    echo.may_go_on.set()
    with echo.call() as connection:
        connection.sendall(b"one")
        assert connection.recv(64) == b"one"
        with echo.call() as second:
            assert second.recv(64) == b""
        connection.sendall(b"two")
        assert connection.recv(64) == b"two"


def test_nobody_is_left_to_wait_when_it_closes(echo: Echo) -> None:
    echo.may_go_on.set()
    with echo.call() as connection:
        connection.sendall(b"one")
        assert connection.recv(64) == b"one"
        echo.client.close()
        assert connection.recv(64) == b""
    assert not echo.client.unread


def test_clients_that_have_gone_leave_nothing_behind(echo: Echo) -> None:
    echo.may_go_on.set()
    for _ in range(8):
        with echo.call() as connection:
            connection.sendall(b"one")
            assert connection.recv(64) == b"one"
    gc.collect()
    threads = [one for one in gc.get_objects() if isinstance(one, threading.Thread) and one.name == "echo"]
    assert len(threads) <= 3, "the listener's, the last client's, and one that is about to end"
