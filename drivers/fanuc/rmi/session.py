"""One motion session with the controller: handshake, who answers what, and the way out.

Commands are answered at once and go out one at a time (a second one would be refused, RMIT-027); instructions are
queued by the controller and answered when they have been carried out. Replies are matched by kind, name and sequence
number. A packet that answers nothing ends the session: whoever sent it, the arm is not to be moved on its word.
Nothing is ever sent twice.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Any, Final

from drivers.fanuc.rmi import messages
from drivers.fanuc.rmi.errors import ASCII_MODE, describe, meaning
from drivers.fanuc.rmi.messages import LAST_SEQUENCE, Kind, Packet
from drivers.fanuc.rmi.wire import LineWire
from srvs_cell.alarms import Alarm
from srvs_cell.ports import NotConnectedError, NotReadyError, PortError

if TYPE_CHECKING:
    from asyncio import Future
    from collections.abc import Coroutine

    from srvs_cell.ports import Clock

MOST_IN_FLIGHT: Final = 2
"""Instructions that may wait for their reply. What the controller does with queued ones when the cable is cut is not
specified; it would take eight."""

RESET_WITHOUT_INITIALIZE: Final = 4
"""Major version from which FRC_Reset works while RMI does not run."""

_GOODBYE: Final = "FRC_Disconnect"
_LAST_PORT: Final = 65535
_KNOCKS: Final = 8
_KNOCK_EVERY_S: Final = 0.25
_LOOK_EVERY_S: Final = 0.05
_NOTICES: Final = frozenset({"frc_systemfault", "frc_terminate", "frc_asbnready", "frc_record"})


class RefusedError(NotReadyError):
    """The controller answered a command with an ErrorID; it has done nothing."""

    def __init__(self, name: str, error_id: int) -> None:
        super().__init__(meaning(error_id).alarm, f"{name}: {describe(error_id)}")
        self.error_id = error_id


class RmiSession:
    """The controller's one motion session.

    Args:
        host, port: where the controller waits for ``FRC_Connect``.
        timeout_s: real seconds for a connection or a reply to a command that needs no work of the robot.
        clock: for what the robot needs time for.

    Attributes:
        major_version, minor_version: of the interface; 0 before `open`.
        system_fault: the sequence number of the instruction at which the controller reported an alarm, or None.
        lost: why the session ended, where not by `close`.
    """

    def __init__(self, host: str, port: int, timeout_s: float, clock: Clock) -> None:
        self.major_version = self.minor_version = 0
        self.system_fault: int | None = None
        self.lost: PortError | None = None
        self._host, self._port, self._timeout_s, self._clock = host, port, timeout_s, clock
        self._wire: LineWire | None = None
        self._turn = asyncio.Lock()
        self._askers = 0
        self._awaited: tuple[Kind, str, Future[Packet]] | None = None
        self._instructions: dict[int, tuple[str, Future[Packet]]] = {}
        self._abandoned: dict[int, Future[Packet]] = {}
        self._next_sequence = 1
        self._leaving = False

    @property
    def address(self) -> str:
        """Where the controller is."""
        return f"{self._host}:{self._port}" if self._wire is None else self._wire.address

    @property
    def connected(self) -> bool:
        """Whether the session stands."""
        return self._wire is not None

    @property
    def busy(self) -> bool:
        """Whether somebody waits for the reply to a command."""
        return self._askers > 0 or self._awaited is not None

    async def open(self) -> None:
        """Ask for the session on the first port and go on on the one that the controller names.

        Raises:
            NotConnectedError: refused, no route, unknown name, silence; SESSION_HELD where somebody else has it.
            PortError: PROTOCOL_ERROR, PROTOCOL_VERSION where what answers is not the interface as the manual has it.
        """
        self.lost, self.system_fault, self._leaving = None, None, False
        reply = await self._ask_for_session()
        if reply.error_id:
            raise NotConnectedError(
                meaning(reply.error_id).alarm, f"{self.address}: FRC_Connect: {describe(reply.error_id)}"
            )
        if "PortNumber" not in reply.fields:
            raise PortError(
                Alarm.PROTOCOL_ERROR,
                f"{self.address}: the reply to FRC_Connect names no PortNumber: this is no RMI of B-84184EN.",
            )
        port = messages.whole(reply, "PortNumber", 1, _LAST_PORT)
        try:
            self.major_version = messages.whole(reply, "MajorVersion", 1)
            self.minor_version = messages.whole(reply, "MinorVersion", 0)
        except PortError as error:
            raise PortError(Alarm.PROTOCOL_VERSION, f"{self.address}: {error.detail}") from error
        self._wire = await self._go_on_at(port)
        self._instructions.clear()
        self._abandoned.clear()

    async def command(self, name: str, **fields: Any) -> Packet:
        """Send a command that the controller answers at once; return the reply.

        Raises:
            RefusedError: the controller does not carry it out.
            NotConnectedError: the session has ended, or ends because no reply came in time.
        """
        return await self._whole(self._exchange(Kind.COMMAND, name, fields))

    async def lengthy(
        self, name: str, limit_s: float, fields: dict[str, Any] | None = None, sent: asyncio.Event | None = None
    ) -> Packet:
        """Send a command that the robot needs time for (abort, reset, initialise); otherwise as `command`.

        Args:
            name: the command.
            limit_s: seconds of the clock after which the session is given up.
            fields: its fields.
            sent: set as soon as the command is on its way.
        """
        return await self._whole(self._lengthy_exchange(name, limit_s, fields or {}, sent))

    def instruct(self, name: str, fields: dict[str, Any]) -> Future[Packet]:
        """Queue an instruction; the future is the reply, whatever its ErrorID, or the error that ended the session.

        Raises:
            NotConnectedError: the session has ended; nothing was sent.
            NotReadyError: `MOST_IN_FLIGHT` instructions wait already; nothing was sent.
        """
        wire = self._require_wire(name)
        if len(self._instructions) >= MOST_IN_FLIGHT:
            raise NotReadyError(Alarm.ROBOT_BUSY, f"{len(self._instructions)} instructions wait for their reply.")
        sequence, self._next_sequence = self._next_sequence, self._next_sequence % LAST_SEQUENCE + 1
        reply: Future[Packet] = asyncio.get_running_loop().create_future()
        self._instructions[sequence] = name, reply
        wire.send(messages.encode(Kind.INSTRUCTION, name, {"SequenceID": sequence, **fields}))
        return reply

    def number_from(self, sequence: int) -> None:
        """Let the next instruction have this number; what was abandoned before is forgotten."""
        self._next_sequence = sequence
        self._abandoned.clear()

    def abandon_instructions(self) -> None:
        """Expect no replies any more: the controller has aborted. One that was under way as it did is let pass."""
        for sequence, (name, reply) in self._instructions.items():
            self._abandoned[sequence] = reply
            if not reply.done():
                _fail(reply, PortError(Alarm.MOTION_STOPPED, f"{name} {sequence} was aborted."))
        self._instructions.clear()

    async def close(self) -> None:
        """Say goodbye and close; never raises for a session that has ended.

        Nothing is sent behind the goodbye, however long somebody has waited for his turn: a controller may take what
        comes then for the next client's.
        """
        wire = self._wire
        if wire is None:
            return
        self._leaving = True
        with contextlib.suppress(PortError):  # a controller that does not answer is left all the same
            await self._whole(self._exchange(Kind.COMMUNICATION, _GOODBYE, {}))
        self._end(NotConnectedError(Alarm.CONNECTION_LOST, f"{wire.address}: the session was closed."))

    def give_up(self, error: PortError) -> None:
        """End a session that cannot be trusted: ask the controller to abort, and leave, without waiting for replies."""
        wire = self._wire
        if wire is None:
            return
        self.lost = error
        if wire.open:
            if self._awaited is None or self._awaited[1] != "FRC_Abort":
                wire.send(messages.encode(Kind.COMMAND, "FRC_Abort", {}))
            wire.send(messages.encode(Kind.COMMUNICATION, _GOODBYE, {}))
        self._end(error)

    async def _ask_for_session(self) -> Packet:
        """Say ``FRC_Connect`` on the first port, which the controller closes after its reply."""
        answered: Future[Packet] = asyncio.get_running_loop().create_future()

        def take(line: bytes) -> None:
            if answered.done():
                return
            try:
                answered.set_result(_connect_reply(line))
            except PortError as error:
                _fail(
                    answered, PortError(error.alarm, f"{wire.address}: {error.detail} Is this port {self._port} RMI?")
                )

        def end(error: PortError) -> None:
            if not answered.done():
                _fail(answered, error)

        wire = LineWire(self._host, self._port, self._timeout_s, take, end)
        try:
            await wire.connect()
        except NotConnectedError as error:
            if error.alarm is not Alarm.CONNECTION_REFUSED:
                raise
            raise NotConnectedError(
                error.alarm, f"{error.detail} Option R912 is missing, or the controller has not finished starting."
            ) from error
        try:
            wire.send(messages.encode(Kind.COMMUNICATION, "FRC_Connect", {}))
            async with asyncio.timeout(self._timeout_s):
                return await answered
        except TimeoutError as error:
            raise NotConnectedError(
                Alarm.CONNECTION_TIMEOUT,
                f"{wire.address}: connected, but no reply to FRC_Connect within {self._timeout_s} s: is this RMI?",
            ) from error
        finally:
            wire.close()

    async def _go_on_at(self, port: int) -> LineWire:
        """Connect to the session's own port, which the controller may open a moment late."""
        knocks = 1
        while True:
            wire = LineWire(self._host, port, self._timeout_s, self._take, self.give_up)
            try:
                await wire.connect()
            except NotConnectedError as error:
                if error.alarm is Alarm.CONNECTION_TIMEOUT:
                    raise NotConnectedError(
                        Alarm.SESSION_HELD,
                        f"{self._host}: FRC_Connect was answered, but port {port} did not accept within "
                        f"{self._timeout_s} s: so a controller behaves while another client holds the session "
                        f"(or a firewall passes only port {self._port}).",
                    ) from error
                if error.alarm is not Alarm.CONNECTION_REFUSED or knocks == _KNOCKS:
                    raise
            else:
                return wire
            knocks += 1
            await self._clock.sleep(_KNOCK_EVERY_S)

    async def _exchange(self, kind: Kind, name: str, fields: dict[str, Any]) -> Packet:
        async with self._turn:
            reply = self._post(kind, name, fields)
            try:
                async with asyncio.timeout(self._timeout_s):
                    await asyncio.wait({reply})
            except TimeoutError:
                self._give_up_waiting(name, self._timeout_s)
            return self._accepted(name, reply)

    async def _lengthy_exchange(
        self, name: str, limit_s: float, fields: dict[str, Any], sent: asyncio.Event | None
    ) -> Packet:
        async with self._turn:
            reply = self._post(Kind.COMMAND, name, fields)
            if sent is not None:
                sent.set()
            deadline_s = self._clock.now_s() + limit_s
            while not reply.done():
                if self._clock.now_s() > deadline_s:
                    self._give_up_waiting(name, limit_s)
                    break
                timer = asyncio.create_task(self._clock.sleep(_LOOK_EVERY_S))
                either: set[Future[Any]] = {reply, timer}
                await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
                if timer.done():
                    await timer  # a clock that has stopped says so
                timer.cancel()
            return self._accepted(name, reply)

    async def _whole(self, exchange: Coroutine[Any, Any, Packet]) -> Packet:
        """Let an exchange come to its end also where its asker is cancelled: the next one has to wait for the reply."""
        task = asyncio.create_task(exchange)
        task.add_done_callback(_look_at)
        self._askers += 1
        try:
            return await asyncio.shield(task)
        finally:
            self._askers -= 1

    def _give_up_waiting(self, name: str, limit_s: float) -> None:
        detail = f"{self.address}: {name}: no reply within {limit_s} s."
        self.give_up(NotConnectedError(Alarm.CONNECTION_TIMEOUT, detail))

    def _post(self, kind: Kind, name: str, fields: dict[str, Any]) -> Future[Packet]:
        wire = self._require_wire(name)
        reply: Future[Packet] = asyncio.get_running_loop().create_future()
        self._awaited = kind, name, reply
        wire.send(messages.encode(kind, name, fields))
        return reply

    @staticmethod
    def _accepted(name: str, reply: Future[Packet]) -> Packet:
        packet = reply.result()
        if packet.error_id:
            raise RefusedError(name, packet.error_id)
        return packet

    def _take(self, line: bytes) -> None:
        """Give a packet to whom it answers."""
        try:
            self._assign(messages.decode(line), line)
        except PortError as error:
            self.give_up(PortError(error.alarm, f"{self.address}: {error.detail}"))

    def _assign(self, packet: Packet, line: bytes) -> None:
        awaited = self._awaited
        if packet.kind is Kind.INSTRUCTION:
            reply = self._finished_instruction(packet)
        elif awaited is not None and packet.answers(*awaited[:2]):
            reply, self._awaited = awaited[2], None
        elif self._note(packet):
            return
        else:
            reply = None
        if reply is None or packet.error_id is None:
            what = "answers nothing that was asked" if reply is None else "has no ErrorID"
            if reply is not None and not reply.done():
                _fail(reply, PortError(Alarm.PROTOCOL_ERROR, f"The packet {line!r} {what}."))
            raise PortError(Alarm.PROTOCOL_ERROR, f"The packet {line!r} {what}.")
        if not reply.done():
            reply.set_result(packet)

    def _finished_instruction(self, packet: Packet) -> Future[Packet] | None:
        sequence = packet.sequence or 0
        name, reply = self._instructions.get(sequence, ("", None))
        if reply is not None and packet.answers(Kind.INSTRUCTION, name):
            del self._instructions[sequence]
            return reply
        return self._abandoned.pop(sequence, None)

    def _note(self, packet: Packet) -> bool:
        """Take a packet that the controller sends by itself; return whether it is one."""
        name = packet.name.casefold()
        if name == "frc_systemfault":
            self.system_fault = packet.sequence or 0
        elif name == "frc_terminate":
            raise NotConnectedError(
                Alarm.CONNECTION_LOST,
                "The controller ended the session (FRC_Terminate): nothing was asked for longer than "
                "$RMI_CFG.$DISCNT_TIM.",
            )
        elif name == "frc_asbnready":
            raise NotReadyError(meaning(ASCII_MODE).alarm, describe(ASCII_MODE))
        # Any other without an ErrorID (FRC_Record: a key on the pendant's RMI menu; later versions) asks for nothing.
        return packet.error_id is None or name in _NOTICES

    def _require_wire(self, name: str) -> LineWire:
        if self._wire is None:
            error = self.lost or NotConnectedError(Alarm.CONNECTION_LOST, f"{self.address}: not connected.")
            raise NotConnectedError(error.alarm, f"{name}: {error.detail}")
        if self._leaving and name != _GOODBYE:
            raise NotConnectedError(Alarm.CONNECTION_LOST, f"{name}: {self.address}: the session is being closed.")
        return self._wire

    def _end(self, error: PortError) -> None:
        """Close the wire and tell everybody who waits."""
        wire, self._wire = self._wire, None
        if wire is not None:
            wire.close()
        replies = [reply for _, reply in self._instructions.values()]
        if self._awaited is not None:
            replies.append(self._awaited[2])
        self._instructions.clear()
        self._awaited = None
        for reply in replies:
            if not reply.done():
                _fail(reply, error)


def _connect_reply(line: bytes) -> Packet:
    packet = messages.decode(line)
    if not packet.answers(Kind.COMMUNICATION, "FRC_Connect") or packet.error_id is None:
        raise PortError(Alarm.PROTOCOL_ERROR, f"The packet {line!r} does not answer FRC_Connect.")
    return packet


def _look_at(task: asyncio.Task[Packet]) -> None:
    """Take note of an error that may have nobody to raise to any more."""
    if not task.cancelled():
        task.exception()


def _fail(reply: Future[Packet], error: PortError) -> None:
    """Let a future raise; nobody need be waiting for it."""
    reply.set_exception(error)
    reply.exception()
