"""Reads one statement of a program's main part."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from drivers.sim.tp.expressions import Reader
from drivers.sim.tp.lexer import tokens
from drivers.sim.tp.syntax import (
    Assign,
    Call,
    Delay,
    Element,
    End,
    Expression,
    FrameNumber,
    If,
    Jump,
    Label,
    Message,
    Move,
    Register,
    Remark,
    Run,
    Select,
    Signal,
    SkipCondition,
    TakePosition,
    UserAlarm,
    Variable,
    Wait,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from drivers.sim.tp.syntax import Statement

_REMARK_CHARS: Final = 32
_MESSAGE_CHARS: Final = 24
_PROGRAM_CHARS: Final = 8
_NUMBERED: Final = frozenset({"UFRAME_NUM", "UTOOL_NUM"})
_OUTPUTS: Final = frozenset({"DO", "RO", "F"})


def statement(text: str) -> Statement:
    """Return the statement in ``text``, the part of a line between its number and its semicolon.

    A SELECT must have its further lines appended, one blank between them.

    Raises:
        ValueError: it is not understood; the message says why.
    """
    text = text.strip()
    if not text or text.startswith("//"):
        return Remark()
    if text.startswith("!"):
        if len(text) - 1 > _REMARK_CHARS:
            raise ValueError(f"the remark is longer than {_REMARK_CHARS} characters")
        return Remark()
    if text.startswith("MESSAGE["):
        return _message(text)
    reader = Reader(tokens(text))
    found = _KEYWORDS[reader.take().text](reader) if reader.next.text in _KEYWORDS else _assignment(reader)
    reader.end()
    return found


def _message(text: str) -> Message:
    if not text.endswith("]"):
        raise ValueError("MESSAGE[ is not closed")
    message = text[len("MESSAGE[") : -1]
    if not 0 < len(message) <= _MESSAGE_CHARS:
        raise ValueError(f"a message has 1 to {_MESSAGE_CHARS} characters")
    return Message(message)


def _assignment(reader: Reader) -> Assign | TakePosition:
    word = reader.next.text
    if word in _NUMBERED:
        reader.take()
        reader.expect("=")
        return Assign(FrameNumber(word), reader.value())
    if word == "PR":
        reader.take()
        if len(reader.next.numbers) == 1:
            index = reader.index()
            reader.expect("=")
            reader.expect("LPOS")
            return TakePosition(index)
        target: Expression = reader.element()
    else:
        target = reader.operand()
    if not isinstance(target, Register | Element | Variable | Signal) or (
        isinstance(target, Signal) and target.kind not in _OUTPUTS
    ):
        raise ValueError(f"{word!r} is no statement and nothing that can be assigned")
    reader.expect("=")
    return Assign(target, reader.value())


def _label(reader: Reader) -> Label:
    return Label(reader.index())


def _jump(reader: Reader) -> Jump:
    reader.expect("LBL")
    return Jump(reader.index())


def _program_name(reader: Reader) -> str:
    name = reader.word()
    if len(name) > _PROGRAM_CHARS:
        raise ValueError(f"{name} is longer than {_PROGRAM_CHARS} characters, which older controllers refuse")
    return name


def _call(reader: Reader) -> Call:
    name = _program_name(reader)
    arguments = []
    if reader.has("("):
        arguments.append(reader.operand())
        while reader.has(","):
            arguments.append(reader.operand())
        reader.expect(")")
    return Call(name, tuple(arguments))


def _run(reader: Reader) -> Run:
    return Run(_program_name(reader))


def _branch(reader: Reader) -> Jump | Call:
    reader.expect(",")
    if reader.has("JMP"):
        return _jump(reader)
    reader.expect("CALL")
    return _call(reader)


def _if(reader: Reader) -> If:
    condition = reader.condition()
    if reader.next.text == "THEN":
        raise ValueError("IF .. THEN blocks are not known to the interpreter")
    if reader.next.text == "," and (action := _conditional_assignment(reader)):
        return If(condition, action)
    return If(condition, _branch(reader))


def _conditional_assignment(reader: Reader) -> Assign | None:
    """Return ``,target=(value)``; None where JMP or CALL follows the comma."""
    if reader.following.text in {"JMP", "CALL"}:
        return None
    reader.expect(",")
    action = _assignment(reader)
    if isinstance(action, TakePosition):
        raise ValueError("IF cannot take a position")  # noqa: TRY004 - every refusal is a ValueError
    return action


def _select(reader: Reader) -> Select:
    reader.expect("R")
    subject = Register(reader.index())
    cases: list[tuple[Expression, Jump | Call]] = []
    otherwise = None
    while reader.has("="):
        value = reader.operand()
        cases.append((value, _branch(reader)))
    if reader.has("ELSE"):
        otherwise = _branch(reader)
    if not cases:
        raise ValueError("SELECT has no case")
    return Select(subject, tuple(cases), otherwise)


def _wait(reader: Reader) -> Wait | Delay:
    if reader.next.kind == "number":
        seconds = reader.number()
        for text in ("(", "sec", ")"):
            reader.expect(text)
        return Delay(seconds)
    condition = reader.condition()
    if not reader.has("TIMEOUT"):
        return Wait(condition, None)
    reader.expect(",")
    reader.expect("LBL")
    return Wait(condition, reader.index())


def _skip_condition(reader: Reader) -> SkipCondition:
    reader.expect("CONDITION")
    return SkipCondition(reader.condition())


def _move(reader: Reader, *, joint: bool) -> Move:
    reader.expect("PR")
    position = reader.index()
    speed = reader.operand()
    for text in ("%",) if joint else ("mm", "/", "sec"):
        reader.expect(text)
    reader.expect("FINE")
    label = None
    if reader.has("Skip"):
        reader.expect(",")
        reader.expect("LBL")
        label = reader.index()
    return Move(joint, position, speed, label)


_KEYWORDS: Final[dict[str, Callable[[Reader], Statement]]] = {
    "LBL": _label,
    "JMP": _jump,
    "CALL": _call,
    "RUN": _run,
    "END": lambda _: End(),
    "IF": _if,
    "SELECT": _select,
    "WAIT": _wait,
    "SKIP": _skip_condition,
    "L": lambda reader: _move(reader, joint=False),
    "J": lambda reader: _move(reader, joint=True),
    "UALM": lambda reader: UserAlarm(reader.index()),
}
