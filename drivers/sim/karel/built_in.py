"""Built-in routines and constants of KAREL, as many as the robot's program of this cell uses.

After the KAREL reference manual and sources of programs that run on controllers. Codes of parameters: ``i r b s`` are
values, ``I R B S`` variables that are written, ``f`` a file, ``p`` a pose, ``j`` joint angles, ``A`` an array of reals,
``v`` any value, ``V`` any variable.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

from drivers.sim.karel.errors import KarelAbort
from drivers.sim.karel.values import BOOLEAN, INTEGER, JOINTPOS, STRING, XYZWPR, integer

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from drivers.sim.karel.values import Cell, FileVariable, Pose, Type

BAD: Final = 1
"""A status that is not 0."""

(RUNNING, PAUSED, ABORTED) = range(3)
_CHARS: Final = 256
_DECIMAL: Final = 10

CONSTANTS: Final[dict[str, int]] = {
    "MAXINT": 2**31 - 1,
    "PG_RUNNING": RUNNING,
    "PG_PAUSED": PAUSED,
    "PG_ABORTED": ABORTED,
    **{
        name: 100 + number  # which numbers they are says nothing
        for number, name in enumerate(
            (
                *("TSK_STATUS", "ATR_IA", "ATR_PASSALL", "ATR_READAHD", "ATR_BAUD", "ATR_DBITS", "ATR_PARITY"),
                *("ATR_SBITS", "ATR_XONOFF", "ATR_MODEM", "PORT_2", "PORT_3", "BAUD_9600", "DBITS_8"),
                *("PARITY_NONE", "SBITS_1", "XF_NOT_USED", "MD_NOT_USED"),
            )
        )
    },
}


class Host(Protocol):
    """The controller that the program runs on; a status of 0 is good."""

    def connected(self, tag: str) -> bool:
        """Whether a client has connected to a server tag (MSG_CONNECT returns then)."""
        ...

    def disconnect(self, tag: str) -> int:
        """Let go of the client."""
        ...

    def open_file(self, file: FileVariable, device: str) -> int:
        """Open a tag or a port."""
        ...

    def close_file(self, file: FileVariable) -> None:
        """Close it."""
        ...

    def bytes_ahead(self, file: FileVariable) -> int | None:
        """Return how many bytes have come; None where the device is gone."""
        ...

    def read(self, file: FileVariable, count: int) -> str | None:
        """Take bytes that have come; None where the device is gone."""
        ...

    def write(self, file: FileVariable | None, text: str) -> int:
        """Send text, or show it where there is no file."""
        ...

    def set_port(self, port: int, attribute: int, value: int) -> int:
        """Set an attribute of a serial port."""
        ...

    def system_variable(self, name: str) -> int | None:
        """Return a system variable; None where there is none."""
        ...

    def set_system_variable(self, name: str, value: int) -> int:
        """Write a system variable."""
        ...

    def select_program_frame(self, target: str, source: str) -> None:
        """Make a frame the one that positions are told in: ``$GROUP[1].$UFRAME = $MNUFRAME[1,1]``."""
        ...

    def port_value(self, kind: int, number: int) -> int | None:
        """Return a signal; None where there is none."""
        ...

    def set_port_value(self, kind: int, number: int, value: int) -> int:
        """Switch an output."""
        ...

    def pose(self) -> Pose | None:
        """Return the TCP's pose."""
        ...

    def joints(self) -> Sequence[float] | None:
        """Return joint angles in degrees."""
        ...

    def set_pose_register(self, number: int, pose: Pose) -> int:
        """Write PR[number]."""
        ...

    def register(self, number: int) -> float:
        """Return R[number]."""
        ...

    def set_register(self, number: int, value: float) -> int:
        """Write R[number]."""
        ...

    def run_task(self, program: str) -> int:
        """Begin a task."""
        ...

    def abort_task(self, program: str, *, cancel_motion: bool) -> int:
        """End a task."""
        ...

    def task_state(self, program: str) -> int | None:
        """Return what a task does; None where there was never one."""
        ...

    def alarm(self) -> tuple[int, str] | None:
        """Return number (facility * 1000 + number) and text of the newest alarm."""
        ...

    def reset(self) -> bool:
        """Reset the controller's fault."""
        ...


@dataclass(frozen=True)
class BuiltIn:
    """A built-in routine.

    Attributes:
        parameters: a code each.
        result: type of what a function returns, None of a procedure.
        call: carries it out.
    """

    parameters: str
    result: Type | None
    call: Callable[..., Any]


def _ord(_: Host, text: str, index: int) -> int:
    if not 1 <= index <= len(text):
        raise KarelAbort(f"INTP-312 ORD at {index} of {len(text)} characters")
    return ord(text[index - 1])


def _sub_str(_: Host, text: str, start: int, length: int) -> str:
    if start < 1 or length < 0 or start + length - 1 > len(text):
        raise KarelAbort(f"INTP-312 SUB_STR from {start}, {length} of {len(text)} characters")
    return text[start - 1 : start - 1 + length]


