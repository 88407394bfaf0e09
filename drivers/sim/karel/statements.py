"""Statements as functions that carry them out.

What may wait (DELAY, MSG_CONNECT, and what contains them) is carried out by a generator that yields seconds; everything
else runs through at once, which is what makes a line of the protocol cheap.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from drivers.sim.karel.errors import KarelAbort
from drivers.sim.karel.expressions import assignable, call, expression, system_name, variable
from drivers.sim.karel.scope import Statement
from drivers.sim.karel.values import BOOLEAN, FILE, FRAME, INTEGER, NOTHING, STRING, FileVariable

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence

    from drivers.sim.karel.scope import Expression, Frame, Reader, Routine, Scope, Signal

_CONNECT_POLL_S: Final = 0.02
_MS: Final = 1000.0


def block(reader: Reader, scope: Scope, *ends: str) -> Statement:
    """Read statements up to, and without, one of the words ``ends``."""
    found: list[Statement] = []
    line = _line(reader)
    reader.skip_ends()
    while not reader.sees(*ends):
        found.append(_statement(reader, scope))
        if not reader.sees(*ends):
            reader.end_of_statement()
    return _sequence(line, found)


def _sequence(line: str, statements: Sequence[Statement]) -> Statement:
    runs = [(statement.line, statement.run) for statement in statements]

    def run(frame: Frame) -> Signal:
        at = line
        try:
            for at, carry_out in runs:  # noqa: B007 - `at` tells where it went wrong
                ended = carry_out(frame)
                if ended is not None:
                    return ended
        except KarelAbort as abort:
            abort.line = abort.line or at
            raise
        return None

    def wait(frame: Frame) -> Generator[float, None, Signal]:
        for statement in statements:
            try:
                ended = statement.run(frame) if statement.wait is None else (yield from statement.wait(frame))
            except KarelAbort as abort:
                abort.line = abort.line or statement.line
                raise
            if ended is not None:
                return ended
        return None

    return Statement(line, run, wait if any(statement.wait for statement in statements) else None)


def _statement(reader: Reader, scope: Scope) -> Statement:
    line, word = _line(reader), reader.now.text
    if word in _READERS:
        reader.next()
        return _READERS[word](reader, scope, line)
    if word.startswith("$"):
        return _system_assignment(reader, scope, line)
    if word in scope.local_names or word in scope.variables:
        return _assignment(reader, scope, line)
    if reader.now.kind != "word":
        raise reader.error(f"a statement cannot begin with {word!r}")
    reader.next()
    if word == "MSG_CONNECT":
        return _msg_connect(reader, scope, line)
    routine, called = call(reader, scope, word)
    if called.type != NOTHING:
        raise reader.error(f"what {word} returns is not used")
    return _procedure(routine, called, line)


def _procedure(routine: Routine | None, called: Expression, line: str) -> Statement:
    body = None if routine is None else routine.body
    if routine is not None and body is not None and body.wait is not None:
        waiting, made = body.wait, routine
        if routine.parameters:
            raise KarelAbort(f"{routine.name} waits: the interpreter calls it without parameters only")

        def wait(_: Frame) -> Generator[float, None, Signal]:
            yield from waiting(made.frame([]))
            return None

        return Statement(line, _discard(called.value), wait)
    return Statement(line, _discard(called.value))


def _discard(value: Callable[[Frame], Any]) -> Callable[[Frame], Signal]:
    def run(frame: Frame) -> Signal:
        value(frame)
        return None

    return run


def _assignment(reader: Reader, scope: Scope, line: str) -> Statement:
    target = variable(reader, scope)
    reader.expect("=")
    source = expression(reader, scope)
    if target.cell is None or not assignable(target.type, source.type):
        raise reader.error(f"{source.type.name} cannot be written to {target.type.name}")
    cell, value = target.cell, source.value

    def run(frame: Frame) -> Signal:
        cell(frame).set(value(frame))
        return None

    return Statement(line, run)


def _system_assignment(reader: Reader, scope: Scope, line: str) -> Statement:
    """Read an assignment of frames such as ``$GROUP[1].$UFRAME = $MNUFRAME[1, 2]``."""
    target = system_name(reader, scope)
    reader.expect("=")
    source = expression(reader, scope)
    if source.type != FRAME:
        raise reader.error("the interpreter writes only frames to system variables; SET_VAR writes numbers")

    def run(frame: Frame) -> Signal:
        scope.host.select_program_frame(target(frame), source.value(frame))
        return None

    return Statement(line, run)


def _if(reader: Reader, scope: Scope, line: str) -> Statement:
    condition = _condition(reader, scope)
    reader.expect("THEN")
    then = block(reader, scope, "ELSE", "ENDIF")
    otherwise = block(reader, scope, "ENDIF") if reader.accepts("ELSE") else _sequence(line, [])
    reader.expect("ENDIF")

    def run(frame: Frame) -> Signal:
        return (then if condition(frame) else otherwise).run(frame)

    def wait(frame: Frame) -> Generator[float, None, Signal]:
        chosen = then if condition(frame) else otherwise
        return chosen.run(frame) if chosen.wait is None else (yield from chosen.wait(frame))

    return Statement(line, run, wait if then.wait or otherwise.wait else None)


def _while(reader: Reader, scope: Scope, line: str) -> Statement:
    condition = _condition(reader, scope)
    reader.expect("DO")
    body = block(reader, scope, "ENDWHILE")
    reader.expect("ENDWHILE")

    def run(frame: Frame) -> Signal:
        while condition(frame):
            ended = body.run(frame)
            if ended is not None:
                return ended
        return None

    def wait(frame: Frame) -> Generator[float, None, Signal]:
        while condition(frame):
            ended = body.run(frame) if body.wait is None else (yield from body.wait(frame))
            if ended is not None:
                return ended
        return None

    return Statement(line, run, wait if body.wait else None)


def _for(reader: Reader, scope: Scope, line: str) -> Statement:
    counter = variable(reader, scope)
    reader.expect("=")
    first = expression(reader, scope)
    reader.expect("TO")
    last = expression(reader, scope)
    reader.expect("DO")
    body = block(reader, scope, "ENDFOR")
    reader.expect("ENDFOR")
    if not counter.type == first.type == last.type == INTEGER or counter.cell is None:
        raise reader.error("FOR counts with INTEGER")
    if body.wait is not None:
        raise reader.error("the interpreter does not wait inside of FOR")
    cell = counter.cell

    def run(frame: Frame) -> Signal:
        counted = cell(frame)
        for number in range(first.value(frame), last.value(frame) + 1):
            counted.value = number
            ended = body.run(frame)
            if ended is not None:
                return ended
        return None

    return Statement(line, run)


def _return(reader: Reader, scope: Scope, line: str) -> Statement:
    wanted = None if scope.routine is None else scope.routine.result
    if wanted is None:
        return Statement(line, lambda _: (None,))
    reader.expect("(")
    result = expression(reader, scope)
    reader.expect(")")
    if not assignable(wanted, result.type):
        raise reader.error(f"{wanted.name} is to be returned, not {result.type.name}")
    value = result.value
    return Statement(line, lambda frame: (value(frame),))


def _delay(reader: Reader, scope: Scope, line: str) -> Statement:
    duration = expression(reader, scope)
    if duration.type != INTEGER:
        raise reader.error("DELAY takes milliseconds as INTEGER")

    def wait(frame: Frame) -> Generator[float, None, Signal]:
        yield duration.value(frame) / _MS
        return None

    return Statement(line, _never, wait)


def _msg_connect(reader: Reader, scope: Scope, line: str) -> Statement:
    """Read MSG_CONNECT(tag, status), which returns when a client has connected."""
    reader.expect("(")
    tag = expression(reader, scope)
    reader.expect(",")
    status = variable(reader, scope)
    reader.expect(")")
    if tag.type != STRING or status.type != INTEGER or status.cell is None:
        raise reader.error("MSG_CONNECT takes a tag and a status variable")
    cell = status.cell

    def wait(frame: Frame) -> Generator[float, None, Signal]:
        while not scope.host.connected(tag.value(frame)):
            yield _CONNECT_POLL_S
        cell(frame).set(0)
        return None

    return Statement(line, _never, wait)


def _never(_: Frame) -> Signal:
    raise KarelAbort("the interpreter waits only in procedures that the main program calls")


def _connect_timer(reader: Reader, scope: Scope, line: str) -> Statement:
    for word in ("TIMER", "TO"):
        reader.expect(word)
    timer = variable(reader, scope)
    if timer.type != INTEGER or timer.cell is None:
        raise reader.error("a timer is an INTEGER")
    cell = timer.cell

    def run(frame: Frame) -> Signal:
        found = cell(frame)
        found.set(0)
        scope.timers.append(found)
        return None

    return Statement(line, run)


def _open(reader: Reader, scope: Scope, line: str) -> Statement:
    reader.expect("FILE")
    file = _file(reader, scope)
    reader.expect("(")
    usage = expression(reader, scope)
    reader.expect(",")
    device = expression(reader, scope)
    reader.expect(")")
    if usage.type != STRING or device.type != STRING:
        raise reader.error("OPEN FILE takes usage and device as STRING")

    def run(frame: Frame) -> Signal:
        opened = file(frame)
        opened.status = scope.host.open_file(opened, device.value(frame))
        return None

    return Statement(line, run)


def _close(reader: Reader, scope: Scope, line: str) -> Statement:
    reader.expect("FILE")
    file = _file(reader, scope)

    def run(frame: Frame) -> Signal:
        scope.host.close_file(file(frame))
        return None

    return Statement(line, run)


def _read(reader: Reader, scope: Scope, line: str) -> Statement:
    """Read READ file(text::count): that many bytes, uninitialised where there are none any more."""
    file = _file(reader, scope)
    reader.expect("(")
    text = variable(reader, scope)
    reader.expect("::")
    count = expression(reader, scope)
    reader.expect(")")
    if text.type != STRING or text.cell is None or count.type != INTEGER:
        raise reader.error("READ takes a STRING and a count")
    cell = text.cell

    def run(frame: Frame) -> Signal:
        opened, target = file(frame), cell(frame)
        got = scope.host.read(opened, count.value(frame))
        opened.status = 0 if got is not None else 1
        target.value = None
        if got is not None:
            target.set(got)
        return None

    return Statement(line, run)


def _write(reader: Reader, scope: Scope, line: str) -> Statement:
    """Read WRITE file(item, ...) or, without a file, what is shown to the user."""
    file = None if reader.sees("(") else _file(reader, scope)
    items: list[Expression | None] = []
    reader.expect("(")
    while not reader.accepts(")"):
        if items:
            reader.expect(",")
        items.append(None if reader.accepts("CR") else expression(reader, scope))

    def run(frame: Frame) -> Signal:
        text = "".join("\n" if item is None else str(item.value(frame)) for item in items)
        opened = None if file is None else file(frame)
        status = scope.host.write(opened, text)
        if opened is not None:
            opened.status = status
        return None

    return Statement(line, run)


def _file(reader: Reader, scope: Scope) -> Callable[[Frame], FileVariable]:
    found = variable(reader, scope)
    if found.type != FILE:
        raise reader.error("a FILE is expected")
    return found.value


def _condition(reader: Reader, scope: Scope) -> Callable[[Frame], bool]:
    condition = expression(reader, scope)
    if condition.type != BOOLEAN:
        raise reader.error(f"a condition is BOOLEAN, not {condition.type.name}")
    return condition.value


def _line(reader: Reader) -> str:
    return f"{reader.now.file}, line {reader.now.line}"


_READERS: Final[dict[str, Callable[[Reader, Scope, str], Statement]]] = {
    "CLOSE": _close,
    "CONNECT": _connect_timer,
    "DELAY": _delay,
    "FOR": _for,
    "IF": _if,
    "OPEN": _open,
    "READ": _read,
    "RETURN": _return,
    "WHILE": _while,
    "WRITE": _write,
}
