"""What keeps the arm from working over Modbus TCP: reads, over a connection of its own, and writes nothing."""

from __future__ import annotations

import asyncio
import struct
from typing import TYPE_CHECKING, Final

from drivers.fanuc import judgement, registers
from drivers.fanuc.diagnosis import Conditions, judge, not_connected
from drivers.fanuc.registers import PROTOCOL, Snapshot, UopOutput
from drivers.fanuc.wire import ModbusWire
from srvs_cell.alarms import Alarm
from srvs_cell.ports import Finding, NotReadyError, PortError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.fanuc.modbus import FanucModbusConfig
    from srvs_cell.ports import Clock

_BYTES_EXCHANGED: Final = int.from_bytes(PROTOCOL.to_bytes(2, "big"), "little")
_AS_FLOAT: Final = list(struct.unpack("<2H", struct.pack("<f", PROTOCOL)))
_OVERRIDE_AT: Final = 21
_GREATEST_OVERRIDE: Final = 100

_WHERE: Final = f"Word %R{registers.FIRST_WORD} (R[100])"
_ORDER: Final = "Set $SNPX_PARAM.$CMD_ENDIAN so that the low word of a pair comes first, and cycle the power."
_MULTIPLY: Final = "Set $SNPX_ASG[n].$MULTIPLY as in docs/reference/modbus-map.md; 0 makes floats. Cycle the power."
_ASSIGN: Final = "Set $SNPX_ASG as in docs/reference/modbus-map.md, cycle the power, start the program SRVS."
_LOAD: Final = "Load and start the robot's programs of this release: docs/how-to/install-robot-programs.md."
_UNIT: Final = (
    "Check $SNPX_PARAM.$MODBUS_ADR against unit_id, and end whatever else is connected: the controller serves one "
    "client."
)


async def diagnose_modbus(config: FanucModbusConfig, clock: Clock) -> list[Finding]:
    """Look at wire, register map, robot and program; each only where what comes before it is all right."""
    wire = ModbusWire(config.host, config.port, config.unit_id, config.timeout_s)
    findings: list[Finding] = []
    try:
        await wire.connect()
        findings.append(Finding.fine("connection", f"{wire.address}, Modbus TCP"))
        try:
            words = await wire.read_words(registers.FIRST_WORD, registers.WORD_COUNT)
        except PortError as error:
            findings.append(Finding.failed("first reading", error, _UNIT))
            return findings
        if (wrong := mapping_fault(words)) is not None:
            findings.append(wrong)
            return findings
        snapshot = registers.decode(words)
        findings.append(Finding.fine("register map", f"protocol {snapshot.protocol}"))
        conditions = Conditions(remote=UopOutput.CMDENBL in snapshot.uop)
        findings += judge(judgement.robot_status(snapshot, clock.now_s()), conditions)
        findings.append(_command(snapshot))
        findings.append(await _heartbeat(wire, snapshot, config, clock))
    except PortError as error:
        findings.append(not_connected(error))
    finally:
        wire.close()
        await asyncio.sleep(0)  # the socket is closed in the loop's next turn; the controller takes one client
    return findings


async def peek_inputs_modbus(config: FanucModbusConfig, numbers: Sequence[int]) -> tuple[bool, ...]:
    """Read DI[number] of each over a connection of its own."""
    wire = ModbusWire(config.host, config.port, config.unit_id, config.timeout_s)
    await wire.connect()
    try:
        return tuple([await wire.read_input(number) for number in numbers])
    finally:
        wire.close()
        await asyncio.sleep(0)


def mapping_fault(words: list[int]) -> Finding | None:
    """Return what is wrong with how the controller maps its registers to words, or None."""
    first = words[0]
    if first == PROTOCOL:
        return _pair_fault(words[_OVERRIDE_AT], words[_OVERRIDE_AT + 1])
    if not any(words):
        return _fault("All words read 0: they are not mapped, or the program SRVS has never run.", _ASSIGN)
    if first == _BYTES_EXCHANGED:
        return _fault(f"{_WHERE} reads {first}: {PROTOCOL} with its bytes exchanged.", _ORDER)
    if words[:2] in (_AS_FLOAT, _AS_FLOAT[::-1]):
        return _fault(f"{_WHERE} reads the float {PROTOCOL}.0 instead of the whole number.", _MULTIPLY)
    return _fault(f"{_WHERE} reads {first}, not {PROTOCOL}: programs of another release, or another map.", _LOAD)


def _pair_fault(low: int, high: int) -> Finding | None:
    """Judge the order of words and their kind by one pair whose value is known to be 0 to 100."""
    override, exchanged = registers.from_words(low, high), registers.from_words(high, low)
    if 0 <= override <= _GREATEST_OVERRIDE:
        return None
    if 0 <= exchanged <= _GREATEST_OVERRIDE:
        return _fault(f"The speed override reads {override}: the words of a pair are in the other order.", _ORDER)
    return _fault(f"The speed override reads {override}, which is no whole number from 0 to 100.", _MULTIPLY)


def _fault(detail: str, remedy: str) -> Finding:
    return Finding.failed("register map", PortError(Alarm.PROTOCOL_VERSION, detail), remedy)


def _command(snapshot: Snapshot) -> Finding:
    counted = f"sequence {snapshot.sequence} written, {snapshot.acknowledged} acknowledged, state {snapshot.state}"
    if snapshot.busy:
        return Finding.failed("last command", NotReadyError(Alarm.ROBOT_BUSY, f"It is not finished: {counted}."))
    return Finding.fine("last command", counted)


async def _heartbeat(wire: ModbusWire, snapshot: Snapshot, config: FanucModbusConfig, clock: Clock) -> Finding:
    """Wait for the robot's heartbeat to count on; that of this PC is not sent, which the robot's watchdog allows."""
    deadline_s = clock.now_s() + config.heartbeat_timeout_s
    beat = snapshot.robot_heartbeat
    while clock.now_s() <= deadline_s:
        await clock.sleep(config.heartbeat_s)
        (now,) = await wire.read_words(registers.ROBOT_HEARTBEAT_WORD, 1)
        if now != beat:
            return Finding.fine("robot's heartbeat", f"counts, {beat} to {now}")
    detail = f"R[114] has stood at {beat} for {config.heartbeat_timeout_s} s."
    return Finding.failed("robot's heartbeat", NotReadyError(Alarm.HEARTBEAT_LOST, detail))
