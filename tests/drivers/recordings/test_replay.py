"""The recorded conversations, byte by byte, to the driver and to the double: both still say exactly the same."""

import asyncio
import socket

import pytest

from drivers.sim.modbus_controller import ModbusController
from drivers.sim.rmi_controller import RmiController
from tests.drivers.fanuc.bench import PATIENT_S
from tests.drivers.recordings.conversation import WIRES, Scripted, make, read, take_part, with_port
from tests.drivers.stepped import PointArm, SteppedClock, SteppedTime


@pytest.mark.parametrize("wire", WIRES)
async def test_the_driver_says_what_it_said(wire: str) -> None:
    clock = SteppedClock(SteppedTime())
    scripted = Scripted(wire, clock)
    servers = [await asyncio.start_server(scripted.door(connection), "127.0.0.1", 0) for connection in (0, 1)]
    ports = [server.sockets[0].getsockname()[1] for server in servers]
    scripted.session_port = ports[1]
    arm = make(wire, ports[0], clock)
    clock.busy = lambda: arm._session.busy if wire == "rmi" else arm._wire.busy  # type: ignore[union-attr]
    try:
        async with asyncio.timeout(60.0):
            await asyncio.gather(take_part(arm), scripted.play())
    finally:
        await arm.disconnect()
        for server in servers:
            server.close()


@pytest.mark.parametrize("wire", WIRES)
def test_the_double_answers_what_it_answered(wire: str) -> None:
    time = SteppedTime()
    point = PointArm(time)
    controller = ModbusController(point, time) if wire == "modbus" else RmiController(point, time)
    ports = [controller.start(), getattr(controller.server, "session_port", 0)]
    connections: dict[int, socket.socket] = {}
    try:
        for said in read(wire):
            time.advance_to(said.time_s)
            if said.connection not in connections:
                connections[said.connection] = socket.create_connection(
                    ("127.0.0.1", ports[said.connection]), PATIENT_S
                )
            connection = connections[said.connection]
            if said.speaker == ">":
                for byte in said.data:
                    connection.sendall(bytes([byte]))
            else:
                heard = connection.recv(len(said.data), socket.MSG_WAITALL)
                assert with_port(heard, 16002) == said.data, f"at {said.time_s}"
        assert controller.motions_started == 2
    finally:
        for connection in connections.values():
            connection.close()
        time.release()
        controller.close()