def _chr(_: Host, code: int) -> str:
    if not 0 <= code < _CHARS:
        raise KarelAbort(f"INTP-312 CHR of {code}")
    return chr(code)


def _int_text(_: Host, value: int, length: int, base: int, target: Cell) -> None:
    if base != _DECIMAL:
        raise KarelAbort(f"the interpreter writes decimal numbers only, not base {base}")
    target.set(f"{value: d}".rjust(length))


def _get(cell: Cell, status: Cell, value: Any) -> None:
    """Write a value and the status that says whether there is one; without it the variable is uninitialised."""
    status.set(0 if value is not None else BAD)
    if value is None:
        cell.value = None
    else:
        cell.set(value)


def _get_reg(host: Host, number: int, is_real: Cell, whole: Cell, fraction: Cell, status: Cell) -> None:
    value = host.register(number)
    is_real.set(not float(value).is_integer())
    (fraction if is_real.value else whole).set(value if is_real.value else int(value))
    status.set(0)


def _joints(_: Host, joints: Sequence[float], target: Cell, status: Cell) -> None:
    for cell, angle in zip(target.value, joints, strict=False):
        cell.set(angle)
    status.set(0)


def _err_data(host: Host, _: int, code: Cell, text: Cell, *rest: Cell) -> None:
    newest = host.alarm()
    if newest is not None:
        code.set(newest[0])
        text.set(newest[1])
        for cell in rest:
            cell.set("" if cell.type == STRING else 0)


def _set_attribute(_: Host, file: FileVariable, attribute: int) -> None:
    file.attributes.add(attribute)


def _status(name: str) -> Callable[..., None]:
    """Return a procedure whose last parameter is the status that the host returns."""

    def call(host: Host, *arguments: Any) -> None:
        arguments[-1].set(getattr(host, name)(*arguments[:-1]))

    return call


BUILT_INS: Final[dict[str, BuiltIn]] = {
    "ABS": BuiltIn("i", INTEGER, lambda _, value: abs(value)),
    "CHR": BuiltIn("i", STRING, _chr),
    "CNV_INT_STR": BuiltIn("iiiS", None, _int_text),
    "INDEX": BuiltIn("ss", INTEGER, lambda _, text, part: text.find(part) + 1),
    "ORD": BuiltIn("si", INTEGER, _ord),
    "ROUND": BuiltIn("r", INTEGER, lambda _, value: integer(round(value))),
    "STR_LEN": BuiltIn("s", INTEGER, lambda _, text: len(text)),
    "SUB_STR": BuiltIn("sii", STRING, _sub_str),
    "UNINIT": BuiltIn("V", BOOLEAN, lambda _, cell: cell.value is None),
    "ABORT_TASK": BuiltIn(
        "sbbI",
        None,
        lambda host, task, _, cancel, status: status.set(host.abort_task(task, cancel_motion=cancel)),
    ),
    "BYTES_AHEAD": BuiltIn("fII", None, lambda host, f, n, status: _get(n, status, host.bytes_ahead(f))),
    "CNV_JPOS_REL": BuiltIn("jAI", None, _joints),
    "CURJPOS": BuiltIn("ii", JOINTPOS, lambda host, *_: host.joints()),
    "CURPOS": BuiltIn("ii", XYZWPR, lambda host, *_: host.pose()),
    "ERR_DATA": BuiltIn("iISISIIS", None, _err_data),
    "GET_PORT_VAL": BuiltIn(
        "iiII", None, lambda host, kind, n, value, status: _get(value, status, host.port_value(kind, n))
    ),
    "GET_REG": BuiltIn("iBIRI", None, _get_reg),
    "GET_TSK_INFO": BuiltIn(
        "sIiISI", None, lambda host, task, _n, _a, value, _s, status: _get(value, status, host.task_state(task))
    ),
    "GET_VAR": BuiltIn(
        "IssVI", None, lambda host, _e, _p, name, value, status: _get(value, status, host.system_variable(name))
    ),
    "IO_STATUS": BuiltIn("f", INTEGER, lambda _, file: file.status),
    "MSG_DISCO": BuiltIn("sI", None, _status("disconnect")),
    "RESET": BuiltIn("B", None, lambda host, done: done.set(host.reset())),
    "RUN_TASK": BuiltIn("sibbiI", None, lambda host, task, _l, _p, _t, _m, status: status.set(host.run_task(task))),
    "SET_FILE_ATR": BuiltIn("fi", None, _set_attribute),
    "SET_INT_REG": BuiltIn("iiI", None, _status("set_register")),
    "SET_PORT_ATR": BuiltIn("iii", INTEGER, lambda host, *arguments: host.set_port(*arguments)),
    "SET_PORT_VAL": BuiltIn("iiiI", None, _status("set_port_value")),
    "SET_POS_REG": BuiltIn("ipI", None, _status("set_pose_register")),
    "SET_REAL_REG": BuiltIn("irI", None, _status("set_register")),
    "SET_VAR": BuiltIn(
        "IssvI",
        None,
        lambda host, _e, _p, name, value, status: status.set(host.set_system_variable(name, value)),
    ),
}
