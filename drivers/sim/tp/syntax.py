"""The statements and expressions of the TP language that the interpreter knows, as data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Constant:
    """A number, or ON and OFF."""

    value: float | bool


@dataclass(frozen=True)
class Register:
    """R[index]."""

    index: int


@dataclass(frozen=True)
class Argument:
    """AR[index]: what CALL has handed over."""

    index: int


@dataclass(frozen=True)
class Signal:
    """DO[index], DI, RO, RI, SI, SO, UI, UO or F."""

    kind: str
    index: int


@dataclass(frozen=True)
class Variable:
    """A system variable, with its index: ``$MNUFRAMENUM[1]``."""

    name: str


@dataclass(frozen=True)
class Element:
    """PR[index,element]: 1 to 6 are X, Y, Z, W, P, R."""

    index: int
    element: int


@dataclass(frozen=True)
class FrameNumber:
    """UFRAME_NUM or UTOOL_NUM."""

    name: str


@dataclass(frozen=True)
class Not:
    """!operand."""

    operand: Expression


@dataclass(frozen=True)
class Binary:
    """Two operands and what stands between them."""

    operator: str
    left: Expression
    right: Expression


Expression = Constant | Register | Argument | Signal | Variable | Element | Not | Binary
Target = Register | Signal | Variable | Element | FrameNumber


@dataclass(frozen=True)
class Remark:
    """A comment, a blank line, or a line that is switched off."""


@dataclass(frozen=True)
class Label:
    """LBL[number]."""

    number: int


@dataclass(frozen=True)
class Jump:
    """JMP LBL[label]."""

    label: int


@dataclass(frozen=True)
class Call:
    """CALL program(arguments)."""

    program: str
    arguments: tuple[Expression, ...] = ()


@dataclass(frozen=True)
class Run:
    """RUN program: as a task beside this one."""

    program: str


@dataclass(frozen=True)
class End:
    """END."""


@dataclass(frozen=True)
class Assign:
    """target=value."""

    target: Target
    value: Expression


@dataclass(frozen=True)
class TakePosition:
    """PR[index]=LPOS: where the TCP is, in the active frames."""

    index: int


@dataclass(frozen=True)
class If:
    """IF condition,action."""

    condition: Expression
    action: Jump | Call | Assign


@dataclass(frozen=True)
class Select:
    """SELECT subject=value,action and its further lines; the first match only."""

    subject: Register
    cases: tuple[tuple[Expression, Jump | Call], ...]
    otherwise: Jump | Call | None


@dataclass(frozen=True)
class Wait:
    """WAIT condition, for ``$WAITTMOUT`` where a label says where to go then."""

    condition: Expression
    timeout_label: int | None


@dataclass(frozen=True)
class Delay:
    """WAIT seconds."""

    seconds: float


@dataclass(frozen=True)
class SkipCondition:
    """SKIP CONDITION: what cancels the moves of this program that end with Skip,LBL[..]."""

    condition: Expression


@dataclass(frozen=True)
class Move:
    """L or J to a position register, FINE.

    Attributes:
        joint: J, whose speed is in per cent; otherwise L, in mm/s.
        position: number of the position register.
        speed: a register or a constant.
        skip_label: where to go when the skip condition has *not* come on the way; it goes on with the next line when
            it has.
    """

    joint: bool
    position: int
    speed: Expression
    skip_label: int | None


@dataclass(frozen=True)
class UserAlarm:
    """UALM[number]: shows ``$UALRM_MSG[number]`` and pauses."""

    number: int


@dataclass(frozen=True)
class Message:
    """MESSAGE[text] on the pendant's user screen."""

    text: str


Statement = (
    Remark
    | Label
    | Jump
    | Call
    | Run
    | End
    | Assign
    | TakePosition
    | If
    | Select
    | Wait
    | Delay
    | SkipCondition
    | Move
    | UserAlarm
    | Message
)


@dataclass(frozen=True)
class Program:
    """One .LS file.

    Attributes:
        name: as in /PROG.
        file: its file's name.
        statements: with the line of the file where each begins.
        labels: number of a label to the index of its statement.
        owns_arm: DEFAULT_GROUP names group 1.
        ignores_pause, ignores_abort: PAUSE_REQUEST and ABORT_REQUEST are not 0.
    """

    name: str
    file: str
    statements: tuple[tuple[int, Statement], ...]
    labels: Mapping[int, int]
    owns_arm: bool
    ignores_pause: bool
    ignores_abort: bool
