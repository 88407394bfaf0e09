"""Expressions, and calls of routines, as functions that compute them."""

from __future__ import annotations

import math
import operator
from typing import TYPE_CHECKING, Any, Final

from drivers.sim.karel.built_in import BUILT_INS, CONSTANTS
from drivers.sim.karel.errors import KarelAbort
from drivers.sim.karel.scope import Expression
from drivers.sim.karel.values import (
    AXES,
    BOOLEAN,
    FILE,
    FRAME,
    INTEGER,
    JOINTPOS,
    NOTHING,
    REAL,
    STRING,
    STRING_CHARS,
    XYZWPR,
    Cell,
    Pose,
    integer,
    real,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.sim.karel.scope import Frame, Reader, Routine, Scope
    from drivers.sim.karel.values import Type

_NUMBERS: Final = (INTEGER, REAL)
_COMPARE: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "=": operator.eq,
    "<>": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
}
_VALUE_TYPES: Final = {"i": INTEGER, "r": REAL, "b": BOOLEAN, "s": STRING, "p": XYZWPR, "j": JOINTPOS, "f": FILE}
_VARIABLE_TYPES: Final = {"I": INTEGER, "R": REAL, "B": BOOLEAN, "S": STRING}


def expression(reader: Reader, scope: Scope) -> Expression:
    """Read an expression: relations bind least, then + - OR, then * / AND DIV MOD, then NOT (manual, section 3.1)."""
    left = _sum(reader, scope)
    if not reader.sees(*_COMPARE):
        return left
    sign = reader.next().text
    right = _sum(reader, scope)
    same = left.type == right.type or (left.type in _NUMBERS and right.type in _NUMBERS)
    if not same or (left.type not in {*_NUMBERS, STRING} and sign not in {"=", "<>"}):
        raise reader.error(f"{left.type.name} {sign} {right.type.name} cannot be compared")
    return _binary(BOOLEAN, _COMPARE[sign], left, right)


def variable(reader: Reader, scope: Scope) -> Expression:
    """Read a variable, an element of an array, or of a position."""
    name = reader.name()
    found = _variable(name, scope)
    if found is None:
        raise reader.error(f"{name} is not declared")
    return _elements(found, reader, scope)


def call(reader: Reader, scope: Scope, name: str) -> tuple[Routine | None, Expression]:
    """Read the arguments of a call whose name has been taken; return the routine, where it is no built-in one."""
    arguments: list[Expression] = []
    if reader.accepts("("):
        while not reader.accepts(")"):
            if arguments:
                reader.expect(",")
            arguments.append(expression(reader, scope))
    if name in BUILT_INS:
        return None, _built_in(reader, scope, name, arguments)
    routine = scope.routines.get(name)
    if routine is None:
        raise reader.error(f"{name} is neither declared nor known to the interpreter")
    return routine, _routine(reader, routine, arguments)


def assignable(target: Type, source: Type) -> bool:
    """Whether a value may be written to a variable: an integer also to a real, nothing else across types."""
    return target == source or (target == REAL and source == INTEGER)


def system_name(reader: Reader, scope: Scope) -> Callable[[Frame], str]:
    """Read a system variable with its indices, such as ``$MNUFRAME[1, 2]``."""
    parts: list[str | Expression] = []
    while reader.now.kind == "word" and reader.now.text.startswith("$"):
        parts.append(reader.next().text)
        if reader.accepts("["):
            opening = "["
            while not reader.accepts("]"):
                parts += [opening, expression(reader, scope)]
                opening = ","
                reader.accepts(",")
            parts.append("]")
        if reader.accepts("."):
            parts.append(".")
    return lambda frame: "".join(part if isinstance(part, str) else str(part.value(frame)) for part in parts)


def _sum(reader: Reader, scope: Scope) -> Expression:
    if reader.accepts("-"):
        operand = _product(reader, scope)
        _check(reader, operand.type in _NUMBERS, "-", operand, operand)
        left = Expression(operand.type, lambda frame: -operand.value(frame))
    else:
        left = _product(reader, scope)
    while reader.sees("+", "-", "OR"):
        sign = reader.next().text
        right = _product(reader, scope)
        if sign == "OR":
            _check(reader, left.type == right.type == BOOLEAN, sign, left, right)
            left = _binary(BOOLEAN, operator.or_, left, right)
        elif left.type == STRING and sign == "+":
            _check(reader, right.type == STRING, sign, left, right)
            left = _binary(STRING, lambda a, b: (a + b)[:STRING_CHARS], left, right)
        else:
            left = _arithmetic(reader, sign, left, right)
    return left


