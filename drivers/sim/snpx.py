"""The word table of a controller with option R553: what its command file assigns to ``$SNPX_ASG``.

Written from the rules in references/fanuc.md 1b (``$SIZE`` words from ``$ADDRESS`` on, ``$VAR_NAME`` with ``@a.b`` for
words a to a+b-1 of each element, ``$MULTIPLY``), not from the driver.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_LINE: Final = re.compile(r'SETVAR \$SNPX_ASG\[(\d+)\]\.\$([A-Z_]+) (?:"([^"]*)"|(-?\d+))')
_NAME: Final = re.compile(r"(\$?[A-Z.$_]+)(?:\[(\d+)\])?(?:@(\d+)\.(\d+))?")
_FIELDS: Final = ("ADDRESS", "SIZE", "VAR_NAME", "MULTIPLY")
_SIGN: Final = 1 << 15
_REGISTER_WORDS: Final = 2


class SnpxError(ValueError):
    """The command file assigns something that the controller does not have."""


class SnpxSource(Protocol):
    """The controller's data."""

    def register(self, index: int) -> float:
        """Return R[index]."""
        ...

    def set_register(self, index: int, value: int) -> None:
        """Write R[index]."""
        ...

    def element(self, name: str, index: int, multiply: int) -> list[int]:
        """Return the words of anything else, as POS, ALM, UO and system variables have them; KeyError if unknown."""
        ...


@dataclass(frozen=True)
class Assignment:
    """One entry of the table.

    Attributes:
        address: its first word, from 1 on.
        size: how many words.
        name, index: of its first element; index 0 where there is none.
        first, count: the words of each element that are taken, from 0 on; count 0 takes all.
        multiply: factor of integers.
    """

    address: int
    size: int
    name: str
    index: int
    first: int
    count: int
    multiply: int

    def words(self, source: SnpxSource, begin: int, end: int) -> list[int]:
        """Return the present words from ``begin`` up to ``end``, counted from the entry's first."""
        index, found = self.index, list[int]()
        if self.name == "R":  # registers are all of one length, so those before are not asked
            per_element = self.count or _REGISTER_WORDS
            index, begin, end = index + begin // per_element, begin % per_element, end - begin + begin % per_element
        while len(found) < end:
            words = (
                split(round(source.register(index) * self.multiply))
                if self.name == "R"
                else source.element(self.name, index, self.multiply)
            )
            found += words[self.first : self.first + self.count] if self.count else words
            index += 1
        return found[begin:end]

    def write(self, source: SnpxSource, offset: int, value: int) -> None:
        """Write one word; anything but a register keeps its value."""
        if self.name != "R":
            return
        per_element = self.count or _REGISTER_WORDS
        index, word = self.index + offset // per_element, self.first + offset % per_element
        if per_element == 1:
            source.set_register(index, value - 2 * _SIGN if value & _SIGN else value)
            return
        words = split(round(source.register(index)))
        words[word] = value
        source.set_register(index, int(struct.unpack("<i", struct.pack("<2H", *words))[0]))


class WordTable:
    """All words that are assigned; numbers from 1 on, as ``%R``. Of two entries that overlap the lower slot wins."""

    def __init__(self, command_file: str) -> None:
        self._entries = tuple(_assignments(command_file))

    def read(self, word: int, count: int, source: SnpxSource) -> list[int]:
        """Return words; what is not assigned reads 0 without an error."""
        found = [0] * count
        for entry in reversed(self._entries):
            if entry.address < word + count and word < entry.address + entry.size:
                first, end = max(word, entry.address), min(word + count, entry.address + entry.size)
                found[first - word : end - word] = entry.words(source, first - entry.address, end - entry.address)
        return found

    def write(self, word: int, values: list[int], source: SnpxSource) -> None:
        """Write words; what is not assigned is ignored without an error."""
        for number, value in enumerate(values, start=word):
            for entry in self._entries:
                if entry.address <= number < entry.address + entry.size:
                    entry.write(source, number - entry.address, value)
                    break


def split(value: int) -> list[int]:
    """Return the two words of a 32-bit integer, the low one first."""
    return list(struct.unpack("<2H", struct.pack("<i", value)))


def _assignments(command_file: str) -> Iterator[Assignment]:
    slots: dict[int, dict[str, str]] = {}
    for number, field, text, value in _LINE.findall(command_file):
        slots.setdefault(int(number), {})[field] = text or value
    for number in sorted(slots):
        yield _assignment(number, slots[number])


def _assignment(number: int, fields: Mapping[str, str]) -> Assignment:
    missing = [field for field in _FIELDS if field not in fields]
    if missing:
        raise SnpxError(f"$SNPX_ASG[{number}] has no ${missing[0]}")
    match = _NAME.fullmatch(fields["VAR_NAME"])
    if match is None:
        raise SnpxError(f"$SNPX_ASG[{number}].$VAR_NAME {fields['VAR_NAME']!r} is not understood")
    name, index, first, count = match.groups()
    return Assignment(
        int(fields["ADDRESS"]),
        int(fields["SIZE"]),
        name,
        int(index or 0),
        int(first or 1) - 1,
        int(count or 0),
        int(fields["MULTIPLY"]),
    )
