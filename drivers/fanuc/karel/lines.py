"""The lines of the KAREL protocol (docs/reference/karel-protocol.md) as bytes and as values. Pure.

    >17,MOVL,600000,0,400000,180000,0,0,20000*14913     PC to robot
    <17,OK*43627                                        robot to PC

The checksum is Fletcher-16 (RFC 1146, appendix II) over everything before the star, written as high * 256 + low: two
additions a character, which a controller of the nineties can afford and a CRC bit by bit is not.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

PROTOCOL: Final = 4301
"""Magic 43 and protocol version 01."""

LAST_SEQUENCE: Final = 30_000
"""Sequence numbers count 1 to this and start again at 1; 0 answers a line that could not be read."""

LINE_LIMIT: Final = 120
"""What a KAREL string and the serial port's read-ahead buffer of 128 bytes hold with room to spare."""

NUMBER_LIMIT: Final = 999_999_999
"""Nine digits: no sum of them on the way leaves the 32 bits of a KAREL INTEGER."""

END: Final = b"\r\n"
_MODULUS: Final = 255
_NUMBER: Final = rb"(?:0|-?[1-9]\d{0,8})"
_REPLY: Final = re.compile(rb"<(0|[1-9]\d{0,4}),(OK|NO)((?:,%b)*)\*(0|[1-9]\d{0,4})" % _NUMBER)


class LineError(ValueError):
    """A line is none of the protocol; the text says why."""


@dataclass(frozen=True)
class Reply:
    """What the robot answers.

    Attributes:
        sequence: number of the command that it answers; 0 where the robot could not read the command.
        accepted: whether the command was accepted.
        values: what it answers; where it refuses, the code first.
    """

    sequence: int
    accepted: bool
    values: tuple[int, ...]


def checksum(text: bytes) -> int:
    """Return Fletcher-16: the sum of the characters, and the sum of these sums, modulo 255."""
    low = high = 0
    for character in text:
        low = (low + character) % _MODULUS
        high = (high + low) % _MODULUS
    return high * 256 + low


def encode(sequence: int, name: str, *values: int) -> bytes:
    """Return a command with its line end.

    Raises:
        ValueError: a number has more than nine digits, or the line would be too long.
    """
    if any(abs(value) > NUMBER_LIMIT for value in values):
        raise ValueError(f"{name}: a number has more than nine digits: {values}")
    body = b">%d,%b" % (sequence, ",".join((name, *map(str, values))).encode("ascii"))
    line = b"%b*%d" % (body, checksum(body))
    if len(line) > LINE_LIMIT:
        raise ValueError(f"{name}: {len(line)} characters, {LINE_LIMIT} are allowed")
    return line + END


def decode(line: bytes) -> Reply:
    """Read a reply without its line end; raises `LineError`."""
    match = _REPLY.fullmatch(line) if len(line) <= LINE_LIMIT else None
    if match is None:
        raise LineError(f"{line[:LINE_LIMIT]!r} is no reply of the protocol")
    computed = checksum(line[: match.start(4) - 1])
    if int(match[4]) != computed:
        raise LineError(f"{line!r} has the checksum {int(match[4])}, {computed} is right")
    values = tuple(int(value) for value in match[3].split(b",")[1:])
    accepted, sequence = match[2] == b"OK", int(match[1])
    if sequence > LAST_SEQUENCE or not (accepted or values):
        raise LineError(f"{line!r} has a number that is none")
    return Reply(sequence, accepted, values)


class LineBuffer:
    """Collects bytes until a line is whole. CR, LF or both end a line; empty lines are dropped."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that ``data`` completes, without their ends.

        What goes on without an end for longer than any line is handed on in pieces that no decoder takes.
        """
        *lines, rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        while len(rest) > LINE_LIMIT:
            lines.append(rest[: LINE_LIMIT + 1])
            rest = rest[LINE_LIMIT + 1 :]
        self._rest = rest
        return [line for line in lines if line]


def next_sequence(sequence: int) -> int:
    """Return the sequence number after ``sequence``: 1 to `LAST_SEQUENCE`, then 1 again."""
    return sequence % LAST_SEQUENCE + 1
