"""The controller's data while programs run, and what expressions are worth."""

from __future__ import annotations

import math
import operator
import struct
from typing import TYPE_CHECKING, Final, Protocol

from drivers.sim.tp.errors import TpAlarm
from drivers.sim.tp.syntax import Argument, Binary, Constant, Element, FrameNumber, Not, Register, Signal, Variable

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from drivers.sim.tp.syntax import Expression, Target

Value = float | bool
_INT32: Final = 1 << 31
_REAL_LIMIT: Final = 3.4e38
_TIMEOUT: Final = "$WAITTMOUT"
_DEFAULT_TIMEOUT: Final = 3000
_TICK_S: Final = 0.01
_OVERFLOW: Final = "INTP-323 Value overflow"
_MISMATCH: Final = "INTP-205 Data types do not match"

_COMPARE: Final[dict[str, Callable[[float, float], bool]]] = {
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
}
_COMPUTE: Final[dict[str, Callable[[float, float], float]]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "DIV": lambda a, b: math.trunc(a / b),
    "MOD": math.fmod,
}


class Devices(Protocol):
    """What programs see of the controller that they run on."""

    def signal(self, kind: str, number: int) -> bool:
        """Return a signal."""
        ...

    def set_signal(self, kind: str, number: int, on: bool) -> None:
        """Switch an output."""
        ...

    def variable(self, name: str) -> int:
        """Return a system variable; raises KeyError where there is none."""
        ...

    def select_frame(self, name: str, number: int) -> None:
        """Make a user frame (UFRAME_NUM) or a tool (UTOOL_NUM) the active one."""
        ...


class Memory:
    """Registers and position registers; they keep their values when the power goes.

    Attributes:
        registers: R[n]; one that was never written reads 0.
        positions: PR[n] as X, Y, Z, W, P, R.
    """

    def __init__(self, devices: Devices) -> None:
        self.registers: dict[int, float] = {}
        self.positions: dict[int, list[float]] = {}
        self._devices = devices
        self._timeout = _DEFAULT_TIMEOUT

    @property
    def wait_timeout_s(self) -> float:
        """How long a WAIT with TIMEOUT waits: ``$WAITTMOUT``."""
        return self._timeout * _TICK_S

    def value(self, expression: Expression, arguments: Sequence[Value]) -> Value:
        """Return what an expression is worth; ``arguments`` are those of the program that asks.

        Raises:
            TpAlarm: types that do not match, an overflow, something that is not there.
        """
        if isinstance(expression, Constant):
            return expression.value
        if isinstance(expression, Register):
            return self.registers.get(expression.index, 0)
        if isinstance(expression, Argument):
            if not 1 <= expression.index <= len(arguments):
                raise TpAlarm(f"INTP-288 AR[{expression.index}] was not handed over")
            return arguments[expression.index - 1]
        if isinstance(expression, Signal):
            return self._devices.signal(expression.kind, expression.index)
        if isinstance(expression, Variable):
            return self._variable(expression.name)
        if isinstance(expression, Element):
            return self._position(expression.index)[expression.element - 1]
        if isinstance(expression, Not):
            return not self.condition(expression.operand, arguments)
        return self._binary(expression, arguments)

    def condition(self, expression: Expression, arguments: Sequence[Value]) -> bool:
        """Return whether a condition holds."""
        value = self.value(expression, arguments)
        if not isinstance(value, bool):
            raise TpAlarm(_MISMATCH)
        return value

    def number(self, expression: Expression, arguments: Sequence[Value]) -> float:
        """Return a number: an integer of 32 bits, or a real as 32 bits hold it."""
        value = self.value(expression, arguments)
        if isinstance(value, bool):
            raise TpAlarm(_MISMATCH)
        return _stored(value)

    def assign(self, target: Target, expression: Expression, arguments: Sequence[Value]) -> None:
        """Carry out ``target=expression``."""
        if isinstance(target, Signal):
            self._devices.set_signal(target.kind, target.index, self.condition(expression, arguments))
            return
        number = self.number(expression, arguments)
        if isinstance(target, Register):
            self.registers[target.index] = number
        elif isinstance(target, Element):
            self._position(target.index)[target.element - 1] = number
        elif isinstance(target, FrameNumber):
            self._devices.select_frame(target.name, int(number))
        elif target.name == _TIMEOUT:
            self._timeout = int(number)
        else:
            raise TpAlarm(f"INTP-311 {target.name} cannot be written")

    def position(self, index: int) -> tuple[float, ...]:
        """Return PR[index]."""
        return tuple(self._position(index))

    def _position(self, index: int) -> list[float]:
        if index not in self.positions:
            raise TpAlarm(f"INTP-311 PR[{index}] was never written")
        return self.positions[index]

    def _variable(self, name: str) -> int:
        try:
            return self._devices.variable(name)
        except KeyError as error:
            raise TpAlarm(f"INTP-311 {name} is not there") from error

    def _binary(self, expression: Binary, arguments: Sequence[Value]) -> Value:
        sign = expression.operator
        if sign in {"AND", "OR"}:
            left = self.condition(expression.left, arguments)
            right = self.condition(expression.right, arguments)
            return (left and right) if sign == "AND" else (left or right)
        first, second = self.value(expression.left, arguments), self.value(expression.right, arguments)
        if isinstance(first, bool) != isinstance(second, bool):
            raise TpAlarm(_MISMATCH)
        if sign in {"=", "<>"}:
            return (first == second) == (sign == "=")
        if isinstance(first, bool):
            raise TpAlarm(_MISMATCH)
        if sign in _COMPARE:
            return _COMPARE[sign](first, second)
        try:
            return _stored(_COMPUTE[sign](first, second))
        except (ZeroDivisionError, ValueError) as error:  # the latter from MOD
            raise TpAlarm("INTP-302 Divide by 0") from error


def _stored(value: float) -> float:
    """Return a number as a register holds it: whole results as INTEGER, others as REAL of 32 bits."""
    if not abs(value) <= _REAL_LIMIT:
        raise TpAlarm(_OVERFLOW)
    if float(value).is_integer():
        if not -_INT32 <= value < _INT32:
            raise TpAlarm(_OVERFLOW)
        return int(value)
    return float(struct.unpack("<f", struct.pack("<f", value))[0])
