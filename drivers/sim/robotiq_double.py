"""A Robotiq 2F gripper behind a pseudo-terminal, as a PC sees it through its USB to RS-485 converter.

Written from the instruction manual of the 2F-85 & 2F-140 (sections 4 and 4.7), with its own framing and checksum; it
shares no code with the driver that talks to it. Its motor works in simulated time; the wire is real.
"""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING, Final

from drivers.sim.robotiq_fingers import ENDS, FASTEST, SLOWEST, Contact
from drivers.sim.rtu_line import RtuLine

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

    from drivers.sim.robotiq_fingers import Fingers

_OUTPUTS, _INPUTS = 0x03E8, 0x07D0
_WORDS: Final = 3
_READ_WORDS, _READ_INPUTS, _WRITE_WORDS, _READ_WRITE = 3, 4, 16, 23
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE = 1, 2, 3
_MOST: Final = 125
_ACT, _GTO, _ATR, _ARD = 0x01, 0x08, 0x10, 0x20
_RESET, _ACTIVATING, _ACTIVE = 0, 1, 3
_EARLY, _NOT_ACTIVATED, _UNHEARD = 0x05, 0x07, 0x09
_RELEASING, _ACTIVATION_FAILED, _RELEASED = 0x0B, 0x0D, 0x0F
_UNHEARD_S: Final = 1.0
_RELEASE_S: Final = 3.0
_MOTION_CURRENT, _GRIP_CURRENT = 16, 1
_COUNTS: Final = 255


