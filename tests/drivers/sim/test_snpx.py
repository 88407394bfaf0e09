"""The word table that a command file assigns."""

from __future__ import annotations

import pytest

from drivers.sim.snpx import SnpxError, WordTable


class _Data:
    def __init__(self) -> None:
        self.registers: dict[int, float] = {1: 7, 2: -2, 3: 1.25, 4: 70_000}

    def register(self, index: int) -> float:
        return self.registers.get(index, 0)

    def set_register(self, index: int, value: int) -> None:
        self.registers[index] = value

    def element(self, name: str, index: int, multiply: int) -> list[int]:
        return {"UO": [5], "ALM": [11, 50, 0, 0], "$MCR.$GENOVERRIDE": [40, 0]}[name][: index + multiply + 3]


def _slot(number: int, address: int, size: int, name: str, multiply: int = 1) -> str:
    at = f"SETVAR $SNPX_ASG[{number}]"
    return f'{at}.$ADDRESS {address}\n{at}.$SIZE {size}\n{at}.$VAR_NAME "{name}"\n{at}.$MULTIPLY {multiply}\n'


@pytest.mark.parametrize(
    ("slot", "words"),
    [
        (_slot(1, 101, 2, "R[1]@1.1"), [7, 65534, 0, 0]),
        (_slot(1, 101, 4, "R[1]"), [7, 0, 65534, 65535]),
        (_slot(1, 101, 2, "R[3]", 1000), [1250, 0, 0, 0]),
        (_slot(1, 101, 2, "R[4]"), [4464, 1, 0, 0]),
        (_slot(1, 101, 1, "R[4]@2.1"), [1, 0, 0, 0]),
        (_slot(1, 102, 2, "ALM[1]@1.2"), [0, 11, 50, 0]),
        (_slot(1, 104, 1, "UO[1]", 0), [0, 0, 0, 5]),
        (_slot(1, 103, 2, "$MCR.$GENOVERRIDE"), [0, 0, 40, 0]),
        (_slot(2, 101, 4, "R[1]@1.1") + _slot(1, 102, 1, "UO[1]"), [7, 5, 1, 4464]),
        (_slot(1, 99, 4, "R[1]@1.1"), [1, 4464, 0, 0]),
    ],
)
def test_words_are_read_as_they_are_assigned(slot: str, words: list[int]) -> None:
    data = _Data()
    data.registers[3] = 1.25 if "1000" in slot else 1
    assert WordTable(slot).read(101, 4, data) == words


def test_words_are_written_to_registers_only() -> None:
    data = _Data()
    table = WordTable(_slot(2, 101, 2, "R[11]@1.1") + _slot(3, 103, 4, "R[20]") + _slot(4, 107, 1, "UO[1]"))
    table.write(100, [9, 1, 65535, 4464, 1, 65535, 65535, 3, 3], data)
    assert {n: data.registers[n] for n in (11, 12, 20, 21)} == {11: 1, 12: -1, 20: 70_000, 21: -1}
    table.write(104, [2], data)
    assert data.registers[20] == 4464 + (2 << 16)


@pytest.mark.parametrize(
    ("file", "reason"),
    [
        (_slot(3, 1, 1, "R[1]").replace("$SIZE", "$OTHER"), r"\$SNPX_ASG\[3\] has no \$SIZE"),
        (_slot(3, 1, 1, "R 1"), "'R 1' is not understood"),
    ],
)
def test_an_assignment_that_is_not_right(file: str, reason: str) -> None:
    with pytest.raises(SnpxError, match=reason):
        WordTable(file)
