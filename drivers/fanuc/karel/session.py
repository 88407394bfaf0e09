"""A conversation with the robot's program: who answers what, and what is done about noise.

A serial line may lose or garble a line, so nothing hangs on a single one: replies are matched by sequence number, what
is no reply is dropped and counted, and what may be asked twice without harm (readings, greeting, heartbeat, stop) is
asked again under a new number. A move or an output is never sent twice: `NoAnswerError` tells its sender that it has
to ask what has become of it.
"""

from __future__ import annotations

import asyncio
import secrets
from collections import deque
from typing import TYPE_CHECKING, Final

from drivers.fanuc.karel.lines import (
    END,
    LAST_SEQUENCE,
    PROTOCOL,
    LineBuffer,
    LineError,
    Reply,
    decode,
    encode,
    next_sequence,
)
from drivers.fanuc.karel.messages import Refusal, refused
from srvs_cell.alarms import Alarm
from srvs_cell.ports import NotConnectedError, PortError

if TYPE_CHECKING:
    from asyncio import Future

    from drivers.fanuc.karel.link import Link

MOST_BAD_LINES: Final = 8
"""So many lines one after the other that are none: this is not noise."""

_REMEMBERED: Final = 16
"""How many numbers that are done with are remembered: a late or a second reply to them is let pass, also in the next
conversation, since a robot that stood still answers on a serial line what it was asked in the last one. Before the
greeting is answered any other reply is let pass: lines keep their order, so it is meant for an earlier process."""


class NoAnswerError(PortError):
    """No reply came, or the robot could not read the command.

    Attributes:
        sequence: number of the command.
    """

    def __init__(self, alarm: Alarm, detail: str, sequence: int) -> None:
        super().__init__(alarm, detail)
        self.sequence = sequence