class RobotiqDouble:
    """The gripper.

    Args:
        fingers: what its motor moves.
        now_s: the time in which it works.
        device_id: its Modbus address.
        hold: lets simulated time stand still while a request is answered.

    Attributes:
        activation_takes_s: how long an activation lasts.
        activation_fails: the next activations end in fault 0x0D.
        fault_code: a fault that is reported until the next reset.
        commands: rACT and its neighbours, rPR, rSP, rFR of every write, in order.
        line: the wire, with its faults.
    """

    def __init__(
        self,
        fingers: Fingers,
        now_s: Callable[[], float],
        device_id: int = 9,
        hold: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext,
    ) -> None:
        self.activation_takes_s = 2.0
        self.activation_fails = False
        self.fault_code = 0
        self.commands: list[tuple[int, int, int, int]] = []
        self.line = RtuLine(self._answer, device_id)
        self._fingers, self._now_s, self._hold = fingers, now_s, hold
        self._lock = threading.RLock()
        self._outputs = [0] * _WORDS
        self._action = 0
        self._request = 0
        self._activated_at_s: float | None = None
        self._released_at_s: float | None = None
        self._failing = False
        self._heard_at_s = now_s()

    def start(self) -> str:
        """Open the pseudo-terminal; return the path of the end that a PC opens."""
        return self.line.start()

    def close(self) -> None:
        """Close the pseudo-terminal, as a converter that is unplugged."""
        self.line.close()

    def make_ready(self) -> None:
        """Be as a gripper that was activated and opened long ago."""
        with self._lock:
            self._action, self._activated_at_s = _ACT | _GTO, self._now_s() - 2.0 * self.activation_takes_s
            self._request = 0

    def lose_power(self) -> None:
        """Be without power for a moment: activation and commands are forgotten, the fingers stay where they are."""
        with self._lock:
            self._fingers.stand()
            self._outputs = [0] * _WORDS
            self._action = self._request = self.fault_code = 0
            self._activated_at_s = self._released_at_s = None

    def _activation(self) -> int:
        if not self._action & _ACT or self._activated_at_s is None:
            return _RESET
        if self._released_at_s is not None:
            return _RESET
        done = self._now_s() - self._activated_at_s >= self.activation_takes_s
        return _ACTIVE if done and not self._failing else _ACTIVATING

    def _fault(self) -> int:
        if self.fault_code:
            return self.fault_code
        now_s = self._now_s()
        if self._released_at_s is not None:
            return _RELEASED if now_s - self._released_at_s >= _RELEASE_S else _RELEASING
        if self._failing and self._activated_at_s is not None:
            return _ACTIVATION_FAILED if now_s - self._activated_at_s >= self.activation_takes_s else 0
        if self._action & _GTO and self._activation() != _ACTIVE:
            return _EARLY if self._action & _ACT else _NOT_ACTIVATED
        return 0

    def _command(self, words: list[int]) -> None:
        """Take the three output words; a real gripper acts on them at once."""
        action, request, speed, force = words[0] >> 8, words[1] & 0xFF, words[2] >> 8, words[2] & 0xFF
        self.commands.append((action, request, speed, force))
        rises = bool(action & _ACT) and not self._action & _ACT
        if not action & _ACT:
            self._activated_at_s = self._released_at_s = None
            self.fault_code = 0
        self._action = action
        if rises:
            self._failing = self.activation_fails
            self._activated_at_s = self._now_s()
            self._fingers.go(ENDS[0], FASTEST)
        if action & _ATR and self._released_at_s is None and self._activation() == _ACTIVE:
            self._released_at_s = self._now_s()
            self._fingers.go(ENDS[0] if action & _ARD else ENDS[1], SLOWEST)
        elif action & _GTO and self._activation() == _ACTIVE and not self._fault():
            self._request = request
            self._fingers.go(request, SLOWEST + (FASTEST - SLOWEST) * speed / _COUNTS)

    def _inputs(self) -> list[int]:
        activation, going = self._activation(), bool(self._action & _GTO)
        contact = self._fingers.contact() if activation == _ACTIVE and going else Contact.MOVING
        state = (self._action & _ACT) | (_GTO if going else 0) | activation << 4 | contact << 6
        fault = self._fault()
        if not fault and self._now_s() - self._heard_at_s > _UNHEARD_S:
            fault = _UNHEARD
        moving = contact is Contact.MOVING and activation == _ACTIVE and going
        current = _MOTION_CURRENT if moving else _GRIP_CURRENT if contact is Contact.WHILE_CLOSING else 0
        return [state << 8, fault << 8 | self._request, round(self._fingers.position) << 8 | current]

    def _answer(self, pdu: bytes) -> bytes:
        """Carry out a request; return the answer, or an exception."""
        with self._hold(), self._lock:
            function = pdu[0]
            try:
                if function in {_READ_WORDS, _READ_INPUTS}:
                    answer = self._read(pdu)
                elif function == _WRITE_WORDS:
                    self._write(pdu[1:])
                    answer = pdu[:5]
                elif function == _READ_WRITE:
                    self._read(pdu)  # refused before anything is written
                    self._write(pdu[5:])
                    answer = self._read(pdu)
                else:
                    answer = bytes([function | 0x80, _ILLEGAL_FUNCTION])
            except IndexError:
                answer = bytes([function | 0x80, _ILLEGAL_ADDRESS])
            except ValueError:
                answer = bytes([function | 0x80, _ILLEGAL_VALUE])
            self._heard_at_s = self._now_s()
            return answer

    def _read(self, pdu: bytes) -> bytes:
        """Return the answer; raises as `_check_range`."""
        first, count = (int.from_bytes(pdu[at : at + 2], "big") for at in (1, 3))
        start, words = (_OUTPUTS, self._outputs) if first < _INPUTS else (_INPUTS, self._inputs())
        _check_range(first - start, count)
        data = b"".join(word.to_bytes(2, "big") for word in words[first - start : first - start + count])
        return bytes([pdu[0], len(data)]) + data

    def _write(self, block: bytes) -> None:
        """Take address, number of words, number of bytes and the words; raises as `_check_range`."""
        first, count = int.from_bytes(block[:2], "big") - _OUTPUTS, int.from_bytes(block[2:4], "big")
        data = block[5:]
        if len(data) != 2 * count or list(block[4:5]) != [len(data)]:
            raise ValueError(len(data))
        _check_range(first, count)
        self._outputs[first : first + count] = [
            int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2)
        ]
        self._command(self._outputs)


def _check_range(first: int, count: int) -> None:
    """Raise ValueError for a number of words that no request may have, IndexError for words that are not there."""
    if not 0 < count <= _MOST:
        raise ValueError(count)
    if first < 0 or first + count > _WORDS:
        raise IndexError(first)