def _product(reader: Reader, scope: Scope) -> Expression:
    left = _factor(reader, scope)
    while reader.sees("*", "/", "AND", "DIV", "MOD"):
        sign = reader.next().text
        right = _factor(reader, scope)
        if sign == "AND":
            _check(reader, left.type == right.type == BOOLEAN, sign, left, right)
            left = _binary(BOOLEAN, operator.and_, left, right)
        else:
            left = _arithmetic(reader, sign, left, right)
    return left


def _arithmetic(reader: Reader, sign: str, left: Expression, right: Expression) -> Expression:
    _check(reader, left.type in _NUMBERS and right.type in _NUMBERS, sign, left, right)
    whole = left.type == right.type == INTEGER
    if sign in {"DIV", "MOD"}:
        _check(reader, whole, sign, left, right)
        compute = (lambda a, b: math.trunc(a / b)) if sign == "DIV" else (lambda a, b: int(math.fmod(a, b)))
        return _binary(INTEGER, _divided(compute), left, right)
    if sign == "/":
        return _binary(REAL, _divided(lambda a, b: real(a / b)), left, right)
    compute = {"+": operator.add, "-": operator.sub, "*": operator.mul}[sign]
    if whole:
        return _binary(INTEGER, lambda a, b: integer(compute(a, b)), left, right)
    return _binary(REAL, lambda a, b: real(compute(a, b)), left, right)


