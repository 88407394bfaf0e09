"""Whatever comes over the gripper's wire: a state, or an error with an alarm; never a crash, never a motion."""

import asyncio
import os

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.sim.rtu_line import LineFault, checksum
from srvs_cell.ports import GripState, PortError
from tests.drivers.gripper.robotiq_bench import robotiq_bench

HASTY_S = 0.05
QUICK = settings(max_examples=40, suppress_health_check=[HealthCheck.too_slow])


async def _read_after(answer: bytes) -> GripState | None:
    """Return the state that the driver makes of any bytes in answer to a reading, None where it refuses them."""
    async with robotiq_bench() as b:
        line = b.double.line
        await b.gripper.connect()
        b.lose_patience(HASTY_S)
        unheard: list[object] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: unheard.append(context))

        def send(frame: bytes, fault: LineFault) -> None:
            del frame, fault
            os.write(line._ours, answer)

        line._send = send  # type: ignore[method-assign]
        try:
            state = await b.gripper.state()
        except PortError:
            state = None
        assert b.double.commands == []
        return state


@QUICK
@given(st.binary(max_size=300))
def test_any_bytes(answer: bytes) -> None:
    state = asyncio.run(_read_after(answer))
    assert state is None or checksum(answer[:-2]) == answer[-2:] or len(answer) > 11


@QUICK
@given(st.integers(0, 255), st.binary(min_size=6, max_size=6))
def test_any_registers_in_a_proper_frame(function: int, data: bytes) -> None:
    frame = bytes([9, function, len(data)]) + data
    state = asyncio.run(_read_after(frame + checksum(frame)))
    assert state is None or function == 4


@QUICK
@given(st.integers(0, 10), st.integers(1, 255))
def test_one_wrong_byte_is_enough(at: int, flip: int) -> None:
    frame = bytes.fromhex("09 04 06 F9 00 00 00 03 00")
    whole = bytearray(frame + checksum(frame))
    whole[at] ^= flip
    assert asyncio.run(_read_after(bytes(whole))) is None