class LineSession:
    """A conversation over one carrier.

    Args:
        link: the carrier.
        timeout_s: real seconds for a reply.
        tries: how often what is harmless is asked.

    Attributes:
        lost: why the conversation ended, where not by `close`.
    """

    def __init__(self, link: Link, timeout_s: float, tries: int) -> None:
        self.lost: PortError | None = None
        self._link, self._timeout_s, self._tries = link, timeout_s, tries
        self._open = self._greeted = False
        self._not_ours = 0
        self._buffer = LineBuffer()
        self._bad_in_a_row: list[str] = []
        self._pending: dict[int, Future[Reply]] = {}
        self._done_with: deque[int] = deque(maxlen=_REMEMBERED)
        self._turn = asyncio.Lock()
        # anywhere: on a serial line a robot that stood still may yet answer another process, which began elsewhere
        self._sequence, self._last_move = secrets.randbelow(LAST_SEQUENCE), 0

    @property
    def address(self) -> str:
        """Where the robot is."""
        return self._link.address

    @property
    def connected(self) -> bool:
        """Whether the conversation stands."""
        return self._open

    @property
    def busy(self) -> bool:
        """Whether somebody waits for a reply."""
        return bool(self._pending)

    async def open(self) -> None:
        """Open the carrier and greet the robot's program.

        Raises:
            NotConnectedError: the carrier cannot be opened, or nobody answers; SESSION_HELD where somebody else has it.
            PortError: PROTOCOL_ERROR, PROTOCOL_VERSION where something else answers.
        """
        self.lost, self._bad_in_a_row, self._greeted = None, [], False
        self._not_ours = 0
        self._buffer = LineBuffer()
        await self._link.open(self._take, self._end)
        self._open = True
        try:
            # Whoever was on the wire before may have left half a line there; an end makes it a line of its own.
            self._link.send(END)
            reply = await self.read("HELO", PROTOCOL)
            self._check_greeting(reply)
        except BaseException as error:
            self.close()
            await asyncio.sleep(0)  # a socket is closed in the loop's next turn
            if isinstance(error, PortError):
                raise self._why_not_greeted(error) from error
            raise
        self._last_move, self._greeted = reply.values[1], True

    def close(self) -> None:
        """End the conversation."""
        self._open = False
        self._link.close()
        self._fail_pending(NotConnectedError(Alarm.CONNECTION_LOST, f"{self.address}: not connected."))

    async def ask(self, name: str, *values: int, timeout_s: float | None = None) -> Reply:
        """Send a command once and return the reply, accepted or not.

        Raises:
            NoAnswerError: none came in time, or the robot could not read the command; the conversation goes on.
            NotConnectedError: the conversation has ended.
        """
        async with self._turn:
            return await self._exchange(name, values, timeout_s or self._timeout_s)

    async def read(self, name: str, *values: int, urgent: bool = False) -> Reply:
        """Send a command that does no harm twice until it is accepted; the conversation ends where it never is.

        Args:
            name: the command.
            values: its arguments.
            urgent: do not wait for the reply to what was sent before.

        Raises:
            NotConnectedError: no reply, or the conversation has ended.
            PortError: the command is refused, see `drivers.fanuc.karel.messages.refused`.
        """
        for left in reversed(range(self._tries)):
            try:
                reply = await (self._exchange(name, values, self._timeout_s) if urgent else self.ask(name, *values))
            except NoAnswerError as error:
                if not left:
                    self._end(NotConnectedError(error.alarm, f"{error.detail} Asked {self._tries} times."))
                continue
            if reply.accepted:
                return reply
            raise refused(name, reply)
        raise self._not_connected(name)

    async def move(self, name: str, *values: int) -> Reply:
        """Send a move, as `ask`; its number is not used again while the robot may take it for the same move."""
        try:
            reply = await self.ask(name, *values)
        except NoAnswerError as error:
            self._last_move = error.sequence
            raise
        self._last_move = reply.sequence
        return reply

    async def _exchange(self, name: str, values: tuple[int, ...], timeout_s: float) -> Reply:
        if not self._open:
            raise self._not_connected(name)
        sequence = self._next_number()
        reply: Future[Reply] = asyncio.get_running_loop().create_future()
        self._pending[sequence] = reply
        self._link.send(encode(sequence, name, *values))
        try:
            async with asyncio.timeout(timeout_s):
                answer = await asyncio.shield(reply)
        except TimeoutError as error:
            raise NoAnswerError(
                Alarm.CONNECTION_TIMEOUT, f"{self.address}: {name}: no reply within {timeout_s} s.", sequence
            ) from error
        finally:
            self._pending.pop(sequence, None)
            self._done_with.append(sequence)
        if not answer.sequence:
            raise NoAnswerError(
                Alarm.PROTOCOL_ERROR, f"{self.address}: {name}: the robot could not read the line.", sequence
            )
        if not answer.accepted and answer.values[0] == Refusal.GREETING:
            self._end(refused(name, answer))
            raise self._not_connected(name)
        return answer

    def _next_number(self) -> int:
        while True:
            self._sequence = next_sequence(self._sequence)
            if self._sequence not in (self._last_move, *self._pending, *self._done_with):
                return self._sequence

    def _take(self, data: bytes) -> None:
        for line in self._buffer.feed(data):
            if not self._open:
                return
            try:
                reply = decode(line)
            except LineError as error:
                self._note_bad_line(str(error))
                continue
            self._bad_in_a_row.clear()
            self._assign(reply)

    def _assign(self, reply: Reply) -> None:
        """Give a reply to whom it answers."""
        if not reply.sequence:
            if len(self._pending) == 1:  # the robot could not read the only line that is under way
                _answer(next(iter(self._pending.values())), reply)
            return
        waiting = self._pending.get(reply.sequence)
        if waiting is not None:
            _answer(waiting, reply)
        elif reply.sequence not in self._done_with:
            self._not_ours = reply.sequence
            if self._greeted:
                self._end(self._stranger())

    def _stranger(self) -> PortError:
        return PortError(
            Alarm.PROTOCOL_ERROR,
            f"{self.address}: a reply to number {self._not_ours}, which was never sent: does somebody else talk to the "
            "robot on this wire?",
        )

    def _note_bad_line(self, reason: str) -> None:
        self._bad_in_a_row.append(reason)
        if len(self._bad_in_a_row) >= MOST_BAD_LINES:
            self._end(
                PortError(Alarm.PROTOCOL_ERROR, f"{self.address}: {MOST_BAD_LINES} bad lines, the last: {reason}.")
            )

    def _check_greeting(self, reply: Reply) -> None:
        if len(reply.values) != 2 or reply.values[0] != PROTOCOL:  # noqa: PLR2004 - version, last move
            raise PortError(Alarm.PROTOCOL_VERSION, f"{self.address}: HELO answers {reply.values}, not {PROTOCOL}.")

    def _why_not_greeted(self, error: PortError) -> PortError:
        if self._bad_in_a_row:
            return PortError(
                Alarm.PROTOCOL_ERROR,
                f"{self.address}: what answers is not the program of srvs_cell: {self._bad_in_a_row[-1]}.",
            )
        if error.alarm is Alarm.CONNECTION_LOST and "was cut" in error.detail:
            return NotConnectedError(
                Alarm.SESSION_HELD,
                f"{self.address}: the robot hangs up at once: it talks to one PC at a time, and another one is there.",
            )
        if error.alarm is Alarm.CONNECTION_TIMEOUT and self._not_ours:
            return self._stranger()
        if error.alarm is Alarm.CONNECTION_TIMEOUT:
            return NotConnectedError(
                error.alarm,
                f"{error.detail} The wire is open: does srvstcp or srvsser run on the robot, on this port, at this "
                "speed, and does no other PC talk to it?",
            )
        return error

    def _end(self, error: PortError) -> None:
        """Take note of the end of the conversation and tell everybody who waits."""
        if self._open:
            self._open, self.lost = False, error
            self._link.close()
            self._fail_pending(error)

    def _fail_pending(self, error: PortError) -> None:
        for reply in self._pending.values():
            if not reply.done():
                reply.set_exception(NotConnectedError(error.alarm, error.detail))
                reply.exception()  # nobody need be waiting for it

    def _not_connected(self, name: str) -> NotConnectedError:
        why = self.lost or NotConnectedError(Alarm.CONNECTION_LOST, f"{self.address}: not connected.")
        return NotConnectedError(why.alarm, f"{name}: {why.detail}")


def _answer(waiting: Future[Reply], reply: Reply) -> None:
    if not waiting.done():
        waiting.set_result(reply)