def _divided(compute: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def divided(a: Any, b: Any) -> Any:
        if b == 0:
            raise KarelAbort("INTP-302 Divide by 0")
        return compute(a, b)

    return divided


def _binary(type_: Type, compute: Callable[[Any, Any], Any], left: Expression, right: Expression) -> Expression:
    a, b = left.value, right.value
    return Expression(type_, lambda frame: compute(a(frame), b(frame)))


def _check(reader: Reader, holds: bool, sign: str, left: Expression, right: Expression) -> None:
    if not holds:
        raise reader.error(f"{sign} does not go with {left.type.name} and {right.type.name}")


def _factor(reader: Reader, scope: Scope) -> Expression:
    if reader.accepts("NOT"):
        operand = _factor(reader, scope)
        _check(reader, operand.type == BOOLEAN, "NOT", operand, operand)
        return Expression(BOOLEAN, lambda frame: not operand.value(frame))
    if reader.accepts("("):
        inner = expression(reader, scope)
        reader.expect(")")
        return Expression(inner.type, inner.value)  # in parentheses: by value
    token = reader.now
    if token.kind in {"integer", "real", "string"}:
        reader.next()
        return constant(token.kind, token.text)
    if token.kind == "word" and token.text.startswith("$"):
        name = system_name(reader, scope)
        return Expression(FRAME, name)
    return _named(reader, scope)


def constant(kind: str, text: str) -> Expression:
    """Return a literal."""
    type_: Type
    value: Any
    if kind == "integer":
        type_, value = INTEGER, int(text)
    elif kind == "real":
        type_, value = REAL, float(text)
    else:
        type_, value = STRING, text
    return Expression(type_, lambda _: value)


def _named(reader: Reader, scope: Scope) -> Expression:
    name = reader.next().text
    if name in {"TRUE", "FALSE"}:
        return Expression(BOOLEAN, lambda _: name == "TRUE")
    found = _variable(name, scope)
    if found is not None:
        return _elements(found, reader, scope)
    if name in scope.constants:
        return scope.constants[name]
    if name in CONSTANTS:
        return constant("integer", str(CONSTANTS[name]))
    _, result = call(reader, scope, name)
    if result.type == NOTHING:
        raise reader.error(f"{name} returns nothing")
    return result


def _variable(name: str, scope: Scope) -> Expression | None:
    if name in scope.local_names and scope.routine is not None:
        at = scope.local_names[name]
        return _stored(name, scope.routine.locals[at], lambda frame: frame[at])
    if name in scope.variables:
        cell = scope.variables[name]
        return _stored(name, cell.type, lambda _: cell)
    return None


def _stored(name: str, type_: Type, cell: Callable[[Frame], Cell]) -> Expression:
    def value(frame: Frame) -> Any:
        found = cell(frame).value
        if found is None:
            raise KarelAbort(f"INTP-311 Uninitialized data is used: {name}")
        return found

    return Expression(type_, value, cell)


def _elements(found: Expression, reader: Reader, scope: Scope) -> Expression:
    if found.type.of is not None and reader.accepts("["):
        index = expression(reader, scope)
        reader.expect("]")
        if index.type != INTEGER:
            raise reader.error("an index is an INTEGER")
        array, number, length = found.value, index.value, found.type.length

        def element(frame: Frame) -> Cell:
            at = number(frame)
            if not 1 <= at <= length:
                raise KarelAbort(f"INTP-302 Index {at} of an array of {length}")
            cell: Cell = array(frame)[at - 1]
            return cell

        return _stored("an element", found.type.of, element)
    if found.type == XYZWPR and reader.accepts("."):
        axis = reader.next().text
        if axis not in AXES:
            raise reader.error(f"{axis} is no element of a position")
        pose = found.value
        return Expression(REAL, lambda frame: pose(frame).elements[axis], lambda frame: _Axis(pose(frame), axis))
    return found


class _Axis(Cell):
    """An element of a position, as a variable."""

    __slots__ = ("_axis", "_pose")

    def __init__(self, pose: Pose, axis: str) -> None:
        super().__init__(REAL, pose.elements[axis])
        self._pose, self._axis = pose, axis

    def set(self, value: Any) -> None:
        self._pose.elements[self._axis] = real(value)


def _built_in(reader: Reader, scope: Scope, name: str, arguments: list[Expression]) -> Expression:
    built_in, host = BUILT_INS[name], scope.host
    if len(arguments) != len(built_in.parameters):
        raise reader.error(f"{name} takes {len(built_in.parameters)} arguments, not {len(arguments)}")
    taken = [
        _built_in_argument(reader, name, code, argument)
        for code, argument in zip(built_in.parameters, arguments, strict=True)
    ]
    carry_out = built_in.call
    result = NOTHING if built_in.result is None else built_in.result
    return Expression(result, lambda frame: carry_out(host, *[take(frame) for take in taken]))


def _built_in_argument(reader: Reader, name: str, code: str, argument: Expression) -> Callable[[Frame], Any]:
    if code in _VALUE_TYPES:
        if not assignable(_VALUE_TYPES[code], argument.type):
            raise reader.error(f"{name} takes {_VALUE_TYPES[code].name}, not {argument.type.name}")
        return argument.value
    if code == "v":
        return argument.value
    wrong = code in _VARIABLE_TYPES and argument.type != _VARIABLE_TYPES[code]
    if argument.cell is None or wrong or (code == "A" and argument.type.of != REAL):
        raise reader.error(f"{name} writes to an argument that is no variable of its type")
    return argument.cell


def _routine(reader: Reader, routine: Routine, arguments: list[Expression]) -> Expression:
    if len(arguments) != len(routine.parameters):
        raise reader.error(f"{routine.name} takes {len(routine.parameters)} arguments, not {len(arguments)}")
    taken: list[Callable[[Frame], Cell]] = []
    for type_, argument in zip(routine.parameters, arguments, strict=True):
        if argument.cell is not None and type_ == argument.type:
            taken.append(argument.cell)
        elif argument.cell is None and assignable(type_, argument.type):
            taken.append(_by_value(type_, argument.value))
        else:
            raise reader.error(f"{routine.name} takes {type_.name}, not {argument.type.name}")

    def value(frame: Frame) -> Any:
        if routine.body is None:
            raise KarelAbort(f"{routine.name} has no body")
        ended = routine.body.run(routine.frame([take(frame) for take in taken]))
        if routine.result is None:
            return None
        if ended is None:
            raise KarelAbort(f"INTP-304 {routine.name} ended without RETURN")
        return ended[0]

    return Expression(routine.result or NOTHING, value)


def _by_value(type_: Type, value: Callable[[Frame], Any]) -> Callable[[Frame], Cell]:
    def made(frame: Frame) -> Cell:
        cell = Cell(type_)
        cell.set(value(frame))
        return cell

    return made
